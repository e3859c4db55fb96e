//! There and back, and round a triangle: do fields of several directions agree with each other?

use super::pair::{displacement, per_voxel};
use crate::error::Result;
use crate::geometry::Grid;
use crate::stats::Summary;
use crate::volume::{Mask, Volume};
use nalgebra::{Point3, Vector3};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// Distances by which a chain of fields misses its start or its shortcut.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct Consistency {
    /// Distance, mm, over the voxels of the mask whose chain stays inside the fields' grids.
    pub distance_mm: Summary,
    /// Voxels of the mask whose chain leaves the grids.
    pub outside: usize,
}

/// Inverse consistency error |u(x) + v(x + u(x))| at the voxels of `mask`, which lies in the frame of `there`.
///
/// Christensen and Johnson, "Consistent image registration", IEEE Trans. Med. Imaging 20 (2001) 568.
pub fn inverse(there: &Volume<[f32; 3]>, back: &Volume<[f32; 3]>, mask: &Mask) -> Consistency {
    measure(mask, |x| {
        let u = displacement(there, x)?;
        Some((u + displacement(back, &(x + u))?).norm())
    })
}

/// Transitivity error |u_ab(x) + u_bc(x + u_ab(x)) - u_ac(x)| at the voxels of `mask` (frame a).
///
/// Christensen and Johnson, "Invertibility and transitivity analysis for nonrigid image registration", J. Electron. Imaging
/// 12 (2003) 106.
pub fn transitivity(ab: &Volume<[f32; 3]>, bc: &Volume<[f32; 3]>, ac: &Volume<[f32; 3]>, mask: &Mask) -> Consistency {
    measure(mask, |x| {
        let u = displacement(ab, x)?;
        Some((u + displacement(bc, &(x + u))? - displacement(ac, x)?).norm())
    })
}

/// Residual |u(y) + v(y + u(y))| at every voxel of `grid`, mm: infinite where the chain leaves the fields' grids, no
/// number where `folded(y, y + u(y))` says that the map is not one-to-one. Voxels outside `there` stay where they are: 0.
///
/// # Errors
/// Only for internal inconsistency of grids.
pub fn residual(
    there: &Volume<[f32; 3]>,
    back: &Volume<[f32; 3]>,
    grid: &Grid,
    folded: impl Fn(&Point3<f64>, &Point3<f64>) -> bool + Sync,
) -> Result<Volume<f32>> {
    let data = per_voxel(grid, |y| {
        let Some(u) = displacement(there, &y) else { return 0.0 };
        let x = y + u;
        match displacement(back, &x) {
            Some(_) if folded(&y, &x) => f32::NAN,
            Some(v) => (u + v).norm() as f32,
            None => f32::INFINITY,
        }
    });
    Volume::new(grid.clone(), data)
}

fn measure(mask: &Mask, distance: impl Fn(&Point3<f64>) -> Option<f64> + Sync) -> Consistency {
    let grid = mask.grid();
    let plane = grid.strides()[2];
    let planes: Vec<(Vec<f32>, usize)> = mask
        .data()
        .par_chunks(plane)
        .enumerate()
        .map(|(k, set)| {
            let (mut all, mut outside) = (Vec::new(), 0);
            for n in (0..plane).filter(|n| set[*n]) {
                let at = Vector3::from(grid.voxel(k * plane + n).map(|c| c as f64));
                match distance(&grid.world(&at)) {
                    Some(d) => all.push(d as f32),
                    None => outside += 1,
                }
            }
            (all, outside)
        })
        .collect();
    let outside = planes.iter().map(|p| p.1).sum();
    let distances: Vec<&[f32]> = planes.iter().map(|p| &p.0[..]).collect();
    Consistency { distance_mm: Summary::of_singles(&distances), outside }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::about;

    fn field(grid: &Grid, map: impl Fn(Point3<f64>) -> Point3<f64> + Sync) -> Volume<[f32; 3]> {
        Volume::from_fn(grid.clone(), |l| {
            let x = grid.centre(grid.voxel(l));
            (map(x) - x).map(|c| c as f32).into()
        })
    }

    #[test]
    fn exact_inverses_return_and_exact_chains_close() {
        let grid = Grid::axis_aligned([24, 20, 16], [2.0, 2.0, 3.0], [-24.0; 3]).unwrap();
        let all = Volume::filled(grid.clone(), true);
        let a = about(&Point3::origin(), Vector3::new(0.1, 0.2, -0.1), Vector3::new(3.0, 0.0, -2.0));
        let b = about(&Point3::origin(), Vector3::new(0.0, -0.2, 0.1), Vector3::new(0.0, 2.0, 1.0));
        let (there, back) = (field(&grid, |x| a * x), field(&grid, |x| a.inverse() * x));
        let c = inverse(&there, &back, &all);
        assert!(
            c.distance_mm.max < 1e-3 && c.distance_mm.p95 < 1e-5 && c.distance_mm.n > 3000 && c.outside > 0,
            "{c:?}"
        );
        assert_eq!(c.distance_mm.n + c.outside, grid.len());
        let round = transitivity(&there, &field(&grid, |x| b * x), &field(&grid, |x| b * (a * x)), &all);
        assert!(round.distance_mm.max < 1e-3, "{round:?}");
        // A shift of (3, 4, 0) that nothing takes back misses by 5 mm everywhere.
        let shift = field(&grid, |x| x + Vector3::new(3.0, 4.0, 0.0));
        let missed = inverse(&shift, &field(&grid, |x| x), &all);
        assert!((missed.distance_mm.min - 5.0).abs() < 1e-6 && (missed.distance_mm.max - 5.0).abs() < 1e-6);
    }
}
