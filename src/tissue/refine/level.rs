//! The pull of the images on elements of one spacing.
//!
//! Each element compares a few points of its cell in planning, `p`, with the fraction where they are now, `f`. To first
//! order in a further step `d` of the element the difference is `r - J d` with `r = p - (g f + o)`; its weighted squares
//! are the element's energy, a quadratic with a 3x3 stiffness that vanishes where there is no contrast. `J` is the mean
//! of both images' gradients (Benhimane and Malis 2004), `g` and `o` the gain and offset that fit all points best.

use super::RefineOptions;
use super::local::{self, Grey};
use super::planning::{ElementShown, Planning, Windowed, sample};
use crate::chainmail::{Lattice, Pull, Quadratic};
use crate::geometry::vectorised;
use crate::stats::gain_and_offset;
use crate::volume::{Mask, Volume, trilinear_vector};
use nalgebra::{Point3, Vector3};
use rayon::prelude::*;

/// Least noise of a difference, HU.
/// At 12 smooth motion errs by 0.38 mm for 0.34 (spline) and posed motion by 0.233 for 0.245; at 3 nothing changes.
const LEAST_NOISE: f64 = 6.0;

/// Every so many-th comparison tells how the grey values of the two scans agree.
const THINNED: usize = 7;

/// Farthest that one comparison may ask an element to move, in widths of the blur.
/// Half and twice as far: within 0.005 mm on all cases.
const REACH: f64 = 2.0;

/// Both images blurred for one lattice, and the lattice's points.
pub(super) struct Level<'a> {
    lattice: &'a Lattice,
    fraction: Volume<f32>,
    /// Soft elements, ascending.
    soft: Vec<u32>,
    /// Whether images mislead there; empty where they do nowhere.
    misled: Vec<bool>,
    /// Points per element.
    offsets: [Vector3<f64>; 8],
    planning: ElementShown,
    weight: f64,
    robust: f64,
    /// Farthest that one comparison may ask an element to move, mm: beyond the blur the linear model says nothing.
    reach: f64,
    /// Width of the neighbourhoods that have a gain and offset of their own, mm; `None` where one serves all.
    neighbourhood_mm: Option<f64>,
    /// What the bones alone would do with each soft element, mm; empty where nothing goes back to it.
    alone: Vec<[f32; 3]>,
    /// How stiffly an element of which the fraction shows nothing goes back to it.
    hold: f32,
}

/// Elements of which the fraction shows nothing go back, over this distance from what it shows, to where the bones alone would
/// carry them, mm: of those tried the longest that errs nowhere more than the bones alone (docs/decisions/patient.md).
const UNSEEN_MM: f64 = 80.0;
/// Stiffness of soft tissue's links together along an axis, against which [`UNSEEN_MM`] is a length.
/// Half and twice as much: 0.759 and 0.785 for 0.772 mm on a cone-beam CT.
const HOLD: f64 = 17.0;

/// Where the bones alone carry soft tissue, because images cannot.
#[derive(Clone, Copy)]
pub(super) struct Alone<'a> {
    /// What the bones alone would do, mm.
    pub(super) field: Option<&'a Volume<[f32; 3]>>,
    /// Where images mislead.
    pub(super) misled: Option<&'a Mask>,
}

impl<'a> Level<'a> {
    pub(super) fn new(
        planning: &Planning<'_>,
        fraction: &Windowed,
        lattice: &'a Lattice,
        options: &RefineOptions,
        neighbourhood_mm: Option<f64>,
        bones: Alone<'_>,
    ) -> Self {
        let Alone { field: alone, misled } = bones;
        let mean = lattice.grid.mean_edge();
        let voxel = planning.ct.grid().mean_edge().max(fraction.grid().mean_edge());
        let sigma = (options.blur * mean).max(options.least_blur * voxel);
        let soft: Vec<u32> = lattice.soft().collect();
        let (planning, fraction) = rayon::join(|| planning.shown(lattice, &soft, sigma), || fraction.blurred(sigma));
        let alone = alone.map_or_else(Vec::new, |alone| {
            let at = |&n: &u32| {
                let u = trilinear_vector(alone, &alone.grid().index(&lattice.rest(n as usize)));
                u.map_or([0.0; 3], |u| u.map(|c| c as f32).into())
            };
            soft.par_iter().map(at).collect()
        });
        let misled = misled.map_or_else(Vec::new, |misled| {
            let near = |n: &u32| misled.grid().voxel_at(&lattice.rest(*n as usize)).is_some_and(|v| *misled.at(v));
            soft.par_iter().map(near).collect()
        });
        Self {
            lattice,
            fraction,
            soft,
            misled,
            offsets: lattice.grid.eighths(),
            planning,
            weight: options.weight * mean * mean,
            robust: options.robust,
            reach: REACH * sigma,
            neighbourhood_mm,
            alone,
            hold: (HOLD * (mean / UNSEEN_MM).powi(2)) as f32,
        }
    }

    /// Whether what images show of soft element `s` counts.
    #[inline(always)]
    fn counts(&self, s: usize) -> bool {
        !self.misled.get(s).is_some_and(|misled| *misled)
    }

