//! Atomic writing: a temporary file in the same folder, renamed when complete, removed on failure.

use crate::error::{Error, Result};
use std::fs::{File, OpenOptions};
use std::io::{self, BufWriter, ErrorKind, Write};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};

/// Tells apart temporary files of one process.
static SERIAL: AtomicU64 = AtomicU64::new(0);

/// A temporary file that disappears unless it is renamed.
struct Partial {
    path: PathBuf,
    kept: bool,
}

impl Drop for Partial {
    fn drop(&mut self) {
        if !self.kept {
            // Nothing more can be done if removal fails too; the error that led here is the one to report.
            let _ = std::fs::remove_file(&self.path);
        }
    }
}

/// Writes a whole file or leaves what was there before: `fill` gets a buffered writer on a temporary file beside `path`.
///
/// # Errors
/// [`Error::Write`] when the folder is missing, not writable or full, or when `path` is a folder.
pub fn write_file(path: impl AsRef<Path>, fill: impl FnOnce(&mut dyn Write) -> io::Result<()>) -> Result<()> {
    let path = path.as_ref();
    if path.is_dir() {
        return Err(Error::write(path, "it is a folder", "name a file"));
    }
    let mut partial = Partial { path: temporary(path)?, kept: false };
    write_and_rename(&mut partial, path, fill).map_err(|e| refusal(path, &e))
}

fn write_and_rename(
    partial: &mut Partial,
    path: &Path,
    fill: impl FnOnce(&mut dyn Write) -> io::Result<()>,
) -> io::Result<()> {
    let file: File = OpenOptions::new().write(true).create_new(true).open(&partial.path)?;
    let mut out = BufWriter::with_capacity(1 << 16, file);
    fill(&mut out)?;
    out.into_inner().map_err(io::IntoInnerError::into_error)?;
    std::fs::rename(&partial.path, path)?;
    partial.kept = true;
    Ok(())
}

/// A hidden name beside `path` that no other writer of this machine uses.
fn temporary(path: &Path) -> Result<PathBuf> {
    let Some(name) = path.file_name() else {
        return Err(Error::write(path, "the path names no file", "give a file name"));
    };
    let serial = SERIAL.fetch_add(1, Ordering::Relaxed);
    let hidden = format!(".{}.{}-{serial}.partial", name.to_string_lossy(), std::process::id());
    Ok(path.with_file_name(hidden))
}

/// The error of a failed write, with the remedy that fits its cause.
fn refusal(path: &Path, error: &io::Error) -> Error {
    let remedy = match error.kind() {
        ErrorKind::NotFound | ErrorKind::NotADirectory => "create the folder first, or choose another place",
        ErrorKind::PermissionDenied | ErrorKind::ReadOnlyFilesystem => "choose a folder that you may write to",
        ErrorKind::StorageFull | ErrorKind::QuotaExceeded | ErrorKind::FileTooLarge => {
            "free some space, or choose another disk"
        }
        _ => "check the disk, or choose another place",
    };
    Error::write(path, error.to_string(), remedy)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn listing(folder: &Path) -> Vec<String> {
        let mut names: Vec<_> =
            std::fs::read_dir(folder).unwrap().map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
        names.sort();
        names
    }

    #[test]
    fn failure_keeps_the_old_file_and_leaves_nothing_else() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("case.01.nii");
        write_file(&path, |out| out.write_all(b"old")).unwrap();
        let err = write_file(&path, |out| {
            out.write_all(b"new")?;
            Err(io::Error::from(ErrorKind::StorageFull))
        });
        assert!(matches!(err, Err(Error::Write { .. })));
        assert_eq!(std::fs::read(&path).unwrap(), b"old");
        assert_eq!(listing(dir.path()), ["case.01.nii"]);
        write_file(&path, |out| out.write_all(b"newer")).unwrap();
        assert_eq!(std::fs::read(&path).unwrap(), b"newer");
        assert_eq!(listing(dir.path()), ["case.01.nii"]);
    }

    #[test]
    fn places_that_cannot_be_written() {
        let dir = tempfile::tempdir().unwrap();
        for path in [dir.path().join("missing/a.nii"), dir.path().to_path_buf(), PathBuf::from("/")] {
            let err = write_file(&path, |out| out.write_all(b"x")).unwrap_err();
            assert_eq!(err.exit_code(), 5, "{err}");
        }
    }
}
