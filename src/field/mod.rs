//! Rank 3: displacement fields. Push and pull are two types so that no one can mix them up.

mod bones;
mod cells;
mod chain;
mod consistency;
mod contour;
mod density;
mod format;
mod invert;
mod jacobian;
mod label_vote;
mod multiple;
mod newton;
mod overlap;
mod scatter;
mod search;
mod tetrahedra;
mod walk;
mod warp;

pub use bones::MovedBones;
pub use chain::{Chain, ChainReport, Link, Mapped, Motion, displacement};
pub use consistency::{ConsistencyOptions, ConsistencyReport, agree};
pub use contour::resample_contours;
pub use density::{Scaled, scale_by_volume};
pub use format::FieldFormat;
pub use invert::{Inverse, InverseReport, InvertOptions, Solved, invert};
pub use jacobian::{FOLDED, digital_folds, jacobian, jacobian_and_folds};
pub use label_vote::resample_labels;
pub use multiple::multiple_preimages;
pub use overlap::overlaps;
pub use scatter::{Resampling, ScatterReport, scatter_image};
pub use warp::{Interpolation, push_point, resample, warp_image, warp_labels, warp_mask};

use crate::volume::{Mask, Volume};

/// On the planning grid: planning point `x` goes to `x + u(x)` in the fraction. LPS mm.
///
/// In ITK's sense the displacement field transform of fixed = planning, moving = fraction.
#[derive(Debug, Clone)]
pub struct PushField {
    /// Displacement `u`, mm, at each voxel of the planning grid; finite everywhere.
    pub displacement: Volume<[f32; 3]>,
    /// Voxels whose displacement the model computed; elsewhere it is a smooth extension that fades to zero.
    pub computed: Mask,
}

/// On the fraction grid: fraction voxel `y` shows what was at `y + v(y)` in planning. LPS mm.
///
/// The inverse of the push field; resampling images needs this one.
#[derive(Debug, Clone)]
pub struct PullField {
    /// Displacement `v`, mm, at each voxel of the fraction grid; finite everywhere.
    pub displacement: Volume<[f32; 3]>,
    /// Voxels whose pre-image lies inside the planning image.
    pub inside: Mask,
}
