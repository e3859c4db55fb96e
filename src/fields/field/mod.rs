//! Rank 3: displacement fields. Push and pull are two types so that no one can mix them up.
//!
//! A registration makes a [`PushField`]; `inverse` makes the [`PullField`] of it and `consistency` lets soft tissue give way until
//! both agree as they are stored. `mesh` measures a push field (Jacobian, folds), `warp` carries images, labels, contours and
//! points, [`Chain`] joins fields and rigid transforms between named frames into one map. Fields are read by
//! [`crate::volume::interpolation`].
//! Directions and frames: docs/conventions.md; what was tried: docs/decisions/fields.md.

mod chain;
mod consistency;
mod format;
mod inverse;
mod mesh;
mod outside;
mod warp;

pub use chain::{Chain, ChainReport, Link, Mapped, Motion, displacement};
pub use consistency::{Beside, ConsistencyOptions, ConsistencyReport, agree, beside_contact};
pub use format::FieldFormat;
pub use inverse::{Inverse, InverseReport, InvertOptions, MovedBones, Solved, invert, take_sides};
pub use mesh::{
    FOLDED, Resampling, RowOfCells, ScatterReport, digital_folds, folded_anywhere, folded_cells, jacobian,
    jacobian_by_rows, multiple_preimages, overlaps, scatter_image,
};
pub use outside::{Outside, WORTH, WORTH_OF_IMAGE, WORTH_OF_LABELS, covers, outside_field};
pub use warp::{
    Interpolation, Scaled, push_point, resample, resample_contours, resample_labels, scale_by_volume, warp_image,
    warp_labels,
};

use crate::volume::{Mask, Volume};

/// On the planning grid: planning point `x` goes to `x + u(x)` in the fraction. LPS mm.
///
/// In ITK's sense the displacement field transform of fixed = planning, moving = fraction.
#[derive(Debug, Clone)]
pub struct PushField {
    /// Displacement `u`, mm, at each voxel of the planning grid; finite everywhere.
    pub displacement: Volume<[f32; 3]>,
    /// Voxels whose displacement the model computed; elsewhere it is a smooth extension that fades to the mean motion.
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

/// A displacement where a field is a mere continuation, mm, in steps of 1/2048 mm: single precision's last bits would be noise
/// there, which makes files larger and slower to write (docs/decisions/fields.md).
#[inline(always)]
pub fn in_steps(u: [f32; 3]) -> [f32; 3] {
    // Sums of up to 2 m with it have single-precision steps of just that size; larger ones keep about their own precision.
    const MAGIC: f32 = 6144.0;
    u.map(|c| (c + MAGIC) - MAGIC)
}

#[cfg(test)]
mod tests {
    use super::in_steps;

    #[test]
    fn steps_are_a_half_thousandth_of_a_millimetre() {
        for c in [0.0f32, 1.0, -0.3, 17.123_456, -1999.9, 0.000_2] {
            let [x, y, z] = in_steps([c, -c, 0.5 * c]);
            for (held, given) in [(x, c), (y, -c), (z, 0.5 * c)] {
                assert!(
                    (held - given).abs() <= 1.0 / 4096.0 && (held * 2048.0).fract().abs() < f32::EPSILON,
                    "{held} for {given}"
                );
            }
        }
        let far = in_steps([1e6, -3e5, 12_345.678]);
        assert!((far[0] - 1e6).abs() < 0.1 && (far[1] + 3e5).abs() < 0.1 && (far[2] - 12_345.678).abs() < 0.001);
    }
}
