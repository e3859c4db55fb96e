//! The page of a run of several fractions, above their folders.

use super::super::record;
use super::super::terminal::command_line;
use super::super::{planned, run_folder};
use crate::config::InputRole;
use crate::error::Result;
use crate::io::{self, RunFolder};
use crate::provenance::InputFile;
use crate::report::Fractions;
use serde::Serialize;
use std::path::{Path, PathBuf};
use std::time::{SystemTime, UNIX_EPOCH};

/// The page, and what a machine reads of it.
const PAGE: &str = "index.html";
const JSON: &str = "index.json";

/// The folder above those of the fractions, held until its index is written.
pub(super) struct Index {
    folder: RunFolder,
    out: PathBuf,
}

#[derive(Serialize)]
struct IndexWritten<'a> {
    #[serde(flatten)]
    fractions: &'a Fractions,
    inputs: Vec<InputFile>,
    outputs: Vec<record::Output>,
}

impl Index {
    /// Takes hold of the folder of a run that reads `files`.
    ///
    /// # Errors
    /// As [`RunFolder::open`].
    pub(super) fn hold(out: &Path, files: &[&Path]) -> Result<Self> {
        let folder = run_folder(out, &planned(&[JSON, PAGE], &[]), files)?;
        Ok(Self { folder, out: out.to_owned() })
    }

    /// Removes the index of an earlier run: it tells of other results from now on.
    ///
    /// # Errors
    /// [`crate::error::Error::Write`] when it cannot be removed.
    pub(super) fn begin(&mut self) -> Result<()> {
        self.folder.begin()
    }

    /// Writes the index of the fractions, which are finished; returns the page.
    ///
    /// # Errors
    /// When a report cannot be read again, or the page not be written.
    pub(super) fn write(self, names: &[&str]) -> Result<PathBuf> {
        let created = SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |d| d.as_secs());
        let fractions = Fractions::read(&self.out, names, created, command_line())?;
        fractions.write(&self.out)?;
        let report = |name: &&str| {
            let mut input = InputFile::read(InputRole::Report, &self.out.join(name).join("report.json"))?;
            input.path = io::relative_to(&self.out, &input.path);
            Ok(input)
        };
        let inputs = names.iter().map(report).collect::<Result<_>>()?;
        let outputs = record::outputs(&self.out, &[PAGE.into()])?;
        io::write_json(self.out.join(JSON), &IndexWritten { fractions: &fractions, inputs, outputs })?;
        self.folder.finish();
        Ok(self.out.join(PAGE))
    }
}
