//! Atomic writing: a temporary file in the same folder, on the disk before it is renamed, removed on failure.
//!
//! A temporary file is made new under a name of its own and locked while its writer lives, so that what a killed process
//! has left can be told from what is being written, on whatever machine.

use super::held::{Held, spare_runs};
use super::identity::is_still;
use crate::error::{Error, Result};
use std::cell::Cell;
use std::fs::{File, OpenOptions, TryLockError};
use std::io::{self, BufWriter, ErrorKind, Write};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

/// Tells apart temporary files of one process.
static SERIAL: AtomicU64 = AtomicU64::new(0);
/// How the name of a temporary file ends.
const SUFFIX: &str = ".partial";
/// Names that are tried for a temporary file.
const TRIES: usize = 1000;

/// A temporary file that disappears unless it is renamed.
struct Partial {
    path: PathBuf,
    file: File,
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
/// In a folder that a run holds, the file is noted as one of the run's.
///
/// # Errors
/// [`Error::Write`] when the folder is missing, not writable or full, or when `path` is a folder; [`Error::Input`] when it
/// is an input of the run that holds the folder.
pub fn write_file(path: impl AsRef<Path>, fill: impl FnOnce(&mut dyn Write) -> io::Result<()>) -> Result<()> {
    let path = path.as_ref();
    if path.is_dir() {
        return Err(Error::write(path, "it is a folder", "name a file"));
    }
    let failed = |e: io::Error| refusal(path, &e);
    let mut partial = Partial::new(path)?;
    let mut out = BufWriter::with_capacity(1 << 16, &partial.file);
    fill(&mut out).and_then(|()| out.flush()).map_err(failed)?;
    drop(out);
    synced(&partial.file).map_err(failed)?;
    Held::note(path)?;
    std::fs::rename(&partial.path, path).map_err(failed)?;
    partial.kept = true;
    Ok(())
}

/// How long a thread without work sleeps before it asks again whether the disk is done.
const NAP: Duration = Duration::from_micros(200);

/// Files that a thread of a pool waits for at most while it works on: what it does meanwhile lies on its stack.
const MOST_WAITED: usize = 4;

thread_local! {
    /// Files that this thread waits for.
    static WAITED: Cell<usize> = const { Cell::new(0) };
}

/// Waits until the bytes are on the disk; a thread of a pool works on meanwhile.
fn synced(file: &File) -> io::Result<()> {
    let waited = WAITED.get();
    if rayon::current_thread_index().is_none() || waited == MOST_WAITED {
        return file.sync_data();
    }
    WAITED.set(waited + 1);
    let done = work_until_synced(file);
    WAITED.set(waited);
    done
}

fn work_until_synced(file: &File) -> io::Result<()> {
    std::thread::scope(|scope| {
        let disk = scope.spawn(|| file.sync_data());
        while !disk.is_finished() {
            if rayon::yield_now() != Some(rayon::Yield::Executed) {
                std::thread::sleep(NAP);
            }
        }
        disk.join().unwrap_or_else(|_| Err(io::Error::other("the thread that waited for the disk has ended")))
    })
}

/// Makes the folder where it is missing, proves that it can be written to, and clears what killed processes have left.
///
/// # Errors
/// [`Error::Write`] when it cannot be made or written to.
pub fn open_folder(folder: &Path) -> Result<()> {
    let remedy =
        if folder.is_file() { "this is a file: name a folder" } else { "choose a folder that you may write to" };
    let refuse = |e: io::Error| Error::write(folder, e.to_string(), remedy);
    std::fs::create_dir_all(folder).map_err(refuse)?;
    sweep(folder);
    Partial::create(&folder.join("probe")).map_err(refuse).map(drop)
}

/// Proves that a single result can be written before anything long begins, and clears what killed processes have left
/// in its folder.
///
/// # Errors
/// [`Error::Write`] when the folder is missing or cannot be written to, or `path` is a folder; [`Error::Input`] when it is a
/// file of a run whose report lies there.
pub fn check_place(path: &Path) -> Result<()> {
    if path.is_dir() {
        return Err(Error::write(path, "it is a folder", "name a file"));
    }
    spare_runs(path)?;
    sweep(path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new(".")));
    Partial::new(path).map(drop)
}

/// Removes temporary files whose writers are gone; what cannot be removed stays.
pub(super) fn sweep(folder: &Path) {
    for entry in std::fs::read_dir(folder).into_iter().flatten().flatten() {
        if is_partial(&entry.file_name().to_string_lossy()) {
            let _ = remove_abandoned(&entry.path());
        }
    }
}

