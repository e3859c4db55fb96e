//! `aventail inspect PATH...`: what files and folders hold, whether images lie on one grid, and whether folders of runs hold what their reports
//! say.

use super::args::JsonArgs;
use crate::error::Result;
use crate::findings;
use crate::io::dicom::{Summary, is_listed, summary, summary_without};
use crate::io::inspect::{FolderCheck, Inspection, check_folder, compare_grids, images, inspect};
use crate::io::is_json;
use clap::Args;
use serde::Serialize;
use std::collections::BTreeSet;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};

/// Options of `inspect`.
#[derive(Debug, Args)]
pub struct InspectArgs {
    /// Images, label maps or displacement fields, or folders of them; DICOM folders or files, to list
    /// their contents; folders of runs (or the JSON beside a single result), to check their files
    /// against the recorded checksums
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

/// What lies at a path.
#[derive(Default)]
struct Found {
    runs: Vec<FolderCheck>,
    dicom: Option<Summary>,
    images: Vec<PathBuf>,
}

impl Found {
    /// A file is a record of a run, a list of DICOM, or an image; a folder may hold all of them.
    fn at(path: &Path, anonymous: bool) -> Result<Self> {
        // JSON is the record of a run.
        if is_json(path) {
            return Ok(Self { runs: check_folder(path)?, ..Self::default() });
        }
        if is_listed(path) {
            return Ok(Self { dicom: Some(summary(path, anonymous)?), ..Self::default() });
        }
        if !path.is_dir() {
            return Ok(Self { images: vec![path.to_owned()], ..Self::default() });
        }
        let (runs, no_run) = match check_folder(path) {
            Err(error) if error.is(findings::NO_RUN) => (Vec::new(), Some(error)),
            checked => (checked?, None),
        };
        // What a run wrote is told with it.
        let own: BTreeSet<PathBuf> = runs.iter().flat_map(FolderCheck::files).collect();
        let (dicom, images) = (summary_without(path, anonymous, &own)?, images(path, &own)?);
        match no_run.filter(|_| dicom.is_none() && images.is_empty()) {
            Some(error) => Err(error),
            None => Ok(Self { runs, dicom, images }),
        }
    }
}

/// The text, or with `json` the JSON document, that describes `files`.
///
/// # Errors
/// When a file cannot be read or its geometry cannot be used, and when a folder does not hold what its report says.
pub fn run(files: &[PathBuf], json: bool, anonymous: bool) -> Result<String> {
    let (mut folders, mut dicom, mut plain) = (Vec::new(), Vec::new(), Vec::new());
    for path in files {
        let found = Found::at(path, anonymous)?;
        folders.extend(found.runs);
        dicom.extend(found.dicom);
        plain.extend(found.images);
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
