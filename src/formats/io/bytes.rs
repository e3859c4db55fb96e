//! Bytes of files, with errors that say what to do, and their SHA-256.

use crate::error::{Error, Result};
use sha2::{Digest, Sha256};
use std::fmt::Write as _;
use std::fs::File;
use std::io::{self, BufReader, ErrorKind, Read as _};
use std::path::Path;

/// Bytes that are read before a file's length is judged; every header ends within them.
const FIRST: u64 = 1 << 24;
/// Bytes that a file may have beyond what its header promises.
const SLACK: u64 = 1 << 26;
/// Longest text or mesh.
const MOST_TEXT: u64 = 1 << 31;

/// Bytes that are read at once where a file is streamed: in the processor's cache, and few calls.
const PIECE: usize = 1 << 18;

/// SHA-256 of one file's bytes, which are streamed.
pub(super) fn sha256_of(path: &Path) -> Result<String> {
    let mut hash = Sha256::new();
    let mut bytes = BufReader::with_capacity(PIECE, open(path)?);
    io::copy(&mut bytes, &mut hash).map_err(|e| unreadable(path, &e))?;
    Ok(hex(&hash.finalize()))
}

/// SHA-256 of bytes, as 64 hexadecimal digits.
pub fn sha256(bytes: &[u8]) -> String {
    hex(&Sha256::digest(bytes))
}

fn hex(digest: &[u8]) -> String {
    digest.iter().fold(String::with_capacity(2 * digest.len()), |mut text, byte| {
        write!(text, "{byte:02x}").expect("writing to a String cannot fail");
        text
    })
}

/// All bytes of a text or mesh file that should hold something.
pub(super) fn read_bytes(path: &Path) -> Result<Vec<u8>> {
    read_bytes_of(path, &|_| Ok(MOST_TEXT))
}

/// All bytes of a file that should hold something. Where there are many, `most` tells from the first of them how many there
/// can be: a longer file is refused before it fills the memory.
pub(super) fn read_bytes_of(path: &Path, most: &dyn Fn(&[u8]) -> Result<u64>) -> Result<Vec<u8>> {
    let mut file = open(path)?;
    // Room at once: growing copies what was read. A length that the system makes up is not believed.
    let length = file.metadata().map_or(0, |m| m.len());
    let mut bytes = Vec::with_capacity(length.min(FIRST) as usize);
    let mut read =
        |bytes: &mut Vec<u8>, upto: u64| file.by_ref().take(upto).read_to_end(bytes).map_err(|e| unreadable(path, &e));
    if read(&mut bytes, FIRST)? as u64 == FIRST {
        let most = most(&bytes)?.saturating_add(SLACK).max(FIRST);
        if length <= most {
            bytes.reserve_exact(length.saturating_sub(FIRST) as usize);
            read(&mut bytes, most - FIRST + 1)?;
        }
        if length > most || bytes.len() as u64 > most {
            let problem = format!("it is far longer than its header promises: more than {most} bytes");
            return Err(Error::read(path, problem, "the header is damaged, or not this file's: export it again"));
        }
    }
    if bytes.is_empty() {
        return Err(Error::read(path, "the file is empty (0 bytes)", "copy or export it again"));
    }
    Ok(bytes)
}

pub(super) fn open(path: &Path) -> Result<File> {
    if path.is_dir() {
        let remedy = "name one file";
        return Err(Error::read(path, "it is a folder", remedy));
    }
    File::open(path).map_err(|e| unreadable(path, &e))
}

fn unreadable(path: &Path, error: &io::Error) -> Error {
    match error.kind() {
        ErrorKind::NotFound => Error::read(path, "no such file", "check the path"),
        ErrorKind::PermissionDenied => Error::read(path, "permission denied", "make the file readable for you"),
        _ => Error::read(path, error.to_string(), "check the disk, or copy the file again"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn refusals_name_the_file() {
        let dir = tempfile::tempdir().unwrap();
        let empty = dir.path().join("empty.nii");
        std::fs::write(&empty, b"").unwrap();
        for (path, word) in
            [(dir.path().join("none.nii"), "no such file"), (dir.path().into(), "folder"), (empty, "empty")]
        {
            let err = read_bytes(&path).unwrap_err();
            assert_eq!(err.exit_code(), 3);
            let text = err.to_string();
            assert!(text.contains(word) && text.contains(&path.display().to_string()), "{text}");
        }
    }
}
