//! The mesh that a push field deforms: voxels of the planning grid as vertices, five tetrahedra per cell (thesis 4.2.5,
//! after Rodriguez), and what of it lies at each voxel of another grid.
//!
//! The cut is mirrored in alternate cells, so that neighbours share the diagonal of their common face and the
//! tetrahedra fill space without gap or overlap.

use super::super::PushField;
use crate::geometry::{Grid, vectorised};
use nalgebra::{Matrix3, Vector3};
use rayon::prelude::*;

/// Corner `c` of a cell lies high along i, j, k where bits 0, 1, 2 of `c` are set. Each tetrahedron is positive in an
/// undeformed, right-handed cell.
const EVEN: [[usize; 4]; 5] = [[0, 1, 2, 4], [3, 2, 1, 7], [5, 4, 7, 1], [6, 7, 4, 2], [1, 2, 4, 7]];
const ODD: [[usize; 4]; 5] = [[1, 3, 0, 5], [2, 0, 3, 6], [4, 0, 6, 5], [7, 3, 5, 6], [0, 5, 3, 6]];

/// The cut of the cell whose lowest corner is at `[i, j, k]`.
pub(in crate::field) fn cut([i, j, k]: [usize; 3]) -> &'static [[usize; 4]; 5] {
    if (i + j + k).is_multiple_of(2) { &EVEN } else { &ODD }
}

/// Calls `hit` with each voxel of a grid inside a tetrahedron, given by its corners' continuous indices and the edges
/// from the first corner as columns.
fn voxels_inside(grid: &Grid, corners: &[Vector3<f64>; 4], edges: &Matrix3<f64>, mut hit: impl FnMut(usize)) {
    let Some(inverse) = edges.try_inverse() else { return };
    let size = grid.size();
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
                    hit(grid.linear([i, j, k]));
                }
            }
        }
    }
}

/// Which tetrahedra of a moved cell are meant.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(in crate::field) enum CellSide {
    /// Those that kept their orientation.
    Upright,
    /// Those turned inside out.
    Inverted,
}

/// Calls `hit` with each fraction voxel inside a tetrahedron of one side of the moved cell that begins at `at`.
pub(in crate::field) fn cover(
    push: &PushField,
    at: [usize; 3],
    fraction: &Grid,
    side: CellSide,
    mut hit: impl FnMut(usize),
) {
    let grid = push.displacement.grid();
    let corner = |c: usize| {
        let voxel: [usize; 3] = std::array::from_fn(|a| at[a] + (c >> a & 1));
        let u = Vector3::from(push.displacement.at(voxel).map(f64::from));
        (grid.centre(voxel), fraction.index(&(grid.centre(voxel) + u)))
    };
    let handed = fraction.inverse_step().determinant().signum();
    for t in cut(at) {
        let p = t.map(corner);
        let rest = Matrix3::from_columns(&[p[1].0 - p[0].0, p[2].0 - p[0].0, p[3].0 - p[0].0]).determinant();
        let edges = Matrix3::from_columns(&[p[1].1 - p[0].1, p[2].1 - p[0].1, p[3].1 - p[0].1]);
        let sense = edges.determinant() * handed * rest.signum();
        if (sense > 0.0 && side == CellSide::Upright) || (sense < 0.0 && side == CellSide::Inverted) {
            voxels_inside(fraction, &p.map(|c| c.1), &edges, &mut hit);
        }
    }
}

/// A voxel counts as inside a tetrahedron when no barycentric coordinate is below this.
const INSIDE: f64 = -1e-9;
/// Barycentric coordinates above this are inside for certain, not on a common face.
const WELL_INSIDE: f64 = 1e-6;
/// Tetrahedra smaller than this, in cubic voxels, hold no point.
const LEAST_VOLUME: f64 = 1e-12;

/// What a voxel of the target grid has received.
#[derive(Debug, Clone, Copy)]
pub(in crate::field) struct Drop<const N: usize> {
    /// Barycentric mean of the vertices' values.
    pub(in crate::field) value: [f32; N],
    /// 0 nothing, 1 from an inverted tetrahedron, 2 from an upright one.
    pub(in crate::field) rank: u8,
    /// How many tetrahedra hold the voxel well inside.
    pub(in crate::field) count: u8,
}

impl<const N: usize> Default for Drop<N> {
    fn default() -> Self {
        Self { value: [0.0; N], rank: 0, count: 0 }
    }
}

