//! Many postures of one patient: what does not depend on the posture is made once.

use super::carry::{Fitted, Through, Told, carry_out};
use super::contact;
use super::planning::{Patient, Resting};
use super::register::fit_warnings;
use super::{Outcome, PlanningScan};
use crate::config::Config;
use crate::error::{Error, Result};
use crate::evaluate::contact::ContactReport;
use crate::evaluate::landmark::Landmark;
use crate::findings;
use crate::fit::{BoneLandmark, GivenMotion, from_landmarks, given};
use crate::geometry::{Grid, Rigid};
use crate::postures::Limits;
use crate::runtime::Runtime;
use crate::skeleton::{Bone, Pose, Skeleton};
use crate::warning::Warning;
use nalgebra::Vector3;
use std::collections::BTreeMap;
use std::sync::Arc;

/// How the bones are told to move.
#[derive(Debug, Clone, PartialEq)]
pub enum BoneMotion {
    /// Joint by joint; of all bones of the skeleton.
    Pose(Pose),
    /// Some bones' transforms, by name, planning to fraction, LPS mm; the others follow their joints.
    Transforms(BTreeMap<String, Rigid>),
    /// Landmarks on some bones: these move as they say, the others follow their joints.
    Landmarks(Vec<BoneLandmark>),
}

/// A patient who can be put into any posture.
pub struct Posing {
    pub(super) planning: Arc<PlanningScan>,
    patient: Patient,
    resting: Resting,
    target: Grid,
}

impl Posing {
    /// Prepares the planning side; artificial CTs will lie on the planning grid, grown by `margin_mm` on all sides.
    ///
    /// # Errors
    /// As [`super::pose`].
    pub fn new(planning: Arc<PlanningScan>, margin_mm: f64, config: &Config, runtime: &Runtime) -> Result<Self> {
        let patient = Patient::new(&planning, config, runtime)?;
        Self::of(planning, patient, margin_mm, config, runtime)
    }

    /// Of a patient who was found.
    pub(super) fn of(
        planning: Arc<PlanningScan>,
        patient: Patient,
        margin_mm: f64,
        config: &Config,
        runtime: &Runtime,
    ) -> Result<Self> {
        let target = grown(planning.ct.grid(), margin_mm)?;
        let resting = Resting::new(&planning, &patient.skeleton, &patient.body, false, config, runtime)?;
        Ok(Self { planning, patient, resting, target })
    }

    /// The planning side.
    pub fn planning(&self) -> &PlanningScan {
        &self.planning
    }

    /// The skeleton that is posed.
    pub fn skeleton(&self) -> &Skeleton {
        &self.patient.skeleton
    }

    /// What was found of the planning side.
    pub fn warnings(&self) -> &[Warning] {
        &self.patient.warnings
    }

    /// The bones' contact in a pose, before anything else is made of it.
    pub fn bones_meet(&self, pose: &Pose) -> ContactReport {
        self.resting.bones.moved(&self.patient.skeleton.transforms(pose))
    }

    /// The patient in a posture, with residuals of landmarks that are known in both. Settings may differ from those of [`Posing::new`] in `chainmail.volume_change` alone. Its
    /// warnings are of the posture; those of the planning side are [`Posing::warnings`].
    ///
    /// # Errors
    /// As [`super::pose`].
    pub fn posed(
        &self,
        motion: &BoneMotion,
        landmarks: &[Landmark],
        config: &Config,
        runtime: &Runtime,
    ) -> Result<Outcome> {
        let fit = given(&self.patient.skeleton, &known(&self.patient.skeleton, motion)?)?;
        let warnings = fit_warnings(&fit);
        let fitted = Fitted { skeleton: self.patient.skeleton.clone(), body: self.patient.body.clone(), fit };
        let through = Through { scan: &self.planning, target: &self.target, fraction: None };
        let carried = carry_out(through, self.resting.clone(), fitted, warnings, config, runtime)?;
        carried.outcome(&self.planning, landmarks, Told::default(), config, runtime)
    }

