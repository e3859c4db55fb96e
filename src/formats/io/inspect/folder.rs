//! Whether the folder of a run still holds what its report says, file by file.

use super::super::atomic::is_partial;
use super::super::bytes::read_bytes;
use super::super::checksum::sha256_file;
use super::super::folder::PARTS;
use super::super::held::{REPORTS, at_work, is_inside};
use crate::error::{Error, Result};
use crate::findings;
use crate::warning::counted;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;
use std::fmt::{Display, Formatter};
use std::path::{Path, PathBuf};

/// Names of files that verbs write into folders, up to the first dot.
const OURS: [&str; 23] = [
    "body",
    "bone_transforms",
    "bones_on_fraction",
    "computed",
    "curve",
    "distance_to_dose_difference",
    "dose_difference",
    "dvh",
    "dvh_figures",
    "evaluation",
    "fraction_to_planning",
    "inside_planning",
    "jacobian",
    "landmarks",
    "planning_on_fraction",
    "planning_to_fraction",
    "regions",
    "report",
    "settings",
    "skin_contact",
    "study",
    "summary",
    "uncertainty",
];

/// What the folder of a run holds, beside what its report says. `Display` renders it for people.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct FolderCheck {
    /// The folder, or the JSON file that lists a run's files.
    #[serde(serialize_with = "super::super::path_as_text")]
    pub folder: PathBuf,
    /// Files as the report says.
    pub unchanged: Vec<String>,
    /// Files without a checksum: the report is of an earlier version of aventail.
    pub unknown: Vec<String>,
    /// Files that are not there.
    pub missing: Vec<String>,
    /// Files whose bytes are others.
    pub changed: Vec<String>,
    /// Files that a run writes and that this one has not.
    pub of_another_run: Vec<String>,
    /// That a run is at work there, or was stopped.
    pub at_work: Option<String>,
}

/// An output as reports list it.
#[derive(Deserialize)]
struct Listed {
    name: String,
    #[serde(default)]
    sha256: String,
}

/// The part of a report that is needed here.
#[derive(Deserialize)]
struct Listing {
    outputs: Vec<Listed>,
}

/// Checks the folder of a run, or each folder in it that is one, or the files that a JSON file lists under `outputs`.
///
/// # Errors
/// [`Error::Read`] when a report cannot be read; [`Error::Input`] when the folder holds no finished run.
pub fn check_folder(folder: &Path) -> Result<Vec<FolderCheck>> {
    if folder.is_file() {
        let mut check = FolderCheck::new(folder);
        check.compare(folder)?;
        return Ok(vec![check]);
    }
    let finished = |f: &Path| REPORTS.iter().any(|report| f.join(report).is_file());
    if finished(folder) || at_work(folder).is_some() {
        return one(folder).map(|check| vec![check]);
    }
    let entries = std::fs::read_dir(folder).map_err(|e| Error::read(folder, e.to_string(), "check the path"))?;
    let mut runs: Vec<PathBuf> = entries.flatten().map(|e| e.path()).filter(|p| p.is_dir() && finished(p)).collect();
    runs.sort();
    if runs.is_empty() {
        return Err(Error::refused(
            findings::NO_RUN,
            folder.display().to_string(),
            format!("the folder holds none of {}: no run, or one that was not finished", REPORTS.join(", ")),
            "give the --out folder of a finished run, a folder of DICOM or images, or files",
        ));
    }
    runs.iter().map(|run| one(run)).collect()
}

fn one(folder: &Path) -> Result<FolderCheck> {
    let mut check = FolderCheck::new(folder);
    check.at_work = at_work(folder);
    let mut known: BTreeSet<String> = REPORTS.map(String::from).into();
    for report in REPORTS.map(|name| folder.join(name)).into_iter().filter(|path| path.is_file()) {
        known.extend(check.compare(&report)?);
    }
    check.of_another_run = strangers(folder, &known);
    Ok(check)
}

impl FolderCheck {
    /// The files that its report lists, and those that another run left beside them.
    pub fn files(&self) -> impl Iterator<Item = PathBuf> {
        let lists = [&self.unchanged, &self.unknown, &self.missing, &self.changed, &self.of_another_run];
        lists.into_iter().flatten().map(|name| self.folder.join(name))
    }

    fn new(folder: &Path) -> Self {
        Self {
            folder: folder.to_owned(),
            unchanged: Vec::new(),
            unknown: Vec::new(),
            missing: Vec::new(),
            changed: Vec::new(),
            of_another_run: Vec::new(),
            at_work: None,
        }
    }

    /// Compares what a report lists with what lies beside it; returns the names listed.
    fn compare(&mut self, report: &Path) -> Result<Vec<String>> {
        let folder = report.parent().unwrap_or(Path::new(""));
        let listing: Listing = serde_json::from_slice(&read_bytes(report)?).map_err(|e| {
            Error::read(report, format!("it is no report of a run ({e})"), "give the --out folder of a finished run")
        })?;
        let own: Vec<Listed> = listing.outputs.into_iter().filter(|o| is_inside(Path::new(&o.name))).collect();
        let found: Vec<Option<String>> = own.par_iter().map(|o| sha256_file(folder.join(&o.name)).ok()).collect();
        let names = own.iter().map(|o| o.name.clone()).collect();
        for (listed, sha256) in own.into_iter().zip(found) {
            let list = match sha256 {
                None => &mut self.missing,
                Some(_) if listed.sha256.is_empty() => &mut self.unknown,
                Some(sha256) if sha256 == listed.sha256 => &mut self.unchanged,
                Some(_) => &mut self.changed,
            };
            list.push(listed.name);
        }
        Ok(names)
    }
}

