//! What of an image a cone-beam machine sees: slices, circle, and where a voxel lies in the scanner.

use super::super::shape::V3;
use super::options::CbctOptions;
use crate::error::{Error, Result};
use crate::geometry::Grid;
use crate::volume::{Mask, Volume};
use std::ops::Range;

impl CbctOptions {
    /// Where a scan of this grid was measured: within the circle, blank slices left out. `grid` is
    /// that of the degraded image.
    pub fn measured(&self, grid: &Grid) -> Mask {
        let view = CircleView::new(self, grid);
        Volume::from_fn(grid.clone(), |n| view.measured(grid, n).is_some())
    }
}

/// The storage axis that runs most along the body.
fn long_axis(grid: &Grid) -> usize {
    let along = |a: &usize| grid.direction()[(2, *a)].abs();
    (0..3).max_by(|a, b| along(a).total_cmp(&along(b))).unwrap_or(2)
}

/// The voxels that a short scan keeps.
pub(super) fn kept(options: &CbctOptions, grid: &Grid) -> Result<[Range<usize>; 3]> {
    let mut kept = grid.size().map(|n| 0..n);
    let axis = long_axis(grid);
    let (all, spacing) = (grid.size()[axis], grid.spacing()[axis]);
    if options.length_mm > 0.0 {
        let count = (options.length_mm / spacing + 1e-9).floor().min(all as f64 - 1.0) as usize + 1;
        let first = (all - count) / 2;
        kept[axis] = first..first + count;
    }
    let [low, high] = options.blank_slices;
    if low.saturating_add(high) >= kept[axis].len() {
        let problem = format!("{low} and {high} blank slices of {} leave nothing", kept[axis].len());
        return Err(Error::input("options of the cone-beam CT", problem, "leave fewer slices blank, or scan longer"));
    }
    Ok(kept)
}

/// Where a voxel lies in the scanner.
pub(super) struct CircleSeen {
    /// Across the axis, mm.
    pub(super) from_axis: V3,
    /// Distance to the axis, mm.
    pub(super) radius: f64,
    /// Along the axis, LPS mm.
    pub(super) height: f64,
}

/// The field of view.
pub(super) struct CircleView {
    axis: usize,
    along: V3,
    middle: V3,
    pub(super) radius: f64,
    filled: Range<usize>,
}

impl CircleView {
    pub(super) fn new(options: &CbctOptions, grid: &Grid) -> Self {
        let axis = long_axis(grid);
        let [left, back] = options.circle_offset_mm;
        // Blank ends are told by height, however slices are stored.
        let along: V3 = grid.direction().column(axis).into();
        let (first, last) = match options.blank_slices {
            [low, high] if along.z < 0.0 => (high, low),
            [low, high] => (low, high),
        };
        Self {
            axis,
            along,
            middle: grid.middle().coords + V3::new(left, back, 0.0),
            radius: if options.circle_radius_mm > 0.0 { options.circle_radius_mm } else { f64::MAX },
            filled: first..grid.size()[axis].saturating_sub(last),
        }
    }

    /// Where a voxel lies, or `None` for one that was not measured.
    pub(super) fn measured(&self, grid: &Grid, n: usize) -> Option<CircleSeen> {
        let at = grid.voxel(n);
        let x = grid.centre(at).coords;
        let across = x - self.middle;
        let from_axis = across - self.along * self.along.dot(&across);
        let radius = from_axis.norm();
        (radius <= self.radius && self.filled.contains(&at[self.axis])).then_some(CircleSeen {
            from_axis,
            radius,
            height: x.z,
        })
    }
}
