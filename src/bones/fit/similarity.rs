//! Bone-masked similarity of one bone: value, gradient and curvature with respect to a small rigid motion.
//!
//! For a bone with samples `a_i` and fraction values `f_i` at the moved points, with `w_i` the visibility (1 in the tissue
//! of the fraction image, 0 in air and outside), the unexplained share of the visible samples is
//!
//! ```text
//! q = [ sum_i w_i (g f_i + o - a_i)^2 / sum_i w_i ] / [ sum_i (a_i - mean a)^2 / n ]
//! cost = N/2 * 1/n * sum_i w_i * ln q
//! ```
//!
//! The cost is the negative profile log-likelihood of Gaussian residuals with unknown variance and `N` independent
//! samples. Its denominator `n` counts all samples: a hidden one contributes nothing, which is the worst it can do as
//! `q <= 1`, so leaving the field of view never pays; and entering it pays only as far as what comes into view
//! agrees. (Counting hidden samples as unexplained contrast draws cut bones into view: docs/decisions/fit.md.)
//! `g, o` are the best gain and offset of the bone ([`Measure::Correlation`]: then `1 - q` is the squared correlation
//! when all is visible) or 1 and 0 ([`Measure::SquaredDifference`]).

use super::relation::{self, Normal, Weights};
use super::samples::Samples;
use super::tissue::Tissue;
use crate::geometry::{Rigid, vectorised};
use crate::volume::cubic;
use nalgebra::{Matrix2, Matrix2x6, Matrix3, Matrix6, Point3, Vector3, Vector6};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// How planning and fraction HU are compared.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Measure {
    /// Squared correlation: gain and offset of the HU are free for each bone.
    #[default]
    Correlation,
    /// Squared difference of HU as they are.
    SquaredDifference,
    /// Correlation ratio: each range of HU has a grey value of its own, as in an MR.
    CorrelationRatio,
}

/// Cubic mm of image that carry one independent sample: residuals are correlated over a few voxels.
const CORRELATION_VOLUME_MM3: f64 = 60.0;
/// Unexplained share that every image has; keeps the logarithm finite on noise-free ones.
pub(super) const LEAST_SHARE: f64 = 1e-6;

/// Similarity of one bone at one position.
#[derive(Debug, Clone)]
pub struct Evaluation {
    /// Cost.
    pub cost: f64,
    /// Gradient with respect to (rotation vector about the centre in radians, shift in mm).
    pub gradient: Vector6<f64>,
    /// Gauss-Newton curvature, positive semidefinite.
    pub curvature: Matrix6<f64>,
    /// Explained share `1 - q` of the visible samples.
    pub explained: f64,
    /// Mean visibility.
    pub visible: f64,
    /// Covariance of planning and fraction values and variance of the fraction's, each times the number of independent
    /// samples in view: the quotient is the bone's gain.
    pub contrast: [f64; 2],
    /// What the grey values of ranges of HU follow from, by the correlation ratio.
    pub normal: Option<Normal>,
}

/// What a bone's similarity takes from elsewhere instead of finding it anew at each position.
///
/// A sliver of a bone can buy a closer match by moving until more of it is in view, or by a gain that no scanner has.
#[derive(Debug, Clone, Copy)]
pub struct Held {
    /// Visible share that counts, whatever is in view.
    pub view: f64,
    /// Gain of the HU.
    pub gain: f64,
    /// Grey value of each range of HU, by the correlation ratio.
    pub grey: Option<Weights>,
}

impl Evaluation {
    /// Of a bone of which nothing is seen.
    pub fn nothing() -> Self {
        Self {
            cost: 0.0,
            gradient: Vector6::zeros(),
            curvature: Matrix6::zeros(),
            explained: 0.0,
            visible: 0.0,
            contrast: [0.0; 2],
            normal: None,
        }
    }
}

/// Sums over a chunk of samples. `J` is the derivative of `f`, `K` of `w`.
#[derive(Clone)]
struct Sums {
    w: f64,
    f: f64,
    a: f64,
    ff: f64,
    fa: f64,
    aa: f64,
    j: Vector6<f64>,
    fj: Vector6<f64>,
    aj: Vector6<f64>,
    jj: Matrix6<f64>,
    /// K times 1, f, a, ff, fa, aa.
    k: [Vector6<f64>; 6],
}

