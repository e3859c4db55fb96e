//! Rank 3: what of a scan was measured. A reconstruction is often a circle in a square, padded with a value that is none,
//! and blank or short at its ends: there the scan says nothing, neither air nor skin.

mod circle;
mod rim;

use crate::geometry::Grid;
use crate::volume::components::{Components, Connectivity};
use crate::volume::morphology::dilate;
use crate::volume::{Mask, Volume};
use nalgebra::Point3;
use ndarray::Axis;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::borrow::Cow;

/// Air as CTs show it, HU: padding of such a value is told from air by its shape alone.
const AIR_HU: std::ops::RangeInclusive<f32> = -1200.0..=-900.0;
/// Padding fills at least this share of a scan: less hides nothing.
const LEAST_SHARE: f64 = 0.01;
/// Denser than this is tissue, HU.
const TISSUE_HU: f32 = -300.0;
/// A slice cuts the patient where it shows this share of the tissue of the slice so many further on.
const CUT_SHARE: f64 = 0.8;
const ON: usize = 3;
/// Voxels beside padding hold a part of it: so many of them, along their longest edge, are left out.
const PARTIAL_VOXELS: f64 = 1.0;

/// The circle of a reconstruction, in world coordinates of its scan.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Circle {
    /// A point of its axis in the middle of the scan, LPS mm.
    pub centre_mm: [f64; 3],
    /// Axis of the grid (0, 1, 2) that it runs along.
    pub along: usize,
    /// Of the widest slice, mm.
    pub radius_mm: f64,
    /// Width of the bright ring that truncation leaves just inside, mm; 0 for none.
    pub rim_mm: f64,
}

/// What a scan leaves unmeasured.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct ViewReport {
    /// Value of the padding, HU; not a number where that is the padding. `None` without padding.
    pub padding: Option<f32>,
    /// The circle that the padding leaves, if it is one.
    pub circle: Option<Circle>,
    /// Slices without any contrast at the low and high end of each axis of the grid.
    pub blank: [[usize; 2]; 3],
    /// Share of the grid that was measured, percent.
    pub measured_percent: f64,
}

impl ViewReport {
    /// Whether a place lies where a scan of this grid was measured, as far as circle, rim and blank ends tell.
    pub fn shows(&self, grid: &Grid, place: &Point3<f64>) -> bool {
        let index = grid.index(place);
        let within = self.circle.is_none_or(|circle| {
            let apart = (place - Point3::from(circle.centre_mm)).dot(&grid.direction().column(circle.along));
            let off = place - Point3::from(circle.centre_mm) - grid.direction().column(circle.along) * apart;
            off.norm() <= circle.radius_mm - circle.rim_mm
        });
        let at = |a: usize| {
            let [low, high] = self.blank[a].map(|n| n as f64);
            index[a] >= low - 0.5 && index[a] <= grid.size()[a] as f64 - 0.5 - high
        };
        within && (0..3).all(at)
    }

    /// What limits the view, each in a few words; nothing where all of the grid was measured.
    pub fn words(&self) -> Vec<String> {
        let mut words = Vec::new();
        if let Some(circle) = &self.circle {
            words.push(format!("circle of {:.0} mm", 2.0 * circle.radius_mm));
            if circle.rim_mm > 0.0 {
                words.push(format!("bright rim of {:.0} mm", circle.rim_mm));
            }
        } else if let Some(padding) = self.padding {
            words.push(format!("padded with {padding}"));
        }
        for (ends, what) in self.blank.iter().zip(["column", "row", "slice"]).rev() {
            match ends[0] + ends[1] {
                0 => {}
                1 => words.push(format!("1 blank {what} at the edge")),
                n => words.push(format!("{n} blank {what}s at the edges")),
            }
        }
        words
    }
}

/// What of a scan was measured.
#[derive(Debug, Clone)]
pub struct View {
    /// The measured voxels; `None` where all are.
    measured: Option<Mask>,
    /// In numbers.
    pub report: ViewReport,
}

impl View {
    /// Finds what of a CT (HU) was measured.
    pub fn of(ct: &Volume<f32>) -> Self {
        let blank = blank_ends(ct);
        let mut report = ViewReport { measured_percent: 100.0, ..ViewReport::default() };
        let unknown = padding(ct, blank, &mut report);
        Self::from_parts(ct, blank, unknown, report)
    }

    /// Finds what of a scan was measured by its blank ends alone: what lies beside the patient has one value.
    pub fn of_ends(scan: &Volume<f32>) -> Self {
        let report = ViewReport { measured_percent: 100.0, ..ViewReport::default() };
        Self::from_parts(scan, blank_ends(scan), None, report)
    }

    fn from_parts(
        ct: &Volume<f32>,
        mut blank: [[usize; 2]; 3],
        mut unknown: Option<Mask>,
        mut report: ViewReport,
    ) -> Self {
        if let Some(circle) = &report.circle {
            // Beside the circle there is nothing but its padding.
            (0..3).filter(|a| *a != circle.along).for_each(|a| blank[a] = [0; 2]);
        }
        report.blank = blank;
        if blank != [[0; 2]; 3] {
            let grid = ct.grid();
            let unknown = unknown.get_or_insert_with(|| Volume::filled(grid.clone(), false));
            // A slice beside blank ones may hold a part of them.
            let reaches = |n: usize, blank: usize| blank > 0 && n <= blank;
            let beyond = |a: usize, n: usize| reaches(n, blank[a][0]) || reaches(grid.size()[a] - 1 - n, blank[a][1]);
            let [ni, nj, _] = grid.size();
            unknown.data_mut().par_chunks_mut(ni).enumerate().for_each(|(row, unknown)| {
                if beyond(1, row % nj) || beyond(2, row / nj) {
                    unknown.fill(true);
                } else if blank[0] != [0; 2] {
                    unknown.iter_mut().enumerate().for_each(|(i, u)| *u |= beyond(0, i));
                }
            });
        }
        let measured = unknown.map(|unknown| unknown.map(|u| !u));
        if let Some(mask) = &measured {
            report.measured_percent = 100.0 * mask.count() as f64 / mask.data().len().max(1) as f64;
        }
        Self { measured, report }
    }

