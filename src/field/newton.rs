//! The inverse at a voxel by Newton's method from a good start: value and gradient of the field from the same eight corners,
//! in single precision, whose error of about 1e-5 mm is far below any tolerance.

use super::PushField;
use crate::error::Result;
use crate::geometry::Grid;
use crate::volume::{Mask, Volume};
use nalgebra::Vector3;

/// Determinants of the map's gradient below this are too close to a fold.
const LEAST_DETERMINANT: f32 = 0.05;

/// A field that is continued by its edge values, with the constants of its grid at hand.
pub(super) struct Sampler<'a> {
    data: &'a [[f32; 3]],
    strides: [usize; 3],
    last: [f64; 3],
    /// Lower neighbour of the last pair of voxels.
    most: [usize; 3],
    up: [usize; 3],
    /// World to index.
    turn: [[f64; 3]; 3],
    origin: Vector3<f64>,
}

/// Value of a field at a place, and its derivative by the index: one column per axis.
struct Sample {
    value: [f32; 3],
    slope: [[f32; 3]; 3],
}

#[inline(always)]
fn minus(a: [f32; 3], b: [f32; 3]) -> [f32; 3] {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

/// `a + t (b)`.
#[inline(always)]
fn add(a: [f32; 3], t: f32, b: [f32; 3]) -> [f32; 3] {
    [a[0] + t * b[0], a[1] + t * b[1], a[2] + t * b[2]]
}

impl<'a> Sampler<'a> {
    pub(super) fn new(field: &'a Volume<[f32; 3]>) -> Self {
        let grid = field.grid();
        let (size, strides, turn) = (grid.size(), grid.strides(), grid.inverse_step());
        Self {
            data: field.data(),
            strides,
            last: size.map(|n| (n - 1) as f64),
            most: size.map(|n| n.saturating_sub(2)),
            up: std::array::from_fn(|a| if size[a] > 1 { strides[a] } else { 0 }),
            turn: std::array::from_fn(|r| std::array::from_fn(|c| turn[(r, c)])),
            origin: grid.origin().coords,
        }
    }

    /// Continuous index of a world position.
    #[inline(always)]
    fn index(&self, p: [f64; 3]) -> [f64; 3] {
        let d = [p[0] - self.origin.x, p[1] - self.origin.y, p[2] - self.origin.z];
        self.turn.map(|r| r[0] * d[0] + r[1] * d[1] + r[2] * d[2])
    }

    #[inline(always)]
    fn at(&self, index: [f64; 3]) -> Option<Sample> {
        let (mut base, mut t, mut free) = (0, [0f32; 3], [1f32; 3]);
        for a in 0..3 {
            // What is no number becomes 0 here.
            let x = index[a].max(0.0).min(self.last[a]);
            if !(0.0..=self.last[a]).contains(&index[a]) {
                free[a] = 0.0;
            }
            let low = (x as u32 as usize).min(self.most[a]);
            t[a] = (x - low as f64) as f32;
            base += low * self.strides[a];
        }
        let line = |n: usize| -> Option<([f32; 3], [f32; 3])> {
            let (a, b) = (*self.data.get(n)?, *self.data.get(n + self.up[0])?);
            let along = minus(b, a);
            Some((add(a, t[0], along), along))
        };
        let face = |n: usize| -> Option<([f32; 3], [f32; 3], [f32; 3])> {
            let ((a, ax), (b, bx)) = (line(n)?, line(n + self.up[1])?);
            let across = minus(b, a);
            Some((add(a, t[1], across), add(ax, t[1], minus(bx, ax)), across))
        };
        let ((a, ax, ay), (b, bx, by)) = (face(base)?, face(base + self.up[2])?);
        let z = minus(b, a);
        let slope = [add(ax, t[2], minus(bx, ax)), add(ay, t[2], minus(by, ay)), z];
        // Beyond the edge the field does not change.
        Some(Sample { value: add(a, t[2], z), slope: std::array::from_fn(|c| slope[c].map(|s| s * free[c])) })
    }

    /// The value at a world position.
    #[inline]
    pub(super) fn value(&self, p: [f64; 3]) -> Vector3<f64> {
        self.at(self.index(p)).map_or_else(Vector3::zeros, |s| s.value.map(f64::from).into())
    }

    /// Searches `v` with `v + u(y + v) = 0` within `tolerance` mm, in at most `steps` steps: the best found, its residual in
    /// mm, and whether that is within the tolerance.
    #[inline]
    pub(super) fn invert(
        &self,
        y: &Vector3<f64>,
        start: Vector3<f64>,
        (tolerance, steps): (f64, usize),
    ) -> (Vector3<f64>, f64, bool) {
        let mut v = [start.x, start.y, start.z];
        let mut best = (v, f64::INFINITY);
        for _ in 0..=steps {
            let Some(sample) = self.at(self.index([y.x + v[0], y.y + v[1], y.z + v[2]])) else { break };
            let r: [f64; 3] = std::array::from_fn(|a| v[a] + f64::from(sample.value[a]));
            let size = (r[0] * r[0] + r[1] * r[1] + r[2] * r[2]).sqrt();
            if size < best.1 {
                best = (v, size);
            }
            if size < tolerance {
                break;
            }
            // A step is kept short, so that it stays in its basin; near a fold the fixed point takes its place.
            let whole = self.step(&sample.slope, r.map(|c| c as f32)).map_or(r, |s| s.map(f64::from));
            let length = (whole[0] * whole[0] + whole[1] * whole[1] + whole[2] * whole[2]).sqrt();
            let share = if length > 2.0 * size { 2.0 * size / length } else { 1.0 };
            v = std::array::from_fn(|a| v[a] - share * whole[a]);
        }
        (best.0.into(), best.1, best.1 < tolerance)
    }

    /// The Newton step for a residual: the map's gradient, turned round. `None` near a fold.
    #[inline(always)]
    fn step(&self, slope: &[[f32; 3]; 3], r: [f32; 3]) -> Option<[f32; 3]> {
        // Columns of the gradient by world position.
        let column = |c: usize| -> [f32; 3] {
            let by = [self.turn[0][c] as f32, self.turn[1][c] as f32, self.turn[2][c] as f32];
            std::array::from_fn(|a| slope[0][a] * by[0] + slope[1][a] * by[1] + slope[2][a] * by[2])
        };
        let (mut a, mut b, mut c) = (column(0), column(1), column(2));
        (a[0], b[1], c[2]) = (a[0] + 1.0, b[1] + 1.0, c[2] + 1.0);
        let cross = |p: [f32; 3], q: [f32; 3]| {
            [p[1] * q[2] - p[2] * q[1], p[2] * q[0] - p[0] * q[2], p[0] * q[1] - p[1] * q[0]]
        };
        let dot = |p: [f32; 3], q: [f32; 3]| p[0] * q[0] + p[1] * q[1] + p[2] * q[2];
        let bc = cross(b, c);
        let determinant = dot(a, bc);
        if determinant.is_nan() || determinant < LEAST_DETERMINANT {
            return None;
        }
        let scale = determinant.recip();
        Some([dot(r, bc) * scale, dot(r, cross(c, a)) * scale, dot(r, cross(a, b)) * scale])
    }
}

/// The field at every few voxels, about `spacing` mm apart: enough to start an inversion from.
///
/// # Errors
/// Only for internal inconsistency of grids.
pub(super) fn thinned(push: &PushField, spacing: f64) -> Result<PushField> {
    let grid = push.displacement.grid();
    let stride = grid.spacing().map(|s| ((spacing / s + 1e-6) as usize).max(1));
    let last = grid.size().map(|n| n - 1);
    let size = std::array::from_fn(|a| last[a].div_ceil(stride[a]) + 1);
    let coarse: [f64; 3] = std::array::from_fn(|a| grid.spacing()[a] * stride[a] as f64);
    let thin = Grid::new(size, coarse, grid.origin(), *grid.direction())?;
    let from = |n: usize| {
        let at = thin.voxel(n);
        grid.linear(std::array::from_fn(|a| (at[a] * stride[a]).min(last[a])))
    };
    let displacement = Volume::from_fn(thin.clone(), |n| push.displacement.data()[from(n)]);
    let computed: Mask = Volume::from_fn(thin.clone(), |n| push.computed.data()[from(n)]);
    Ok(PushField { displacement, computed })
}
