//! Error against run time: one case registered with settings of different cost.

use super::{Case, register};
use crate::config::Config;
use crate::error::{Error, Result};
use crate::evaluate::jacobian::tissue;
use crate::evaluate::landmark::Landmark;
use crate::phantom::Phantom;
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

/// Points whose true motion tells the error on a phantom.
const POINTS: usize = 20_000;

/// The phantom as a case, whose landmarks are points all over its soft tissue with their true positions.
pub fn phantom_case(phantom: Phantom) -> Case {
    let grid = phantom.planning.grid();
    let soft = tissue(&phantom.body, &phantom.planning);
    let is_soft = |&v: &usize| soft.data()[v] && phantom.bones.volume.data()[v] == 0;
    let all: Vec<usize> = (0..grid.len()).filter(is_soft).collect();
    let every = (all.len() / POINTS).max(1);
    let fraction = phantom.fraction.grid();
    let landmark = |&v: &usize| {
        let planning = grid.centre(grid.voxel(v));
        Landmark { name: v.to_string(), planning, fraction: phantom.push(&planning) }
    };
    let seen = |l: &Landmark| fraction.contains(&fraction.index(&l.fraction));
    let landmarks = all.iter().step_by(every).map(landmark).filter(seen).collect();
    let mut case = Case::from(phantom);
    case.fraction.landmarks = landmarks;
    case
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
        stages: outcome.stages,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::phantom::PhantomOptions;
    use crate::refine::RefineOptions;

    #[test]
    fn the_error_is_that_of_the_settings_and_not_of_the_points() {
        let case = phantom_case(Phantom::new(&PhantomOptions::coarse()).unwrap());
        assert!(case.fraction.landmarks.len() > 10_000);
        let runtime = Runtime::silent().unwrap();
        // Nothing that comes after the images plays a part here.
        let mut by_images = Config::default();
        by_images.consistency.rounds = 0;
        by_images.output.uncertainty = false;
        let by_bones =
            Config { refine: RefineOptions { weight: 0.0, ..RefineOptions::default() }, ..by_images.clone() };
        let [with, without] = [&by_images, &by_bones].map(|config| measure(&case, config, &runtime).unwrap());
        assert!(with.error_mm.mean > 0.0 && with.error_mm.mean < without.error_mm.mean, "{with:?} {without:?}");
        assert!(with.seconds > 0.0 && with.stages.len() > 5);
        let mut blind = case;
        blind.fraction.landmarks.clear();
        assert_eq!(measure(&blind, &Config::default(), &runtime).unwrap_err().exit_code(), 4);
    }
}
