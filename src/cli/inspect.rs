//! `aventail inspect FILE...`: what files hold, and whether they lie on one grid.

use crate::error::Result;
use crate::io::inspect::{Inspection, compare_grids, inspect};
use clap::Args;
use serde::Serialize;
use std::fmt::Write as _;
use std::path::PathBuf;

/// Options of `inspect`.
#[derive(Debug, Args)]
pub struct InspectArgs {
    /// Images, label maps or displacement fields
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
}

/// The text, or with `json` the JSON document, that describes `files`.
///
/// # Errors
/// When a file cannot be read or its geometry cannot be used.
pub fn run(files: &[PathBuf], json: bool) -> Result<String> {
    let files = files.iter().map(inspect).collect::<Result<Vec<_>>>()?;
    let grids = compare_grids(&files);
    if json {
        let report = Report { files: &files, grids };
        return crate::io::json(&report);
    }
    let mut text = files.iter().map(ToString::to_string).collect::<Vec<_>>().join("\n");
    if !grids.is_empty() {
        text.push('\n');
    }
    for line in &grids {
        writeln!(text, "{line}").expect("writing to a String cannot fail");
    }
    Ok(text)
}
