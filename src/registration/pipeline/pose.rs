//! Moving the skeleton by hand: an artificial CT in another posture (thesis 6.2.2).

use super::planning::Patient;
use super::posing::{BoneMotion, Posing, known};
use super::{Case, Outcome};
use crate::config::Config;
use crate::error::Result;
use crate::runtime::Runtime;

/// The patient in another posture, on the planning grid grown by `margin_mm` on all sides.
///
/// `case.fraction` plays no part. Returns the case with the artificial CT as its fraction, and the outcome.
///
/// # Errors
/// [`crate::error::Error::Input`] when the inputs do not fit each other or name bones that the skeleton does not have.
pub fn pose(
    case: Case,
    motion: &BoneMotion,
    margin_mm: f64,
    config: &Config,
    runtime: &Runtime,
) -> Result<(Case, Outcome)> {
    let patient = Patient::new(&case, config, runtime)?;
    // Wrong motions are found before the long work begins.
    known(&case, &patient.skeleton, motion)?;
    let posing = Posing::of(case, patient, margin_mm, config, runtime)?;
    let mut outcome = posing.posed(motion, config, runtime)?;
    outcome.warnings = [posing.warnings(), outcome.warnings].concat();
    let case = Case { fraction: outcome.planning_on_fraction.clone(), ..posing.case };
    Ok((case, outcome))
}
