//! Curl of a displacement field: how much it turns tissue on the spot.

use crate::stats::Summary;
use crate::volume::{Mask, Volume};
use nalgebra::{Matrix3, Vector3};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// Curl beyond this is called unphysical (Schreibmann et al. 2012, as cited in thesis 2.3.2).
pub const UNPHYSICAL: f64 = 5.0;

/// Magnitude of the curl over a mask.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct CurlReport {
    /// |curl u|, mm per mm; a rotation by the angle t has 2 sin t.
    pub magnitude: Summary,
    /// Voxels beyond [`UNPHYSICAL`].
    pub above_5: usize,
}

/// |curl u| at the voxels of `mask` that have neighbours on all sides, by central differences in the world frame. `mask` has
/// the field's grid.
pub fn evaluate(field: &Volume<[f32; 3]>, mask: &Mask) -> CurlReport {
    let grid = field.grid();
    let [ni, nj, nk] = grid.size();
    let strides = grid.strides();
    let u = |l: usize| Vector3::from(field.data()[l].map(f64::from));
    let planes: Vec<Vec<f32>> = (1..nk.max(2) - 1)
        .into_par_iter()
        .map(|k| {
            let mut all = Vec::new();
            for j in 1..nj.max(2) - 1 {
                for i in 1..ni.max(2) - 1 {
                    let l = grid.linear([i, j, k]);
                    if mask.data()[l] {
                        let by_index = Matrix3::from_columns(&strides.map(|s| (u(l + s) - u(l - s)) / 2.0));
                        all.push(curl(&(by_index * grid.inverse_step())).norm() as f32);
                    }
                }
            }
            all
        })
        .collect();
    let above_5 = planes.iter().flatten().filter(|c| f64::from(**c) > UNPHYSICAL).count();
    CurlReport { magnitude: Summary::of_singles(&planes.iter().map(|p| &p[..]).collect::<Vec<_>>()), above_5 }
}

/// The curl of a field with this derivative (row: component, column: direction).
fn curl(d: &Matrix3<f64>) -> Vector3<f64> {
    Vector3::new(d[(2, 1)] - d[(1, 2)], d[(0, 2)] - d[(2, 0)], d[(1, 0)] - d[(0, 1)])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Grid;
    use nalgebra::{Point3, Rotation3};
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn a_rotation_has_twice_its_sine(axis in prop::array::uniform3(-1.0f64..1.0), angle in 0.01f64..1.5, flip in any::<bool>()) {
            let axis = nalgebra::Unit::new_normalize(Vector3::from(axis) + Vector3::new(0.0, 0.0, 1.5));
            let mut direction = Rotation3::from_euler_angles(0.2, 0.1, -0.4).into_inner();
            if flip { direction.column_mut(2).neg_mut(); }
            let grid = Grid::new([7, 6, 5], [1.0, 2.0, 3.0], Point3::new(5.0, 3.0, 1.0), direction).unwrap();
            let turn = Rotation3::from_axis_angle(&axis, angle);
            let field = Volume::from_fn(grid.clone(), |l| {
                let x = grid.centre(grid.voxel(l));
                (turn * x - x).map(|c| c as f32).into()
            });
            let report = evaluate(&field, &Volume::filled(grid, true));
            prop_assert_eq!(report.magnitude.n, 5 * 4 * 3);
            prop_assert!((report.magnitude.min - 2.0 * angle.sin()).abs() < 1e-4);
            prop_assert!((report.magnitude.max - 2.0 * angle.sin()).abs() < 1e-4);
        }
    }

    #[test]
    fn a_stretch_has_none_and_a_shear_has_its_slope() {
        let grid = Grid::axis_aligned([5, 5, 5], [1.0; 3], [0.0; 3]).unwrap();
        let all = Volume::filled(grid.clone(), true);
        let at = |l: usize| grid.voxel(l).map(|c| c as f32);
        let stretch = Volume::from_fn(grid.clone(), |l| at(l).map(|c| 0.5 * c));
        assert!(evaluate(&stretch, &all).magnitude.max < 1e-6);
        let shear = Volume::from_fn(grid.clone(), |l| [6.0 * at(l)[1], 0.0, 0.0]);
        let report = evaluate(&shear, &all);
        assert!((report.magnitude.mean - 6.0).abs() < 1e-5 && report.above_5 == 27);
    }
}
