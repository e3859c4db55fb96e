//! Error against run time: one case registered with settings of different cost.

use super::elements::bone_of_label;
use super::planning::Planning;
use super::{Case, FractionScan, Outcome, PlanningScan, register, register_fraction};
use crate::config::Config;
use crate::error::{Error, Result};
use crate::evaluate::jacobian::tissue;
use crate::field::push_point;
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
    /// Distance from the known positions, mm; with a third scan what the way around it misses.
    pub error_mm: Summary,
    /// Folded cells of soft tissue outside contact and sliding interfaces.
    pub folded: usize,
    /// Time of each stage.
    pub stages: Vec<StageTime>,
}

/// Registers the case and compares the result with its landmarks; or, with a third scan of the patient, the way from planning to
/// the fraction and on to the third with the way to the third alone, in soft tissue. The time is that of the first registration.
///
/// # Errors
/// [`Error::Input`] when the case has neither landmarks nor a third scan; [`Error::Usage`] for a region of interest with a third
/// scan; else those of [`register`].
pub fn measure(case: &Case, third: Option<&FractionScan>, config: &Config, runtime: &Runtime) -> Result<CurvePoint> {
    if case.fraction.landmarks.is_empty() && third.is_none() {
        let remedy = "give --landmarks, or a third scan with --around";
        return Err(Error::input("case", "it has no landmarks, which tell the error", remedy));
    }
    if third.is_some() && config.region.is_some() {
        let remedy = "leave the region of interest out of the settings";
        return Err(Error::usage("a third scan tells the error of whole scans only", remedy));
    }
    runtime.restart();
    let before = processor_seconds();
    let start = Instant::now();
    let planning = Planning::new(&case.planning, config, runtime)?;
    let outcome = register_fraction(case, planning.clone(), config, runtime)?.0;
    let seconds = start.elapsed().as_secs_f64();
    let spent = processor_seconds_since(before);
    let (folded, stages) = (outcome.jacobian_report.body.folded, runtime.times());
    let error_mm = match third {
        None => outcome.landmarks.map(|l| l.after).unwrap_or_default(),
        Some(third) => Summary::of(&around((case, planning), outcome, third, config, runtime)?),
    };
    Ok(CurvePoint { seconds, processor_seconds: spent, error_mm, folded, stages })
}

/// Points of soft tissue at which the way around is followed, about.
const POINTS: usize = 20_000;

/// Distances between the ends of both ways to the third scan, mm, from a case and its prepared planning side. The fraction has
/// planning's bones as `first` carries them.
fn around(
    (case, prepared): (&Case, Planning),
    first: Outcome,
    third: &FractionScan,
    config: &Config,
    runtime: &Runtime,
) -> Result<Vec<f64>> {
    let planning = &case.planning;
    let bone = bone_of_label(&first.skeleton);
    let counts = tissue(&first.body, &planning.ct);
    let soft = |n: &usize| counts.data()[*n] && bone[usize::from(planning.bones.volume.data()[*n])].is_none();
    let soft: Vec<usize> = (0..counts.data().len()).filter(soft).collect();
    let grid = planning.ct.grid();
    let points = soft.iter().step_by((soft.len() / POINTS).max(1)).map(|n| grid.centre(grid.voxel(*n)));
    // Each field is let go before the next registration.
    let there: Vec<_> = points.filter_map(|x| Some((x, push_point(&first.push, &x)?))).collect();
    let fraction = PlanningScan::new(case.fraction.ct.clone(), first.bones_on_fraction.to_map());
    drop(first.push);
    let on = Case { planning: fraction.into(), fraction: third.clone() };
    let on = register(&on, config, runtime)?.push;
    let there: Vec<_> = there.into_iter().filter_map(|(x, y)| Some((x, push_point(&on, &y)?))).collect();
    drop(on);
    let direct = Case { planning: planning.clone(), fraction: third.clone() };
    let direct = register_fraction(&direct, prepared, config, runtime)?.0.push;
    Ok(there.into_iter().filter_map(|(x, z)| Some((push_point(&direct, &x)? - z).norm())).collect())
}
