//! The folder of a run: held by one process at a time, rid of what an earlier run left before anything is written, and
//! known file by file.
//!
//! While a run holds a folder, a hidden file there is locked for it. It tells which process works, and which files it has
//! written so far, so that the next run removes them if this one is killed. The lock is the operating system's: it ends
//! with the process, however that ends. Where the file system has no locks, runs are not kept apart.

use super::atomic::sweep;
use super::guard::{check_files, guarded};
use super::held::{
    Held, Journal, LOCK, REPORTS, all_held, is_inside, is_report, line, lock, of_another_run, outputs_of,
};
use crate::error::{Error, Result};
use crate::findings;
use std::collections::BTreeSet;
use std::io::{self, ErrorKind, Write};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex};

/// Folders in a run's folder that hold files of the run, the inner ones first.
pub(super) const PARTS: [&str; 10] = [
    "report",
    "pictures",
    "stages",
    "fraction_2",
    "dicom/planning",
    "dicom/fraction",
    "dicom/fraction_2",
    "dicom/registration",
    "dicom/ct",
    "dicom",
];
/// What every page of ours holds.
const OWN: &[u8] = b"aventail";

/// What a run is going to write into its folder.
#[derive(Debug, Clone, Default)]
pub struct Planned {
    /// The files that tell what was written, the one for machines first: they go first and come last.
    pub reports: Vec<String>,
    /// Names of all other files, as far as they are known before.
    pub names: Vec<String>,
}

/// A folder that this process holds until this is dropped. What was written since [`RunFolder::begin`] is removed with it
/// unless [`RunFolder::finish`] is called.
#[derive(Debug)]
pub struct RunFolder {
    held: Arc<Held>,
    /// What the runs before have written, and is still to be removed.
    leftovers: BTreeSet<PathBuf>,
    reports: Vec<String>,
    /// Folders in it that hold files of the run, the inner ones first.
    parts: Vec<PathBuf>,
    /// Folders that were made for it, the outermost first: they go with a run that has written nothing.
    made: Vec<PathBuf>,
    begun: bool,
    finished: bool,
}

impl RunFolder {
    /// Makes the folder where it is missing and takes hold of it. `command` is what this process is asked for, for the
    /// message that others get meanwhile.
    ///
    /// # Errors
    /// [`Error::Write`] when the folder cannot be written to or another process holds it; [`Error::Read`] when an input is
    /// missing; [`Error::Input`] when an input would be overwritten or removed, or a file of another verb's run.
    pub fn open(folder: &Path, planned: &Planned, inputs: &[&Path], command: &str) -> Result<Self> {
        let at = |name: &String| folder.join(name);
        let all: Vec<PathBuf> = planned.reports.iter().chain(&planned.names).map(at).collect();
        check_files(inputs, &all)?;
        let remedy =
            if folder.is_file() { "this is a file: name a folder" } else { "choose a folder that you may write to" };
        let refuse = |e: io::Error| Error::write(folder, e.to_string(), remedy);
        let mut made: Vec<PathBuf> = folder.ancestors().take_while(|f| missing(f)).map(Path::to_owned).collect();
        made.reverse();
        std::fs::create_dir_all(folder).map_err(refuse)?;
        let real = std::fs::canonicalize(folder).map_err(refuse)?;
        let (file, unfinished) = lock(folder, command)?;
        let journal = Mutex::new(Journal { file, written: BTreeSet::new() });
        let held = Arc::new(Held { folder: real, inputs: guarded(inputs), journal });
        all_held().push(Arc::clone(&held));
        let mut parts: Vec<PathBuf> = PARTS.iter().map(PathBuf::from).collect();
        let more: BTreeSet<&Path> = planned.names.iter().filter_map(|name| Path::new(name).parent()).collect();
        parts.extend(more.into_iter().rev().filter(|part| is_inside(part)).map(Path::to_owned));
        let reports = planned.reports.clone();
        let mut own = Self { held, leftovers: unfinished, reports, parts, made, begun: false, finished: false };
        sweep(folder);
        own.parts.iter().for_each(|part| sweep(&folder.join(part)));
        own.earlier(folder, planned)?;
        own.spares_others(folder, planned)?;
        Ok(own)
    }

    /// Adds what an earlier run of this verb wrote to what is to be removed, and refuses what must stay.
    fn earlier(&mut self, folder: &Path, planned: &Planned) -> Result<()> {
        for report in REPORTS {
            let outputs = outputs_of(&folder.join(report));
            if planned.reports.iter().any(|own| own == report) {
                self.leftovers.extend(outputs);
            } else if let Some(name) = planned.names.iter().find(|n| outputs.contains(Path::new(n))) {
                return Err(of_another_run(folder, Path::new(name), report));
            }
        }
        let inputs = &self.held.inputs;
        let spare = |name: &PathBuf| inputs.iter().try_for_each(|input| input.spare(&folder.join(name)));
        self.leftovers.iter().try_for_each(spare)
    }