    /// The measured voxels; `None` where all of the grid are.
    pub fn measured(&self) -> Option<&Mask> {
        self.measured.as_ref()
    }

    /// The scan with no number where nothing was measured.
    pub fn known<'a>(&self, ct: &'a Volume<f32>) -> Cow<'a, Volume<f32>> {
        let Some(mask) = &self.measured else { return Cow::Borrowed(ct) };
        Cow::Owned(Volume::from_fn(ct.grid().clone(), |l| if mask.data()[l] { ct.data()[l] } else { f32::NAN }))
    }
}

/// Whether two values are the same, no number included.
fn same(a: f32, b: f32) -> bool {
    a.to_bits() == b.to_bits() || (a - b).abs() <= 0.0 || (a.is_nan() && b.is_nan())
}

/// Slices of one value, no number included, at both ends of each axis.
fn blank_ends(ct: &Volume<f32>) -> [[usize; 2]; 3] {
    let (size, scan) = (ct.grid().size(), ct.view());
    std::array::from_fn(|a| {
        let slice = |n: usize| scan.index_axis(Axis(a), n);
        let blank = |n: &usize| {
            let slice = slice(*n);
            slice.first().is_none_or(|first| slice.iter().all(|v| same(*v, *first)))
        };
        let low = (0..size[a]).take_while(blank).count();
        if low == size[a] {
            return [0; 2];
        }
        // Air beyond a patient may be cut off at one value: what is blank cuts him, so that he is as wide in the next slice
        // as some slices on.
        let tissue = |n: usize| slice(n).iter().filter(|hu| **hu > TISSUE_HU).count() as f64;
        let cuts = |next: usize, on: usize| tissue(next) > CUT_SHARE * tissue(on).max(1.0);
        let last = size[a] - 1;
        let air = |end: usize| slice(end).first().is_some_and(|hu| AIR_HU.contains(hu));
        let keep = |count: usize, end: usize, next: usize, on: usize| {
            if count > 0 && air(end) && !cuts(next, on) { 0 } else { count }
        };
        let high = (0..size[a]).rev().take_while(blank).count();
        let (next, before) = (low, last - high);
        [keep(low, 0, next, (next + ON).min(before)), keep(high, last, before, before.saturating_sub(ON).max(next))]
    })
}

/// The voxels that hold padding or a part of it, if any.
fn padding(ct: &Volume<f32>, blank: [[usize; 2]; 3], report: &mut ViewReport) -> Option<Mask> {
    let value = common_at_corners(ct, blank)?;
    let equal = ct.map(|v| same(*v, value));
    let outside = joined_to_border(&equal);
    let share = outside.count() as f64 / outside.data().len() as f64;
    if share < LEAST_SHARE {
        return None;
    }
    let circle = circle::find(&outside);
    if circle.is_none() && AIR_HU.contains(&value) {
        return None;
    }
    report.padding = Some(value);
    let partial = PARTIAL_VOXELS * ct.grid().spacing().into_iter().fold(0.0, f64::max);
    let Some(found) = circle else { return Some(dilate(&outside, partial)) };
    let rim_mm = rim::width(ct, &found);
    report.circle = Some(Circle { rim_mm, ..found.circle });
    // In the plane alone: slices above and below a circle are as good as any.
    Some(found.beyond(ct.grid(), &outside, rim_mm.max(2.0 * found.edge(ct.grid()))))
}

/// The value that at least half of the corners of the scan's middle slices along any axis share: padding lies there if
/// anywhere. Blank ends are left out.
fn common_at_corners(ct: &Volume<f32>, blank: [[usize; 2]; 3]) -> Option<f32> {
    let size = ct.grid().size();
    let ends = |a: usize| [blank[a][0], size[a] - 1 - blank[a][1]];
    let middle = |a: usize| usize::midpoint(ends(a)[0], ends(a)[1]);
    for along in [2, 1, 0] {
        let mut values = Vec::new();
        for step in 0..4 {
            let mut at = [0; 3];
            at[along] = middle(along);
            for (n, a) in (0..3).filter(|a| *a != along).enumerate() {
                at[a] = ends(a)[step >> n & 1];
            }
            values.push(*ct.at(at));
        }
        let votes = |v: f32| values.iter().filter(|w| same(v, **w)).count();
        if let Some(value) = values.iter().copied().find(|v| votes(*v) >= 2) {
            return Some(value);
        }
    }
    None
}

/// The voxels of a mask that hang together with the border of the image.
fn joined_to_border(mask: &Mask) -> Mask {
    let grid = mask.grid();
    let parts = Components::of(mask, false, Connectivity::Face);
    let mut touches = vec![false; parts.len()];
    for run in &parts.runs {
        let ends = [run.start, run.end - 1].map(|l| grid.voxel(l));
        touches[run.component] |= ends.iter().any(|at| on_border(*at, grid));
    }
    parts.select(mask, |n| touches[n])
}

fn on_border(at: [usize; 3], grid: &Grid) -> bool {
    (0..3).any(|a| grid.size()[a] > 1 && (at[a] == 0 || at[a] + 1 == grid.size()[a]))
}

#[cfg(test)]
mod tests;