/// Ends of the names of images that a folder is looked through for.
const IMAGES: [&str; 4] = [".nii", ".nii.gz", ".mha", ".nrrd"];

/// The images in a folder, by name, but for `own`.
///
/// # Errors
/// [`Error::Read`] when the folder cannot be read.
pub fn images(folder: &Path, own: &BTreeSet<PathBuf>) -> Result<Vec<PathBuf>> {
    let failed = |e: std::io::Error| Error::read(folder, e.to_string(), "make the folder readable for you");
    let mut all = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(failed)? {
        let entry = entry.map_err(failed)?;
        let name = entry.file_name().to_string_lossy().to_lowercase();
        // Hidden files are other programs' notes, or parts of what is being written.
        let image = !name.starts_with('.') && IMAGES.iter().any(|end| name.ends_with(end));
        if image && entry.path().is_file() && !own.contains(&entry.path()) {
            all.push(entry.path());
        }
    }
    all.sort();
    Ok(all)
}

/// Files of a run that no report there lists.
fn strangers(folder: &Path, known: &BTreeSet<String>) -> Vec<String> {
    let mut found = Vec::new();
    for part in std::iter::once("").chain(PARTS) {
        for entry in std::fs::read_dir(folder.join(part)).into_iter().flatten().flatten() {
            let name = entry.file_name().to_string_lossy().into_owned();
            let stem = name.split('.').next().unwrap_or_default();
            let ours = if part.is_empty() { OURS.contains(&stem) } else { name.ends_with(".png") };
            let whole = if part.is_empty() { name.clone() } else { format!("{part}/{name}") };
            if entry.path().is_file() && (ours || is_partial(&name)) && !known.contains(&whole) {
                found.push(whole);
            }
        }
    }
    found.sort();
    found
}

impl FolderCheck {
    /// The refusal of a folder that does not hold what its report says.
    ///
    /// # Errors
    /// [`Error::Input`] with the files by name.
    pub fn require(&self) -> Result<()> {
        let faults = self.faults();
        if faults.is_empty() {
            return Ok(());
        }
        let remedy = "run it again into a new folder; `aventail register --config report.json` repeats a run";
        Err(Error::refused(findings::RUN_CHANGED, self.folder.display().to_string(), faults.join("; "), remedy))
    }

    fn faults(&self) -> Vec<String> {
        let lists = [
            ("missing", &self.missing),
            ("changed since, or of another run", &self.changed),
            ("of another run, not in the report", &self.of_another_run),
        ];
        let named = lists.into_iter().filter(|l| !l.1.is_empty()).map(|(what, l)| format!("{what}: {}", l.join(", ")));
        named.chain(self.at_work.clone()).collect()
    }
}

impl Display for FolderCheck {
    fn fmt(&self, f: &mut Formatter<'_>) -> std::fmt::Result {
        writeln!(f, "{}", self.folder.display())?;
        let what = if self.folder.is_file() { "the record of a run" } else { "the folder of a run" };
        writeln!(
            f,
            "  {:<12} {what}; {} as its report says",
            "content",
            counted(self.unchanged.len(), "file is", "files are")
        )?;
        if !self.unknown.is_empty() {
            writeln!(f, "  {:<12} no checksum: {}", "unknown", self.unknown.join(", "))?;
        }
        for fault in self.faults() {
            writeln!(f, "  {:<12} {fault}", "fault")?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_missing_changed_or_of_another_run_is_named() {
        let dir = tempfile::tempdir().unwrap();
        let run = dir.path().join("day1");
        std::fs::create_dir_all(run.join("report")).unwrap();
        let at = |name: &str| run.join(name);
        assert_eq!(check_folder(dir.path()).unwrap_err().code(), "no-run");
        for name in ["body.nii.gz", "jacobian.nii.gz", "notes.txt", "report/x.png"] {
            std::fs::write(at(name), name).unwrap();
        }
        let outputs: Vec<_> = ["body.nii.gz", "jacobian.nii.gz", "report/x.png"]
            .map(|name| serde_json::json!({ "name": name, "sha256": sha256_file(at(name)).unwrap() }))
            .into();
        std::fs::write(at("report.json"), serde_json::json!({ "outputs": outputs }).to_string()).unwrap();
        let check = check_folder(dir.path()).unwrap().remove(0);
        assert_eq!(check.unchanged.len(), 3);
        check.require().unwrap();
        std::fs::remove_file(at("body.nii.gz")).unwrap();
        std::fs::write(at("jacobian.nii.gz"), "other").unwrap();
        for name in ["skin_contact.nii.gz", "report/y.png", ".regions.nii.gz.12-3.partial"] {
            std::fs::write(at(name), name).unwrap();
        }
        let check = check_folder(&run).unwrap().remove(0);
        assert_eq!(check.missing, ["body.nii.gz"]);
        assert_eq!(check.changed, ["jacobian.nii.gz"]);
        assert_eq!(check.of_another_run, [".regions.nii.gz.12-3.partial", "report/y.png", "skin_contact.nii.gz"]);
        let error = check.require().unwrap_err();
        assert!(error.exit_code() == 4 && error.to_string().contains("skin_contact.nii.gz"), "{error}");
        assert!(check.to_string().contains("missing: body.nii.gz"), "{check}");
    }
}