    /// Refuses to take the place of a page that no run of ours has written.
    fn spares_others(&self, folder: &Path, planned: &Planned) -> Result<()> {
        // The report for machines tells of the page beside it.
        if planned.reports.first().is_some_and(|report| is_report(&folder.join(report))) {
            return Ok(());
        }
        let foreign = |name: &&String| {
            let path = folder.join(name);
            let page =
                path.extension().is_some_and(|e| e == "html") && !self.leftovers.contains(Path::new(name.as_str()));
            page && std::fs::read(&path).is_ok_and(|text| !text.windows(OWN.len()).any(|part| part == OWN))
        };
        planned.reports.iter().chain(&planned.names).find(foreign).map_or(Ok(()), |name| {
            let problem = "no run of aventail has written this page, and the results would overwrite it";
            let remedy = "give another --out, or move the file away";
            Err(Error::refused(findings::OTHER_FILE, folder.join(name).display().to_string(), problem, remedy))
        })
    }

    /// Removes the reports of an earlier run, then its other files: from here on the folder holds this run alone.
    ///
    /// # Errors
    /// [`Error::Write`] when a file cannot be removed.
    pub fn begin(&mut self) -> Result<()> {
        self.clear()?;
        self.begun = true;
        Ok(())
    }

    /// Goes on with what an earlier run has written, finished or not: the files that `kept` names stay, whatever becomes of
    /// this run; the reports and all others are removed.
    ///
    /// # Errors
    /// [`Error::Write`] when a file cannot be removed.
    pub fn go_on(&mut self, kept: impl Fn(&Path) -> bool) -> Result<()> {
        let stays;
        (stays, self.leftovers) = std::mem::take(&mut self.leftovers).into_iter().partition(|name| kept(name));
        self.clear()?;
        // Listed as if this run had written them: if it is killed, the next one knows of them.
        let mut journal = self.held.journal();
        let lines: String = stays.iter().filter_map(|name| line(name)).collect();
        let noted = journal.file.write_all(lines.as_bytes());
        noted.map_err(|e| Error::write(&self.held.folder, e.to_string(), "check the disk"))?;
        let stays: BTreeSet<PathBuf> = stays;
        journal.written.extend(stays);
        Ok(())
    }

    fn clear(&mut self) -> Result<()> {
        let folder = &self.held.folder;
        let mut journal = self.held.journal();
        // If this process is killed meanwhile, the next one goes on.
        let rest: Vec<PathBuf> = self.reports.iter().map(PathBuf::from).chain(self.leftovers.iter().cloned()).collect();
        let lines: String = rest.iter().filter_map(|name| line(name)).collect();
        journal.file.write_all(lines.as_bytes()).map_err(|e| Error::write(folder, e.to_string(), "check the disk"))?;
        for name in &rest {
            remove(folder, name)?;
        }
        drop(journal);
        self.leftovers.clear();
        // Of a run with fewer parts, empty folders would be left.
        let above: BTreeSet<&Path> = rest.iter().filter_map(|name| name.parent()).filter(|p| is_inside(p)).collect();
        above.into_iter().for_each(|part| drop(std::fs::remove_dir(folder.join(part))));
        Ok(())
    }

    /// What has been written so far, by its path in the folder.
    pub fn written(&self) -> Vec<PathBuf> {
        self.held.journal().written.iter().cloned().collect()
    }

    /// Removes what this run has written into a part of its folder, and the part where nothing else is in it.
    pub fn take_back(&self, part: &Path) {
        let mut journal = self.held.journal();
        let folder = &self.held.folder;
        let (gone, kept) = std::mem::take(&mut journal.written).into_iter().partition(|name| name.starts_with(part));
        journal.written = kept;
        // What led here is the error to report, not that something could not be removed.
        let gone: BTreeSet<PathBuf> = gone;
        gone.iter().for_each(|name| drop(remove(folder, name)));
        let _ = std::fs::remove_dir(folder.join(part));
    }

    /// The run is complete: its files stay.
    pub fn finish(mut self) {
        self.finished = true;
    }
}

impl Drop for RunFolder {
    fn drop(&mut self) {
        all_held().retain(|held| !Arc::ptr_eq(held, &self.held));
        let folder = &self.held.folder;
        let journal = self.held.journal();
        if self.begun && !self.finished {
            // What led here is the error to report, not that something could not be removed.
            journal.written.iter().for_each(|name| drop(remove(folder, name)));
            self.parts.iter().for_each(|part| drop(std::fs::remove_dir(folder.join(part))));
        }
        // What is left of a killed run stays listed for the next.
        if self.begun || self.leftovers_listed_elsewhere() {
            let _ = std::fs::remove_file(folder.join(LOCK));
        }
        if !self.finished {
            // Whatever has come into them since stays, and they with it.
            self.made.iter().rev().for_each(|made| drop(std::fs::remove_dir(made)));
        }
    }
}

