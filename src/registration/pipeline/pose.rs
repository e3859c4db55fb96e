//! Moving the skeleton by hand: an artificial CT in another posture (thesis 6.2.2).

use super::carry::{Carried, OUTSIDE_HU, carry_out};
use super::planning::{Patient, Resting};
use super::register::fit_warnings;
use super::{Case, Outcome};
use crate::config::Config;
use crate::error::{Error, Result};
use crate::fit::{GivenMotion, from_landmarks, given};
use crate::geometry::{Grid, Rigid};
use crate::runtime::Runtime;
use crate::skeleton::{Pose, Skeleton};
use crate::volume::Volume;
use nalgebra::Vector3;
use std::collections::BTreeMap;

/// How the bones are told to move.
#[derive(Debug, Clone, PartialEq)]
pub enum BoneMotion {
    /// Joint by joint; of all bones of the skeleton.
    Pose(Pose),
    /// Some bones' transforms, by name, planning to fraction, LPS mm; the others follow their joints.
    Transforms(BTreeMap<String, Rigid>),
    /// [`Case::bone_landmarks`]: bones with landmarks move as these say, the others follow their joints.
    Landmarks,
}

/// The patient in another posture, on the planning grid grown by `margin_mm` on all sides.
///
/// `case.fraction` plays no part. Returns the case with the artificial CT as its fraction, and the outcome.
///
/// # Errors
/// [`Error::Input`] when the inputs do not fit each other or name bones that the skeleton does not have.
pub fn pose(
    mut case: Case,
    motion: &BoneMotion,
    margin_mm: f64,
    config: &Config,
    runtime: &Runtime,
) -> Result<(Case, Outcome)> {
    let Patient { skeleton, body, warnings } = Patient::new(&case, config, runtime)?;
    let fit = given(&skeleton, &known(&case, &skeleton, motion)?)?;
    let warnings = [case.warnings.as_slice(), &warnings, &fit_warnings(&fit)].concat();
    let target = grown(case.planning.grid(), margin_mm)?;
    case.fraction = Volume::filled(target.clone(), OUTSIDE_HU);
    let resting = Resting::new(&case, (&skeleton, &body), false, config, runtime)?;
    let Carried { outcome, .. } =
        carry_out(&case, &target, (skeleton, body, fit), (&resting, None), warnings, config, runtime)?;
    case.fraction = outcome.planning_on_fraction.clone();
    Ok((case, outcome))
}

/// What is said about each bone's motion.
fn known(case: &Case, skeleton: &Skeleton, motion: &BoneMotion) -> Result<Vec<Option<GivenMotion>>> {
    let exactly = |transform: Rigid, source: &str| {
        Some(GivenMotion { transform, position_sd_mm: 0.0, source: source.to_owned() })
    };
    match motion {
        BoneMotion::Pose(pose) => {
            if pose.joints.len() != skeleton.bones.len() {
                let problem = format!("it has {} joints, the skeleton {}", pose.joints.len(), skeleton.bones.len());
                return Err(Error::input("pose", problem, "make the pose for this skeleton"));
            }
            Ok(skeleton.transforms(pose).into_iter().map(|t| exactly(t, "pose")).collect())
        }
        BoneMotion::Transforms(all) => {
            if let Some(name) = all.keys().find(|n| skeleton.bones.iter().all(|b| b.name != **n)) {
                return Err(Error::input(
                    "bone transforms",
                    format!("{name} is no bone of this skeleton"),
                    "use the names that `aventail skeleton` shows",
                ));
            }
            Ok(skeleton.bones.iter().map(|b| all.get(&b.name).and_then(|t| exactly(*t, "transform"))).collect())
        }
        BoneMotion::Landmarks => from_landmarks(skeleton, &case.bone_landmarks),
    }
}

/// The grid with whole voxels added on all sides.
fn grown(grid: &Grid, margin_mm: f64) -> Result<Grid> {
    let more: [usize; 3] = grid.spacing().map(|s| (margin_mm / s).ceil() as usize);
    let size = std::array::from_fn(|a| grid.size()[a] + 2 * more[a]);
    let origin = grid.world(&-Vector3::from(more.map(|m| m as f64)));
    Grid::new(size, grid.spacing(), origin, *grid.direction())
}
