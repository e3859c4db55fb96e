//! What lies around voxels, and where bones touch.

use super::BoneOf;
use crate::geometry::Grid;
use crate::geometry::stencil::NEIGHBOURS_26;
use crate::volume::{Mask, Volume};
use rayon::prelude::*;

/// The voxels within `radius` mm of any of `centres`, by their position in storage.
pub(super) fn balls(grid: &Grid, centres: &[usize], radius: f64) -> Mask {
    let mut out = Volume::filled(grid.clone(), false);
    let (size, spacing) = (grid.size(), grid.spacing());
    let reach = spacing.map(|s| (radius / s) as isize);
    let inside = |at: usize, by: isize, n: usize| at.checked_add_signed(by).filter(|&c| c < n);
    for &centre in centres {
        let [i, j, k] = grid.voxel(centre);
        for dk in -reach[2]..=reach[2] {
            let Some(k) = inside(k, dk, size[2]) else { continue };
            for dj in -reach[1]..=reach[1] {
                let Some(j) = inside(j, dj, size[1]) else { continue };
                let left = radius.powi(2) - (dk as f64 * spacing[2]).powi(2) - (dj as f64 * spacing[1]).powi(2);
                if left >= 0.0 {
                    let along = (left.sqrt() / spacing[0]) as usize;
                    let row = grid.linear([0, j, k]);
                    let (low, high) = (i.saturating_sub(along), (i + along).min(size[0] - 1));
                    out.data_mut()[row + low..=row + high].fill(true);
                }
            }
        }
    }
    out
}

/// Voxels of a bone beside one of another bone.
pub(super) fn touching(grid: &Grid, bone: &BoneOf<'_>) -> Vec<usize> {
    let size = grid.size();
    let touches = |&voxel: &usize| {
        let Some(own) = bone(voxel) else { return false };
        let at = grid.voxel(voxel);
        NEIGHBOURS_26.iter().any(|by| {
            let beside = [0, 1, 2].map(|a| at[a].checked_add_signed(by[a] as isize).filter(|&c| c < size[a]));
            let [Some(i), Some(j), Some(k)] = beside else { return false };
            bone(grid.linear([i, j, k])).is_some_and(|other| other != own)
        })
    };
    (0..grid.len()).into_par_iter().filter(touches).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn balls_are_what_lies_near_enough() {
        let grid = Grid::axis_aligned([12, 9, 7], [1.0, 2.0, 3.0], [0.0; 3]).unwrap();
        let centres = [grid.linear([1, 4, 3]), grid.linear([10, 8, 6])];
        let near = balls(&grid, &centres, 4.1);
        for n in 0..grid.len() {
            let x = grid.centre(grid.voxel(n));
            let expected = centres.iter().any(|&c| (grid.centre(grid.voxel(c)) - x).norm() <= 4.1);
            assert_eq!(near.data()[n], expected, "{:?}", grid.voxel(n));
        }
    }
}
