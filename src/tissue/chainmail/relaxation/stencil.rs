//! The links of an element, row by row: what the relaxation sums over.

use super::super::lattice::Lattice;
use super::turn::{Lanes, Turn, add_scaled};
use nalgebra::{Matrix3, Vector3};

/// Least play of a link, relative to its length: rigid material without a label is stiff, not infinitely so.
const LEAST_PLAY: f32 = 0.03;

/// Something for each of the 26 links of an element: nine rows (k, then j) of three; the middle is the element itself.
pub(super) type Stencil<T> = [[T; 3]; 9];

/// Offsets (j, k) of a stencil's rows.
pub(super) const ROWS: [(isize, isize); 9] =
    [(-1, -1), (0, -1), (1, -1), (-1, 0), (0, 0), (1, 0), (-1, 1), (0, 1), (1, 1)];

/// The links of a lattice.
pub(super) struct Links {
    /// Rest vectors, mm.
    rest: Stencil<Lanes>,
    /// Geometric weights: 1 / length^2, relative to the shortest link; 0 where there is no link.
    weight: Stencil<f32>,
    /// Columns of the lattice's step, mm.
    step: Turn,
    /// Nodes in a row, and in a plane.
    row: usize,
    pub(super) plane: usize,
}

impl Links {
    /// 26 links where they turn, else 6.
    pub(super) fn new(lattice: &Lattice, turning: bool) -> Self {
        let [row, columns, _] = lattice.grid.size();
        let step = lattice.grid.step();
        let shortest = lattice.links().iter().map(|l| l.norm()).fold(f64::MAX, f64::min);
        let (mut rest, mut weight) = (Stencil::default(), Stencil::default());
        for (r, (j, k)) in ROWS.into_iter().enumerate() {
            for (c, i) in [-1isize, 0, 1].into_iter().enumerate() {
                let offset = Vector3::new(i, j, k);
                let vector = step * offset.cast::<f64>();
                rest[r][c] = [vector.x as f32, vector.y as f32, vector.z as f32, 0.0];
                weight[r][c] = match (turning, offset.abs().sum()) {
                    (_, 0) => 0.0,
                    (true, _) => (shortest / vector.norm()).powi(2) as f32,
                    (false, 1) => 1.0,
                    (false, _) => 0.0,
                };
            }
        }
        Self { rest, weight, step: columns_of(step), row, plane: row * columns }
    }

    /// Stiffness of the links of a node, 0 to what is outside.
    pub(super) fn stiffness(&self, softness: &[f32], node: usize) -> Stencil<f32> {
        std::array::from_fn(|r| {
            let (j, k) = ROWS[r];
            let middle = node as isize + j * self.row as isize + k * self.plane as isize;
            std::array::from_fn(|c| {
                let other = softness[(middle + c as isize - 1) as usize];
                let play = (0.5 * (softness[node] + other)).max(LEAST_PLAY);
                if other < 0.0 { 0.0 } else { self.weight[r][c] / play }
            })
        })
    }

    /// What lies around node `n` of the second of three planes; `None` on the border.
    #[inline(always)]
    pub(super) fn around<'a, T>(&self, planes: [&'a [T]; 3], n: usize) -> Option<[&'a [T; 3]; 9]> {
        let row = |plane: &'a [T], first: usize| plane.get(first..)?.first_chunk::<3>();
        let first = n.checked_sub(self.row + 1)?;
        let of = |plane: &'a [T]| {
            Some([row(plane, first)?, row(plane, first + self.row)?, row(plane, first + 2 * self.row)?])
        };
        let [[a, b, c], [d, e, f], [g, h, i]] = [of(planes[0])?, of(planes[1])?, of(planes[2])?];
        Some([a, b, c, d, e, f, g, h, i])
    }

    /// Moment of the links, `sum w (rest + q - u) rest^T`, of an element at `u` with neighbours at `q`.
    #[inline(always)]
    pub(super) fn moment(&self, stiffness: &Stencil<f32>, neighbours: [&[Lanes; 3]; 9], u: &Lanes) -> Turn {
        // By index offsets first, whose components are -1, 0 and 1.
        let mut by_offset = Turn::default();
        for ((w, q), (rest, (j, k))) in stiffness.iter().zip(neighbours).zip(self.rest.iter().zip(ROWS)) {
            let moved = |c: usize| -> Lanes { std::array::from_fn(|l| w[c] * (rest[c][l] + q[c][l] - u[l])) };
            let [a, b, c] = [moved(0), moved(1), moved(2)];
            let row: Lanes = std::array::from_fn(|l| a[l] + b[l] + c[l]);
            for l in 0..4 {
                by_offset[0][l] += c[l] - a[l];
            }
            for (column, side) in [(1, j), (2, k)] {
                match side {
                    1 => (0..4).for_each(|l| by_offset[column][l] += row[l]),
                    -1 => (0..4).for_each(|l| by_offset[column][l] -= row[l]),
                    _ => {}
                }
            }
        }
        let mut moment = Turn::default();
        for (b, column) in moment.iter_mut().enumerate() {
            (0..3).for_each(|c| add_scaled(column, self.step[c][b], &by_offset[c]));
        }
        moment
    }

    /// A turn times the lattice's step.
    #[inline(always)]
    pub(super) fn per_step(&self, turn: &Turn) -> Turn {
        let mut out = Turn::default();
        for (column, step) in out.iter_mut().zip(&self.step) {
            (0..3).for_each(|b| add_scaled(column, step[b], &turn[b]));
        }
        out
    }

    /// Inverse of `sum w rest rest^T`; zero where the links leave a direction open.
    pub(super) fn inverse_spread(&self, stiffness: &Stencil<f32>) -> [f32; 6] {
        let mut m = Matrix3::zeros();
        for (w, rest) in stiffness.as_flattened().iter().zip(self.rest.as_flattened()) {
            let r = Vector3::new(rest[0], rest[1], rest[2]).cast::<f64>();
            m += r * r.transpose() * f64::from(*w);
        }
        let scale = m.trace() / 3.0;
        match m.try_inverse() {
            Some(i) if i.norm() * scale < 30.0 => {
                [i[(0, 0)], i[(0, 1)], i[(0, 2)], i[(1, 1)], i[(1, 2)], i[(2, 2)]].map(|v| v as f32)
            }
            _ => [0.0; 6],
        }
    }
}

/// Sum of the links' index offsets, by stiffness.
pub(super) fn lean(stiffness: &Stencil<f32>) -> [f32; 3] {
    let mut out = [0.0; 3];
    for (w, (j, k)) in stiffness.iter().zip(ROWS) {
        let row = w[0] + w[1] + w[2];
        out[0] += w[2] - w[0];
        out[1] += j as f32 * row;
        out[2] += k as f32 * row;
    }
    out
}

/// The columns of a matrix in lanes.
pub(super) fn columns_of(m: &Matrix3<f64>) -> Turn {
    std::array::from_fn(|c| [m[(0, c)] as f32, m[(1, c)] as f32, m[(2, c)] as f32, 0.0])
}
