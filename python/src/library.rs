//! Artificial CTs in sampled postures, and the modes of a patient's own.

use crate::case::{COMMAND, Settings};
use crate::errors::Raised;
use crate::runs::{Runs, Work};
use aventail::cli::args::{QuietArgs, RunArgs};
use aventail::cli::library::{self, LibraryArgs};
use aventail::io;
use aventail::postures::VolumeRange;
use pyo3::prelude::*;
use std::path::PathBuf;

/// Files and numbers of a library.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub(crate) struct Wanted {
    planning: PathBuf,
    bones: PathBuf,
    out: PathBuf,
    plan: Option<PathBuf>,
    sample: Option<u32>,
    seed: u32,
    reject: bool,
    margin: f64,
    labels: Option<PathBuf>,
    organs: Option<PathBuf>,
    volume_change: Vec<(String, [f64; 2])>,
    skeleton: Option<PathBuf>,
    structures: Option<PathBuf>,
    dose: Option<PathBuf>,
    fields: bool,
    cbct: bool,
    cbct_file: Option<PathBuf>,
    noise: Option<f64>,
}

impl Wanted {
    /// The same as the program's arguments; `quiet` where nobody is told of progress.
    fn arguments(self, quiet: bool) -> LibraryArgs {
        let range = |(organ, range): (String, [f64; 2])| VolumeRange { organ, range };
        LibraryArgs {
            planning: Some(self.planning),
            bones: Some(self.bones),
            plan: self.plan,
            sample: self.sample,
            seed: self.seed,
            reject: self.reject,
            out: self.out,
            fit: Vec::new(),
            margin: self.margin,
            labels: self.labels,
            organs: self.organs,
            volume_change: self.volume_change.into_iter().map(range).collect(),
            skeleton: self.skeleton,
            structures: self.structures,
            dose: self.dose,
            no_fields: !self.fields,
            cbct: self.cbct.then_some(self.cbct_file),
            noise: self.noise,
            config: None,
            run: RunArgs { shown: QuietArgs { quiet }, ..RunArgs::default() },
        }
    }
}

/// Makes a library; returns its datalist as JSON.
#[pyfunction]
#[pyo3(signature = (wanted, settings, work))]
pub(crate) fn make_library(py: Python<'_>, wanted: Wanted, settings: Settings, work: Work<'_>) -> PyResult<String> {
    let config = settings.config().raised(py)?;
    let mut arguments = wanted.arguments(work.progress().is_none());
    arguments.run.work.threads = work.threads();
    Runs::new(work.threads()).raised(py)?.run(py, work.progress(), move |runtime| {
        io::json(&library::make(&arguments, config, &[], runtime, COMMAND)?.manifest)
    })
}

/// Finds the principal modes of saved registrations; returns them as JSON.
#[pyfunction]
pub(crate) fn fit_postures(py: Python<'_>, runs: Vec<PathBuf>, out: PathBuf) -> PyResult<String> {
    py.detach(|| io::json(&library::fit(&runs, &out, COMMAND)?)).raised(py)
}