/// The mesh in indices of a target grid.
pub(in crate::field) struct FieldMesh<'a, V> {
    push: &'a PushField,
    /// Value of a planning voxel by its storage position.
    value: V,
    /// Whether cells without a computed corner are left out.
    only_computed: bool,
    target: &'a Grid,
    base: Vector3<f64>,
    step: Matrix3<f64>,
    turn: Matrix3<f64>,
    /// Least and greatest target index along k over each row (j, k) of planning voxels, and whether any is computed.
    rows: Vec<(f64, f64, bool)>,
    /// -1 where the two grids have different handedness.
    sense: f64,
}

impl<'a, const N: usize, V: Fn(usize) -> [f32; N] + Sync> FieldMesh<'a, V> {
    pub(in crate::field) fn new(push: &'a PushField, value: V, only_computed: bool, target: &'a Grid) -> Self {
        let own = push.displacement.grid();
        let [_, nj, nk] = own.size();
        let step = target.inverse_step() * own.step();
        let mut mesh = Self {
            push,
            value,
            only_computed,
            target,
            base: target.index(&own.origin()),
            step,
            turn: *target.inverse_step(),
            rows: Vec::new(),
            sense: step.determinant().signum(),
        };
        mesh.rows = (0..nj * nk)
            .into_par_iter()
            .map_init(Vec::new, |places, row| {
                let (j, k) = (row % nj, row / nj);
                mesh.places(j, k, places);
                let start = own.linear([0, j, k]);
                let any = push.computed.data()[start..start + own.size()[0]].iter().any(|c| *c);
                let (low, high) = places.iter().fold((f64::MAX, f64::MIN), |r, p| (r.0.min(p.z), r.1.max(p.z)));
                (low, high, any)
            })
            .collect();
        mesh
    }

    /// The whole target grid. Of several tetrahedra at one voxel upright ones win, of equals the last in storage.
    pub(in crate::field) fn draw(&self) -> Vec<Drop<N>> {
        let plane = self.target.size()[0] * self.target.size()[1];
        // Slabs do not change the result: every voxel sees the cells in the same order.
        let slab = self.target.size()[2].div_ceil(4 * rayon::current_num_threads()).max(1);
        let mut out = vec![Drop::default(); self.target.len()];
        out.par_chunks_mut(slab * plane).enumerate().for_each(|(n, part)| self.draw_slab(n * slab, part));
        out
    }

    /// Target indices of the row of planning voxels (j, k).
    #[inline(always)]
    fn places(&self, j: usize, k: usize, out: &mut Vec<Vector3<f64>>) {
        let own = self.push.displacement.grid();
        let start = own.linear([0, j, k]);
        let origin = self.base + self.step * Vector3::new(0.0, j as f64, k as f64);
        let along: Vector3<f64> = self.step.column(0).into_owned();
        out.clear();
        out.extend(
            self.push.displacement.data()[start..start + own.size()[0]]
                .iter()
                .enumerate()
                .map(|(i, u)| origin + along * i as f64 + self.turn * Vector3::from(u.map(f64::from))),
        );
    }

    /// Draws all cells into the planes of `part`, the first of which is plane `first` of the target.
    pub(in crate::field) fn draw_slab(&self, first: usize, part: &mut [Drop<N>]) {
        vectorised(
            #[inline(always)]
            || self.draw_cells(first, part),
        );
    }

    #[inline(always)]
    fn draw_cells(&self, first: usize, part: &mut [Drop<N>]) {
        let own = self.push.displacement.grid();
        let [ni, nj, nk] = own.size();
        let planes = part.len() / (self.target.size()[0] * self.target.size()[1]);
        let (low, high) = (first as f64, (first + planes - 1) as f64);
        let mut places: [Vec<Vector3<f64>>; 4] = Default::default();
        for k in 0..nk.saturating_sub(1) {
            for j in 0..nj.saturating_sub(1) {
                let four = [(j, k), (j + 1, k), (j, k + 1), (j + 1, k + 1)];
                let rows = four.map(|(j, k)| self.rows[j + nj * k]);
                let missed = rows.iter().all(|r| r.0 > high) || rows.iter().all(|r| r.1 < low);
                if missed || (self.only_computed && !rows.iter().any(|r| r.2)) {
                    continue;
                }
                for (row, (j, k)) in places.iter_mut().zip(four) {
                    self.places(j, k, row);
                }
                let start = four.map(|(j, k)| own.linear([0, j, k]));
                for i in 0..ni - 1 {
                    let corner = |c: usize| start[c >> 1] + i + (c & 1);
                    if self.only_computed && !(0..8).any(|c| self.push.computed.data()[corner(c)]) {
                        continue;
                    }
                    let at: [Vector3<f64>; 8] = std::array::from_fn(|c| places[c >> 1][i + (c & 1)]);
                    for t in cut([i, j, k]) {
                        self.tetrahedron(t.map(|c| at[c]), t.map(corner), first, part);
                    }
                }
            }
        }
    }

