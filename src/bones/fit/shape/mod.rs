//! Similarity of a bone by descriptors of its surroundings, beside the correlation ratio: it finds bones from farther away
//! (docs/decisions/mr.md).
//!
//! With the descriptors `p_i` of planning and `f_i` of the fraction at a bone's places, `q` is how much they differ of what
//! unrelated ones would:
//!
//! ```text
//! q = sum_i |p_i - f_i|^2 / [ sum_i |p_i|^2 + sum_i |f_i|^2 - 2/n (sum_i p_i) . (sum_i f_i) ]
//! ```
//!
//! `ln q` counts as the logarithm of what the ratio leaves unexplained does.

mod descriptor;

pub use descriptor::{CHANNELS, Described, Descriptor, Undescribed};

use super::coarse::Coarse;
use super::evaluation::{Evaluation, Held};
use super::relation::INDEPENDENT_MM3;
use super::samples::Samples;
use crate::geometry::Rigid;
use nalgebra::{Matrix6, Point3, UnitQuaternion, Vector3, Vector6};
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex};

#[cfg(test)]
mod tests;

/// Places of a bone that are compared.
const PLACES: usize = 400;
/// A turn counts as the nearest whose quaternion has multiples of this, about 11 degrees: descriptors bear 20.
const TURN: f64 = 0.1;
/// Fewer places in view say nothing.
const LEAST_PLACES: usize = 40;
/// Descriptors of a bone of which so little is in view do not count, and those of one of which so much is count whole: what is left
/// of a cut bone has them at many places.
const WHOLE: [f64; 2] = [0.35, 0.7];
/// Share that differs in any image; keeps the logarithm finite.
const LEAST_SHARE: f64 = 1e-3;

type Found = Arc<Vec<Option<Descriptor>>>;

/// Planning and a fraction, ready to be compared bone by bone.
pub struct Shapes<'a> {
    coarse: Coarse,
    fraction: Described,
    planning: &'a Undescribed,
    variance: f32,
    bones: Vec<Samples>,
    found: Mutex<BTreeMap<(usize, [i32; 4]), Found>>,
}

/// A bone's part of them, as turned.
#[derive(Clone)]
pub struct Shape<'a> {
    fraction: &'a Described,
    places: &'a Samples,
    descriptors: Found,
}

impl<'a> Shapes<'a> {
    /// Of the fraction's blocks and the samples of each bone.
    pub fn new(coarse: Coarse, planning: &'a Undescribed, bones: &[Samples]) -> Self {
        let fraction = Described::new(&coarse);
        let variance = planning.variance(fraction.grid.step());
        let bones = bones.iter().map(|b| b.thinned(PLACES)).collect();
        Self { coarse, fraction, planning, variance, bones, found: Mutex::default() }
    }

    /// The fraction's blocks, which have the descriptors.
    pub fn coarse(&self) -> &Coarse {
        &self.coarse
    }

    /// The fraction's descriptors.
    pub fn fraction(&self) -> &Described {
        &self.fraction
    }

    /// Planning's descriptors at places, turned.
    pub fn planning(&self, places: &[Point3<f64>], turn: &UnitQuaternion<f64>) -> Vec<Option<Descriptor>> {
        self.planning.described(places, turn, self.fraction.grid.step(), self.variance)
    }

    /// A bone, about so turned.
    pub fn of(&self, bone: usize, turn: &UnitQuaternion<f64>) -> Shape<'_> {
        let q = if turn.w < 0.0 { -turn.into_inner() } else { turn.into_inner() };
        let key = [q.i, q.j, q.k, q.w].map(|v| (v / TURN).round() as i32);
        let places = &self.bones[bone];
        let known = self.found.lock().ok().and_then(|found| found.get(&(bone, key)).cloned());
        let descriptors = known.unwrap_or_else(|| {
            let [i, j, k, w] = key.map(f64::from);
            let turn = UnitQuaternion::from_quaternion(nalgebra::Quaternion::new(w, i, j, k));
            let made: Found = Arc::new(self.planning(&places.points, &turn));
            if let Ok(mut found) = self.found.lock() {
                found.insert((bone, key), made.clone());
            }
            made
        });
        Shape { fraction: &self.fraction, places, descriptors }
    }
}

/// What the fraction shows at a place of planning.
struct Pair<'a> {
    planning: &'a Descriptor,
    fraction: [f64; CHANNELS],
    /// Derivative of each channel along the axes, per mm.
    slope: [Vector3<f64>; CHANNELS],
    lever: Vector3<f64>,
}

