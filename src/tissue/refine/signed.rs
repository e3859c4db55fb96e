//! Signed distances to a surface that voxels describe.

use crate::geometry::Grid;
use crate::volume::{Mask, Volume, distance::squared_distance_within, gaussian, trilinear};
use nalgebra::{Point3, Vector3};

/// Distance of each voxel from the surface of a mask, mm: negative inside; no more than `known`. Blurred by a share of the
/// voxels' least edge, which draws the surface of a ball inwards by the blur's square over its radius.
pub(super) fn depth(inside: &Mask, known: f64, blur: f64) -> Volume<f32> {
    let [outside, within] = [true, false].map(|target| squared_distance_within(inside, target, known));
    let known = |square: f32| f64::from(square).sqrt().min(known) as f32;
    let values = outside.data().iter().zip(within.data()).map(|(&o, &i)| known(o) - known(i)).collect();
    let signed = Volume::new(inside.grid().clone(), values).expect("one value per voxel");
    let edge = inside.grid().spacing().into_iter().fold(f64::MAX, f64::min);
    if blur > 0.0 { gaussian(&signed, blur * edge) } else { signed }
}

/// Gradient of such distances at a continuous index, per mm; `None` at the edge of the grid.
pub(super) fn slope(depth: &Volume<f32>, at: &Vector3<f64>) -> Option<Vector3<f64>> {
    let along = |a: usize| {
        let mut step = Vector3::zeros();
        step[a] = 0.5;
        Some(trilinear(depth, &(at + step))? - trilinear(depth, &(at - step))?)
    };
    Some(depth.grid().inverse_step().transpose() * Vector3::new(along(0)?, along(1)?, along(2)?))
}

/// How far a point lies within the edges of a grid, mm; negative outside.
pub(super) fn within_edges(grid: &Grid, point: &Point3<f64>) -> f64 {
    let (at, size, spacing) = (grid.index(point), grid.size(), grid.spacing());
    (0..3).map(|a| at[a].min(size[a] as f64 - 1.0 - at[a]) * spacing[a]).fold(f64::MAX, f64::min)
}
