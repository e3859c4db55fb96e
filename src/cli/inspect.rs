//! `aventail inspect PATH...`: what files and folders of DICOM hold, whether they lie on one grid, and whether folders hold what their reports
//! say.

use super::args::JsonArgs;
use crate::error::Result;
use crate::findings;
use crate::io::dicom::{Summary, is_structure_set, summary};
use crate::io::inspect::{FolderCheck, Inspection, check_folder, compare_grids, inspect};
use clap::Args;
use serde::Serialize;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};

/// Options of `inspect`.
#[derive(Debug, Args)]
pub struct InspectArgs {
    /// Images, label maps or displacement fields; DICOM folders or files, to list their contents;
    /// folders of runs (or the JSON beside a single result), to check their files against the
    /// recorded checksums
    #[arg(required = true, value_name = "FILE")]
    pub files: Vec<PathBuf>,
    /// How the result is told.
    #[command(flatten)]
    pub told: JsonArgs,
    /// For DICOM, do not print the patient's name, number and date of birth
    #[arg(long)]
    pub anonymous: bool,
}

/// What `--json` prints.
#[derive(Serialize)]
struct InspectedReport<'a> {
    files: &'a [Inspection],
    grids: Vec<String>,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    folders: Vec<FolderCheck>,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    dicom: Vec<Summary>,
}

/// What a path is described as.
enum InspectedKind {
    Run(Vec<FolderCheck>),
    Dicom(Summary),
    File,
}

/// A folder of runs is one, whatever else it holds; other folders are described by their DICOM.
fn kind(path: &Path, anonymous: bool) -> Result<InspectedKind> {
    if is_record(path) {
        return check_folder(path).map(InspectedKind::Run);
    }
    if is_structure_set(path) {
        return summary(path, anonymous).map(InspectedKind::Dicom);
    }
    if !path.is_dir() {
        return Ok(InspectedKind::File);
    }
    match check_folder(path) {
        Err(error) if error.is(findings::NO_RUN) => {
            summary(path, anonymous).map(InspectedKind::Dicom).map_err(|_| error)
        }
        checked => checked.map(InspectedKind::Run),
    }
}

/// Whether a file is JSON by its name: the record of a run.
fn is_record(path: &Path) -> bool {
    path.extension().is_some_and(|e| e.eq_ignore_ascii_case("json"))
}

/// The text, or with `json` the JSON document, that describes `files`.
///
/// # Errors
/// When a file cannot be read or its geometry cannot be used, and when a folder does not hold what its report says.
pub fn run(files: &[PathBuf], json: bool, anonymous: bool) -> Result<String> {
    let (mut folders, mut dicom, mut plain) = (Vec::new(), Vec::new(), Vec::new());
    for path in files {
        match kind(path, anonymous)? {
            InspectedKind::Run(checks) => folders.extend(checks),
            InspectedKind::Dicom(summary) => dicom.push(summary),
            InspectedKind::File => plain.push(path),
        }
    }
    folders.iter().try_for_each(FolderCheck::require)?;
    let files = plain.into_iter().map(inspect).collect::<Result<Vec<_>>>()?;
    let grids = compare_grids(&files);
    if json {
        let report = InspectedReport { files: &files, grids, folders, dicom };
        return crate::io::json(&report);
    }
    let shown = folders.iter().map(ToString::to_string).chain(dicom.iter().map(ToString::to_string));
    let shown = shown.chain(files.iter().map(ToString::to_string));
    let mut text = shown.collect::<Vec<_>>().join("\n");
    if !grids.is_empty() {
        text.push('\n');
    }
    for line in &grids {
        writeln!(text, "{line}").expect("writing to a String cannot fail");
    }
    Ok(text)
}
