//! `aventail summary`: many runs side by side.

use super::args::JsonArgs;
use super::terminal::command_line;
use super::{planned, record, run_folder};
use crate::config::InputRole;
use crate::error::{Error, Result};
use crate::findings;
use crate::io::{self, relative_to};
use crate::pipeline::InputFile;
use crate::report::{Cohort, Member, Report};
use clap::Args;
use serde::Serialize;
use std::path::{Path, PathBuf};

pub(super) const HELP: &str = "\
A folder of a run is one with a report.json; other folders are searched for such, six levels deep. A run's patient is the one
that its DICOM names, else the folder around it, and its fraction is its own folder: results/PATIENT/FRACTION.

A figure stands apart where it is worse than the median of all runs by more than 3.5 modified z-scores (median absolute
deviations) and by an amount that matters. Five runs are needed.

Writes summary.html (what stands apart, every run, each patient's course over the fractions), summary.csv and summary.json
to OUT. Links in the page lead to the runs' own reports.

Examples:
  aventail summary results --out summary
  aventail summary patient_1/* patient_2/* --out summary";

/// How deep folders are searched.
const DEEPEST: usize = 6;
/// The file that tells of a run.
const REPORT: &str = "report.json";

/// Options of `summary`.
#[derive(Debug, Args)]
pub struct SummaryArgs {
    /// Folders of runs (the OUT of `register`), or folders that hold them
    #[arg(required = true, value_name = "RUNS")]
    pub runs: Vec<PathBuf>,
    /// Folder for the results; made if missing
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// Name patients by folders, not by what DICOM says
    #[arg(long)]
    pub anonymous: bool,
    /// How the result is told.
    #[command(flatten)]
    pub told: JsonArgs,
}

/// What is written as JSON: the cohort, and what it was made of.
#[derive(Serialize)]
struct Written<'a> {
    #[serde(flatten)]
    cohort: &'a Cohort,
    inputs: Vec<crate::pipeline::InputFile>,
    outputs: Vec<record::Output>,
}

/// Gathers the runs; returns what a person should know.
///
/// # Errors
/// [`Error::Input`] where a folder holds no run; when a report cannot be read or a file not be written.
pub fn run(args: &SummaryArgs) -> Result<String> {
    let mut found = Found::default();
    for path in &args.runs {
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
    let files: Vec<&Path> = found.reports.iter().map(PathBuf::as_path).collect();
    let mut folder = run_folder(&args.out, &planned(&["summary.json"], &["summary.csv", "summary.html"]), &files)?;
    let mut members = Vec::new();
    for path in &found.reports {
        members.push(member(path, args)?);
    }
    let unfinished = found.unfinished.iter().map(|p| p.display().to_string()).collect();
    let cohort = Cohort::new(members, unfinished, command_line());
    folder.begin()?;
    cohort.write(&args.out)?;
    let mut inputs = files.iter().map(|path| InputFile::read(InputRole::Report, path)).collect::<Result<Vec<_>>>()?;
    inputs.iter_mut().for_each(|input| input.path = relative_to(&args.out, &input.path));
    let outputs = record::outputs(&args.out, &folder.written())?;
    let written = Written { cohort: &cohort, inputs, outputs };
    io::write_json(args.out.join("summary.json"), &written)?;
    folder.finish();
    if args.told.json {
        return io::json(&written);
    }
    Ok(format!("{}\nThe page: {}", cohort.terminal_text(), args.out.join("summary.html").display()))
}

/// Reports, and folders of runs without one.
#[derive(Default)]
struct Found {
    reports: Vec<PathBuf>,
    unfinished: Vec<PathBuf>,
}

impl Found {
    fn search(&mut self, path: &Path, depth: usize) -> Result<()> {
        if path.file_name().is_some_and(|name| name == REPORT) && path.is_file() {
            self.reports.push(path.to_owned());
            return Ok(());
        }
        let report = path.join(REPORT);
        if io::at_work(path).is_some() {
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

fn member(path: &Path, args: &SummaryArgs) -> Result<Member> {
    let report = Report::read(path, "give the --out folder of a finished `aventail register`")?;
    let folder = path.parent().unwrap_or(Path::new(""));
    // Names as they are, where the path goes through links or is `.`.
    let whole = std::fs::canonicalize(folder).map_err(|e| Error::read(folder, e.to_string(), "check the path"))?;
    let name = |p: Option<&Path>| p.and_then(Path::file_name).unwrap_or_default().to_string_lossy().into_owned();
    let mut patient = name(whole.parent());
    if !args.anonymous {
        let told = report.inputs.iter().filter_map(|i| i.about.as_ref()?.patient.as_ref());
        patient = told.map(|p| p.id.clone()).find(|id| !id.is_empty()).unwrap_or(patient);
    }
    Ok(Member::new(patient, name(Some(&whole)), relative_to(&args.out, folder), &report))
}
