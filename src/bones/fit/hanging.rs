//! Skeletons that tests of trees and joints look at.

use crate::skeleton::{Bone, Joint, Skeleton};
use nalgebra::{Matrix3, Point3};

/// Bones that hang on these.
pub fn hanging(parents: &[Option<usize>]) -> Skeleton {
    let joint = || Joint {
        name: String::new(),
        centre: Point3::origin(),
        axes: Matrix3::identity(),
        rotation_range_deg: [[-1.0, 1.0]; 3],
        translation_range_mm: [1.0; 3],
        source: String::new(),
    };
    let bone = |(n, &parent): (usize, &Option<usize>)| Bone {
        name: n.to_string(),
        label: n as u16 + 1,
        parent,
        joint: joint(),
        centroid: Point3::origin(),
        volume_mm3: 1.0,
    };
    Skeleton { bones: parents.iter().enumerate().map(bone).collect() }
}
