//! What is moved and what follows: soft voxels, the fraction voxels whose pre-image lies among them, cells that must not fold.

use super::ball::{BallMarks, Balls};
use super::inverse_error::InverseError;
use super::{Beside, BoneOf, REACH_MM};
use crate::field::inverse::pre_image::{Continued, InvertOptions, solve};
use crate::field::mesh::tetrahedra::cut;
use crate::field::{PullField, PushField};
use crate::geometry::Grid;
use nalgebra::{Matrix3, Point3, Vector3};
use rayon::prelude::*;

/// The number of all voxels that do not move; those of the movable ones follow it.
pub(super) const FIXED: u32 = 0;

/// Distance within which voxels no longer move where moving folded a cell or lost a pre-image, mm.
const BARRED_MM: f64 = 6.0;

/// PatchValues of voxels, by position in storage.
type PatchValues = Vec<(usize, [f32; 3])>;

/// The movable voxels and what depends on them.
pub(super) struct Patch {
    /// Planning voxels that may move, by position in storage.
    pub(super) movable: Vec<usize>,
    /// The number of each planning voxel: one more than its place among them, or [`FIXED`].
    pub(super) number: Vec<u32>,
    /// Planning voxels whose way there and back can change.
    pub(super) watched: Vec<usize>,
    near: Balls,
    /// Around where moving went astray.
    barred: Balls,
    around: Balls,
    grid: Grid,
    /// Fraction voxels that are inverted anew.
    inverted: Vec<usize>,
    asked: BallMarks,
    /// Cells that hold a movable voxel and were not folded.
    upright: Vec<usize>,
    cells: BallMarks,
    /// Both fields before anything moved.
    before: [PatchValues; 2],
    /// The same after the best step.
    best: [PatchValues; 2],
}

impl Patch {
    pub(super) fn new(planning: &Grid, fraction: &Grid) -> Self {
        Self {
            movable: Vec::new(),
            number: vec![FIXED; planning.len()],
            watched: Vec::new(),
            near: Balls::new(planning, [REACH_MM; 3]),
            barred: Balls::new(planning, [BARRED_MM; 3]),
            // A voxel of either field reaches one voxel further.
            around: Balls::new(planning, planning.spacing().map(|h| REACH_MM + 2.0 * h)),
            grid: planning.clone(),
            inverted: Vec::new(),
            asked: BallMarks::new(fraction.len()),
            upright: Vec::new(),
            cells: BallMarks::new(planning.len()),
            before: Default::default(),
            best: Default::default(),
        }
    }

    /// Misses in groups so far apart that what is moved for one does not reach the other.
    pub(super) fn clusters(&self, errors: &[InverseError]) -> Vec<Vec<InverseError>> {
        let apart = self.grid.spacing().map(|h| 2.0 * (REACH_MM / h + 2.0) + 1.0);
        let at: Vec<[usize; 3]> = errors.iter().map(|m| self.grid.voxel(m.voxel)).collect();
        let mut left: Vec<usize> = (0..errors.len()).rev().collect();
        let mut out = Vec::new();
        while let Some(first) = left.pop() {
            let mut cluster = vec![first];
            let mut next = 0;
            while let Some(&here) = cluster.get(next) {
                next += 1;
                left.retain(|&n| {
                    let close = (0..3).all(|a| at[n][a].abs_diff(at[here][a]) as f64 <= apart[a]);
                    if close {
                        cluster.push(n);
                    }
                    !close
                });
            }
            cluster.sort_unstable();
            out.push(cluster.into_iter().map(|n| errors[n]).collect());
        }
        out
    }

    /// Lets everything go.
    pub(super) fn clear(&mut self) {
        for voxel in self.movable.drain(..) {
            self.number[voxel] = FIXED;
        }
        self.watched.clear();
        self.inverted.clear();
        self.upright.clear();
        self.near.clear();
        self.barred.clear();
        self.around.clear();
        self.asked.clear();
        self.cells.clear();
        (self.before, self.best) = Default::default();
    }

    /// Makes soft voxels around `seeds` movable.
    pub(super) fn extend(
        &mut self,
        seeds: &[usize],
        beside: &Beside<'_, impl BoneOf>,
        push: &PushField,
        pull: &PullField,
        options: &InvertOptions,
    ) {
        let u = push.displacement.data();
        let soft = |v: usize| push.computed.data()[v] && (beside.bone)(v).is_none();
        let movable = |&v: &usize| soft(v) && !self.barred.holds(v);
        let new: Vec<usize> = self.near.add(seeds).into_iter().filter(movable).collect();
        for &v in &new {
            self.movable.push(v);
            self.number[v] = self.movable.len() as u32;
            self.before[0].push((v, u[v]));
        }
        for cell in new.iter().flat_map(|&v| self.grid.cells_around(self.grid.voxel(v))) {
            if self.cells.first(cell) && !folded(push, cell) {
                self.upright.push(cell);
            }
        }
        let added: Vec<usize> = self.around.add(seeds).into_iter().filter(|&v| push.computed.data()[v]).collect();
        self.ask(&added, push, pull, options);
        self.watched.extend(added.into_iter().filter(|&v| !beside.spared.data()[v]));
    }