impl Shape<'_> {
    /// Without derivatives, slopes are left out.
    fn pair<'d>(
        &self,
        planning: &'d Descriptor,
        at: Point3<f64>,
        centre: &Point3<f64>,
        derivatives: bool,
    ) -> Option<Pair<'d>> {
        let grid = &self.fraction.grid;
        let index = grid.index(&at);
        let (size, strides) = (grid.size(), grid.strides());
        if (0..3).any(|a| !(index[a] >= 0.0 && index[a] < (size[a].max(1) - 1) as f64)) {
            return None;
        }
        let low: [usize; 3] = std::array::from_fn(|a| index[a] as usize);
        let share: [f64; 3] = std::array::from_fn(|a| index[a] - low[a] as f64);
        let base = grid.linear(low);
        let mut fraction = [0.0; CHANNELS];
        let mut slope = [Vector3::zeros(); CHANNELS];
        for corner in 0..8usize {
            let up: [usize; 3] = std::array::from_fn(|a| corner >> a & 1);
            let l = base + (0..3).map(|a| up[a] * strides[a]).sum::<usize>();
            if !self.fraction.is[l] {
                return None;
            }
            let w: [f64; 3] = std::array::from_fn(|a| if up[a] == 1 { share[a] } else { 1.0 - share[a] });
            let sign: [f64; 3] = std::array::from_fn(|a| if up[a] == 1 { 1.0 } else { -1.0 });
            let weight = w[0] * w[1] * w[2];
            let by = Vector3::new(sign[0] * w[1] * w[2], w[0] * sign[1] * w[2], w[0] * w[1] * sign[2]);
            let each = &self.fraction.each[l];
            fraction.iter_mut().zip(each).for_each(|(value, d)| *value += weight * f64::from(*d));
            if derivatives {
                slope.iter_mut().zip(each).for_each(|(slope, d)| *slope += by * f64::from(*d));
            }
        }
        let back = grid.inverse_step().transpose();
        Some(Pair { planning, fraction, slope: slope.map(|s| back * s), lever: at - centre })
    }

    /// Adds cost and derivatives of the bone moved by `t` for a further small motion about `centre`.
    pub fn add(&self, to: &mut Evaluation, t: &Rigid, centre: &Point3<f64>, held: Option<Held>, derivatives: bool) {
        let all = self.places.points.iter().zip(self.descriptors.iter());
        let pairs: Vec<Pair<'_>> =
            all.filter_map(|(p, d)| d.as_ref().and_then(|d| self.pair(d, t * p, centre, derivatives))).collect();
        if pairs.len() < LEAST_PLACES {
            return;
        }
        let n = pairs.len() as f64;
        let (mut apart, mut own) = (0.0, 0.0);
        let (mut sum_p, mut sum_f) = ([0.0; CHANNELS], [0.0; CHANNELS]);
        for pair in &pairs {
            for c in 0..CHANNELS {
                let (p, f) = (f64::from(pair.planning[c]), pair.fraction[c]);
                apart += (p - f).powi(2);
                own += p * p + f * f;
                sum_p[c] += p;
                sum_f[c] += f;
            }
        }
        let unrelated = own - 2.0 / n * sum_p.iter().zip(&sum_f).map(|(p, f)| p * f).sum::<f64>();
        if unrelated <= 1e-9 * n {
            return;
        }
        let apart = apart + LEAST_SHARE * unrelated;
        let view = held.map_or(n / self.places.points.len() as f64, |held| held.view);
        let [none, all] = WHOLE;
        let whole = ((n / self.places.points.len() as f64 - none) / (all - none)).clamp(0.0, 1.0);
        let scale = self.places.volume_mm3 / INDEPENDENT_MM3 * view * whole;
        to.cost += 0.5 * scale * (apart / unrelated).ln();
        if !derivatives {
            return;
        }
        let mean = sum_p.map(|p| p / n);
        let (mut down, mut up, mut curvature) = (Vector6::zeros(), Vector6::zeros(), Matrix6::zeros());
        for pair in &pairs {
            for (c, mean) in mean.iter().enumerate() {
                let (p, f, v) = (f64::from(pair.planning[c]), pair.fraction[c], pair.slope[c]);
                let r = pair.lever.cross(&v);
                let j = Vector6::new(r.x, r.y, r.z, v.x, v.y, v.z);
                down.axpy(f - p, &j, 1.0);
                up.axpy(f - mean, &j, 1.0);
                curvature.ger(1.0, &j, &j, 1.0);
            }
        }
        let rest = 1.0 / unrelated - LEAST_SHARE / apart;
        to.gradient += (down / apart - up * rest) * scale;
        to.curvature += curvature * (scale / apart);
    }
}
