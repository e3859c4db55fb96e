//! Runs in folders: found, read, and written as one summary.

use super::{Cohort, CourseDose, Member, natural};
use crate::config::InputRole;
use crate::error::{Error, Result};
use crate::findings;
use crate::io::checksum::{Output, outputs};
use crate::io::{Planned, RunFolder, at_work, relative_to, whole_path, write_json};
use crate::provenance::InputFile;
use crate::report::Report;
use serde::Serialize;
use std::path::{Path, PathBuf};

/// How deep folders are searched.
const DEEPEST: usize = 6;
/// The file that tells of a run.
const REPORT: &str = "report.json";
/// Where the summary's own record lies.
const SUMMARY: &str = "summary.json";

/// A cohort, and the files that it was made of and was written to: what `summary.json` holds.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Summary {
    /// The runs side by side.
    #[serde(flatten)]
    pub cohort: Cohort,
    /// Their reports, as seen from the folder of the summary.
    pub inputs: Vec<InputFile>,
    /// Files beside `summary.json`; none where nothing was written.
    pub outputs: Vec<Output>,
}

impl Summary {
    /// Of the runs in `folders`: each is the folder of a run, or is searched for such, six levels deep. A run's patient is
    /// the one that its DICOM names, unless the summary is to be anonymous, else the folder around it.
    ///
    /// With `out`, a folder, `summary.json`, `summary.csv` and `summary.html` are written there, and folders of runs are
    /// named as seen from it; without it as seen from the current folder. `command` is what asked for it. `doses` are the files
    /// beside doses that were accumulated with samples.
    ///
    /// # Errors
    /// [`Error::Input`] where a folder holds no run; [`Error::Read`] when a report cannot be read; [`Error::Write`].
    pub fn of(
        folders: &[PathBuf],
        doses: &[PathBuf],
        anonymous: bool,
        out: Option<&Path>,
        command: &str,
    ) -> Result<Self> {
        let found = RunFound::in_folders(folders)?;
        let files: Vec<&Path> = found.reports.iter().map(PathBuf::as_path).collect();
        let all: Vec<&Path> = files.iter().copied().chain(doses.iter().map(PathBuf::as_path)).collect();
        let held = out.map(|out| RunFolder::open(out, &planned(), &all, command)).transpose()?;
        let seen_from = out.unwrap_or(Path::new("."));
        let members = files.iter().map(|path| member(path, seen_from, anonymous)).collect::<Result<_>>()?;
        let unfinished = found.unfinished.iter().map(|p| p.display().to_string()).collect();
        let mut cohort = Cohort::new(members, unfinished, command.to_owned());
        let mut inputs =
            files.iter().map(|path| InputFile::read(InputRole::Report, path)).collect::<Result<Vec<_>>>()?;
        inputs.iter_mut().for_each(|input| input.path = relative_to(seen_from, &input.path));
        for path in doses {
            let (dose, input) = CourseDose::read(path, seen_from)?;
            cohort.doses.push(dose);
            inputs.push(input);
        }
        // Several of one patient stay in their order.
        cohort.doses.sort_by_cached_key(|dose| natural(&dose.patient));
        let mut summary = Self { cohort, inputs, outputs: Vec::new() };
        if let (Some(out), Some(held)) = (out, held) {
            summary.write(out, held)?;
        }
        Ok(summary)
    }

    fn write(&mut self, out: &Path, mut folder: RunFolder) -> Result<()> {
        folder.begin()?;
        self.cohort.write(out)?;
        self.outputs = outputs(out, &folder.written())?;
        write_json(out.join(SUMMARY), self)?;
        folder.finish();
        Ok(())
    }
}

fn planned() -> Planned {
    Planned { reports: vec![SUMMARY.into()], names: vec!["summary.csv".into(), "summary.html".into()] }
}

/// Reports, and folders of runs without one.
#[derive(Default)]
struct RunFound {
    reports: Vec<PathBuf>,
    unfinished: Vec<PathBuf>,
}

impl RunFound {
    fn in_folders(folders: &[PathBuf]) -> Result<Self> {
        let mut found = Self::default();
        for path in folders {
            let before = found.reports.len() + found.unfinished.len();
            found.search(path, 0)?;
            if found.reports.len() + found.unfinished.len() == before {
                return Err(Error::refused(
                    findings::NO_RUN,
                    path.display().to_string(),
                    format!("neither it nor a folder in it holds a {REPORT}: no run, or none that was finished"),
                    "give the --out folders of finished runs, or a folder that holds them",
                ));
            }
        }
        found.reports.sort();
        found.reports.dedup();
        Ok(found)
    }

    fn search(&mut self, path: &Path, depth: usize) -> Result<()> {
        if path.file_name().is_some_and(|name| name == REPORT) && path.is_file() {
            self.reports.push(path.to_owned());
            return Ok(());
        }
        let report = path.join(REPORT);
        if at_work(path).is_some() {
            self.unfinished.push(path.to_owned());
            return Ok(());
        }
        if report.is_file() {
            self.reports.push(report);
            return Ok(());
        }
        let entries = std::fs::read_dir(path).map_err(|e| Error::read(path, e.to_string(), "check the path"))?;
        let mut inner: Vec<PathBuf> = entries.flatten().map(|e| e.path()).filter(|p| p.is_dir()).collect();
        inner.sort();
        if depth < DEEPEST {
            inner.iter().try_for_each(|p| self.search(p, depth + 1))?;
        }
        Ok(())
    }
}

fn member(path: &Path, seen_from: &Path, anonymous: bool) -> Result<Member> {
    let report = Report::read(path, "give the --out folder of a finished `aventail register`")?;
    let folder = path.parent().unwrap_or(Path::new(""));
    // Names as they are, where the path goes through links or is `.`.
    let whole = whole_path(folder).map_err(|e| Error::read(folder, e.to_string(), "check the path"))?;
    let name = |p: Option<&Path>| p.and_then(Path::file_name).unwrap_or_default().to_string_lossy().into_owned();
    let mut patient = name(whole.parent());
    if !anonymous {
        let told = report.inputs.iter().filter_map(|i| i.about.as_ref()?.patient.as_ref());
        patient = told.map(|p| p.id.clone()).find(|id| !id.is_empty()).unwrap_or(patient);
    }
    Ok(Member::new(patient, name(Some(&whole)), relative_to(seen_from, folder), &report))
}
