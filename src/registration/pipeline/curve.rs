//! Error against run time: one case registered with settings of different cost.

use super::{Case, register};
use crate::config::Config;
use crate::error::{Error, Result};
use crate::runtime::{Runtime, StageTime, processor_seconds, processor_seconds_since};
use crate::stats::Summary;
use serde::{Deserialize, Serialize};
use std::time::Instant;

/// How one setting did.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct CurvePoint {
    /// Wall time of the registration in memory, s: no file is read or written.
    pub seconds: f64,
    /// Processor time, all threads together, s, where the system tells.
    pub processor_seconds: Option<f64>,
    /// Distance from the known positions, mm.
    pub error_mm: Summary,
    /// Folded cells of soft tissue outside contact and sliding interfaces.
    pub folded: usize,
    /// Time of each stage.
    pub stages: Vec<StageTime>,
}

/// Registers the case and compares the result with its landmarks.
///
/// # Errors
/// [`Error::Input`] when the case has no landmarks; else those of [`register`].
pub fn measure(case: &Case, config: &Config, runtime: &Runtime) -> Result<CurvePoint> {
    if case.fraction.landmarks.is_empty() {
        return Err(Error::input("case", "it has no landmarks, which tell the error", "give --landmarks"));
    }
    runtime.restart();
    let before = processor_seconds();
    let start = Instant::now();
    let outcome = register(case, config, runtime)?;
    let seconds = start.elapsed().as_secs_f64();
    let spent = processor_seconds_since(before);
    let error_mm = outcome.landmarks.map(|l| l.after).unwrap_or_default();
    Ok(CurvePoint {
        seconds,
        processor_seconds: spent,
        error_mm,
        folded: outcome.jacobian_report.body.folded,
        stages: runtime.times(),
    })
}
