//! The circle that padding leaves of the slices.

use super::Circle;
use crate::geometry::Grid;
use crate::volume::{Mask, Volume};
use nalgebra::{Matrix3, Vector3};

/// The border lies on the circle to this much, in voxels.
const ON_CIRCLE: f64 = 1.0;
/// Share of all border points that must lie on the circle.
const MOST: f64 = 0.8;
/// Share of the full circle that the border must show.
const LEAST_ARC: f64 = 0.4;

/// A circle in the plane of a slice: centre and radius in mm along the slice's axes, from voxel (0, 0).
#[derive(Debug, Clone, Copy)]
struct Round {
    centre: [f64; 2],
    radius: f64,
}

/// The circle of the slices across one axis.
pub(super) struct CircleFound {
    /// In world coordinates, its rim not yet known.
    pub(super) circle: Circle,
    round: Round,
    /// Axes of the slices.
    axes: [usize; 2],
}

impl CircleFound {
    /// Depth of a voxel inside the circle, mm: negative beyond it.
    pub(super) fn depth(&self, grid: &Grid, at: [usize; 3]) -> f64 {
        let spacing = grid.spacing();
        -self.round.off(&self.axes.map(|a| at[a] as f64 * spacing[a]))
    }

    /// The longer edge of a voxel in the slices, mm.
    pub(super) fn edge(&self, grid: &Grid) -> f64 {
        self.axes.map(|a| grid.spacing()[a]).into_iter().fold(0.0, f64::max)
    }

    /// The padding and what lies less than `margin` mm inside the circle.
    pub(super) fn beyond(&self, grid: &Grid, padding: &Mask, margin: f64) -> Mask {
        Volume::from_fn(grid.clone(), |l| padding.data()[l] || self.depth(grid, grid.voxel(l)) < margin)
    }
}

/// The circle that the padding leaves, if it is one about some axis.
pub(super) fn find(padding: &Mask) -> Option<CircleFound> {
    [2, 1, 0].into_iter().find_map(|along| across(padding, along))
}

/// What any slice shows is looked at at once: air that is cut off at the padding's value frays each single one.
fn across(padding: &Mask, along: usize) -> Option<CircleFound> {
    let grid = padding.grid();
    let axes = match along {
        0 => [1, 2],
        1 => [0, 2],
        _ => [0, 1],
    };
    let shown = CircleShown::new(padding, axes);
    let tolerance = ON_CIRCLE * axes.map(|a| grid.spacing()[a]).into_iter().fold(0.0, f64::max);
    let points = shown.border();
    let round = fitted(&points, tolerance)?;
    let on = points.iter().filter(|p| round.off(p).abs() <= tolerance).count();
    if (on as f64) < MOST * points.len() as f64 || round.arc(&points) < LEAST_ARC {
        return None;
    }
    let mut index = Vector3::zeros();
    index[along] = 0.5 * (grid.size()[along] - 1) as f64;
    (0..2).for_each(|n| index[axes[n]] = round.centre[n] / grid.spacing()[axes[n]]);
    let world = grid.world(&index);
    let circle = Circle { centre_mm: [world.x, world.y, world.z], along, radius_mm: round.radius, rim_mm: 0.0 };
    Some(CircleFound { circle, round, axes })
}

/// The pixels in which any slice shows more than padding, and the plane's pixels.
struct CircleShown {
    any: Vec<bool>,
    size: [usize; 2],
    spacing: [f64; 2],
}

impl CircleShown {
    fn new(padding: &Mask, axes: [usize; 2]) -> Self {
        let grid = padding.grid();
        let size = axes.map(|a| grid.size()[a]);
        let mut any = vec![false; size[0] * size[1]];
        for (l, padding) in padding.data().iter().enumerate() {
            let at = grid.voxel(l);
            any[at[axes[0]] + size[0] * at[axes[1]]] |= !padding;
        }
        Self { any, size, spacing: axes.map(|a| grid.spacing()[a]) }
    }

    /// Where it begins and ends along each row and column, mm along the axes; not at the image's own border.
    fn border(&self) -> Vec<[f64; 2]> {
        let mut out = Vec::new();
        for axis in 0..2 {
            let (length, lines) = (self.size[axis], self.size[1 - axis]);
            for line in 0..lines {
                let at = |n: usize| match axis {
                    0 => self.any[n + self.size[0] * line],
                    _ => self.any[line + self.size[0] * n],
                };
                let point = |n: f64| {
                    let mut point = [0.0; 2];
                    (point[axis], point[1 - axis]) = (n * self.spacing[axis], line as f64 * self.spacing[1 - axis]);
                    point
                };
                let (first, last) = ((0..length).find(|n| at(*n)), (0..length).rfind(|n| at(*n)));
                out.extend(first.filter(|n| *n > 0).map(|n| point(n as f64 - 0.5)));
                out.extend(last.filter(|n| n + 1 < length).map(|n| point(n as f64 + 0.5)));
            }
        }
        out
    }
}

impl Round {
    /// How far a point lies beyond the circle, mm.
    fn off(&self, p: &[f64; 2]) -> f64 {
        (p[0] - self.centre[0]).hypot(p[1] - self.centre[1]) - self.radius
    }

    /// Share of the circle near which any of the points lies.
    fn arc(&self, points: &[[f64; 2]]) -> f64 {
        const PARTS: usize = 72;
        let mut seen = [false; PARTS];
        for p in points {
            let turn = (p[1] - self.centre[1]).atan2(p[0] - self.centre[0]) / std::f64::consts::TAU;
            seen[((turn + 0.5) * PARTS as f64) as usize % PARTS] = true;
        }
        seen.iter().filter(|s| **s).count() as f64 / PARTS as f64
    }
}

/// The circle of least squares (Kasa 1976) through the points, without those that lie farther off than `tolerance` of an
/// earlier one; `None` where few points are left on it.
fn fitted(points: &[[f64; 2]], tolerance: f64) -> Option<Round> {
    let mut round = kasa(points.iter())?;
    for slack in [8.0, 3.0, 1.0, 1.0] {
        round = kasa(points.iter().filter(|p| round.off(p).abs() <= slack * tolerance))?;
    }
    let on = points.iter().filter(|p| round.off(p).abs() <= tolerance).count();
    (on >= 24 && 2 * on >= points.len()).then_some(round)
}

fn kasa<'a>(points: impl Iterator<Item = &'a [f64; 2]> + Clone) -> Option<Round> {
    let n = points.clone().count() as f64;
    let mean: [f64; 2] = std::array::from_fn(|a| points.clone().map(|p| p[a]).sum::<f64>() / n);
    let (mut m, mut v) = (Matrix3::zeros(), Vector3::zeros());
    for p in points {
        let row = Vector3::new(p[0] - mean[0], p[1] - mean[1], 1.0);
        m += row * row.transpose();
        v += row * (row.x * row.x + row.y * row.y);
    }
    let x = m.try_inverse()? * v;
    let centre = [0.5 * x[0], 0.5 * x[1]];
    let square = x[2] + centre[0] * centre[0] + centre[1] * centre[1];
    (square > 0.0 && square.is_finite())
        .then(|| Round { centre: [centre[0] + mean[0], centre[1] + mean[1]], radius: square.sqrt() })
}
