//! How far a pose leaves the joints' soft ranges.

use super::{Joint, JointPose, Pose, Skeleton};
use serde::{Deserialize, Serialize};

/// By how much one joint is beyond its soft ranges; 0 within them, negative below, positive above.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct Excess {
    /// Degrees about the joint's axes.
    pub rotation_deg: [f64; 3],
    /// Millimetres along the joint's axes.
    pub translation_mm: [f64; 3],
}

impl Excess {
    /// Whether the joint is within all its ranges.
    pub fn is_zero(&self) -> bool {
        self.rotation_deg.iter().chain(&self.translation_mm).all(|e| e.abs() < f64::EPSILON)
    }
}

impl Joint {
    /// By how much `pose` is beyond this joint's soft ranges.
    pub fn excess(&self, pose: &JointPose) -> Excess {
        let beyond = |v: f64, [low, high]: [f64; 2]| if v < low { v - low } else { (v - high).max(0.0) };
        Excess {
            rotation_deg: std::array::from_fn(|a| beyond(pose.rotation[a].to_degrees(), self.rotation_range_deg[a])),
            translation_mm: std::array::from_fn(|a| {
                let range = self.translation_range_mm[a];
                beyond(pose.translation[a], [-range, range])
            }),
        }
    }
}

impl Skeleton {
    /// By how much each joint of a pose is beyond its soft ranges, in the order of the bones.
    pub fn excess(&self, pose: &Pose) -> Vec<Excess> {
        self.bones.iter().zip(&pose.joints).map(|(b, p)| b.joint.excess(p)).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Matrix3, Point3};

    #[test]
    fn excess_is_signed_and_zero_within() {
        let joint = Joint {
            name: "j".into(),
            centre: Point3::origin(),
            axes: Matrix3::identity(),
            rotation_range_deg: [[-3.0, 30.0], [-5.0, 5.0], [-5.0, 5.0]],
            translation_range_mm: [1.0, 2.0, 3.0],
            source: String::new(),
        };
        let pose = JointPose {
            rotation: [-10f64.to_radians(), 4f64.to_radians(), 12f64.to_radians()],
            translation: [0.5, -2.5, 4.0],
        };
        let e = joint.excess(&pose);
        let expected = [-7.0, 0.0, 7.0, 0.0, -0.5, 1.0];
        for (got, want) in e.rotation_deg.iter().chain(&e.translation_mm).zip(expected) {
            assert!((got - want).abs() < 1e-9, "{e:?}");
        }
        assert!(!e.is_zero() && joint.excess(&JointPose::default()).is_zero());
    }
}
