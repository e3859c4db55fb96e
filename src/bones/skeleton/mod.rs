//! Rank 4: the kinematic skeleton. Rigid bones in a tree, joined by joints with soft limits.

pub mod anatomy;
mod build;
mod centres;
mod check;
mod limits;
mod order;
mod shape;
mod show;
mod sliding;
mod spine;
#[cfg(test)]
mod tests;

pub use anatomy::{is_of_spine, labels_of_spine};
pub use build::{Built, build};
pub use limits::Excess;
pub use order::in_order;
pub use show::tree;
pub use sliding::{Sliding, SlidingOptions};

use crate::geometry::{Rigid, about};
use nalgebra::{Matrix3, Point3, Vector3};
use serde::{Deserialize, Serialize};

/// The joint between a bone and its parent, in the planning posture. LPS mm, degrees.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Joint {
    /// Name, for example `atlanto-occipital`.
    pub name: String,
    /// Centre of rotation, LPS mm.
    pub centre: Point3<f64>,
    /// Unit axes as columns: flexion/extension (about right-left), lateral bending (about front-back),
    /// axial rotation (about foot-head).
    pub axes: Matrix3<f64>,
    /// Soft range of the rotation about each axis, degrees: least, greatest.
    pub rotation_range_deg: [[f64; 2]; 3],
    /// Soft range of the shift along each axis, plus or minus mm.
    pub translation_range_mm: [f64; 3],
    /// Where the ranges come from.
    pub source: String,
}

/// One rigid bone.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Bone {
    /// TotalSegmentator v2 name.
    pub name: String,
    /// Its label in the label map.
    pub label: u16,
    /// Position of the parent in [`Skeleton::bones`]; `None` for the root.
    pub parent: Option<usize>,
    /// Joint to the parent; for the root its centroid, unlimited.
    pub joint: Joint,
    /// Centroid of the label, LPS mm.
    pub centroid: Point3<f64>,
    /// Volume of the label in cubic mm.
    pub volume_mm3: f64,
}

/// Bones in parent-first order; `bones[0]` is the root.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Skeleton {
    /// The bones, each after its parent.
    pub bones: Vec<Bone>,
}

/// Motion of one joint: rotation vector in the joint's axes (radians) and shift along them (mm).
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct JointPose {
    /// Rotation vector, radians, in joint axes.
    pub rotation: [f64; 3],
    /// Shift, mm, in joint axes.
    pub translation: [f64; 3],
}

/// A pose: one [`JointPose`] per bone, in the order of [`Skeleton::bones`]. The root's is relative to the world.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Pose {
    /// Motion of each bone's joint.
    pub joints: Vec<JointPose>,
}

/// A joint that turns by this much about an axis may leave its bone far from where it was, degrees.
const FAR_DEG: f64 = 60.0;

impl Joint {
    /// Whether it turns far about any axis: a shoulder, an elbow, a hip or a knee.
    pub fn turns_far(&self) -> bool {
        self.rotation_range_deg.iter().any(|[low, high]| high - low >= FAR_DEG)
    }

    /// The motion of a child relative to its parent, expressed in the planning frame.
    pub fn motion(&self, pose: &JointPose) -> Rigid {
        about(&self.centre, self.axes * Vector3::from(pose.rotation), self.axes * Vector3::from(pose.translation))
    }
}

impl Skeleton {
    /// Label and name of each bone.
    pub fn labels_and_names(&self) -> Vec<(u16, String)> {
        self.bones.iter().map(|b| (b.label, b.name.clone())).collect()
    }

    /// A bone and all that hang on it, in their order.
    pub fn with_what_hangs_on(&self, bone: usize) -> Vec<usize> {
        let mut out = vec![bone];
        for (b, other) in self.bones.iter().enumerate().skip(bone + 1) {
            if other.parent.is_some_and(|parent| out.contains(&parent)) {
                out.push(b);
            }
        }
        out
    }

    /// Rigid transform of each bone, planning to fraction, LPS mm: parent's transform after the joint's motion.
    pub fn transforms(&self, pose: &Pose) -> Vec<Rigid> {
        let mut out: Vec<Rigid> = Vec::with_capacity(self.bones.len());
        for (bone, joint) in self.bones.iter().zip(&pose.joints) {
            let own = bone.joint.motion(joint);
            out.push(match bone.parent {
                Some(p) => out[p] * own,
                None => own,
            });
        }
        out
    }

    /// The pose that gives these transforms (inverse of [`Skeleton::transforms`]).
    pub fn pose_of(&self, transforms: &[Rigid]) -> Pose {
        let joints = self.bones.iter().zip(transforms).map(|(bone, own)| {
            let relative = match bone.parent {
                Some(p) => transforms[p].inverse() * own,
                None => *own,
            };
            let joint = &bone.joint;
            let back = joint.axes.transpose();
            JointPose {
                rotation: (back * relative.rotation.scaled_axis()).into(),
                translation: (back * (relative * joint.centre - joint.centre)).into(),
            }
        });
        Pose { joints: joints.collect() }
    }
}