impl RunFolder {
    /// Whether a report still tells of everything that is to be removed.
    fn leftovers_listed_elsewhere(&self) -> bool {
        let told: BTreeSet<PathBuf> =
            self.reports.iter().flat_map(|report| outputs_of(&self.held.folder.join(report))).collect();
        self.leftovers.is_subset(&told)
    }
}

/// Whether there is nothing of this name.
fn missing(path: &Path) -> bool {
    !path.as_os_str().is_empty() && std::fs::symlink_metadata(path).is_err_and(|e| e.kind() == ErrorKind::NotFound)
}

/// Removes a file of a folder; links on the way there are not followed, and a folder in its place stays.
fn remove(folder: &Path, name: &Path) -> Result<()> {
    let path = folder.join(name);
    let inside = path.parent().and_then(|p| std::fs::canonicalize(p).ok()).is_some_and(|p| p.starts_with(folder));
    if !inside || path.is_dir() {
        return Ok(());
    }
    match std::fs::remove_file(&path) {
        Err(e) if e.kind() != ErrorKind::NotFound => {
            Err(Error::write(&path, e.to_string(), "an earlier run has left it: remove it, or give another --out"))
        }
        _ => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::super::write_file;
    use super::*;

    fn planned() -> Planned {
        Planned {
            reports: vec!["report.json".into(), "report.html".into()],
            names: vec!["a.nii".into(), "b.nii".into()],
        }
    }

    fn open(folder: &Path) -> Result<RunFolder> {
        RunFolder::open(folder, &planned(), &[], "aventail register")
    }

    fn write(path: PathBuf) {
        write_file(path, |out| out.write_all(b"{}")).unwrap();
    }

    fn names(folder: &Path) -> Vec<String> {
        let entries = std::fs::read_dir(folder).unwrap();
        let mut names: Vec<String> = entries.map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
        names.sort();
        names
    }

    #[test]
    fn one_run_at_a_time() {
        let dir = tempfile::tempdir().unwrap();
        let first = open(dir.path()).unwrap();
        let refused = open(dir.path()).unwrap_err();
        let text = refused.to_string();
        assert!(refused.exit_code() == 5 && text.contains(&std::process::id().to_string()), "{text}");
        assert!(text.contains("aventail register"), "{text}");
        drop(first);
        assert_eq!(names(dir.path()), [""; 0]);
        open(dir.path()).unwrap();
    }

    #[test]
    fn an_earlier_run_goes_and_what_is_not_its_own_stays() {
        let dir = tempfile::tempdir().unwrap();
        let out = dir.path().join("out");
        let at = |name: &str| out.join(name);
        std::fs::create_dir_all(at("report")).unwrap();
        for name in ["a.nii", "skin.nii", "report.html", "report/x.png", "notes.txt", "report/mine.png"] {
            std::fs::write(at(name), b"old").unwrap();
        }
        std::fs::write(dir.path().join("outside"), b"x").unwrap();
        let outputs = ["a.nii", "skin.nii", "report/x.png", "../outside", "/etc/hostname", "report"];
        let outputs: Vec<_> = outputs.iter().map(|name| serde_json::json!({ "name": name })).collect();
        std::fs::write(at("report.json"), serde_json::json!({ "outputs": outputs }).to_string()).unwrap();
        // Refused or given up before it writes: everything stays.
        drop(open(&out).unwrap());
        assert!(at("skin.nii").exists() && at("report.json").exists());
        let mut run = open(&out).unwrap();
        run.begin().unwrap();
        write(at("a.nii"));
        assert_eq!(run.written(), [PathBuf::from("a.nii")]);
        run.finish();
        assert_eq!(names(&out), ["a.nii", "notes.txt", "report"]);
        assert_eq!(names(&at("report")), ["mine.png"]);
        assert!(dir.path().join("outside").exists());
    }

    #[test]
    fn a_failed_run_leaves_nothing_and_a_killed_one_is_cleared_by_the_next() {
        let dir = tempfile::tempdir().unwrap();
        let at = |name: &str| dir.path().join(name);
        let mut failed = open(dir.path()).unwrap();
        failed.begin().unwrap();
        write(at("a.nii"));
        drop(failed);
        assert_eq!(names(dir.path()), [""; 0]);
        let mut killed = open(dir.path()).unwrap();
        killed.begin().unwrap();
        write(at("b.nii"));
        // What a kill leaves: the files, and the list without its lock.
        let list = std::fs::read(at(LOCK)).unwrap();
        drop(killed);
        write(at("b.nii"));
        std::fs::write(at(LOCK), list).unwrap();
        // Neither a run that is given up takes the list away.
        drop(open(dir.path()).unwrap());
        assert_eq!(names(dir.path()), [LOCK, "b.nii"]);
        let mut next = open(dir.path()).unwrap();
        next.begin().unwrap();
        write(at("a.nii"));
        next.finish();
        assert_eq!(names(dir.path()), ["a.nii"]);
    }

    #[test]
    fn a_part_is_taken_back_and_what_stays_is_known_if_the_run_is_killed() {
        let dir = tempfile::tempdir().unwrap();
        let at = |name: &str| dir.path().join(name);
        let planned = Planned {
            reports: vec!["library.json".into()],
            names: vec!["posture_001/a".into(), "posture_002/a".into()],
        };
        let open = || RunFolder::open(dir.path(), &planned, &[], "aventail library").unwrap();
        for part in ["posture_001", "posture_002"] {
            std::fs::create_dir(at(part)).unwrap();
        }
        let first = open();
        write(at("posture_001/a"));
        write(at("posture_002/a"));
        first.take_back(Path::new("posture_002"));
        assert!(at("posture_001/a").exists() && !at("posture_002").exists());
        write(at("library.json"));
        std::fs::write(at("library.json"), r#"{"outputs": [{"name": "posture_001/a"}]}"#).unwrap();
        first.finish();
        // Goes on with it, and is killed.
        let mut second = open();
        second.go_on(|name| name.starts_with("posture_001")).unwrap();
        let list = std::fs::read(at(LOCK)).unwrap();
        second.finish();
        std::fs::write(at(LOCK), list).unwrap();
        assert!(at("posture_001/a").exists());
        // What wants nothing of it finds and removes it, with its folder.
        let mut third = open();
        third.begin().unwrap();
        third.finish();
        assert_eq!(names(dir.path()), [""; 0]);
    }

    #[test]
    fn a_folder_made_for_a_refused_run_goes_with_it() {
        let dir = tempfile::tempdir().unwrap();
        let out = dir.path().join("a/b");
        drop(open(&out).unwrap());
        assert_eq!(names(dir.path()), [""; 0]);
        std::fs::create_dir(dir.path().join("a")).unwrap();
        let run = open(&out).unwrap();
        std::fs::write(out.join("notes.txt"), b"mine").unwrap();
        drop(run);
        assert_eq!(names(&out), ["notes.txt"]);
    }

    #[test]
    fn a_page_that_no_run_has_written_stays() {
        let dir = tempfile::tempdir().unwrap();
        std::fs::write(dir.path().join("report.html"), b"mine").unwrap();
        let error = open(dir.path()).unwrap_err();
        assert!(error.code() == "other-file" && error.to_string().contains("report.html"), "{error}");
        assert_eq!(std::fs::read(dir.path().join("report.html")).unwrap(), b"mine");
    }

    #[test]
    fn inputs_are_spared_before_the_work_and_after() {
        let dir = tempfile::tempdir().unwrap();
        let at = |name: &str| dir.path().join(name);
        for name in ["a.nii", "old.nii", "c.nii"] {
            std::fs::write(at(name), b"x").unwrap();
        }
        std::fs::write(at("report.json"), r#"{"outputs": [{"name": "old.nii"}]}"#).unwrap();
        for name in ["a.nii", "old.nii", "report.json"] {
            let error = RunFolder::open(dir.path(), &planned(), &[&at(name)], "").unwrap_err();
            assert!(error.code() == "input-overwritten" && error.to_string().contains(name), "{error}");
        }
        let run = RunFolder::open(dir.path(), &planned(), &[&at("c.nii")], "").unwrap();
        let error = write_file(at("c.nii"), |out| out.write_all(b"y")).unwrap_err();
        assert_eq!(error.code(), "input-overwritten");
        drop(run);
        assert_eq!(std::fs::read(at("c.nii")).unwrap(), b"x");
        let other = Planned { reports: vec!["evaluation.json".into()], names: vec!["old.nii".into()] };
        let error = RunFolder::open(dir.path(), &other, &[], "").unwrap_err();
        assert_eq!(error.code(), "folder-of-another-run");
    }

    #[cfg(unix)]
    #[test]
    fn a_link_in_the_place_of_the_lock_is_not_followed() {
        let dir = tempfile::tempdir().unwrap();
        let at = |name: &str| dir.path().join(name);
        std::fs::write(at("victim"), b"precious").unwrap();
        std::fs::create_dir(at("out")).unwrap();
        std::os::unix::fs::symlink("../victim", at("out").join(LOCK)).unwrap();
        drop(open(&at("out")).unwrap());
        std::fs::hard_link(at("victim"), at("out").join(LOCK)).unwrap();
        drop(open(&at("out")).unwrap());
        assert_eq!(std::fs::read(at("victim")).unwrap(), b"precious");
    }
}