impl Sums {
    fn zero() -> Self {
        let z = Vector6::zeros();
        Self { w: 0.0, f: 0.0, a: 0.0, ff: 0.0, fa: 0.0, aa: 0.0, j: z, fj: z, aj: z, jj: Matrix6::zeros(), k: [z; 6] }
    }

    fn add(&mut self, o: &Self) {
        self.w += o.w;
        self.f += o.f;
        self.a += o.a;
        self.ff += o.ff;
        self.fa += o.fa;
        self.aa += o.aa;
        self.j += o.j;
        self.fj += o.fj;
        self.aj += o.aj;
        self.jj += o.jj;
        for (a, b) in self.k.iter_mut().zip(&o.k) {
            *a += b;
        }
    }
}

#[inline(always)]
fn accumulate(
    points: &[Point3<f64>],
    values: &[f64],
    fraction: &Tissue,
    t: &Rigid,
    centre: &Point3<f64>,
    derivatives: bool,
) -> Sums {
    let grid = fraction.value.grid();
    let to_index = grid.inverse_step();
    let back: Matrix3<f64> = to_index.transpose();
    let mut s = Sums::zero();
    for (p, &a) in points.iter().zip(values) {
        let y = t * p;
        let index = grid.index(&y);
        let (w, dw) = fraction.visibility(&index);
        let Some((f, g)) = (w > 0.0).then(|| cubic(&fraction.value, &index)).flatten() else {
            continue;
        };
        s.w += w;
        s.f += w * f;
        s.a += w * a;
        s.ff += w * f * f;
        s.fa += w * f * a;
        s.aa += w * a * a;
        if !derivatives {
            continue;
        }
        let lever = y - centre;
        let motion = |v: Vector3<f64>| {
            let r = lever.cross(&v);
            Vector6::new(r.x, r.y, r.z, v.x, v.y, v.z)
        };
        let j = motion(back * g);
        let wj = j * w;
        s.j += wj;
        s.fj += wj * f;
        s.aj += wj * a;
        s.jj.ger(1.0, &wj, &j, 1.0);
        if w < 1.0 {
            let k = motion(back * dw);
            for (sum, factor) in s.k.iter_mut().zip([1.0, f, a, f * f, f * a, a * a]) {
                *sum += k * factor;
            }
        }
    }
    s
}

/// Samples per parallel task; fixed, so that sums do not depend on the number of threads.
const CHUNK: usize = 2048;

/// Similarity of a bone moved by `t`, with what is `held`; derivatives (when asked for) are for a further small motion
/// about `centre`.
pub fn evaluate(
    samples: &Samples,
    fraction: &Tissue,
    t: &Rigid,
    centre: &Point3<f64>,
    measure: Measure,
    held: Option<Held>,
    derivatives: bool,
) -> Evaluation {
    if measure == Measure::CorrelationRatio {
        return relation::evaluate(samples, fraction, t, centre, held, derivatives);
    }
    let n = samples.points.len();
    let mean = samples.values.iter().sum::<f64>() / n.max(1) as f64;
    let total: f64 = samples.values.iter().map(|a| (a - mean).powi(2)).sum::<f64>().max(1e-9);
    let parts: Vec<Sums> = samples
        .points
        .par_chunks(CHUNK)
        .zip(samples.values.par_chunks(CHUNK))
        .map(|(p, v)| {
            vectorised(
                #[inline(always)]
                || accumulate(p, v, fraction, t, centre, derivatives),
            )
        })
        .collect();
    let mut s = Sums::zero();
    parts.iter().for_each(|p| s.add(p));
    let independent = samples.volume_mm3 / CORRELATION_VOLUME_MM3;
    finish(&s, total, independent, n, measure, held)
}

