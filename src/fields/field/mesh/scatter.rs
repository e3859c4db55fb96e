//! Resampling by five tetrahedra (thesis 4.2.5, after Rodriguez): the planning voxels are vertices of a mesh that moves
//! with the push field, and each fraction voxel takes the barycentric mean of the tetrahedron it lies in.
//!
//! No inverse is needed. Where the mesh folds, a voxel lies in several tetrahedra: upright ones win over inverted ones,
//! of equals the last in storage.

use super::super::PushField;
use super::tetrahedra::{Drop, FieldMesh};
use crate::error::Result;
use crate::geometry::Grid;
use crate::volume::Volume;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// How the planning CT is brought onto the fraction grid.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Resampling {
    /// Each fraction voxel looks up its pre-image: trilinear, through the inverse of the push field.
    #[default]
    PullBack,
    /// The deformed mesh of planning voxels is drawn: linear in each of five tetrahedra (thesis 4.2.5).
    FiveTetrahedra,
}

/// What the drawing of the mesh found.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct ScatterReport {
    /// Fraction voxels inside the mesh.
    pub drawn: usize,
    /// Fraction voxels inside more than one tetrahedron (not on their common face): the mesh folds there.
    pub overlapped: usize,
    /// Fraction voxels that lie only in inverted tetrahedra.
    pub inverted: usize,
}

/// The planning image on `grid`, by five tetrahedra; `outside` where no tetrahedron lies.
///
/// # Errors
/// Only for internal inconsistency of grids.
pub fn scatter_image(
    push: &PushField,
    image: &Volume<f32>,
    grid: &Grid,
    outside: f32,
) -> Result<(Volume<f32>, ScatterReport)> {
    let drops = FieldMesh::new(push, |v| [image.data()[v]], false, grid).draw();
    let count = |f: fn(&Drop<1>) -> bool| drops.par_iter().filter(|d| f(d)).count();
    let report = ScatterReport {
        drawn: count(|d| d.rank > 0),
        overlapped: count(|d| d.count > 1),
        inverted: count(|d| d.rank == 1),
    };
    let values = drops.iter().map(|d| if d.rank > 0 { d.value[0] } else { outside }).collect();
    Ok((Volume::new(grid.clone(), values)?, report))
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector3;

    fn cells(u: impl Fn(usize, [usize; 3]) -> [f32; 3] + Sync) -> (PushField, Volume<f32>) {
        let grid = Grid::axis_aligned([9, 8, 7], [1.0, 2.0, 3.0], [5.0, -7.0, 11.0]).unwrap();
        let displacement = Volume::from_fn(grid.clone(), |l| u(l, grid.voxel(l)));
        let image = Volume::from_fn(grid.clone(), |l| {
            let c = grid.centre(grid.voxel(l));
            (3.0 * c.x - 2.0 * c.y + 5.0 * c.z) as f32
        });
        (PushField { computed: Volume::filled(grid, true), displacement }, image)
    }

    #[test]
    fn linear_images_survive_an_affine_motion_exactly() {
        let (push, image) = cells(|_, [i, j, k]| [0.3 + 0.1 * i as f32, -0.4 + 0.1 * k as f32, 0.2 * j as f32]);
        let target = Grid::axis_aligned([12, 14, 12], [0.8, 1.3, 2.1], [4.0, -8.0, 10.0]).unwrap();
        let (out, report) = scatter_image(&push, &image, &target, -1e4).unwrap();
        // The affine push map and its exact inverse.
        let own = push.displacement.grid();
        let mut drawn = 0;
        for n in 0..target.len() {
            let y = target.centre(target.voxel(n));
            let map = |x: &nalgebra::Point3<f64>| {
                let i = own.index(x);
                x + Vector3::new(0.3 + 0.1 * i.x, -0.4 + 0.1 * i.z, 0.2 * i.y)
            };
            let mut x = y;
            (0..200).for_each(|_| x -= map(&x) - y);
            let inside = own.contains(&own.index(&x));
            if out.data()[n] > -1e4 {
                drawn += 1;
                let want = 3.0 * x.x - 2.0 * x.y + 5.0 * x.z;
                assert!((f64::from(out.data()[n]) - want).abs() < 1e-3, "{} {want}", out.data()[n]);
            } else {
                assert!(!inside, "voxel {n} lies in the mesh");
            }
        }
        assert!(drawn > 500 && report.drawn == drawn && report.overlapped == 0 && report.inverted == 0, "{report:?}");
    }

    #[test]
    fn a_flipped_target_grid_gives_the_same_values() {
        let (push, image) = cells(|l, _| [0.2 * (l % 3) as f32, 0.1, -0.1 * (l % 2) as f32]);
        let grid = Grid::axis_aligned([9, 8, 7], [1.0, 2.0, 3.0], [5.0, -7.0, 11.0]).unwrap();
        let mut direction = nalgebra::Matrix3::identity();
        direction[(0, 0)] = -1.0;
        let flipped =
            Grid::new([9, 8, 7], [1.0, 2.0, 3.0], nalgebra::Point3::new(13.0, -7.0, 11.0), direction).unwrap();
        let (a, ra) = scatter_image(&push, &image, &grid, 0.0).unwrap();
        let (b, rb) = scatter_image(&push, &image, &flipped, 0.0).unwrap();
        assert_eq!(ra, rb);
        for n in 0..grid.len() {
            let [i, j, k] = grid.voxel(n);
            assert!((a.data()[n] - b.at([8 - i, j, k])).abs() < 1e-3);
        }
    }

    #[test]
    fn folds_are_counted_and_upright_cells_win() {
        // The middle plane of voxels is pushed beyond the next one: a fold.
        let (push, image) = cells(|_, [i, ..]| [if i == 4 { 1.6 } else { 0.0 }, 0.0, 0.0]);
        let target = Grid::axis_aligned([8, 7, 6], [1.0, 2.0, 3.0], [5.35, -6.5, 11.7]).unwrap();
        let (out, report) = scatter_image(&push, &image, &target, -1e4).unwrap();
        // At x = 5.35 of the voxel index the stretched cell, the inverted one and the next one overlap: 7 x 6 voxels.
        assert_eq!(report, ScatterReport { drawn: out.data().len(), overlapped: 42, inverted: 0 });
    }
}
