//! A posture that is made: the same planning side, moved as it is told.

use super::fraction::bone_landmarks;
use super::headers;
use super::planning::PlanningSources;
use super::registered::{Made, Registered};
use super::source::{Source, landmarks};
use crate::config::{Config, InputRole, RecordedInput};
use crate::error::{Error, Result};
use crate::evaluate::landmark::Landmark;
use crate::fit::BoneLandmark;
use crate::geometry::Rigid;
use crate::io;
use crate::pipeline::{self, BoneMotion, PlanningScan};
use crate::provenance::Provenance;
use crate::runtime::Runtime;
use crate::skeleton::{Skeleton, build};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Widest rim around the planning grid, mm: more is no artificial CT of a patient.
pub const MOST_MARGIN_MM: f64 = 500.0;

/// How the bones are told to move.
#[derive(Debug, Clone)]
pub enum MotionSource {
    /// Joint by joint: a pose file (TOML), or its text.
    Pose(Source<String>),
    /// Transforms of bones by name.
    Transforms(Source<BTreeMap<String, Rigid>>),
    /// Landmarks on bones in both postures.
    Landmarks(Source<Vec<BoneLandmark>>),
}

/// What is to be posed, and how.
#[derive(Debug, Clone)]
pub struct PoseRequest {
    /// The planning side.
    pub planning: PlanningSources,
    /// How the bones move.
    pub motion: MotionSource,
    /// Landmarks known in both postures, which evaluate the result.
    pub landmarks: Option<Source<Vec<Landmark>>>,
    /// Air around the planning grid, mm.
    pub margin_mm: f64,
    /// Inputs of an earlier run, as in [`Request::recorded`](super::Request::recorded).
    pub recorded: Vec<RecordedInput>,
    /// Complete settings.
    pub config: Config,
    /// What is run, as reports and locks name it.
    pub command: String,
}

impl MotionSource {
    /// Its file.
    fn path(&self) -> Option<&Path> {
        match self {
            Self::Pose(source) => source.path(),
            Self::Transforms(source) => source.path(),
            Self::Landmarks(source) => source.path(),
        }
    }

    /// The motion of a patient, whose skeleton it fixes where it names joints.
    fn of(self, scan: &mut PlanningScan, provenance: &mut Provenance) -> Result<BoneMotion> {
        match self {
            Self::Pose(source) => {
                let skeleton = fixed(scan)?;
                Ok(BoneMotion::Pose(match source {
                    Source::Memory(text) => io::pose::parse_pose(&text, "pose", skeleton)?,
                    Source::File(path) => {
                        provenance.note(InputRole::Pose, &path)?;
                        io::pose::read_pose(path, skeleton)?
                    }
                }))
            }
            Self::Transforms(source) => {
                let read = |path: &Path| io::read_bone_transforms(path);
                Ok(BoneMotion::Transforms(source.value(InputRole::Transforms, provenance, read)?))
            }
            Self::Landmarks(source) => Ok(BoneMotion::Landmarks(bone_landmarks(source, provenance)?)),
        }
    }
}

/// The skeleton of a patient, from now on: a pose names its very bones and joints.
fn fixed(scan: &mut PlanningScan) -> Result<&Skeleton> {
    let skeleton = match scan.skeleton.take() {
        Some(own) => own,
        None => build(&scan.bones)?.skeleton,
    };
    Ok(scan.skeleton.insert(skeleton))
}

impl PoseRequest {
    /// All files that will be read.
    pub fn files(&self) -> Vec<PathBuf> {
        let mut all: Vec<PathBuf> = self.planning.files().collect();
        all.extend(self.needed());
        all
    }

    /// The files beside those of the planning side.
    pub fn needed(&self) -> Vec<PathBuf> {
        let marks = self.landmarks.as_ref().and_then(Source::path);
        marks.into_iter().chain(self.motion.path()).map(Path::to_owned).collect()
    }

    /// Refuses what headers tell.
    ///
    /// # Errors
    /// As [`super::judge`].
    pub fn judge(&self) -> Result<()> {
        headers::judge(&self.planning, &[], &self.config).map(drop)
    }
}

/// Makes the posture.
///
/// # Errors
/// When a file cannot be read or used, or the motion names bones that the skeleton does not have.
pub fn pose(request: PoseRequest, runtime: &Runtime) -> Result<Registered> {
    let PoseRequest { planning, motion, landmarks: marks, margin_mm, recorded, mut config, command } = request;
    config.planning.modality = headers::planning_modality(&planning, config.planning.modality)?;
    config.fraction.modality = headers::modality(&[], config.fraction.modality)?;
    if !(0.0..=MOST_MARGIN_MM).contains(&margin_mm) {
        let problem = format!("a margin of {margin_mm} mm cannot be put around the planning scan");
        return Err(Error::usage(problem, format!("give 0 to {MOST_MARGIN_MM} mm")));
    }
    let (mut scan, mut provenance) = planning.read(&recorded, &config, runtime)?;
    let mut of_motion = Provenance::default();
    let marks = marks.map(|marks| landmarks(marks, &mut of_motion)).transpose()?.unwrap_or_default();
    let motion = motion.of(&mut scan, &mut of_motion)?;
    of_motion.compare(&recorded);
    provenance.extend(of_motion);
    let (case, outcome) = pipeline::pose(Arc::new(scan), &motion, marks, margin_mm, &config, runtime)?;
    let made = Made { case, outcome, provenance, back: None };
    Ok(Registered::new(made, &Arc::new(config), &command.into(), runtime))
}