    /// Takes the fraction voxels around where planning voxels come to lie among those that are inverted, if they are now.
    fn ask(&mut self, voxels: &[usize], push: &PushField, pull: &PullField, options: &InvertOptions) {
        let fraction = pull.displacement.grid();
        let size = fraction.size();
        let mut new = Vec::new();
        for &v in voxels {
            let u = Vector3::from(push.displacement.data()[v].map(f64::from));
            let at = fraction.index(&(self.grid.centre(self.grid.voxel(v)) + u));
            if !fraction.contains(&at) {
                continue;
            }
            let [low, high] = [-1.0, 2.0].map(|by| [0, 1, 2].map(|a| (at[a].floor() + by).max(0.0) as usize));
            for k in low[2]..=high[2].min(size[2] - 1) {
                for j in low[1]..=high[1].min(size[1] - 1) {
                    let row = fraction.linear([0, j, k]);
                    for n in row + low[0]..=row + high[0].min(size[0] - 1) {
                        if self.asked.first(n) {
                            new.push(n);
                        }
                    }
                }
            }
        }
        let field = Continued::new(&push.displacement);
        let solved = |&n: &usize| missed(&field, pull, n) < options.tolerance_mm;
        let new: Vec<usize> = new.into_par_iter().filter(solved).collect();
        self.before[1].extend(new.iter().map(|&n| (n, pull.displacement.data()[n])));
        self.inverted.extend(new);
    }

    /// Moves the voxels, by number, and inverts anew; where cells folded or pre-images were lost, as planning voxels.
    pub(super) fn advance(
        &self,
        steps: &[Vector3<f64>],
        push: &mut PushField,
        pull: &mut PullField,
        options: &InvertOptions,
    ) -> Vec<usize> {
        let u = push.displacement.data_mut();
        for (&v, step) in self.movable.iter().zip(&steps[1..]) {
            for a in 0..3 {
                u[v][a] += step[a] as f32;
            }
        }
        let field = Continued::new(&push.displacement);
        let fraction = pull.displacement.grid();
        let anew = |&n: &usize| {
            if missed(&field, pull, n) < options.tolerance_mm {
                return Ok(None);
            }
            let (y, was) =
                (fraction.centre(fraction.voxel(n)), Vector3::from(pull.displacement.data()[n].map(f64::from)));
            let found = solve(&y.coords, was, &field, options);
            if found.converged { Ok(Some(found.displacement.map(|v| v as f32).into())) } else { Err(y + was) }
        };
        let found: Vec<std::result::Result<Option<[f32; 3]>, Point3<f64>>> =
            self.inverted.par_iter().map(anew).collect();
        let mut astray: Vec<usize> = self.upright.par_iter().copied().filter(|&cell| folded(push, cell)).collect();
        let last = self.grid.size().map(|n| (n - 1) as f64);
        for (&n, found) in self.inverted.iter().zip(found) {
            match found {
                Ok(Some(v)) => pull.displacement.data_mut()[n] = v,
                Ok(None) => {}
                Err(x) => {
                    let at = self.grid.index(&x);
                    astray.push(self.grid.linear([0, 1, 2].map(|a| at[a].round().clamp(0.0, last[a]) as usize)));
                }
            }
        }
        astray
    }

    /// The voxels that steps, by number, would move by more than `most` mm.
    pub(super) fn beyond(&self, steps: &[Vector3<f64>], most: f64) -> Vec<usize> {
        self.movable.iter().zip(&steps[1..]).filter(|(_, step)| step.norm() > most).map(|(&v, _)| v).collect()
    }

    /// Lets no voxel near these move any more.
    pub(super) fn bar(&mut self, astray: &[usize]) {
        for voxel in self.barred.add(astray) {
            self.number[voxel] = FIXED;
        }
        self.movable.retain(|&v| !self.barred.holds(v));
        for (n, &voxel) in self.movable.iter().enumerate() {
            self.number[voxel] = n as u32 + 1;
        }
    }

    /// Remembers the fields as they are.
    pub(super) fn keep(&mut self, push: &PushField, pull: &PullField) {
        self.best = [
            // Also those that may no longer move.
            self.before[0].iter().map(|&(v, _)| (v, push.displacement.data()[v])).collect(),
            self.inverted.iter().map(|&n| (n, pull.displacement.data()[n])).collect(),
        ];
    }

    /// Brings the fields back to what was kept last, or to what they were; how far voxels are from what they were, mm.
    pub(super) fn restore(&self, push: &mut PushField, pull: &mut PullField) -> f64 {
        for values in [&self.before, &self.best] {
            for &(v, u) in &values[0] {
                push.displacement.data_mut()[v] = u;
            }
            for &(n, v) in &values[1] {
                pull.displacement.data_mut()[n] = v;
            }
        }
        let far = |&(v, before): &(usize, [f32; 3])| {
            let now = push.displacement.data()[v];
            (Vector3::from(now) - Vector3::from(before)).norm()
        };
        self.before[0].iter().map(far).fold(0.0, f32::max).into()
    }