    /// Renews the pull on the soft elements `which` at the elements' displacements `u`.
    pub(super) fn renew(&self, u: &[[f32; 3]], which: &[u32], pull: &mut Pull) {
        let m = self.offsets.len();
        let grey: Vec<(f64, f64)> = (0..self.planning.len().div_ceil(THINNED))
            .into_par_iter()
            .filter_map(|t| {
                let point = t * THINNED;
                if !self.counts(point / m) {
                    return None;
                }
                let p = self.planning[point][0];
                let f = sample(&self.fraction, &(self.place(point / m, u) + self.offsets[point % m]))?.0;
                (!p.is_nan() && !f.is_nan()).then_some((f64::from(p), f))
            })
            .collect();
        let grey = grey_values(&grey);
        let place = |s: usize, point: usize| self.place(s, u) + self.offsets[point];
        let pair = |s: usize, point: usize| {
            if !self.counts(s) {
                return None;
            }
            let p = self.planning[s * m + point][0];
            let f = sample(&self.fraction, &place(s, point))?.0;
            (!p.is_nan() && !f.is_nan()).then_some((f64::from(p), f))
        };
        let local = self.neighbourhood_mm.map(|mm| local::grey_values(self.lattice, &self.soft, mm, grey, pair));
        let each = which.par_iter().map(|&s| {
            let grey = local.as_ref().map_or(grey, |local| local[s as usize]);
            vectorised(
                #[inline(always)]
                || self.element(s as usize, u, grey),
            )
        });
        let renewed: Vec<_> = each.collect();
        which.iter().zip(renewed).for_each(|(&s, new)| pull.set(s as usize, new));
    }

    /// Where soft element `s` is now.
    #[inline(always)]
    fn place(&self, s: usize, u: &[[f32; 3]]) -> Point3<f64> {
        let n = self.soft[s] as usize;
        self.lattice.rest(n) + Vector3::from(u[n].map(f64::from))
    }

    /// Stiffness and pull of soft element `s`, given the grey values' gain, offset and noise.
    #[inline(always)]
    fn element(&self, s: usize, u: &[[f32; 3]], grey: Grey) -> Quadratic {
        let Grey { gain, offset, noise } = grey;
        let m = self.offsets.len();
        let limit = self.robust * noise;
        let scale = self.weight / (noise * noise) / m as f64;
        let (here, counts) = (self.place(s, u), self.counts(s));
        let (mut a, mut b, mut seen) = ([0f64; 6], Vector3::zeros(), false);
        for (p, o) in self.planning[s * m..(s + 1) * m].iter().zip(&self.offsets) {
            if p[0].is_nan() || !counts {
                continue;
            }
            let Some((f, slope)) = sample(&self.fraction, &(here + o)) else { continue };
            if f.is_nan() {
                continue;
            }
            seen = true;
            let r = f64::from(p[0]) - (gain * f + offset);
            let j = Vector3::from_fn(|c, _| 0.5 * (gain * slope[c] + f64::from(p[c + 1])));
            let w = if r.abs() > limit { limit / r.abs() } else { 1.0 } * scale;
            b += j * (w * r);
            for (k, (x, y)) in Pull::ENTRIES.into_iter().enumerate() {
                a[k] += w * j[x] * j[y];
            }
        }
        if let (false, Some(alone)) = (seen, self.alone.get(s)) {
            let k = self.hold;
            return Quadratic { stiffness: [k, 0.0, 0.0, k, 0.0, k], towards: alone.map(|u| k * u) };
        }
        let now = u[self.soft[s] as usize].map(f64::from);
        let [xx, xy, xz, yy, yz, zz] = a;
        let asked = b.norm() / (xx + yy + zz).max(f64::MIN_POSITIVE);
        if asked > self.reach {
            b *= self.reach / asked;
        }
        let towards = [
            b.x + xx * now[0] + xy * now[1] + xz * now[2],
            b.y + xy * now[0] + yy * now[1] + yz * now[2],
            b.z + xz * now[0] + yz * now[1] + zz * now[2],
        ];
        Quadratic { stiffness: a.map(|v| v as f32), towards: towards.map(|v| v as f32) }
    }
}

/// Gain and offset of the fraction's grey values that fit planning best, and the noise of what is left: its median
/// absolute value as a standard deviation. Outliers are left out in two rounds. `pairs` are planning and fraction values.
fn grey_values(pairs: &[(f64, f64)]) -> Grey {
    if pairs.is_empty() {
        return Grey { gain: 1.0, offset: 0.0, noise: LEAST_NOISE };
    }
    let (mut gain, mut offset, mut noise) = (1.0, 0.0, f64::MAX);
    for _ in 0..3 {
        let limit = 3.0 * noise;
        let near = pairs.iter().copied().filter(|(p, f)| (p - gain * f - offset).abs() < limit);
        if let Some(line) = gain_and_offset(near) {
            (gain, offset) = (line.gain, line.offset);
        }
        let mut left: Vec<f64> = pairs.iter().map(|(p, f)| (p - gain * f - offset).abs()).collect();
        let middle = left.len() / 2;
        noise = (1.4826 * *left.select_nth_unstable_by(middle, f64::total_cmp).1).max(LEAST_NOISE);
    }
    Grey { gain, offset, noise }
}

#[cfg(test)]
mod tests;
