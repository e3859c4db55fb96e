//! Trilinear sampling at continuous indices, as ITK's linear interpolators do inside the image.

use super::place::place;
use crate::geometry::Grid;
use crate::volume::Volume;
use nalgebra::{Matrix3, RowVector3, Vector3};

/// Storage position of the lower corner, the fractions, and the strides to the upper corner (0 at the far edge).
#[inline(always)]
fn cell(size: [usize; 3], index: &Vector3<f64>) -> Option<(usize, [f64; 3], [usize; 3])> {
    let mut base = 0;
    let mut fraction = [0.0; 3];
    let mut step = [0; 3];
    let mut stride = 1;
    for a in 0..3 {
        let (low, way) = place(index[a], size[a])?;
        base += low * stride;
        fraction[a] = way;
        step[a] = if low + 1 < size[a] { stride } else { 0 };
        stride *= size[a];
    }
    Some((base, fraction, step))
}

/// Trilinear value at a continuous index; `None` outside the hull of the voxel centres.
#[inline(always)]
pub fn trilinear(volume: &Volume<f32>, index: &Vector3<f64>) -> Option<f64> {
    let (b, [fx, fy, fz], [sx, sy, sz]) = cell(volume.grid().size(), index)?;
    let d = volume.data();
    let line = |at: usize| f64::from(d[at]) * (1.0 - fx) + f64::from(d[at + sx]) * fx;
    let face = |at: usize| line(at) * (1.0 - fy) + line(at + sy) * fy;
    Some(face(b) * (1.0 - fz) + face(b + sz) * fz)
}

/// Trilinear vector at a continuous index; `None` outside the hull of the voxel centres.
#[inline(always)]
pub fn trilinear_vector(volume: &Volume<[f32; 3]>, index: &Vector3<f64>) -> Option<Vector3<f64>> {
    let (b, [fx, fy, fz], [sx, sy, sz]) = cell(volume.grid().size(), index)?;
    let d = volume.data();
    let get = |at: usize| Vector3::from(d[at].map(f64::from));
    let line = |at: usize| get(at) * (1.0 - fx) + get(at + sx) * fx;
    let face = |at: usize| line(at) * (1.0 - fy) + line(at + sy) * fy;
    Some(face(b) * (1.0 - fz) + face(b + sz) * fz)
}

/// The share of each of a cell's eight corners at a way of `t` (0 to 1) along each axis; corner `c` is the upper one along axis
/// `a` where its bit `a` is set. They add up to 1.
#[inline(always)]
pub fn weights(t: [f64; 3]) -> [f64; 8] {
    let part = |c: usize, a: usize| if c >> a & 1 == 1 { t[a] } else { 1.0 - t[a] };
    std::array::from_fn(|c| part(c, 0) * part(c, 1) * part(c, 2))
}

/// Trilinear value and slope by the index in a cell with these corner values, in the order of [`weights`].
#[inline(always)]
pub fn corners(values: [f64; 8], t: [f64; 3]) -> (f64, Vector3<f64>) {
    let (mut value, mut slope) = (0.0, Vector3::zeros());
    for (c, x) in values.into_iter().enumerate() {
        let high = |a: usize| c >> a & 1 == 1;
        let w: [f64; 3] = std::array::from_fn(|a| if high(a) { t[a] } else { 1.0 - t[a] });
        value += x * w[0] * w[1] * w[2];
        for a in 0..3 {
            slope[a] += x * if high(a) { 1.0 } else { -1.0 } * w[(a + 1) % 3] * w[(a + 2) % 3];
        }
    }
    (value, slope)
}

/// The eight voxels around a continuous index: storage positions, trilinear weights, and the weights' derivatives by the index.
#[derive(Debug, Clone, Copy)]
pub struct Surrounding {
    /// Storage positions.
    pub voxels: [usize; 8],
    /// They add up to 1.
    pub weights: [f64; 8],
    /// By index along each axis; 0 along an axis of one voxel.
    pub slopes: [[f64; 3]; 8],
}

impl Surrounding {
    /// `None` outside the hull of the voxel centres.
    pub fn of(grid: &Grid, index: &Vector3<f64>) -> Option<Self> {
        let (size, strides) = (grid.size(), grid.strides());
        let (mut base, mut t, mut up) = (0, [0.0; 3], [0; 3]);
        for a in 0..3 {
            let (low, way) = place(index[a], size[a])?;
            // The last voxel ends a pair.
            let first = low.min(size[a].saturating_sub(2));
            base += first * strides[a];
            t[a] = way + (low - first) as f64;
            up[a] = if size[a] > 1 { strides[a] } else { 0 };
        }
        let part = |c: usize, a: usize| if c >> a & 1 == 1 { t[a] } else { 1.0 - t[a] };
        let slope = |c: usize, a: usize| {
            let sign = if up[a] == 0 { 0.0 } else { [-1.0, 1.0][c >> a & 1] };
            sign * part(c, (a + 1) % 3) * part(c, (a + 2) % 3)
        };
        Some(Self {
            voxels: std::array::from_fn(|c| base + (0..3).map(|a| (c >> a & 1) * up[a]).sum::<usize>()),
            weights: weights(t),
            slopes: std::array::from_fn(|c| std::array::from_fn(|a| slope(c, a))),
        })
    }

    /// The value there of a field on the grid.
    pub fn value(&self, field: &[[f32; 3]]) -> Vector3<f64> {
        self.voxels.iter().zip(self.weights).map(|(&v, w)| Vector3::from(field[v].map(f64::from)) * w).sum()
    }

    /// The derivative there of a field on the grid, by the index.
    pub fn slope(&self, field: &[[f32; 3]]) -> Matrix3<f64> {
        let of = |(&v, s): (&usize, &[f64; 3])| Vector3::from(field[v].map(f64::from)) * RowVector3::from(*s);
        self.voxels.iter().zip(&self.slopes).map(of).sum()
    }
}