    /// The numbers of a movable voxel's neighbours: two along each axis.
    pub(super) fn neighbours(&self, voxel: usize) -> [u32; 6] {
        self.beside(voxel).map(|n| n.map_or(FIXED, |n| self.number[n]))
    }

    /// How many neighbours along each axis a movable voxel has in the patient.
    pub(super) fn linked(&self, push: &PushField, voxel: usize) -> [usize; 3] {
        let beside = self.beside(voxel);
        let there = |d: usize| usize::from(beside[d].is_some_and(|n| push.computed.data()[n]));
        [0, 1, 2].map(|a| there(2 * a) + there(2 * a + 1))
    }

    /// The voxels before and behind one along each axis.
    fn beside(&self, voxel: usize) -> [Option<usize>; 6] {
        let (at, size, strides) = (self.grid.voxel(voxel), self.grid.size(), self.grid.strides());
        std::array::from_fn(|d| {
            let (a, stride) = (d / 2, strides[d / 2]);
            if d % 2 == 0 { (at[a] > 0).then(|| voxel - stride) } else { (at[a] + 1 < size[a]).then(|| voxel + stride) }
        })
    }
}

/// |v + u(y + v)| of a fraction voxel, mm.
fn missed(field: &Continued<'_>, pull: &PullField, voxel: usize) -> f64 {
    let v = Vector3::from(pull.displacement.data()[voxel].map(f64::from));
    let y = pull.displacement.grid().centre(pull.displacement.grid().voxel(voxel));
    (v + field.value(&(y + v))).norm()
}

/// Whether any of the 10 tetrahedra of a cell, by both ways to cut it, is turned inside out.
fn folded(push: &PushField, cell: usize) -> bool {
    let grid = push.displacement.grid();
    let first = grid.voxel(cell);
    let moved: [Point3<f64>; 8] = std::array::from_fn(|c| {
        let voxel = std::array::from_fn(|a| first[a] + (c >> a & 1));
        grid.centre(voxel) + Vector3::from(push.displacement.data()[grid.linear(voxel)].map(f64::from))
    });
    let volume = |t: &[usize; 4]| {
        let edge = |n: usize| moved[t[n]] - moved[t[0]];
        Matrix3::from_columns(&[edge(1), edge(2), edge(3)]).determinant()
    };
    // Storage may be left-handed.
    let sense = grid.step().determinant();
    [[0; 3], [1, 0, 0]].into_iter().flat_map(cut).any(|t| volume(t) * sense <= 0.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::volume::Volume;

    fn fields(handed: f64, size: [usize; 3]) -> PushField {
        let direction = Matrix3::from_diagonal(&Vector3::new(handed, 1.0, 1.0));
        let grid = Grid::new(size, [1.0, 1.0, 3.0], Point3::origin(), direction).unwrap();
        let computed = Volume::filled(grid.clone(), true);
        PushField { displacement: Volume::filled(grid, [0.0; 3]), computed }
    }

    #[test]
    fn a_cell_is_folded_once_a_corner_passes_the_plane_of_others() {
        for handed in [1.0, -1.0] {
            let mut push = fields(handed, [3, 3, 3]);
            let grid = push.displacement.grid().clone();
            let corner = grid.linear([1, 1, 1]);
            assert!((0..2).all(|i| !folded(&push, grid.linear([i, 0, 0]))));
            // The corner of four tetrahedra is 3 mm above its cell's lowest plane.
            push.displacement.data_mut()[corner] = [0.0, 0.0, -2.9];
            assert!([[0, 0, 0], [1, 0, 1]].iter().all(|at| !folded(&push, grid.linear(*at))));
            push.displacement.data_mut()[corner] = [0.0, 0.0, -3.1];
            assert!(folded(&push, grid.linear([0, 0, 0])), "{handed}");
            // Above it there is only more room.
            assert!(!folded(&push, grid.linear([0, 0, 1])));
        }
    }

    #[test]
    fn the_first_and_last_voxel_of_a_row_have_one_neighbour() {
        let push = fields(1.0, [4, 3, 2]);
        let grid = push.displacement.grid().clone();
        let mut patch = Patch::new(&grid, &grid);
        (0..grid.len()).for_each(|n| patch.number[n] = n as u32 + 1);
        let number = |at: [usize; 3]| grid.linear(at) as u32 + 1;
        assert_eq!(
            patch.neighbours(grid.linear([0, 1, 0])),
            [FIXED, number([1, 1, 0]), number([0, 0, 0]), number([0, 2, 0]), FIXED, number([0, 1, 1])]
        );
        assert_eq!(patch.linked(&push, grid.linear([3, 2, 1])), [1, 1, 1]);
        assert_eq!(patch.linked(&push, grid.linear([1, 1, 1])), [2, 2, 1]);
    }
}
