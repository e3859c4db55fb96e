//! Moving the skeleton by hand: an artificial CT in another posture (thesis 6.2.2).

use super::planning::Patient;
use super::posing::{BoneMotion, Posing, known};
use super::{Case, FractionScan, Outcome, PlanningScan};
use crate::config::Config;
use crate::error::Result;
use crate::evaluate::landmark::Landmark;
use crate::runtime::Runtime;
use std::sync::Arc;

/// The patient in another posture, on the planning grid grown by `margin_mm` on all sides. Landmarks, known in both postures,
/// evaluate the result.
///
/// Returns the case with the artificial CT as its fraction, and the outcome.
///
/// # Errors
/// [`crate::error::Error::Input`] when the inputs do not fit each other or name bones that the skeleton does not have.
pub fn pose(
    planning: Arc<PlanningScan>,
    motion: &BoneMotion,
    landmarks: Vec<Landmark>,
    margin_mm: f64,
    config: &Config,
    runtime: &Runtime,
) -> Result<(Case, Outcome)> {
    let patient = Patient::new(&planning, config, runtime)?;
    // Wrong motions are found before the long work begins.
    known(&patient.skeleton, motion)?;
    let posing = Posing::of(planning, patient, margin_mm, config, runtime)?;
    let mut outcome = posing.posed(motion, &landmarks, config, runtime)?;
    outcome.warnings = [posing.warnings(), &outcome.warnings].concat();
    let fraction = FractionScan { landmarks, ..FractionScan::new(outcome.planning_on_fraction.clone()) };
    Ok((Case { planning: posing.planning, fraction }, outcome))
}
