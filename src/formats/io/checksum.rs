//! SHA-256 of files and of DICOM series.

pub use super::bytes::sha256;
use super::bytes::{open, sha256_of};
use super::dicom;
use super::series_path::root_of;
use crate::error::Result;
use serde::Serialize;
use std::path::{Path, PathBuf};

/// SHA-256 of a file's bytes, as 64 hexadecimal digits. The file is streamed, not loaded. Of the folder of a DICOM series, or
/// a series in it (`FOLDER#NUMBER`), it is that of the sorted SHA-256 of the files that the series is read from, one a line.
///
/// # Errors
/// [`Error::Read`](crate::error::Error::Read) when the file is missing or unreadable, or a folder without DICOM; as for reading a series.
pub fn sha256_file(path: impl AsRef<Path>) -> Result<String> {
    let path = path.as_ref();
    if is_folder(path) { dicom::checksum(path) } else { sha256_of(path) }
}

/// Whether a file, or the folder of a DICOM series, can be opened, for those that are read long after the work has begun.
///
/// # Errors
/// [`Error::Read`](crate::error::Error::Read) when the file is missing or unreadable, or a folder without DICOM.
pub fn require_file(path: impl AsRef<Path>) -> Result<()> {
    let path = path.as_ref();
    if is_folder(path) { dicom::require(path) } else { open(path).map(drop) }
}

/// A file that was written.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Output {
    /// Its name as seen from the folder of the record.
    name: String,
    /// SHA-256 of its bytes, hexadecimal.
    sha256: String,
}

/// Checksums of files of a folder.
///
/// # Errors
/// [`Error::Read`](crate::error::Error::Read) when one cannot be read back.
pub fn outputs(folder: &Path, names: &[PathBuf]) -> Result<Vec<Output>> {
    let one = |name: &PathBuf| {
        let sha256 = sha256_file(folder.join(name))?;
        Ok(Output { name: name.to_string_lossy().into_owned(), sha256 })
    };
    names.iter().map(one).collect()
}

/// Whether a path is a folder, or names a series in one.
fn is_folder(path: &Path) -> bool {
    root_of(path).is_dir()
}

#[cfg(test)]
mod tests {
    use super::super::bytes::read_bytes;
    use super::*;

    #[test]
    fn known_digest_both_ways() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("abc");
        std::fs::write(&path, b"abc").unwrap();
        let expected = "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad";
        assert_eq!(sha256_file(&path).unwrap(), expected);
        assert_eq!(sha256(&read_bytes(&path).unwrap()), expected);
    }
}