    /// Draws one tetrahedron.
    #[inline(always)]
    fn tetrahedron(&self, p: [Vector3<f64>; 4], vertex: [usize; 4], first: usize, part: &mut [Drop<N>]) {
        let [nx, ny, _] = self.target.size();
        let planes = part.len() / (nx * ny);
        let size = [(0, nx), (0, ny), (first, first + planes)];
        let mut range = [(0usize, 0usize); 3];
        for a in 0..3 {
            let least = p.iter().map(|v| v[a]).fold(f64::MAX, f64::min);
            let greatest = p.iter().map(|v| v[a]).fold(f64::MIN, f64::max);
            let from = (least - 1e-9).ceil().max(size[a].0 as f64);
            let to = (greatest + 1e-9).floor().min(size[a].1 as f64 - 1.0);
            // Also false where a coordinate is no number.
            if from <= to {
                range[a] = (from as usize, to as usize + 1);
            } else {
                return;
            }
        }
        let (e1, e2, e3) = (p[1] - p[0], p[2] - p[0], p[3] - p[0]);
        let volume = e1.dot(&e2.cross(&e3));
        if volume.abs() < LEAST_VOLUME {
            return;
        }
        let rank = if volume * self.sense > 0.0 { 2 } else { 1 };
        let dual = [e2.cross(&e3) / volume, e3.cross(&e1) / volume, e1.cross(&e2) / volume];
        for z in range[2].0..range[2].1 {
            for y in range[1].0..range[1].1 {
                let (dy, dz) = (y as f64 - p[0].y, z as f64 - p[0].z);
                let of_row = dual.map(|v| v.y * dy + v.z * dz);
                for x in range[0].0..range[0].1 {
                    let dx = x as f64 - p[0].x;
                    let b: [f64; 3] = std::array::from_fn(|n| of_row[n] + dual[n].x * dx);
                    let b = [1.0 - b[0] - b[1] - b[2], b[0], b[1], b[2]];
                    let least = b.iter().copied().fold(f64::MAX, f64::min);
                    if least < INSIDE {
                        continue;
                    }
                    let drop = &mut part[x + nx * (y + ny * (z - first))];
                    if least > WELL_INSIDE {
                        drop.count = drop.count.saturating_add(1);
                    }
                    if rank >= drop.rank {
                        let values = vertex.map(|v| (self.value)(v));
                        drop.value =
                            std::array::from_fn(|a| (0..4).map(|c| b[c] * f64::from(values[c][a])).sum::<f64>() as f32);
                        drop.rank = rank;
                    }
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::volume::Volume;

    /// Cells of 4 mm, stretched by 1.5 along x and moved, or turned inside out along it.
    fn cells(stretch: f32) -> PushField {
        let grid = Grid::axis_aligned([3, 3, 3], [4.0; 3], [0.0; 3]).unwrap();
        let displacement =
            Volume::from_fn(grid.clone(), |l| [(stretch - 1.0) * 4.0 * grid.voxel(l)[0] as f32 + 0.3, 0.2, 0.1]);
        PushField { displacement, computed: Volume::filled(grid, true) }
    }

    #[test]
    fn a_cell_covers_the_voxels_within_its_moved_corners() {
        for (stretch, side, other) in
            [(1.5, CellSide::Upright, CellSide::Inverted), (-1.5, CellSide::Inverted, CellSide::Upright)]
        {
            let push = cells(stretch);
            for handed in [1.0, -1.0] {
                let direction = Matrix3::from_diagonal(&Vector3::new(handed, 1.0, 1.0));
                let origin = nalgebra::Point3::new(-20.0 * handed, -2.0, -2.0);
                let fraction = Grid::new([40, 14, 14], [1.0; 3], origin, direction).unwrap();
                let at = [1, 0, 1];
                let mut found = vec![0; fraction.len()];
                cover(&push, at, &fraction, side, |n| found[n] += 1);
                cover(&push, at, &fraction, other, |_| panic!("nothing is on the other side"));
                let moved = |i: usize| f64::from(stretch) * 4.0 * i as f64 + 0.3;
                let [a, b] = [moved(1).min(moved(2)), moved(1).max(moved(2))];
                for (n, count) in found.iter().enumerate() {
                    let y = fraction.centre(fraction.voxel(n));
                    let inside = (a..=b).contains(&y.x) && (0.2..=4.2).contains(&y.y) && (4.1..=8.1).contains(&y.z);
                    assert_eq!(*count > 0, inside, "{stretch} {handed} {y:?}");
                }
                assert!(found.iter().filter(|count| **count > 0).count() > 60);
            }
        }
    }
}
