//! A registration or a pose with where it comes from, and its way into a folder.

use crate::config::Config;
use crate::error::Result;
use crate::io::{Planned, RunFolder};
use crate::pipeline::{Case, Outcome};
use crate::provenance::Provenance;
use crate::report::{self, Clinic, Decided, More, OutputFile, Report, Run, Saving, ShownSamples};
use crate::runtime::{Runtime, StageTime};
use std::path::Path;
use std::sync::Arc;

/// A result that is to be told and saved.
#[derive(Debug, Clone)]
pub struct Registered {
    /// The case; of a region of interest the part that was carried on. Everything on a grid lies on its grids.
    pub case: Case,
    /// What was found.
    pub outcome: Outcome,
    /// The files behind it.
    pub provenance: Provenance,
    /// Wall time of each stage.
    stages: Vec<StageTime>,
    config: Arc<Config>,
    command: Arc<str>,
    threads: usize,
    /// What goes back to a planning system, and which of its fractions this is.
    back: Option<(Arc<Clinic>, usize)>,
}

/// What a registration is made of.
pub(super) struct Made {
    pub(super) case: Case,
    pub(super) outcome: Outcome,
    pub(super) provenance: Provenance,
    pub(super) back: Option<(Arc<Clinic>, usize)>,
}

/// How a result is saved.
#[derive(Debug, Clone, Copy, Default)]
pub struct Beside<'a> {
    /// With the volumes in the page, to look through.
    pub view: bool,
    /// Files that lie in the folder already and belong to the run: name and meaning.
    pub files: &'a [(String, &'a str)],
    /// Samples of the error that the report shows.
    pub samples: Option<&'a ShownSamples>,
}

impl Registered {
    /// Of what was made; what reading found comes first among its warnings.
    pub(super) fn new(made: Made, config: &Arc<Config>, command: &Arc<str>, runtime: &Runtime) -> Self {
        let Made { case, mut outcome, provenance, back } = made;
        outcome.warnings.splice(0..0, provenance.warnings.iter().cloned());
        Self {
            case,
            outcome,
            provenance,
            stages: runtime.times(),
            config: Arc::clone(config),
            command: Arc::clone(command),
            threads: runtime.threads(),
            back,
        }
    }

    /// What was run.
    pub(super) fn command(&self) -> &str {
        &self.command
    }

    /// The numbers of it, before it is saved.
    ///
    /// # Errors
    /// [`crate::error::Error::Internal`] when a setting has no JSON.
    pub fn report(&self) -> Result<Report> {
        let run = Run {
            command: self.command.to_string(),
            settings: self.config.value()?,
            inputs: self.provenance.inputs.clone(),
            threads: self.threads,
            stages: self.stages.clone(),
            outputs: Vec::new(),
            limits: self.config.verdict.clone(),
        };
        Ok(Report::new(&self.case, &self.outcome, &run))
    }

    /// Names of what a run with these settings writes; with DICOM also what goes back.
    pub fn planned(config: &Config, dicom: bool) -> Planned {
        let mut planned = report::planned(config);
        planned.names.extend(dicom.then(Clinic::planned).into_iter().flatten());
        planned
    }

    /// Takes hold of the folder that it will be written into; refuses one that holds an input, or somebody else's work.
    ///
    /// # Errors
    /// As [`RunFolder::open`].
    pub fn hold(&self, folder: &Path) -> Result<RunFolder> {
        let inputs: Vec<&Path> = self.provenance.inputs.iter().map(|input| input.path.as_path()).collect();
        RunFolder::open(folder, &Self::planned(&self.config, self.back.is_some()), &inputs, &self.command)
    }

    /// Writes fields, images, masks, what goes back as DICOM, and the report into `out`, which `folder` holds; returns the
    /// report's numbers.
    ///
    /// # Errors
    /// [`crate::error::Error::Write`] when a file cannot be written.
    pub fn save(&mut self, folder: RunFolder, out: &Path, beside: Beside<'_>, runtime: &Runtime) -> Result<Report> {
        let (config, back) = (&*self.config, &self.back);
        let decided = Decided { case: &self.case, inputs: &self.provenance.inputs, config };
        let more = |outcome: &Outcome| {
            let there = beside.files.iter().map(|(name, what)| OutputFile::written(out, name, what));
            let mut files: Vec<OutputFile> = there.collect::<Result<_>>()?;
            let Some((clinic, n)) = back else { return Ok((files, Vec::new())) };
            let (written, warnings) = runtime.stage("write DICOM", || clinic.write(*n, &decided, outcome, out))?;
            files.extend(written);
            Ok((files, warnings))
        };
        let saving = Saving {
            command: &self.command,
            config,
            inputs: &self.provenance.inputs,
            view: beside.view,
            contours: back.as_ref().and_then(|(clinic, _)| clinic.contours()),
            samples: beside.samples,
            more: Some(&more as &More<'_>),
        };
        report::save(&self.case, &mut self.outcome, saving, folder, out, runtime)
    }
}
