//! `aventail inspect PATH...`: what files hold, whether they lie on one grid, and whether folders hold what their reports
//! say.

use crate::error::Result;
use crate::io::inspect::{FolderCheck, Inspection, check_folder, compare_grids, inspect};
use clap::Args;
use serde::Serialize;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};

/// Options of `inspect`.
#[derive(Debug, Args)]
pub struct InspectArgs {
    /// Images, label maps or displacement fields; or folders of runs (of a single result the JSON beside it), whose files are
    /// checked against their reports
    #[arg(required = true, value_name = "FILE")]
    pub files: Vec<PathBuf>,
    /// Print JSON
    #[arg(long)]
    pub json: bool,
}

/// What `--json` prints.
#[derive(Serialize)]
struct Report<'a> {
    files: &'a [Inspection],
    grids: Vec<String>,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    folders: Vec<FolderCheck>,
}

/// Whether a file is JSON by its name: the record of a run.
fn is_record(path: &Path) -> bool {
    path.extension().is_some_and(|e| e.eq_ignore_ascii_case("json"))
}

/// The text, or with `json` the JSON document, that describes `files`.
///
/// # Errors
/// When a file cannot be read or its geometry cannot be used, and when a folder does not hold what its report says.
pub fn run(files: &[PathBuf], json: bool) -> Result<String> {
    let (folders, files): (Vec<&PathBuf>, Vec<&PathBuf>) =
        files.iter().partition(|path| path.is_dir() || is_record(path));
    let folders = folders.into_iter().map(|path| check_folder(path)).collect::<Result<Vec<_>>>()?.concat();
    folders.iter().try_for_each(FolderCheck::require)?;
    let files = files.into_iter().map(inspect).collect::<Result<Vec<_>>>()?;
    let grids = compare_grids(&files);
    if json {
        let report = Report { files: &files, grids, folders };
        return crate::io::json(&report);
    }
    let shown = folders.iter().map(ToString::to_string).chain(files.iter().map(ToString::to_string));
    let mut text = shown.collect::<Vec<_>>().join("\n");
    if !grids.is_empty() {
        text.push('\n');
    }
    for line in &grids {
        writeln!(text, "{line}").expect("writing to a String cannot fail");
    }
    Ok(text)
}