/// Turns the sums into cost, gradient and curvature.
fn finish(s: &Sums, total: f64, independent: f64, n: usize, measure: Measure, held: Option<Held>) -> Evaluation {
    let variance = s.ff - s.f * s.f / s.w.max(1e-9);
    let covariance = s.fa - s.f * s.a / s.w.max(1e-9);
    let fitted = measure == Measure::Correlation && s.w > 1.0 && variance > 1e-6 * s.ff;
    let (g, o) = match (measure, fitted) {
        (Measure::SquaredDifference, _) => (1.0, 0.0),
        // Negative gain explains nothing: contrast never inverts between two CTs.
        (_, true) => {
            let g = held.map_or(covariance / variance, |held| held.gain).max(0.0);
            (g, (s.a - g * s.f) / s.w)
        }
        _ => (0.0, if s.w > 0.0 { s.a / s.w } else { 0.0 }),
    };
    let square = |ff, fa, aa, f, a, one| g * g * ff - 2.0 * g * fa + aa + 2.0 * g * o * f - 2.0 * o * a + o * o * one;
    let count = n.max(1) as f64;
    let weight = independent / count;
    if s.w <= 0.0 {
        return Evaluation::nothing();
    }
    let least = LEAST_SHARE * total / count;
    let rss = square(s.ff, s.fa, s.aa, s.f, s.a, s.w).max(0.0) + least * s.w;
    let q = rss / s.w / (total / count);
    // What counts as visible, and by how much its logarithm weighs a change of what is.
    let (counted, entering) = held.map_or((s.w, q.ln() - 1.0), |held| (held.view * count, -held.view * count / s.w));
    let scale = weight * counted / rss;
    let [k1, kf, ka, kff, kfa, kaa] = &s.k;
    let border = kff * (g * g) - kfa * (2.0 * g) + kaa + kf * (2.0 * g * o) - ka * (2.0 * o) + k1 * (o * o + least);
    let gradient = ((s.fj * g + s.j * o - s.aj) * g + border * 0.5) * scale + k1 * (0.5 * weight * entering);
    let mut curvature = s.jj;
    if fitted && held.is_some() {
        curvature -= s.j * s.j.transpose() / s.w;
    } else if fitted {
        // Gain and offset follow the motion: project them out (variable projection, Kaufman 1975).
        let c = Matrix2x6::from_rows(&[s.fj.transpose(), s.j.transpose()]);
        if let Some(inverse) = Matrix2::new(s.ff, s.f, s.f, s.w).try_inverse() {
            curvature -= c.transpose() * inverse * c;
        }
    }
    Evaluation {
        cost: 0.5 * weight * counted * q.ln(),
        gradient,
        curvature: curvature * (g * g * scale),
        explained: 1.0 - q,
        visible: s.w / count,
        contrast: [covariance, variance].map(|c| c * weight),
        normal: None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_perfect_match_leaves_the_least_share() {
        // Four samples of which 2.5 are in view, planning 2 f + 5 everywhere: gain and offset explain it all.
        let [w, f, ff] = [2.5, 40.0, 900.0];
        let (a, fa, aa) = (2.0 * f + 5.0 * w, 2.0 * ff + 5.0 * f, 4.0 * ff + 20.0 * f + 25.0 * w);
        let found = finish(&Sums { w, f, a, ff, fa, aa, ..Sums::zero() }, 640.0, 12.0, 4, Measure::Correlation, None);
        let (count, weight) = (4.0, 12.0 / 4.0);
        assert!((found.explained - (1.0 - LEAST_SHARE)).abs() < 1e-10, "{}", found.explained);
        let cost = 0.5 * weight * w * LEAST_SHARE.ln();
        assert!((found.cost / cost - 1.0).abs() < 1e-6, "{} for {cost}", found.cost);
        assert!((found.visible - w / count).abs() < 1e-12);
        let [covariance, variance] = found.contrast;
        assert!((variance - weight * (ff - f * f / w)).abs() < 1e-9 && (covariance / variance - 2.0).abs() < 1e-9);
    }

    #[test]
    fn an_image_without_contrast_has_no_gain() {
        // Values of 100 with a variance that is rounding: planning's contrast stays unexplained.
        let sums = Sums { w: 2.0, f: 200.0, a: 6.0, ff: 2e4 + 1e-3, fa: 600.0 + 1e-2, aa: 20.0, ..Sums::zero() };
        let found = finish(&sums, 2.0, 1.0, 2, Measure::Correlation, None);
        assert!(found.explained.abs() < 1e-5, "{}", found.explained);
        assert!(found.curvature.amax() < 1e-12);
    }
}
