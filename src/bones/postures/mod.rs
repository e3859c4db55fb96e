//! Rank 5: postures drawn from distributions of the joints' motion.
//!
//! A [`PosturePlan`] says how a skeleton varies: shared modes (the neck bends as one, with its levels' shares), what each
//! joint varies by itself, the couch, and volumes of organs. [`PosturePlan::draw`] makes posture after posture of it from a
//! scrambled Sobol sequence; [`PosturePlan::usual`] is the default, with its sources; [`principal`] finds the modes of
//! postures that were fitted.

mod modes;
mod plan;
mod sequence;
mod truncated;
mod usual;

pub use modes::{Principal, principal};
pub use plan::{Drawn, Limits, Mode, NamedPose, PosturePlan, Spread, VolumeRange};
pub use sequence::MOST_DRAWS;
pub use usual::{Sd, Source, neck, sources};

use crate::skeleton::{JointPose, Pose};

/// Motion of one joint: flexion, lateral bending, axial turn (degrees), then the shift along the same axes (mm).
pub type Six = [f64; 6];

/// A pose in degrees and mm.
pub fn sixes(pose: &Pose) -> Vec<Six> {
    let six = |j: &JointPose| {
        let ([a, b, c], [x, y, z]) = (j.rotation.map(f64::to_degrees), j.translation);
        [a, b, c, x, y, z]
    };
    pose.joints.iter().map(six).collect()
}

/// The pose of values in degrees and mm.
pub fn pose_of(values: &[Six]) -> Pose {
    let joint =
        |[a, b, c, x, y, z]: &Six| JointPose { rotation: [*a, *b, *c].map(f64::to_radians), translation: [*x, *y, *z] };
    Pose { joints: values.iter().map(joint).collect() }
}