/// Whether a name is that of a temporary file: `.NAME.PROCESS-NUMBER.partial`.
pub(super) fn is_partial(name: &str) -> bool {
    let number = |text: &str| !text.is_empty() && text.bytes().all(|b| b.is_ascii_digit());
    let serial = name.strip_suffix(SUFFIX).and_then(|n| n.strip_prefix('.')).and_then(|n| n.rsplit_once('.'));
    serial.and_then(|(_, s)| s.split_once('-')).is_some_and(|(process, n)| number(process) && number(n))
}

fn remove_abandoned(path: &Path) -> io::Result<()> {
    if !std::fs::symlink_metadata(path)?.is_file() {
        return Ok(());
    }
    let file = OpenOptions::new().read(true).write(true).open(path)?;
    if file.try_lock().is_ok() && is_still(path, &file.metadata()?) {
        std::fs::remove_file(path)?;
    }
    Ok(())
}

impl Partial {
    /// A new file beside `path`.
    fn new(path: &Path) -> Result<Self> {
        if path.file_name().is_none() {
            return Err(Error::write(path, "the path names no file", "give a file name"));
        }
        Self::create(path).map_err(|e| refusal(path, &e))
    }

    fn create(path: &Path) -> io::Result<Self> {
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        // Another machine may have taken a name, or whoever clears up a file before it was locked.
        for _ in 0..TRIES {
            let serial = SERIAL.fetch_add(1, Ordering::Relaxed);
            let hidden = path.with_file_name(format!(".{name}.{}-{serial}{SUFFIX}", std::process::id()));
            let file = match OpenOptions::new().read(true).write(true).create_new(true).open(&hidden) {
                Err(e) if e.kind() == ErrorKind::AlreadyExists => continue,
                opened => opened?,
            };
            match file.try_lock() {
                Err(TryLockError::WouldBlock) => continue,
                // Where files have no locks nobody clears up.
                Err(TryLockError::Error(_)) => {}
                Ok(()) if !is_still(&hidden, &file.metadata()?) => continue,
                Ok(()) => {}
            }
            return Ok(Self { path: hidden, file, kept: false });
        }
        Err(ErrorKind::AlreadyExists.into())
    }
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
    use rayon::prelude::*;

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
    fn one_thread_writes_many_files_while_it_waits_for_the_disk() {
        let dir = tempfile::tempdir().unwrap();
        let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
        let deepest = std::sync::atomic::AtomicUsize::new(0);
        let write = |n: usize| {
            deepest.fetch_max(WAITED.get(), Ordering::Relaxed);
            write_file(dir.path().join(n.to_string()), |out| out.write_all(n.to_string().as_bytes()))
        };
        pool.install(|| (0..60).into_par_iter().with_max_len(1).try_for_each(write)).unwrap();
        let same = |n: usize| std::fs::read_to_string(dir.path().join(n.to_string())).unwrap() == n.to_string();
        assert!((0..60).all(same) && listing(dir.path()).len() == 60);
        assert!(deepest.into_inner() <= MOST_WAITED);
    }

    #[test]
    fn what_killed_writers_left_is_cleared_and_nothing_else() {
        let dir = tempfile::tempdir().unwrap();
        let at = |name: &str| dir.path().join(name);
        for name in [".a.nii.gz.4711-0.partial", ".notes.partial", "b.partial", ".c.1-x.partial"] {
            std::fs::write(at(name), b"x").unwrap();
        }
        let alive = Partial::create(&at("d.nii")).unwrap();
        open_folder(dir.path()).unwrap();
        let own = alive.path.file_name().unwrap().to_string_lossy().into_owned();
        let mut expected = [".c.1-x.partial", ".notes.partial", "b.partial", own.as_str()];
        expected.sort_unstable();
        assert_eq!(listing(dir.path()), expected);
        drop(alive);
        assert_eq!(listing(dir.path()).len(), 3);
    }

    #[cfg(unix)]
    #[test]
    fn links_in_the_place_of_hidden_files_are_not_followed() {
        let dir = tempfile::tempdir().unwrap();
        let at = |name: String| dir.path().join(name);
        std::fs::create_dir(at("out".into())).unwrap();
        std::fs::write(at("victim".into()), b"precious").unwrap();
        let next = SERIAL.load(Ordering::Relaxed);
        // Whatever other tests do meanwhile, some of these names come up.
        for serial in next..next + 200 {
            for name in ["probe", "a.nii"] {
                let link = format!("out/.{name}.{}-{serial}.partial", std::process::id());
                std::os::unix::fs::symlink("../victim", at(link)).unwrap();
            }
        }
        open_folder(&at("out".into())).unwrap();
        write_file(at("out/a.nii".into()), |out| out.write_all(b"new")).unwrap();
        assert_eq!(std::fs::read(at("victim".into())).unwrap(), b"precious");
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
