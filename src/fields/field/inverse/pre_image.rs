//! One pre-image: a field that goes on beyond its edge, and the iteration that finds where it leads to a point.

use crate::geometry::Grid;
use crate::volume::{Volume, trilinear_vector};
use nalgebra::{Matrix3, Point3, Vector3};
use serde::{Deserialize, Serialize};

/// How exactly to invert.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct InvertOptions {
    /// A voxel has converged when |v + u(y + v)| is below this, mm.
    #[serde(skip)]
    pub tolerance_mm: f64,
    /// Iteration limit per voxel.
    pub max_iterations: usize,
}

impl Default for InvertOptions {
    fn default() -> Self {
        Self { tolerance_mm: 1e-3, max_iterations: 40 }
    }
}

/// A field with its edge values continued, so that voxels near the scan's end find a smooth pre-image.
pub(in crate::field) struct Continued<'a> {
    u: &'a Volume<[f32; 3]>,
    last: Vector3<f64>,
}

impl<'a> Continued<'a> {
    pub(in crate::field) fn new(u: &'a Volume<[f32; 3]>) -> Self {
        Self { u, last: Vector3::from(u.grid().size().map(|n| (n - 1) as f64)) }
    }

    /// The grid that it is known on.
    pub(in crate::field) fn grid(&self) -> &Grid {
        self.u.grid()
    }

    fn at(&self, index: &Vector3<f64>) -> Vector3<f64> {
        let inside = index.zip_map(&self.last, |i, l| i.clamp(0.0, l));
        trilinear_vector(self.u, &inside).unwrap_or_default()
    }

    /// The value at a world position.
    pub(in crate::field) fn value(&self, p: &Point3<f64>) -> Vector3<f64> {
        self.at(&self.u.grid().index(p))
    }

    /// Derivative of u by the index, by central differences of half a voxel.
    fn slope(&self, index: &Vector3<f64>) -> Matrix3<f64> {
        let column = |a: usize| {
            let mut d = Vector3::zeros();
            d[a] = 0.5;
            self.at(&(index + d)) - self.at(&(index - d))
        };
        Matrix3::from_columns(&[column(0), column(1), column(2)])
    }
}

/// One point's pre-image under a field.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Solved {
    /// `v` with `v + u(y + v) = 0`, mm.
    pub displacement: Vector3<f64>,
    /// |v + u(y + v)|, mm.
    pub residual_mm: f64,
    /// Whether the residual is below the tolerance.
    pub converged: bool,
}

/// Iterates one voxel.
pub(in crate::field) fn solve(
    y: &Vector3<f64>,
    start: Vector3<f64>,
    field: &Continued<'_>,
    options: &InvertOptions,
) -> Solved {
    let InvertOptions { tolerance_mm, max_iterations } = *options;
    let grid = field.u.grid();
    let index = |v: &Vector3<f64>| grid.inverse_step() * (y + v - grid.origin().coords);
    let mut v = start;
    let mut at = index(&v);
    let mut r = v + field.at(&at);
    let mut best = (v, r.norm());
    for _ in 0..max_iterations {
        let size = r.norm();
        if size < best.1 {
            best = (v, size);
        }
        if size < tolerance_mm {
            return Solved { displacement: v, residual_mm: size, converged: true };
        }
        let fixed = v - r;
        at = index(&fixed);
        let next = fixed + field.at(&at);
        if next.norm() < 0.5 * size {
            (v, r) = (fixed, next);
            continue;
        }
        // The fixed point stalls: a Newton step, shortened to a voxel or two so that it stays in its basin.
        let here = index(&v);
        let jacobian = Matrix3::identity() + field.slope(&here) * grid.inverse_step();
        let step = jacobian.try_inverse().map_or(r, |inverse| inverse * r);
        let limit = (2.0 * size).max(tolerance_mm);
        let step = if step.norm() > limit { step * (limit / step.norm()) } else { step };
        v -= step;
        at = index(&v);
        r = v + field.at(&at);
    }
    let size = r.norm();
    if size < best.1 {
        best = (v, size);
    }
    Solved { displacement: best.0, residual_mm: best.1, converged: best.1 < tolerance_mm }
}
