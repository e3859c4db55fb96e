//! What lies around voxels, and where bones touch.

use super::BoneOf;
use crate::error::Result;
use crate::geometry::Grid;
use crate::geometry::stencil::NEIGHBOURS_26;
use crate::volume::{Mask, Volume};
use rayon::prelude::*;

/// Voxels that were met, by position in storage.
pub(super) struct BallMarks {
    met: Vec<bool>,
    list: Vec<usize>,
}

impl BallMarks {
    pub(super) fn new(voxels: usize) -> Self {
        Self { met: vec![false; voxels], list: Vec::new() }
    }

    /// Whether a voxel is met for the first time.
    pub(super) fn first(&mut self, voxel: usize) -> bool {
        let first = !std::mem::replace(&mut self.met[voxel], true);
        if first {
            self.list.push(voxel);
        }
        first
    }

    /// Forgets all of them.
    pub(super) fn clear(&mut self) {
        for voxel in self.list.drain(..) {
            self.met[voxel] = false;
        }
    }
}

/// Voxels near others, gathered bit by bit.
pub(super) struct Balls {
    grid: Grid,
    radii: [f64; 3],
    marks: BallMarks,
}

impl Balls {
    /// Nothing yet; `radii` along the grid's axes, mm.
    pub(super) fn new(grid: &Grid, radii: [f64; 3]) -> Self {
        Self { grid: grid.clone(), radii, marks: BallMarks::new(grid.len()) }
    }

    /// Takes in the voxels around `centres` (positions in storage); returns those that were not in yet.
    pub(super) fn add(&mut self, centres: &[usize]) -> Vec<usize> {
        let (size, [nx, ny, nz]) =
            (self.grid.size(), [0, 1, 2].map(|a| (self.radii[a] / self.grid.spacing()[a]).max(f64::MIN_POSITIVE)));
        let around = |c: usize, n: f64, size: usize| c.saturating_sub(n as usize)..=(c + n as usize).min(size - 1);
        let known = self.marks.list.len();
        for &centre in centres {
            let [i, j, k] = self.grid.voxel(centre);
            for z in around(k, nz, size[2]) {
                for y in around(j, ny, size[1]) {
                    let left = 1.0 - (y.abs_diff(j) as f64 / ny).powi(2) - (z.abs_diff(k) as f64 / nz).powi(2);
                    if left < 0.0 {
                        continue;
                    }
                    let row = self.grid.linear([0, y, z]);
                    let along = around(i, nx * left.sqrt(), size[0]);
                    let row = row + along.start()..row + along.end() + 1;
                    // Balls overlap for the most part.
                    if self.marks.met[row.clone()].iter().all(|m| *m) {
                        continue;
                    }
                    for voxel in row {
                        self.marks.first(voxel);
                    }
                }
            }
        }
        self.marks.list[known..].to_vec()
    }

    /// All that are in.
    pub(super) fn into_mask(self) -> Result<Mask> {
        Volume::new(self.grid, self.marks.met)
    }

    /// Lets all of them go.
    pub(super) fn clear(&mut self) {
        self.marks.clear();
    }

    /// Whether a voxel is in.
    pub(super) fn holds(&self, voxel: usize) -> bool {
        self.marks.met[voxel]
    }
}

/// Voxels of a bone beside one of another bone; those at the border of the grid are not looked at.
pub(super) fn touching(grid: &Grid, bone: &impl BoneOf) -> Vec<usize> {
    let ([nx, ny, nz], [sx, sy, sz]) = (grid.size(), grid.strides().map(|s| s as isize));
    let beside = NEIGHBOURS_26.map(|[i, j, k]| i as isize * sx + j as isize * sy + k as isize * sz);
    let touches = |voxel: usize| {
        let Some(own) = bone(voxel) else { return false };
        beside.iter().any(|by| bone(voxel.wrapping_add_signed(*by)).is_some_and(|other| other != own))
    };
    let of_plane = |k: usize| {
        let rows = (1..ny.max(2) - 1).map(move |j| grid.linear([0, j, k]));
        rows.flat_map(|row| (row + 1..row + nx.max(2) - 1).filter(|&v| touches(v))).collect::<Vec<_>>()
    };
    (1..nz.max(2) - 1).into_par_iter().flat_map_iter(of_plane).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn balls_are_what_lies_near_enough() {
        let grid = Grid::axis_aligned([12, 9, 7], [1.0, 2.0, 3.0], [0.0; 3]).unwrap();
        let centres = [grid.linear([1, 4, 3]), grid.linear([10, 8, 6]), grid.linear([2, 4, 3])];
        let mut balls = Balls::new(&grid, [4.1; 3]);
        let mut all = balls.add(&centres[..2]);
        all.extend(balls.add(&centres[2..]));
        for n in 0..grid.len() {
            let x = grid.centre(grid.voxel(n));
            let expected = centres.iter().any(|&c| (grid.centre(grid.voxel(c)) - x).norm() <= 4.1);
            assert_eq!(balls.holds(n), expected, "{:?}", grid.voxel(n));
            assert_eq!(all.iter().filter(|&&m| m == n).count(), usize::from(expected));
        }
        balls.clear();
        assert!((0..grid.len()).all(|n| !balls.holds(n)) && balls.add(&centres[..1]).len() > 20);
    }

    #[test]
    fn bones_touch_across_edges_and_not_themselves() {
        let grid = Grid::axis_aligned([5, 5, 5], [1.0; 3], [0.0; 3]).unwrap();
        let at = |i, j, k| grid.linear([i, j, k]);
        let bones = [(at(1, 1, 1), 0), (at(1, 1, 2), 0), (at(2, 2, 3), 1), (at(3, 3, 1), 1)];
        let bone = |v: usize| bones.iter().find(|b| b.0 == v).map(|b| b.1);
        assert_eq!(touching(&grid, &bone), [at(1, 1, 2), at(2, 2, 3)]);
    }
}
