//! `aventail summary`: many runs side by side.

use super::args::JsonArgs;
use super::terminal::command_line;
use crate::error::Result;
use crate::io;
use crate::report::Summary;
use clap::Args;
use std::path::PathBuf;

pub(super) const HELP: &str = "\
A folder with a report.json is a run; other folders are searched for runs, six levels deep. The
patient is the one named in the run's DICOM, otherwise the folder around the run. The fraction is
the run's own folder: results/PATIENT/FRACTION.

A value stands apart (is an outlier) if it is worse than the median of all runs by more than 3.5
modified z-scores, 0.6745 (x - median) / MAD, and by an amount that matters. Five runs are needed.

Writes summary.html (what stands apart, every run, each patient's course over the fractions),
summary.csv and summary.json to OUT. Links in the page lead to the runs' own reports.

Examples:
  aventail summary results --out summary
  aventail summary patient_1/* patient_2/* --out summary
  aventail summary results --dose dose/patient_1/accumulated.json --out summary";

/// Options of `summary`.
#[derive(Debug, Args)]
pub struct SummaryArgs {
    /// Folders of runs (the OUT of `register`), or folders that contain them
    #[arg(required = true, value_name = "RUNS")]
    pub runs: Vec<PathBuf>,
    /// Folder for the results; made if missing
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// JSON files that `dose accumulate --samples` wrote beside its doses: adds their dose values
    /// with intervals, and limits
    #[arg(long, value_name = "JSON", num_args = 1..)]
    pub dose: Vec<PathBuf>,
    /// Name patients by their folders, not by the names in DICOM
    #[arg(long)]
    pub anonymous: bool,
    /// How the result is told.
    #[command(flatten)]
    pub told: JsonArgs,
}

/// Gathers the runs; returns what a person should know.
///
/// # Errors
/// As [`Summary::of`].
pub fn run(args: &SummaryArgs) -> Result<String> {
    let summary = Summary::of(&args.runs, &args.dose, args.anonymous, Some(&args.out), &command_line())?;
    if args.told.json {
        return io::json(&summary);
    }
    let page = args.out.join("summary.html");
    Ok(format!("{}\nThe page: {}", summary.cohort.terminal_text(), page.display()))
}
