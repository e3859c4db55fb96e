//! Similarity of one bone in an image of another modality: the correlation ratio (Roche et al. 1998) of the fraction's grey
//! values given planning's HU.
//!
//! The grey value of a tissue may be any: each of a few ranges of HU has its own, and values between them are interpolated.
//! With the memberships `m_ik` of sample `i` in range `k`, blurred as the fraction is, the best grey values `c` at a place are
//! those of least squares, and the unexplained share of what is visible is
//!
//! ```text
//! q = sum_i w_i (f_i - sum_k c_k m_ik)^2 / sum_i w_i (f_i - mean f)^2
//! ```
//!
//! It takes the place of the squared correlation in [`super::similarity`]; cost, weight and what is hidden are as there.

use super::evaluation::{Evaluation, Held, LEAST_SHARE, Normal, Weights};
use super::samples::Samples;
use super::tissue::Tissue;
use crate::geometry::Rigid;
use crate::volume::ranges::RANGES;
use crate::volume::{Volume, cubic};
use nalgebra::{Matrix6, Point3, SMatrix, Vector3, Vector6};
use rayon::prelude::*;

/// What holds the grey value of a range that a bone hardly has, as a share of all samples.
const RIDGE: f64 = 1e-3;

/// The same about the grey values of all bones together, where these are known.
const SHARED: f64 = 0.1;
/// Cubic mm of image that carry one independent sample: what HU do not explain hangs together more widely than a CT's noise.
pub(super) const INDEPENDENT_MM3: f64 = 300.0;

/// What the fraction shows of a sample.
struct Shown {
    m: Weights,
    /// Visibility and grey value.
    w: f64,
    f: f64,
    /// Derivative of the grey value and of the visibility by a small rigid motion.
    j: Vector6<f64>,
    k: Vector6<f64>,
}

fn shown(m: &[f32; RANGES], p: &Point3<f64>, fraction: &Tissue, t: &Rigid, centre: &Point3<f64>) -> Option<Shown> {
    let grid = fraction.value.grid();
    let y = t * p;
    let index = grid.index(&y);
    let (w, dw) = fraction.visibility(&index);
    let (f, g) = (w > 0.0).then(|| cubic(&fraction.value, &index)).flatten()?;
    let lever = y - centre;
    let motion = |v: Vector3<f64>| {
        let v = grid.inverse_step().transpose() * v;
        let r = lever.cross(&v);
        Vector6::new(r.x, r.y, r.z, v.x, v.y, v.z)
    };
    let m = Weights::from_iterator(m.iter().map(|&m| f64::from(m)));
    Some(Shown { m, w, f, j: motion(g), k: if w < 1.0 { motion(dw) } else { Vector6::zeros() } })
}

/// Evidence for one shift of the samples (`points` as indices of the image, by nearest voxels): visible share times
/// `-ln(1 - correlation ratio)`.
pub fn evidence(points: &[Vector3<f64>], members: &[[f32; RANGES]], image: &Volume<f32>, shift: &Vector3<f64>) -> f64 {
    let size = image.grid().size();
    let mut own = SMatrix::<f64, RANGES, RANGES>::zeros();
    let (mut both, mut sum, mut square, mut n) = (Weights::zeros(), 0.0, 0.0, 0.0);
    for (p, m) in points.iter().zip(members) {
        let r = (p + shift).add_scalar(0.5);
        if (0..3).any(|d| r[d] < 0.0 || r[d] >= size[d] as f64) {
            continue;
        }
        let f = f64::from(image.data()[r.x as usize + size[0] * (r.y as usize + size[1] * r.z as usize)]);
        if Tissue::is_air(f as f32) {
            continue;
        }
        let m = Weights::from_iterator(m.iter().map(|&m| f64::from(m)));
        own.ger(1.0, &m, &m, 1.0);
        both.axpy(f, &m, 1.0);
        (sum, square, n) = (sum + f, square + f * f, n + 1.0);
    }
    let total = square - sum * sum / f64::max(n, 1.0);
    if n < 30.0 || total <= 0.0 {
        return 0.0;
    }
    // Memberships add up to one, so that the mean is among what they explain.
    let mean = sum / n;
    let weight: Weights = own.column_sum();
    let both = both - weight * mean;
    own += SMatrix::<f64, RANGES, RANGES>::identity() * (RIDGE * n);
    let Some(solved) = own.cholesky().map(|c| c.solve(&both)) else { return 0.0 };
    let ratio = (both.dot(&solved) / total).clamp(0.0, 1.0 - 1e-4);
    -n / points.len() as f64 * (1.0 - ratio).ln()
}

