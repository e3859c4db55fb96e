//! The inverse by Newton's method from good starts, eight voxels of a row at a time.
//!
//! One voxel after the other each step would wait for the one before it.

use super::super::PushField;
use crate::error::Result;
use crate::geometry::wide_vector::{WideVector, cross, dot, plus};
use crate::geometry::{Grid, LANES, Wide};
use crate::volume::interpolation::lanes::{Block, Sampler};
use crate::volume::{Mask, Volume};

/// Residuals below this many tolerances are taken for steps: where the field changes by a tenth of the way, that will do.
const CLOSE: f32 = 10.0;

/// Determinants of the map's gradient below this are too close to a fold.
const LEAST_DETERMINANT: f32 = 0.05;

/// What the search has found for [`LANES`] voxels.
pub(in crate::field) struct Best {
    /// The best displacements, mm.
    pub(in crate::field) v: WideVector,
    /// |v + u(y + v)|, mm; infinite where that is no number.
    pub(in crate::field) residual: Wide,
}

/// Searches `v` with `v + u(y + v) = 0` within `tolerance` mm for the places `y` of a block of a field, in at most `steps` steps.
/// Where the start is `rough`, a first step is sure to be needed.
#[inline(always)]
pub(in crate::field) fn newton(
    field: &Sampler<'_>,
    block: &Block,
    start: WideVector,
    rough: bool,
    tolerance: f32,
    steps: usize,
) -> Best {
    let mut v = start;
    let mut best = Best { v, residual: Wide::all(f32::INFINITY) };
    let mut newton = true;
    for step in 0..=steps {
        let cells = field.cells(block, &v);
        let (value, slope) = if rough && step == 0 {
            let sample = field.at(block, &cells);
            (sample.value, Some(sample.slope))
        } else {
            (field.values(block, &cells), None)
        };
        let r = plus(&v, &value);
        let size = dot(&r, &r).sqrt();
        let (mut open, mut close) = (false, true);
        for l in 0..LANES {
            let better = size.0[l] < best.residual.0[l];
            best.residual.0[l] = if better { size.0[l] } else { best.residual.0[l] };
            for (best, v) in best.v.iter_mut().zip(&v) {
                best.0[l] = if better { v.0[l] } else { best.0[l] };
            }
            open |= best.residual.0[l] >= tolerance;
            close &= best.residual.0[l] < CLOSE * tolerance;
        }
        if !open || step == steps {
            break;
        }
        // A small residual is its own step, for which no slope is needed; but not twice in a row.
        newton = !(newton && close);
        // No closure: it would not be compiled for wide registers.
        let by = match slope {
            Some(slope) => newton_step(field, &slope, &r),
            None if newton => newton_step(field, &field.at(block, &cells).slope, &r),
            None => r,
        };
        // A step is kept short, so that it stays in its basin.
        let length = dot(&by, &by).sqrt();
        for l in 0..LANES {
            let longest = 2.0 * size.0[l];
            let share = if length.0[l] > longest { longest / length.0[l] } else { 1.0 };
            // A voxel that has arrived stays, whatever its neighbours still need.
            let share = if best.residual.0[l] < tolerance { 0.0 } else { share };
            for (v, by) in v.iter_mut().zip(&by) {
                v.0[l] -= share * by.0[l];
            }
        }
    }
    best
}

/// The Newton steps for residuals: the map's gradient, turned round; near a fold the residual takes its place.
#[inline(always)]
fn newton_step(field: &Sampler<'_>, slope: &[WideVector; 3], r: &WideVector) -> WideVector {
    // Columns of the gradient by world position.
    let mut by = [[Wide::default(); 3]; 3];
    for (c, column) in by.iter_mut().enumerate() {
        for (a, entry) in column.iter_mut().enumerate() {
            let turn = [Wide::all(field.turn[0][c]), Wide::all(field.turn[1][c]), Wide::all(field.turn[2][c])];
            *entry = slope[0][a] * turn[0] + slope[1][a] * turn[1] + slope[2][a] * turn[2];
        }
        column[c] = column[c] + Wide::all(1.0);
    }
    let [a, b, c] = &by;
    let bc = cross(b, c);
    let determinant = dot(a, &bc);
    let solved = [dot(r, &bc), dot(r, &cross(c, a)), dot(r, &cross(a, b))];
    let mut out = *r;
    for l in 0..LANES {
        let upright = determinant.0[l] >= LEAST_DETERMINANT;
        let scale = if upright { determinant.0[l].recip() } else { 0.0 };
        for a in 0..3 {
            out[a].0[l] = if upright { solved[a].0[l] * scale } else { r[a].0[l] };
        }
    }
    out
}

/// The field at every few voxels, about `spacing` mm apart: enough to start an inversion from.
///
/// # Errors
/// Only for internal inconsistency of grids.
pub(in crate::field) fn thinned(push: &PushField, spacing: f64) -> Result<PushField> {
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
