//! Postures by bone name, as users write them, and the default one.

use crate::error::{Error, Result};
use crate::skeleton::{JointPose, Pose, Skeleton};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Motion of one joint from the planning posture.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct JointMotion {
    /// Rotation vector in joint axes, degrees: flexion (forward), lateral bending, axial turn (to the left).
    pub rotation_deg: [f64; 3],
    /// Shift along the joint axes, mm: left, back, up.
    pub shift_mm: [f64; 3],
}

/// A posture: the joints that move, by the name of the bone that each one carries. Other joints stay.
///
/// Any rotation can be written, up to arms raised from arms down (`data/raise_arms.toml`); bones then are
/// still exactly rigid. Soft tissue is blended by logarithms, so no bone may turn by 180 degrees or more against
/// the planning posture, and at such angles the true map folds (3 % of the body's voxels with both arms raised), so
/// that `Phantom::unfound` is not 0 and the fraction image has no meaning around the shoulders.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Posture {
    /// Motion of each named bone's joint to its parent.
    pub joints: BTreeMap<String, JointMotion>,
}

impl Default for Posture {
    /// The posture of `data/demo_posture.toml`.
    fn default() -> Self {
        toml::from_str(include_str!("../../../data/demo_posture.toml"))
            .expect("the shipped posture is checked by a test")
    }
}

impl Posture {
    /// The posture of the second fraction, `data/second_posture.toml`.
    pub fn second() -> Self {
        toml::from_str(include_str!("../../../data/second_posture.toml"))
            .expect("the shipped posture is checked by a test")
    }

    /// Reads TOML: a table for each bone that moves.
    ///
    /// # Errors
    /// What is wrong, and where.
    pub fn parse(text: &str) -> std::result::Result<Self, String> {
        toml::from_str(text.trim_start_matches('\u{feff}')).map_err(|e| e.to_string())
    }

    /// No motion at all.
    pub fn at_rest() -> Self {
        Self { joints: BTreeMap::new() }
    }

    /// The pose of a skeleton in this posture.
    ///
    /// # Errors
    /// When a name is not a bone of the skeleton or a number is not finite.
    pub fn pose(&self, skeleton: &Skeleton) -> Result<Pose> {
        let mut joints = vec![JointPose::default(); skeleton.bones.len()];
        for (name, motion) in &self.joints {
            let Some(n) = skeleton.bones.iter().position(|b| b.name == *name) else {
                let problem = format!("no bone is named {name}");
                return Err(Error::input("posture", problem, "use the phantom's bone names, for example vertebrae_C5"));
            };
            if motion.rotation_deg.iter().chain(&motion.shift_mm).any(|v| !v.is_finite()) {
                return Err(Error::input("posture", format!("the motion of {name} is not finite"), "give numbers"));
            }
            joints[n] = JointPose { rotation: motion.rotation_deg.map(f64::to_radians), translation: motion.shift_mm };
        }
        Ok(Pose { joints })
    }
}