/// As [`super::similarity::evaluate`].
pub fn evaluate(
    samples: &Samples,
    fraction: &Tissue,
    t: &Rigid,
    centre: &Point3<f64>,
    held: Option<Held>,
    derivatives: bool,
) -> Evaluation {
    let n = samples.points.len();
    let pairs = samples.memberships.par_iter().zip(&samples.points);
    let all: Vec<Shown> = pairs.filter_map(|(m, p)| shown(m, p, fraction, t, centre)).collect();
    let w: f64 = all.iter().map(|s| s.w).sum();
    if w <= 1.0 {
        return Evaluation::nothing();
    }
    let mean = all.iter().map(|s| s.w * s.f).sum::<f64>() / w;
    let mut own = SMatrix::<f64, RANGES, RANGES>::zeros();
    let (mut both, mut total) = (Weights::zeros(), 0.0);
    for s in &all {
        own.ger(s.w, &s.m, &s.m, 1.0);
        both.axpy(s.w * (s.f - mean), &s.m, 1.0);
        total += s.w * (s.f - mean).powi(2);
    }
    let normal = Normal { own, both: both + own.column_sum() * mean };
    let (ridge, prior) = match held.and_then(|h| h.grey) {
        Some(grey) => (SHARED, grey.add_scalar(-mean)),
        None => (RIDGE, Weights::zeros()),
    };
    own += SMatrix::<f64, RANGES, RANGES>::identity() * (ridge * w);
    let Some(inverse) = own.try_inverse() else { return Evaluation::nothing() };
    let grey = inverse * (both + prior * (ridge * w));
    // What departs from the grey values that are held to is paid for, so that the slope is the cost's.
    let departed = ridge * (grey - prior).norm_squared();
    let mut rss = 0.0;
    let (mut down, mut up, mut border) = (Vector6::zeros(), Vector6::zeros(), [Vector6::zeros(); 3]);
    let mut jj = Matrix6::zeros();
    let mut mj = SMatrix::<f64, RANGES, 6>::zeros();
    for s in &all {
        let apart = s.f - mean;
        let r = apart - s.m.dot(&grey);
        rss += s.w * r * r;
        if !derivatives {
            continue;
        }
        down.axpy(s.w * r, &s.j, 1.0);
        up.axpy(s.w * apart, &s.j, 1.0);
        jj.ger(s.w, &s.j, &s.j, 1.0);
        mj.ger(s.w, &s.m, &s.j, 1.0);
        if s.w < 1.0 {
            border[0] += s.k;
            border[1] += s.k * (r * r + departed);
            border[2] += s.k * (apart * apart);
        }
    }
    let flat = total <= 1e-9 * w * mean.abs().max(1.0);
    let total = total.max(1e-9 * w);
    let explained = if flat { 0.0 } else { 1.0 - rss / total };
    rss += departed * w + LEAST_SHARE * total;
    let q = if flat { 1.0 } else { rss / total };
    let count = n.max(1) as f64;
    let weight = samples.volume_mm3 / INDEPENDENT_MM3 / count;
    let (counted, entering) = held.map_or((w, q.ln()), |held| (held.view * count, 0.0));
    let scale = weight * counted;
    let gradient = (down + border[1] * 0.5) * (scale / rss) - (up + border[2] * 0.5) * (scale / total)
        + border[0] * (0.5 * weight * entering);
    // Grey values follow the motion: project them out (variable projection, Kaufman 1975).
    let curvature = (jj - mj.transpose() * inverse * mj) * (scale / rss);
    Evaluation {
        cost: 0.5 * scale * q.ln(),
        gradient,
        curvature,
        explained,
        visible: w / count,
        contrast: [1.0, 1.0],
        normal: Some(Normal { own: normal.own * weight, both: normal.both * weight }),
    }
}
