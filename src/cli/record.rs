//! What a run whose results have no report of their own leaves beside them: its command line, its inputs, and the
//! checksums of what it wrote, which `aventail inspect` verifies.

use super::terminal::command_line;
use crate::error::Result;
pub(super) use crate::io::checksum::{Output, outputs};
use crate::io::{RunFolder, relative_to, write_json};
use crate::provenance::InputFile;
use serde::Serialize;
use std::path::{Path, PathBuf};

/// The record of a run.
#[derive(Serialize)]
struct RunRecord {
    version: &'static str,
    command: String,
    inputs: Vec<InputFile>,
    outputs: Vec<Output>,
}

/// Writes the record of a run as `name` into its folder `out`, after all other files.
///
/// # Errors
/// [`crate::error::Error::Write`] when it cannot be written.
pub(super) fn write(folder: &RunFolder, out: &Path, name: &str, inputs: Vec<InputFile>) -> Result<()> {
    write_of(&folder.written(), out, name, inputs)
}

/// Writes the record of the files named.
///
/// # Errors
/// [`crate::error::Error::Write`] when it cannot be written.
pub(super) fn write_of(names: &[PathBuf], out: &Path, name: &str, mut inputs: Vec<InputFile>) -> Result<()> {
    inputs.iter_mut().for_each(|input| input.path = relative_to(out, &input.path));
    let outputs = outputs(out, names)?;
    let record = RunRecord { version: env!("CARGO_PKG_VERSION"), command: command_line(), inputs, outputs };
    write_json(out.join(name), &record)
}
