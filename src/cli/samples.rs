//! `aventail samples`: plausible registrations beside the one that was found.

use super::args::{QuietArgs, ThreadArgs};
use super::finished::Finished;
use super::terminal::{command_line, progress};
use crate::error::{Error, Result};
use crate::report::{Report, SAMPLES_PAGE};
use crate::runtime::Runtime;
use crate::sampling::SamplingOptions;
use crate::session::{SAMPLES_FOLDER, Sampled, write_samples};
use clap::Args;
use std::path::PathBuf;

pub(super) const AFTER: &str = "\
Each sample is another registration that fits about as well. Bones vary within the uncertainty of
the fit, together with their neighbours. Soft tissue varies by the uncertainty map, correlated over
some millimetres. `aventail dose map|accumulate --samples` uses them to estimate the dose error.

Writes to the folder `samples` of the run (or --out): samples.json, bones.nii.gz, and the samples
sample_001.nii.gz onwards, which are added to planning_to_fraction (docs/formats.md). samples.html
shows the first three.

Example:
  aventail samples out --number 50";

/// Options of `samples`.
#[derive(Debug, Args)]
pub struct SamplesArgs {
    /// Folder of a finished run of `register`
    #[arg(value_name = "RUN")]
    pub run: PathBuf,
    /// How samples are drawn.
    #[command(flatten)]
    pub drawn: DrawnArgs,
    /// Folder for the samples (default: the folder `samples` of the run)
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Threads.
    #[command(flatten)]
    pub work: ThreadArgs,
    /// Whether progress is shown.
    #[command(flatten)]
    pub shown: QuietArgs,
}

/// How samples are drawn.
#[derive(Debug, Args, Clone, Copy)]
pub struct DrawnArgs {
    /// Number of samples; 50 are enough for a 90 % interval
    #[arg(long, value_name = "N", default_value_t = SamplingOptions::default().number)]
    pub number: usize,
    /// Random seed: the same run and seed give the same samples
    #[arg(long, value_name = "N", default_value_t = 0)]
    pub seed: u64,
    /// Standard deviation of soft tissue along each axis, as a multiple of the uncertainty map
    #[arg(long, value_name = "FACTOR", default_value_t = SamplingOptions::default().scale)]
    pub scale: f64,
}

impl DrawnArgs {
    /// As options.
    ///
    /// # Errors
    /// [`Error::Usage`] when they are out of range.
    pub(super) fn options(self) -> Result<SamplingOptions> {
        let options = SamplingOptions { number: self.number, seed: self.seed, scale: self.scale };
        let problem = options.problem();
        problem.map_or(Ok(options), |problem| Err(Error::usage(problem, "correct --number or --scale")))
    }
}

/// Draws the samples; returns where they are.
///
/// # Errors
/// When the run cannot be read, tells nothing of its uncertainty, or the samples cannot be written.
pub(super) fn run(args: &SamplesArgs) -> Result<String> {
    let options = args.drawn.options()?;
    let runtime = Runtime::new(args.work.threads, progress(args.shown.quiet))?;
    let Finished { case, outcome, .. } = Finished::read(&args.run, &runtime)?;
    let report = Report::read(&args.run.join("report.json"), "give the --out folder of a finished run")?;
    let out = args.out.clone().unwrap_or_else(|| args.run.join(SAMPLES_FOLDER));
    let of = Sampled { case: &case, outcome: &outcome, report: &report, command: &command_line() };
    write_samples(of, &options, &out, &runtime)?;
    Ok(format!("{} samples: {}", options.number, out.join(SAMPLES_PAGE).display()))
}
