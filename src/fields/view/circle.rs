//! The circle that padding leaves of each slice.

use super::Circle;
use crate::geometry::Grid;
use crate::volume::{Mask, Volume};
use nalgebra::{Matrix3, Vector3};

/// A slice's border lies on its circle to this much, in voxels.
const ON_CIRCLE: f64 = 1.5;
/// Share of all border points that must lie on the circles.
const MOST: f64 = 0.8;
/// Slices' circles share their centre to this much, mm.
const SAME_CENTRE_MM: f64 = 4.0;
/// Share of the full circle that the border must show.
const LEAST_ARC: f64 = 0.4;

/// A circle in the plane of a slice: centre and radius in mm along the slice's axes, from voxel (0, 0).
#[derive(Debug, Clone, Copy)]
struct Round {
    centre: [f64; 2],
    radius: f64,
}

/// The circles of the slices across one axis.
pub(super) struct Found {
    /// In world coordinates, its rim not yet known.
    pub(super) circle: Circle,
    centre: [f64; 2],
    /// Axes of the slices.
    axes: [usize; 2],
    /// Radius in each slice, mm; infinite where the padding leaves no circle.
    radius: Vec<f64>,
}

impl Found {
    /// Depth of a voxel inside its slice's circle, mm: negative beyond it.
    pub(super) fn depth(&self, grid: &Grid, at: [usize; 3]) -> f64 {
        let spacing = grid.spacing();
        let [x, y] = self.axes.map(|a| at[a] as f64 * spacing[a]);
        self.radius[at[self.circle.along]] - (x - self.centre[0]).hypot(y - self.centre[1])
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

/// The circles that the padding leaves, if they are circles about one axis.
pub(super) fn find(padding: &Mask, blank: [[usize; 2]; 3]) -> Option<Found> {
    [2, 1, 0].into_iter().find_map(|along| across(padding, along, blank[along]))
}

fn across(padding: &Mask, along: usize, blank: [usize; 2]) -> Option<Found> {
    let grid = padding.grid();
    let axes = match along {
        0 => [1, 2],
        1 => [0, 2],
        _ => [0, 1],
    };
    let tolerance = ON_CIRCLE * axes.map(|a| grid.spacing()[a]).into_iter().fold(0.0, f64::max);
    let slices = blank[0]..grid.size()[along] - blank[1];
    let borders: Vec<(usize, Vec<[f64; 2]>)> = slices.map(|n| (n, border(padding, along, axes, n))).collect();
    let (mut all, mut on) = (0, 0);
    let mut rounds: Vec<(usize, Round, f64)> = Vec::new();
    for (n, points) in &borders {
        all += points.len();
        let Some(round) = fitted(points, tolerance) else { continue };
        on += points.iter().filter(|p| round.off(p).abs() <= tolerance).count();
        rounds.push((*n, round, round.arc(points)));
    }
    if rounds.is_empty() || (on as f64) < MOST * all as f64 {
        return None;
    }
    let centre: [f64; 2] = std::array::from_fn(|a| median(rounds.iter().map(|r| r.1.centre[a])));
    let shared = |r: &Round| (r.centre[0] - centre[0]).hypot(r.centre[1] - centre[1]) <= SAME_CENTRE_MM;
    let together = rounds.iter().filter(|r| shared(&r.1)).count();
    let arc = median(rounds.iter().map(|r| r.2));
    if (together as f64) < MOST * rounds.len() as f64 || arc < LEAST_ARC {
        return None;
    }
    let mut radius = vec![f64::INFINITY; grid.size()[along]];
    for (n, round, _) in &rounds {
        radius[*n] = round.radius;
    }
    let widest = rounds.iter().map(|r| r.1.radius).fold(0.0, f64::max);
    let mut index = Vector3::zeros();
    index[along] = 0.5 * (grid.size()[along] - 1) as f64;
    (0..2).for_each(|n| index[axes[n]] = centre[n] / grid.spacing()[axes[n]]);
    let world = grid.world(&index);
    let circle = Circle { centre_mm: [world.x, world.y, world.z], along, radius_mm: widest, rim_mm: 0.0 };
    Some(Found { circle, centre, axes, radius })
}

/// Middles between voxels of padding and their neighbours in a slice, mm along the slice's axes.
fn border(padding: &Mask, along: usize, [a, b]: [usize; 2], n: usize) -> Vec<[f64; 2]> {
    let grid = padding.grid();
    let (size, spacing) = (grid.size(), grid.spacing());
    let at = |i: usize, j: usize| {
        let mut voxel = [0; 3];
        (voxel[along], voxel[a], voxel[b]) = (n, i, j);
        *padding.at(voxel)
    };
    let mut out = Vec::new();
    for j in 0..size[b] {
        for i in 0..size[a] {
            let here = at(i, j);
            if i + 1 < size[a] && at(i + 1, j) != here {
                out.push([(i as f64 + 0.5) * spacing[a], j as f64 * spacing[b]]);
            }
            if j + 1 < size[b] && at(i, j + 1) != here {
                out.push([i as f64 * spacing[a], (j as f64 + 0.5) * spacing[b]]);
            }
        }
    }
    out
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

fn median(values: impl Iterator<Item = f64>) -> f64 {
    let mut values: Vec<f64> = values.collect();
    let middle = values.len() / 2;
    *values.select_nth_unstable_by(middle, f64::total_cmp).1
}
