//! Signed distances to a surface that voxels describe.

use super::{Mask, Volume, distance::squared_distance_within, gaussian, trilinear};
use crate::geometry::Grid;
use nalgebra::{Point3, Vector3};

/// Distance of each voxel from the surface of a mask, mm: negative inside; no more than `known`. Blurred by a share of the
/// voxels' least edge, which draws the surface of a ball inwards by the blur's square over its radius.
pub fn depth(inside: &Mask, known: f64, blur: f64) -> Volume<f32> {
    let signed = measured_depth(inside, |_| true, known);
    let edge = inside.grid().spacing().into_iter().fold(f64::MAX, f64::min);
    if blur > 0.0 { gaussian(&signed, blur * edge) } else { signed }
}

/// The same of what was measured: voxels that were not tell of no surface, and have no number themselves.
pub fn measured_depth(inside: &Mask, measured: impl Fn(usize) -> bool + Sync, known: f64) -> Volume<f32> {
    let outside = Volume::from_fn(inside.grid().clone(), |n| !inside.data()[n] && measured(n));
    let [to_it, out_of_it] = [inside, &outside].map(|mask| squared_distance_within(mask, true, known));
    let mm = |square: f32| f64::from(square).sqrt().min(known) as f32;
    let value = |n: usize| if measured(n) { mm(to_it.data()[n]) - mm(out_of_it.data()[n]) } else { f32::NAN };
    Volume::from_fn(inside.grid().clone(), value)
}

/// Gradient of such distances at a continuous index, per mm; `None` at the edge of the grid.
pub fn slope(depth: &Volume<f32>, at: &Vector3<f64>) -> Option<Vector3<f64>> {
    let along = |a: usize| {
        let mut step = Vector3::zeros();
        step[a] = 0.5;
        Some(trilinear(depth, &(at + step))? - trilinear(depth, &(at - step))?)
    };
    Some(depth.grid().inverse_step().transpose() * Vector3::new(along(0)?, along(1)?, along(2)?))
}

/// How far a point lies within the edges of a grid, mm; negative outside.
pub fn within_edges(grid: &Grid, point: &Point3<f64>) -> f64 {
    let (at, size, spacing) = (grid.index(point), grid.size(), grid.spacing());
    (0..3).map(|a| at[a].min(size[a] as f64 - 1.0 - at[a]) * spacing[a]).fold(f64::MAX, f64::min)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_end_of_what_was_measured_is_no_surface() {
        // A bar along z that goes on beyond the last slices, which are blank.
        let grid = Grid::axis_aligned([21, 21, 12], [1.0, 1.0, 3.0], [0.0; 3]).unwrap();
        let measured = |n: usize| grid.voxel(n)[2] < 10;
        let bar =
            |n: usize| (5..=15).contains(&grid.voxel(n)[0]) && (5..=15).contains(&grid.voxel(n)[1]) && measured(n);
        let found = measured_depth(&Volume::from_fn(grid.clone(), bar), measured, 40.0);
        let at = |v: [usize; 3]| f64::from(*found.at(v));
        assert!((at([10, 10, 9]) + 6.0).abs() < 1e-5 && (at([0, 10, 9]) - 5.0).abs() < 1e-5, "{}", at([10, 10, 9]));
        assert!(
            at([10, 10, 10]).is_nan() && trilinear(&found, &Vector3::new(10.0, 10.0, 9.5)).is_some_and(f64::is_nan)
        );
        let index = Vector3::new(3.0, 10.0, 5.0);
        assert!((slope(&found, &index).unwrap() - Vector3::new(-1.0, 0.0, 0.0)).norm() < 1e-5);
    }
}
