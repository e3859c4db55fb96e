//! Samples of a registration, drawn and written beside it.

use super::registered::Registered;
use crate::error::{Error, Result};
use crate::io::samples::{self, SAMPLES, SampledField, SamplesFile};
use crate::io::{Planned, RunFolder};
use crate::pipeline::{Case, Outcome, correlation, sample};
use crate::report::{Report, SAMPLES_PAGE, SAMPLES_SHOWN, ShownSamples, write_samples_page};
use crate::runtime::Runtime;
use crate::sampling::{Drawn, PosePosterior, SampleSet, SamplingOptions, Strain};
use std::path::Path;

/// The folder of samples inside that of their run.
pub const SAMPLES_FOLDER: &str = "samples";

/// A saved registration of which samples are drawn.
#[derive(Debug, Clone, Copy)]
pub struct Sampled<'a> {
    /// Both scans, on the grids of the results.
    pub case: &'a Case,
    /// What was found.
    pub outcome: &'a Outcome,
    /// Its report, which lists the fields.
    pub report: &'a Report,
    /// What is run, as the folder names it.
    pub command: &'a str,
}

/// Samples of a registration that were drawn and are not written yet.
#[derive(Debug)]
pub struct DrawnSamples {
    drawn: Vec<Drawn>,
    strain: Strain,
    options: SamplingOptions,
    shown: ShownSamples,
}

impl DrawnSamples {
    /// Draws them, and the pictures of the first.
    ///
    /// # Errors
    /// As [`sample`].
    pub fn draw(case: &Case, outcome: &Outcome, options: &SamplingOptions, runtime: &Runtime) -> Result<Self> {
        let all = || {
            let (drawn, strain) = sample(&case.planning, outcome, options)?;
            let labels = outcome.posterior.as_ref().map(PosePosterior::labels).unwrap_or_default();
            let first = &drawn[..drawn.len().min(SAMPLES_SHOWN)];
            let first = SampleSet::new(&case.planning.bones.volume, &labels, first)?;
            let shown = ShownSamples::draw(case, outcome, &first, options)?;
            Ok(Self { drawn, strain, options: *options, shown })
        };
        runtime.stage("draw samples", all)
    }

    /// The first of them as pages show them.
    pub fn shown(&self) -> &ShownSamples {
        &self.shown
    }

    /// Writes them and their page into `out`, with `samples.json` last.
    ///
    /// # Errors
    /// As [`RunFolder::open`] and [`samples::write`].
    pub fn write(&self, of: Sampled<'_>, out: &Path, runtime: &Runtime) -> Result<()> {
        let posterior = of.outcome.posterior.as_ref();
        let posterior = posterior.ok_or_else(|| Error::Internal("samples were drawn of no posterior".into()))?;
        let names = samples::names(self.options.number).chain([SAMPLES_PAGE.to_owned()]).collect();
        let mut folder = RunFolder::open(out, &Planned { reports: vec![SAMPLES.into()], names }, &[], of.command)?;
        folder.begin()?;
        let field = |name: &str| {
            let listed = of.report.outputs.iter().find(|o| o.name.split('.').next() == Some(name));
            listed.map(|o| SampledField { name: o.name.clone(), sha256: o.sha256.clone() })
        };
        let about = SamplesFile {
            version: env!("CARGO_PKG_VERSION").into(),
            command: of.command.into(),
            options: self.options,
            correlation: correlation(of.outcome),
            strain: self.strain,
            fields: ["planning_to_fraction", "fraction_to_planning"].iter().filter_map(|name| field(name)).collect(),
            bones: Vec::new(),
            motions: Vec::new(),
            outputs: Vec::new(),
        };
        let write = || {
            write_samples_page(out, &self.shown, of.command)?;
            samples::write(out, &of.case.planning.bones, posterior, &self.drawn, &[SAMPLES_PAGE], about)
        };
        runtime.stage("write samples", write)?;
        folder.finish();
        Ok(())
    }
}

/// Draws samples and writes them into `out`; refuses options out of range before that folder is made.
///
/// # Errors
/// As [`DrawnSamples::draw`] and [`DrawnSamples::write`].
pub fn write_samples(of: Sampled<'_>, options: &SamplingOptions, out: &Path, runtime: &Runtime) -> Result<()> {
    DrawnSamples::draw(of.case, of.outcome, options, runtime)?.write(of, out, runtime)
}

impl Registered {
    /// Draws samples of it, for its report and for [`Registered::save_samples`].
    ///
    /// # Errors
    /// As [`DrawnSamples::draw`].
    pub fn draw_samples(&self, options: &SamplingOptions, runtime: &Runtime) -> Result<DrawnSamples> {
        DrawnSamples::draw(&self.case, &self.outcome, options, runtime)
    }

    /// Writes samples of what was saved into `run`, into a folder of it; `report` is what saving returned.
    ///
    /// # Errors
    /// As [`DrawnSamples::write`].
    pub fn save_samples(&self, drawn: &DrawnSamples, report: &Report, run: &Path, runtime: &Runtime) -> Result<()> {
        let of = Sampled { case: &self.case, outcome: &self.outcome, report, command: self.command() };
        drawn.write(of, &run.join(SAMPLES_FOLDER), runtime)
    }
}
