//! Samples of a registration, drawn and written beside it.

use super::registered::Registered;
use crate::error::{Error, Result};
use crate::io::samples::{self, SAMPLES, SampledField, SamplesFile};
use crate::io::{Planned, RunFolder};
use crate::pipeline::{Case, Outcome, correlation, sample};
use crate::report::{Report, SAMPLES_PAGE, SAMPLES_SHOWN, write_samples_page};
use crate::runtime::Runtime;
use crate::sampling::{SampleSet, SamplingOptions};
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

/// Draws samples and writes them into `out`, with `samples.json` last; refuses options out of range before that folder is made.
///
/// # Errors
/// As [`sample`], [`RunFolder::open`] and [`samples::write`].
pub fn write_samples(of: Sampled<'_>, options: &SamplingOptions, out: &Path, runtime: &Runtime) -> Result<()> {
    let planning = &of.case.planning;
    let (drawn, strain) = runtime.stage("draw samples", || sample(planning, of.outcome, options))?;
    let posterior = of.outcome.posterior.as_ref();
    let posterior = posterior.ok_or_else(|| Error::Internal("samples were drawn of no posterior".into()))?;
    let names = samples::names(options.number).chain([SAMPLES_PAGE.to_owned()]).collect();
    let mut folder = RunFolder::open(out, &Planned { reports: vec![SAMPLES.into()], names }, &[], of.command)?;
    folder.begin()?;
    let field = |name: &str| {
        let listed = of.report.outputs.iter().find(|o| o.name.split('.').next() == Some(name));
        listed.map(|o| SampledField { name: o.name.clone(), sha256: o.sha256.clone() })
    };
    let about = SamplesFile {
        version: env!("CARGO_PKG_VERSION").into(),
        command: of.command.into(),
        options: *options,
        correlation: correlation(of.outcome),
        strain,
        fields: ["planning_to_fraction", "fraction_to_planning"].iter().filter_map(|name| field(name)).collect(),
        bones: Vec::new(),
        motions: Vec::new(),
        outputs: Vec::new(),
    };
    let first = &drawn[..drawn.len().min(SAMPLES_SHOWN)];
    let shown = SampleSet::new(&planning.bones.volume, &posterior.labels(), first)?;
    let page = || write_samples_page(out, (of.case, of.outcome), &shown, options, of.command);
    runtime.stage("draw", page)?;
    let write = || samples::write(out, &planning.bones, posterior, &drawn, &[SAMPLES_PAGE], about);
    runtime.stage("write samples", write)?;
    folder.finish();
    Ok(())
}

impl Registered {
    /// Draws samples of what was saved into `run`, into a folder of it; `report` is what saving returned.
    ///
    /// # Errors
    /// As [`write_samples`].
    pub fn save_samples(
        &self,
        report: &Report,
        run: &Path,
        options: &SamplingOptions,
        runtime: &Runtime,
    ) -> Result<()> {
        let of = Sampled { case: &self.case, outcome: &self.outcome, report, command: self.command() };
        write_samples(of, options, &run.join(SAMPLES_FOLDER), runtime)
    }
}
