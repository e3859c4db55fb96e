//! Folders that this process holds: the locked file in each, what it lists, and the inputs that stay as they are.
//!
//! The lock is the operating system's: it ends with the process, however that ends. Where the file system has no locks, runs
//! are not kept apart.

use super::identity::{Identity, has_other_names, identity, is_still};
use crate::error::{Error, Result};
use crate::findings;
use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;
use std::fs::{File, OpenOptions, TryLockError};
use std::io::{self, ErrorKind, Read, Seek, Write};
use std::path::{Component, Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

/// The file that is locked.
pub(super) const LOCK: &str = ".aventail-run";
/// Files that tell in `outputs` what a run has written.
pub(super) const REPORTS: [&str; 11] = [
    "report.json",
    "evaluation.json",
    "dvh_run.json",
    "compare.json",
    "curve.json",
    "study.json",
    "concepts.json",
    "phantom.json",
    "library.json",
    "summary.json",
    "samples.json",
];

/// The folders that this process holds.
static HELD: Mutex<Vec<Arc<Held>>> = Mutex::new(Vec::new());

/// A folder that is held.
#[derive(Debug)]
pub(super) struct Held {
    /// Without links.
    pub(super) folder: PathBuf,
    pub(super) inputs: Vec<Guarded>,
    pub(super) journal: Mutex<Journal>,
}

/// The locked file and what it lists.
#[derive(Debug)]
pub(super) struct Journal {
    pub(super) file: File,
    pub(super) written: BTreeSet<PathBuf>,
}

/// The first line of the locked file.
#[derive(Serialize, Deserialize)]
struct Owner {
    process: u32,
    command: String,
}

/// An input that no result may take the place of.
#[derive(Debug)]
pub(super) struct Guarded {
    /// As it was named.
    pub(super) input: PathBuf,
    /// The file or folder itself; nothing where it is not there.
    pub(super) identity: Option<Identity>,
    /// The folder whose files belong to it, without links.
    pub(super) folder: Option<PathBuf>,
    /// Which files of that folder do.
    pub(super) is_part: fn(&Path) -> bool,
}

impl Guarded {
    /// Refuses a result that is this input or belongs to it.
    ///
    /// # Errors
    /// [`Error::Input`].
    pub(super) fn spare(&self, output: &Path) -> Result<()> {
        let Some(own) = identity(output) else { return Ok(()) };
        let inside = || Some(std::fs::canonicalize(output).ok()?.starts_with(self.folder.as_ref()?));
        let part = || output.is_file() && (self.is_part)(output) && inside().unwrap_or(false);
        if self.identity.as_ref() != Some(&own) && !part() {
            return Ok(());
        }
        let (input, output) = (self.input.display().to_string(), output.display().to_string());
        let problem = if input == output {
            "the result would take the place of this input".to_owned()
        } else {
            format!("the result {output} is the same file and would take the place of this input")
        };
        Err(Error::refused(
            findings::INPUT_OVERWRITTEN,
            input,
            problem,
            "give another --out, or copy the input elsewhere",
        ))
    }
}

impl Held {
    pub(super) fn journal(&self) -> MutexGuard<'_, Journal> {
        self.journal.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Notes that `path` is about to be put in its place, if it lies in a folder that is held.
    ///
    /// # Errors
    /// [`Error::Input`] when it is an input of that run.
    pub(super) fn note(path: &Path) -> Result<()> {
        let parent = path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
        let (Ok(parent), Some(name)) = (std::fs::canonicalize(parent), path.file_name()) else { return Ok(()) };
        let real = parent.join(name);
        // The innermost, where one folder that is held lies in another.
        let deep = |held: &&Arc<Self>| held.folder.components().count();
        let held = all_held().iter().filter(|h| real.starts_with(&h.folder)).max_by_key(deep).cloned();
        let Some(held) = held else { return Ok(()) };
        held.inputs.iter().try_for_each(|input| input.spare(path))?;
        if let Ok(own) = real.strip_prefix(&held.folder) {
            let mut journal = held.journal();
            if journal.written.insert(own.to_owned())
                && let Some(line) = line(own)
            {
                let noted = journal.file.write_all(line.as_bytes());
                noted.map_err(|e| Error::write(path, e.to_string(), "free some space, or check the disk"))?;
            }
        }
        Ok(())
    }
}

pub(super) fn all_held() -> MutexGuard<'static, Vec<Arc<Held>>> {
    HELD.lock().unwrap_or_else(PoisonError::into_inner)
}

/// A name as a line of the locked file; names of outputs are plain text.
pub(super) fn line(name: &Path) -> Option<String> {
    name.to_str().filter(|n| !n.contains('\n')).map(|n| format!("{n}\n"))
}

