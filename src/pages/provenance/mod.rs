//! Rank 9: where the inputs of a run come from, and what reading them found. It travels beside the case, which holds values alone.

use crate::config::{InputRole, RecordedInput};
use crate::error::Result;
use crate::findings;
use crate::io::checksum::sha256_file;
use crate::io::dicom::About;
use crate::io::{Loaded, relative_to};
use crate::warning::Warning;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// One input file with its checksum.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct InputFile {
    /// What it is to the run.
    pub role: InputRole,
    /// Path as given; in a report as seen from its folder.
    #[serde(serialize_with = "crate::io::path_as_text")]
    pub path: PathBuf,
    /// SHA-256 of its bytes, hexadecimal.
    pub sha256: String,
    /// What was given behind `#`: which of its entries it is, or its space, where the file alone does not tell.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub entry: Option<String>,
    /// What it says of itself, where it is a series of a clinic.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub about: Option<About>,
}

impl InputFile {
    /// Of a role, a path and the checksum of what was read there.
    pub fn new(role: InputRole, path: PathBuf, sha256: String) -> Self {
        Self { role, path, sha256, entry: None, about: None }
    }

    /// A file whose bytes are read for their checksum.
    ///
    /// # Errors
    /// [`crate::error::Error::Read`] when it cannot be read.
    pub fn read(role: InputRole, path: &Path) -> Result<Self> {
        Ok(Self::new(role, path.to_owned(), sha256_file(path)?))
    }

    /// Leaves the patient's identity out, which reports repeat otherwise.
    pub fn forget_patient(&mut self) {
        self.about = self.about.take().map(About::anonymous);
    }

    /// What an earlier run recorded in its place, where the bytes are others now.
    pub fn recorded_otherwise<'a>(&self, recorded: &'a [RecordedInput]) -> Option<&'a RecordedInput> {
        recorded.iter().find(|r| r.role == self.role && r.sha256 != self.sha256)
    }
}

/// The files behind the inputs of a run, and what reading them found.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Provenance {
    /// The files, in the order in which a report lists them.
    pub inputs: Vec<InputFile>,
    /// Legal but unusual findings.
    pub warnings: Vec<Warning>,
}

impl Provenance {
    /// Takes a file's value and notes the file.
    pub fn take<T>(&mut self, role: InputRole, loaded: Loaded<T>) -> T {
        self.inputs.push(InputFile::new(role, loaded.path, loaded.sha256));
        self.warnings.extend(loaded.warnings);
        loaded.value
    }

    /// Takes a scan or its labels, which may tell whose they are.
    pub fn take_scan<T>(&mut self, role: InputRole, loaded: Loaded<T>) -> T {
        let about = About::of(&loaded.path);
        let value = self.take(role, loaded);
        self.inputs.iter_mut().rev().take(1).for_each(|input| input.about.clone_from(&about));
        value
    }

    /// Notes a file whose value somebody else reads.
    ///
    /// # Errors
    /// [`crate::error::Error::Read`] when it cannot be read.
    pub fn note(&mut self, role: InputRole, path: &Path) -> Result<()> {
        self.inputs.push(InputFile::read(role, path)?);
        Ok(())
    }

    /// Warns of files that are no longer what an earlier run has recorded.
    pub fn compare(&mut self, recorded: &[RecordedInput]) {
        let warn = |input: &InputFile| {
            let then = input.recorded_otherwise(recorded)?;
            let short = |sum: &str| sum.get(..12).unwrap_or(sum).to_owned();
            let message = format!(
                "{} is not the file of the recorded run (SHA-256 {}..., then {}...)",
                input.path.display(),
                short(&input.sha256),
                short(&then.sha256)
            );
            Some(Warning::new(findings::INPUT_CHANGED, message))
        };
        self.warnings.extend(self.inputs.iter().filter_map(warn));
    }

    /// Goes on with what is known of further inputs.
    pub fn extend(&mut self, more: Self) {
        self.inputs.extend(more.inputs);
        self.warnings.extend(more.warnings);
    }

    /// Leaves the patient's identity out of it.
    pub fn forget_patient(&mut self) {
        self.inputs.iter_mut().for_each(InputFile::forget_patient);
    }

    /// The file of a role, where there is one.
    pub fn file(&self, role: InputRole) -> Option<&Path> {
        self.inputs.iter().find(|input| input.role == role).map(|input| input.path.as_path())
    }

    /// The files, as seen from the folder of the report that names them.
    pub fn seen_from(&self, folder: &Path) -> Vec<InputFile> {
        let own = |i: &InputFile| InputFile { path: relative_to(folder, &i.path), ..i.clone() };
        self.inputs.iter().map(own).collect()
    }
}
