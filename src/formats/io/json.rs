//! JSON for machines: indented, whole or not at all.

use super::atomic::write_file;
use crate::error::{Error, Result};
use serde::Serialize;
use serde::de::DeserializeOwned;
use std::path::Path;

/// Whether a file is JSON by its name.
pub fn is_json(path: &Path) -> bool {
    path.extension().is_some_and(|e| e.eq_ignore_ascii_case("json"))
}

/// A value as JSON.
///
/// # Errors
/// [`Error::Internal`] when it holds what JSON cannot.
pub fn json<T: Serialize + ?Sized>(value: &T) -> Result<String> {
    serde_json::to_string_pretty(value).map_err(|e| Error::Internal(format!("a value as JSON: {e}")))
}

/// Reads a value that was written as JSON.
///
/// # Errors
/// [`Error::Read`] with this remedy when the file is missing or holds something else.
pub fn read_json<T: DeserializeOwned>(path: &Path, remedy: &str) -> Result<T> {
    let text = std::fs::read(path).map_err(|e| Error::read(path, e.to_string(), remedy))?;
    serde_json::from_slice(&text).map_err(|e| Error::read(path, format!("it holds something else ({e})"), remedy))
}

/// Writes a value as JSON.
///
/// # Errors
/// As [`json`], and [`Error::Write`] when the file cannot be written.
pub fn write_json<T: Serialize + ?Sized>(path: impl AsRef<Path>, value: &T) -> Result<()> {
    let text = json(value)?;
    write_file(path, |out| out.write_all(text.as_bytes()))
}
