//! Fraction voxels with more than one pre-image: those inside a tetrahedron that the push field turned inside out.
//!
//! A map that covers space once and folds covers the fold three times, once with negative orientation; so the voxels
//! inside inverted tetrahedra are those whose pre-image is not unique.

use super::PushField;
use super::jacobian::FOLDED;
use super::tetrahedra::cut;
use crate::geometry::Grid;
use crate::volume::{Mask, Volume};
use nalgebra::{Matrix3, Vector3};

/// Mask on the fraction grid of voxels with several pre-images. `map` is the Jacobian map of `push`.
pub fn multiple_preimages(push: &PushField, map: &Volume<f32>, fraction: &Grid) -> Mask {
    let grid = push.displacement.grid();
    let mut out = Volume::filled(fraction.clone(), false);
    for (l, _) in map.data().iter().enumerate().filter(|(_, j)| **j <= FOLDED) {
        let at = grid.voxel(l);
        let corner = |c: usize| {
            let voxel: [usize; 3] = std::array::from_fn(|a| at[a] + (c >> a & 1));
            let u = Vector3::from(push.displacement.at(voxel).map(f64::from));
            (grid.centre(voxel), fraction.index(&(grid.centre(voxel) + u)))
        };
        for t in cut(at) {
            let p = t.map(corner);
            let rest = Matrix3::from_columns(&[p[1].0 - p[0].0, p[2].0 - p[0].0, p[3].0 - p[0].0]).determinant();
            let moved = Matrix3::from_columns(&[p[1].1 - p[0].1, p[2].1 - p[0].1, p[3].1 - p[0].1]);
            let handed = fraction.inverse_step().determinant().signum();
            if moved.determinant() * handed * rest.signum() < 0.0 {
                mark(&mut out, &p.map(|c| c.1), &moved);
            }
        }
    }
    out
}

/// Sets the voxels inside a tetrahedron given by its corners' continuous indices and its edge matrix.
fn mark(out: &mut Mask, corners: &[Vector3<f64>; 4], edges: &Matrix3<f64>) {
    let Some(inverse) = edges.try_inverse() else { return };
    let size = out.grid().size();
    let range = |a: usize| {
        let low = corners.iter().map(|c| c[a]).fold(f64::MAX, f64::min).ceil().max(0.0);
        let high = corners.iter().map(|c| c[a]).fold(f64::MIN, f64::max).floor().min(size[a] as f64 - 1.0);
        if high < low { 0..0 } else { low as usize..high as usize + 1 }
    };
    for k in range(2) {
        for j in range(1) {
            for i in range(0) {
                let b = inverse * (Vector3::new(i as f64, j as f64, k as f64) - corners[0]);
                if b.min() >= 0.0 && b.sum() <= 1.0 {
                    let l = out.grid().linear([i, j, k]);
                    out.data_mut()[l] = true;
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::field::jacobian;

    #[test]
    fn a_fold_covers_its_middle_three_times() {
        let grid = Grid::axis_aligned([41, 5, 5], [1.0; 3], [-20.0, 0.0, 0.0]).unwrap();
        // x + u(x) = x - 12 tanh(x / 6): folds between the turning points at +-6 acosh(sqrt 2), images -+3.1.
        let displacement =
            Volume::from_fn(grid.clone(), |l| [-12.0 * ((grid.voxel(l)[0] as f32 - 20.0) / 6.0).tanh(), 0.0, 0.0]);
        let push = PushField { displacement, computed: Volume::filled(grid.clone(), true) };
        let mask = multiple_preimages(&push, &jacobian(&push), &grid);
        for i in 0..41 {
            assert_eq!(*mask.at([i, 2, 2]), (i as i32 - 20).abs() <= 3, "voxel {i}");
        }
        let flat = PushField { displacement: Volume::filled(grid.clone(), [1.0, 0.0, 0.0]), ..push };
        assert_eq!(multiple_preimages(&flat, &jacobian(&flat), &grid).count(), 0);
    }
}
