//! Text of files: byte order marks, and text that may be shown.

use super::bytes::read_bytes;
use crate::error::{Error, Result};
use std::path::Path;

/// What some editors put before UTF-8 text.
pub(super) const BYTE_ORDER_MARK: &[u8] = b"\xef\xbb\xbf";

/// A text file without its byte order mark.
///
/// # Errors
/// [`Error::Read`] when it cannot be read or is no UTF-8 text.
pub(super) fn read_text(path: &Path) -> Result<String> {
    text_of(path, read_bytes(path)?)
}

/// Bytes of a file as text without its byte order mark.
///
/// # Errors
/// As [`read_text`].
pub(super) fn text_of(path: &Path, mut bytes: Vec<u8>) -> Result<String> {
    if bytes.starts_with(BYTE_ORDER_MARK) {
        bytes.drain(..BYTE_ORDER_MARK.len());
    }
    if bytes.starts_with(b"\xff\xfe") || bytes.starts_with(b"\xfe\xff") {
        return Err(Error::read(path, "it is UTF-16 text", "save it as UTF-8"));
    }
    if let Some(other) = super::kinds::told(&bytes) {
        let remedy = format!("{}, or check whether two files are swapped", other.remedy);
        return Err(Error::read(path, format!("it is {}", other.what), remedy));
    }
    String::from_utf8(bytes)
        .map_err(|e| Error::read(path, format!("it is no UTF-8 text ({e})"), "save it as UTF-8 text"))
}

/// A header's text on one line, without characters that steer a terminal.
pub(super) fn plain_text(text: &str) -> String {
    let plain = |c: char| if c.is_control() { ' ' } else { c };
    text.trim_matches(|c: char| c.is_control() || c.is_whitespace()).chars().map(plain).collect()
}
