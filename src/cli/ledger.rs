//! The files that a verb reads and what reading them found, for its report.

use crate::config::InputRole;
use crate::error::{Error, Result};
use crate::io::{self, Loaded, dicom};
use crate::pipeline::InputFile;
use crate::volume::LabelMap;
use crate::warning::Warning;
use std::path::Path;

/// The files behind the inputs and what reading them found.
#[derive(Default)]
pub(super) struct Ledger {
    pub(super) inputs: Vec<InputFile>,
    pub(super) warnings: Vec<Warning>,
}

impl Ledger {
    /// Takes a file's value and notes the file.
    pub(super) fn take<T>(&mut self, role: InputRole, loaded: Loaded<T>) -> T {
        self.inputs.push(InputFile::new(role, loaded.path, loaded.sha256));
        self.warnings.extend(loaded.warnings);
        loaded.value
    }

    /// Takes a scan, which may tell whose it is.
    pub(super) fn take_scan<T>(&mut self, role: InputRole, loaded: Loaded<T>) -> T {
        let about = dicom::About::of(&loaded.path);
        let value = self.take(role, loaded);
        self.inputs.iter_mut().rev().take(1).for_each(|input| input.about.clone_from(&about));
        value
    }

    /// The files, as seen from the folder of the report that names them.
    pub(super) fn seen_from(&self, folder: &Path) -> Vec<InputFile> {
        let own = |i: &InputFile| InputFile { path: io::relative_to(folder, &i.path), ..i.clone() };
        self.inputs.iter().map(own).collect()
    }

    /// Reads a label map of bones: names from its header, else from the JSON file.
    pub(super) fn bones(&mut self, role: InputRole, path: &Path, names: Option<&Path>) -> Result<LabelMap> {
        let loaded = match (io::read_labels(path, None), names) {
            (Err(Error::Input { .. }), Some(names)) => io::read_labels(path, Some(names)),
            (read, _) => read,
        };
        Ok(self.take(role, loaded?))
    }

    /// Reads a label map of structures: names as for bones, and one name is one structure whatever its numbers.
    pub(super) fn structures(&mut self, role: InputRole, path: &Path, names: Option<&Path>) -> Result<LabelMap> {
        Ok(self.take(role, io::read_structures(path, names)?))
    }
}
