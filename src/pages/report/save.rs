//! Everything of a run into its folder.

use super::outputs::write_outputs;
use super::{OutputFile, Report, Run, ShownSamples, draw, embed, write};
use crate::config::Config;
use crate::error::Result;
use crate::io::RunFolder;
use crate::pipeline::{Case, Outcome};
use crate::provenance::InputFile;
use crate::runtime::Runtime;
use crate::volume::contour::Contours;
use crate::warning::Warning;
use std::path::Path;

/// Writes more files of an outcome; returns them, and what is to be known.
pub type More<'a> = dyn Fn(&Outcome) -> Result<(Vec<OutputFile>, Vec<Warning>)> + Sync + 'a;

/// How a run is saved, apart from what it found.
#[derive(Clone, Copy)]
pub struct Saving<'a> {
    /// The command line, for the report.
    pub command: &'a str,
    /// The settings it ran with.
    pub config: &'a Config,
    /// The files that it has read.
    pub inputs: &'a [InputFile],
    /// With the volumes in the page, to look through.
    pub view: bool,
    /// Structures of the planning CT, for the page.
    pub contours: Option<&'a Contours>,
    /// Samples of the registration's error, for the page.
    pub samples: Option<&'a ShownSamples>,
    /// Files beyond fields, images and report.
    pub more: Option<&'a More<'a>>,
}

/// Writes an outcome with its report into `out`, which `folder` holds: fields, images, masks, pictures, `report.html`,
/// `report.json` (docs/formats.md lists them). Returns the report's numbers. The outcome takes up what writing found.
///
/// # Errors
/// [`Error::Write`](crate::error::Error::Write) when a file cannot be written; what [`Saving::more`] reports.
pub fn save(
    case: &Case,
    outcome: &mut Outcome,
    saving: Saving<'_>,
    mut folder: RunFolder,
    out: &Path,
    runtime: &Runtime,
) -> Result<Report> {
    folder.begin()?;
    let report = fill(case, outcome, saving, out, runtime)?;
    folder.finish();
    Ok(report)
}

/// Writes all files, the report last.
fn fill(
    case: &Case,
    outcome: &mut Outcome,
    Saving { command, config, inputs, view, contours, samples, more }: Saving<'_>,
    out: &Path,
    runtime: &Runtime,
) -> Result<Report> {
    let found = &*outcome;
    let draw = || rayon::join(|| draw(case, found), || view.then(|| embed(case, found, contours)).transpose());
    let (outputs, (pictures, view)) =
        runtime.stage("write, draw", || rayon::join(|| write_outputs(out, found, config), draw));
    let mut outputs = outputs?;
    if let Some(more) = more {
        let (files, warnings) = more(outcome)?;
        outputs.extend(files);
        outcome.warnings.extend(warnings);
    }
    let run = Run {
        command: command.to_owned(),
        settings: config.value()?,
        inputs: inputs.to_vec(),
        threads: runtime.threads(),
        stages: runtime.times(),
        outputs,
        limits: config.verdict.clone(),
    };
    let (pictures, view) = (pictures?, view?);
    runtime.stage("report", || write(out, case, outcome, &run, pictures, view, samples))
}