    /// Why bones in contact are implausible; nothing where they are not.
    pub fn why_of_bones(&self, contact: &ContactReport, limits: &Limits) -> Vec<String> {
        let voxel = self.resting.drawn_mm;
        let deepest = limits.overlap_mm.unwrap_or_else(|| contact::least_depth(voxel));
        let deep = contact.overlaps.iter().filter(|o| o.depth_mm > deepest);
        let mut why: Vec<String> =
            deep.map(|o| format!("{} lies {:.1} mm in {}", o.bones[0], o.depth_mm, o.bones[1])).collect();
        let apart = contact::warnings(contact, voxel).into_iter().filter(|w| w.is(findings::BONES_APART));
        why.extend(apart.map(|w| w.message));
        why
    }

    /// Why a posture is implausible: bones that lie in each other or come apart, folds, skin in skin, joints far beyond
    /// their range. Nothing where it is not.
    pub fn why_implausible(&self, outcome: &Outcome, limits: &Limits) -> Vec<String> {
        let mut why = self.why_of_bones(&outcome.contact, limits);
        let body = &outcome.jacobian_report.body;
        if body.folded > limits.folded_cells {
            why.push(format!("{} of {} tissue cells are folded", body.folded, body.cells));
        }
        let told = |w: &&Warning| w.is(findings::SKIN_MEETS_SKIN) || w.is(findings::JOINT_LIMIT);
        why.extend(outcome.warnings.iter().filter(told).map(|w| w.message.clone()));
        why
    }
}

/// What is said about each bone's motion.
pub(super) fn known(skeleton: &Skeleton, motion: &BoneMotion) -> Result<Vec<Option<GivenMotion>>> {
    let exactly = |transform: Rigid, source: &str| {
        Some(GivenMotion { transform, position_sd_mm: 0.0, source: source.to_owned() })
    };
    match motion {
        BoneMotion::Pose(pose) => {
            if pose.joints.len() != skeleton.bones.len() {
                let problem = format!("it has {} joints, the skeleton {}", pose.joints.len(), skeleton.bones.len());
                return Err(Error::input("pose", problem, "make the pose for this skeleton"));
            }
            bounded(skeleton, skeleton.transforms(pose).into_iter().map(|t| exactly(t, "pose")).collect())
        }
        BoneMotion::Transforms(all) => {
            if let Some(name) = all.keys().find(|n| skeleton.bones.iter().all(|b| b.name != **n)) {
                return Err(Error::input(
                    "bone transforms",
                    format!("{name} is no bone of this skeleton"),
                    "use the names that `aventail skeleton` shows",
                ));
            }
            let given = skeleton.bones.iter().map(|b| all.get(&b.name).and_then(|t| exactly(*t, "transform")));
            bounded(skeleton, given.collect())
        }
        BoneMotion::Landmarks(all) => from_landmarks(skeleton, all),
    }
}

/// Farther than this no bone moves, mm; a rotation that is no number shows in the same place.
const FARTHEST_MM: f64 = 5000.0;

/// Refuses motions that no patient makes.
fn bounded(skeleton: &Skeleton, motions: Vec<Option<GivenMotion>>) -> Result<Vec<Option<GivenMotion>>> {
    let gone = |(bone, motion): (&Bone, &Option<GivenMotion>)| {
        let moved = (motion.as_ref()?.transform * bone.centroid - bone.centroid).norm();
        (!moved.is_finite() || moved > FARTHEST_MM).then(|| (bone.name.clone(), moved))
    };
    match skeleton.bones.iter().zip(&motions).find_map(gone) {
        None => Ok(motions),
        Some((name, moved)) => Err(Error::input(
            "pose",
            format!("{name} would move by {moved:.0e} mm"),
            "give degrees and mm that a patient can move by, at most 5 m",
        )),
    }
}

/// The grid with whole voxels added on all sides.
fn grown(grid: &Grid, margin_mm: f64) -> Result<Grid> {
    let more: [usize; 3] = grid.spacing().map(|s| (margin_mm / s).ceil() as usize);
    let size = std::array::from_fn(|a| grid.size()[a] + 2 * more[a]);
    let origin = grid.world(&-Vector3::from(more.map(|m| m as f64)));
    Grid::new(size, grid.spacing(), origin, *grid.direction())
}
