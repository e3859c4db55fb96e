//! JSON for machines: indented, whole or not at all.

use super::atomic::write_file;
use crate::error::{Error, Result};
use serde::Serialize;
use std::path::Path;

/// A value as JSON.
///
/// # Errors
/// [`Error::Internal`] when it holds what JSON cannot.
pub fn json<T: Serialize + ?Sized>(value: &T) -> Result<String> {
    serde_json::to_string_pretty(value).map_err(|e| Error::Internal(format!("a value as JSON: {e}")))
}

/// Writes a value as JSON.
///
/// # Errors
/// As [`json`], and [`Error::Write`] when the file cannot be written.
pub fn write_json<T: Serialize + ?Sized>(path: impl AsRef<Path>, value: &T) -> Result<()> {
    let text = json(value)?;
    write_file(path, |out| out.write_all(text.as_bytes()))
}