/// Takes the lock; returns the file and what a killed run has listed there.
pub(super) fn lock(folder: &Path, command: &str) -> Result<(File, BTreeSet<PathBuf>)> {
    let path = folder.join(LOCK);
    let refuse = |e: io::Error| Error::write(folder, e.to_string(), "choose a folder that you may write to");
    // Again, where the file was another's that has just gone.
    for _ in 0..100 {
        let new = OpenOptions::new().read(true).write(true).create_new(true).open(&path);
        let mut file = match new {
            Err(e) if e.kind() == ErrorKind::AlreadyExists => match existing(&path) {
                Err(e) if e.kind() == ErrorKind::NotFound => continue,
                opened => opened.map_err(refuse)?,
            },
            opened => opened.map_err(refuse)?,
        };
        match file.try_lock() {
            Err(TryLockError::WouldBlock) => return Err(busy(folder, &mut file)),
            Ok(()) | Err(TryLockError::Error(_)) => {}
        }
        let open = file.metadata().map_err(refuse)?;
        if !is_still(&path, &open) {
            continue;
        }
        if has_other_names(&open) {
            std::fs::remove_file(&path).map_err(refuse)?;
            continue;
        }
        let (_, unfinished) = content(&mut file);
        let owner = Owner { process: std::process::id(), command: command.to_owned() };
        let first = serde_json::to_string(&owner).map_err(|e| Error::Internal(e.to_string()))?;
        let rest: String = unfinished.iter().filter_map(|name| line(name)).collect();
        let text = format!("{first}\n{rest}");
        let write = |file: &mut File| {
            file.set_len(0)?;
            file.rewind()?;
            file.write_all(text.as_bytes())
        };
        write(&mut file).map_err(refuse)?;
        return Ok((file, unfinished));
    }
    Err(Error::write(folder, format!("{LOCK} there cannot be locked"), "remove that file, if no run is at work"))
}

/// The file of another run, alive or not; a link in its place is removed, not followed.
fn existing(path: &Path) -> io::Result<File> {
    let kind = std::fs::symlink_metadata(path)?.file_type();
    if kind.is_symlink() {
        std::fs::remove_file(path)?;
        return Err(ErrorKind::NotFound.into());
    }
    if !kind.is_file() {
        return Err(io::Error::other(format!("{LOCK} there is no file")));
    }
    OpenOptions::new().read(true).write(true).open(path)
}

/// Who has locked the file, and the names that it lists.
fn content(file: &mut File) -> (Option<Owner>, BTreeSet<PathBuf>) {
    let mut bytes = Vec::new();
    if file.rewind().and_then(|()| file.read_to_end(&mut bytes)).is_err() {
        return (None, BTreeSet::new());
    }
    let text = String::from_utf8_lossy(&bytes);
    let mut lines = text.lines();
    let owner = lines.next().and_then(|first| serde_json::from_str(first).ok());
    (owner, lines.map(PathBuf::from).filter(|name| is_inside(name)).collect())
}

/// The refusal of a folder that another process holds.
fn busy(folder: &Path, file: &mut File) -> Error {
    let mut owner = content(file).0;
    if owner.is_none() {
        // It may just have begun.
        std::thread::sleep(Duration::from_millis(50));
        owner = content(file).0;
    }
    let who = owner.map_or_else(|| "another process".into(), |o| format!("process {} ({})", o.process, o.command));
    Error::write(folder, format!("{who} is writing its run there"), "wait until it is done, or give another --out")
}

/// Whether a file is the one by which a folder is held.
pub fn is_lock(path: &Path) -> bool {
    path.file_name().is_some_and(|name| name == LOCK)
}

/// Who is at work in a folder, without taking it.
pub fn at_work(folder: &Path) -> Option<String> {
    let mut file = File::open(folder.join(LOCK)).ok()?;
    let owner = content(&mut file).0;
    let who = owner.map_or_else(|| "a process".into(), |o| format!("process {} ({})", o.process, o.command));
    Some(match file.try_lock_shared() {
        Err(TryLockError::WouldBlock) => format!("{who} is at work there"),
        _ => format!("{who} was stopped before its run there was complete"),
    })
}

/// Whether a file is the report of a run for machines: it lists what the run has written.
pub(super) fn is_report(file: &Path) -> bool {
    let text = std::fs::read(file).unwrap_or_default();
    serde_json::from_slice::<serde_json::Value>(&text).is_ok_and(|report| report["outputs"].is_array())
}

/// Names in `outputs` of a report, which may be another tool's or damaged: those that lie in its folder.
pub(super) fn outputs_of(report: &Path) -> BTreeSet<PathBuf> {
    let text = std::fs::read(report).unwrap_or_default();
    let value: serde_json::Value = serde_json::from_slice(&text).unwrap_or_default();
    let names = value["outputs"].as_array().into_iter().flatten().filter_map(|o| o["name"].as_str());
    names.map(PathBuf::from).filter(|name| is_inside(name)).collect()
}

/// Refuses a single result that would take the place of a file of a run whose report lies beside it.
///
/// # Errors
/// [`Error::Input`] with the file and the report by name.
pub(super) fn spare_runs(output: &Path) -> Result<()> {
    let folder = output.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let Some(name) = output.file_name().map(Path::new) else { return Ok(()) };
    match REPORTS.iter().find(|r| Path::new(r) == name || outputs_of(&folder.join(r)).contains(name)) {
        Some(report) if folder.join(report).is_file() => Err(of_another_run(folder, name, report)),
        _ => Ok(()),
    }
}

pub(super) fn of_another_run(folder: &Path, name: &Path, report: &str) -> Error {
    let problem = format!("{} there belongs to the run that {report} tells of", name.display());
    let remedy = "give another --out: a folder holds one run";
    Error::refused(findings::FOLDER_OF_ANOTHER_RUN, folder.display().to_string(), problem, remedy)
}

/// Whether a path leads nowhere but downwards.
pub(super) fn is_inside(name: &Path) -> bool {
    name.components().next().is_some() && name.components().all(|c| matches!(c, Component::Normal(_)))
}
