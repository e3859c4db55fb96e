//! The start of the fit: couch shift and scanner-origin offset, found by exhaustive search.
//!
//! No common field of view or origin is assumed: every shift that brings bones into the fraction image is scored by
//! the share of bone HU variance that it explains, at coarse resolution; the best few are refined with rotation.

use super::problem::{Body, PoseProblem};
use super::samples::Samples;
use super::similarity::Measure;
use super::solver::solve;
use super::tissue::Tissue;
use crate::error::{Error, Result};
use crate::geometry::{Rigid, vectorised};
use crate::volume::Volume;
use nalgebra::{Point3, Translation3, UnitQuaternion, Vector3};
use rayon::prelude::*;

/// Step of the exhaustive search, mm. Half the width of the blur that the images get for it.
const STEP_MM: f64 = 10.0;
/// Candidates that are refined.
const CANDIDATES: usize = 8;
/// Candidates closer than this to a better one are the same optimum, mm.
const APART_MM: f64 = 35.0;
/// Least explained share of the refined start; below it the images show no common anatomy.
const LEAST_EXPLAINED: f64 = 0.15;

/// Index range of shifts along each world axis that bring some point into the image's bounding box.
fn shift_range(points: &[Point3<f64>], fraction: &Volume<f32>) -> ([f64; 3], [usize; 3]) {
    let extent = |ps: &mut dyn Iterator<Item = Point3<f64>>, a: usize| {
        ps.fold((f64::MAX, f64::MIN), |(lo, hi), p| (lo.min(p[a]), hi.max(p[a])))
    };
    let mut low = [0.0; 3];
    let mut count = [0; 3];
    for a in 0..3 {
        let (pl, ph) = extent(&mut points.iter().copied(), a);
        let (fl, fh) = extent(&mut fraction.grid().corners().into_iter(), a);
        low[a] = fl - ph;
        count[a] = ((fh - pl - low[a]) / STEP_MM).ceil() as usize + 1;
    }
    (low, count)
}

/// Evidence for one shift, visible share times `-ln(1 - correlation^2)`, by nearest voxels (the images are blurred wider than a voxel).
#[inline(always)]
fn evidence(points: &[Vector3<f64>], values: &[f64], fraction: &Volume<f32>, shift: &Vector3<f64>) -> f64 {
    let size = fraction.grid().size();
    let data = fraction.data();
    let (mut n, mut f1, mut a1, mut ff, mut fa, mut aa) = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0);
    for (p, &a) in points.iter().zip(values) {
        let i = p + shift;
        // The nearest voxel by truncation: `round` is a call on machines without an instruction for it.
        let r = i.add_scalar(0.5);
        if (0..3).any(|d| r[d] < 0.0 || r[d] >= size[d] as f64) {
            continue;
        }
        let f = f64::from(data[r.x as usize + size[0] * (r.y as usize + size[1] * r.z as usize)]);
        n += 1.0;
        f1 += f;
        a1 += a;
        ff += f * f;
        fa += f * a;
        aa += a * a;
    }
    let m = f64::max(n, 1.0);
    let (variance, contrast, covariance) = (ff - f1 * f1 / m, aa - a1 * a1 / m, fa - f1 * a1 / m);
    if n < 10.0 || variance <= 0.0 || contrast <= 0.0 || covariance <= 0.0 {
        return 0.0;
    }
    -n / values.len() as f64 * (1.0 - covariance * covariance / (variance * contrast)).max(1e-4).ln()
}

/// Points that score every shift; those that do best are scored by all points.
const SCOUTS: usize = 500;
/// Shifts that are scored by all points.
const FINALISTS: usize = 1000;

/// Best shifts of the exhaustive search with their evidence, best first.
fn search(samples: &Samples, fraction: &Volume<f32>) -> Vec<(f64, Vector3<f64>)> {
    let grid = fraction.grid();
    let indices: Vec<Vector3<f64>> = samples.points.iter().map(|p| grid.index(p)).collect();
    let every = (indices.len() / SCOUTS).max(1);
    let thinned = |n: usize| n.is_multiple_of(every);
    let scouts: Vec<Vector3<f64>> = (0..indices.len()).filter(|&n| thinned(n)).map(|n| indices[n]).collect();
    let seen: Vec<f64> = (0..indices.len()).filter(|&n| thinned(n)).map(|n| samples.values[n]).collect();
    let score = |points: &[Vector3<f64>], values: &[f64], shift: &Vector3<f64>| {
        vectorised(
            #[inline(always)]
            || evidence(points, values, fraction, &(grid.inverse_step() * shift)),
        )
    };
    let (low, count) = shift_range(&samples.points, fraction);
    let mut scored: Vec<(f64, Vector3<f64>)> = (0..count[0] * count[1] * count[2])
        .into_par_iter()
        .map(|n| {
            let at = [n % count[0], n / count[0] % count[1], n / count[0] / count[1]];
            let shift = Vector3::from(low) + Vector3::from(at.map(|c| c as f64)) * STEP_MM;
            (score(&scouts, &seen, &shift), shift)
        })
        .filter(|(share, _)| *share > 0.0)
        .collect();
    scored.sort_by(|a, b| b.0.total_cmp(&a.0));
    scored.truncate(FINALISTS);
    scored.par_iter_mut().for_each(|(share, shift)| *share = score(&indices, &samples.values, shift));
    scored.sort_by(|a, b| b.0.total_cmp(&a.0));
    let mut best: Vec<(f64, Vector3<f64>)> = Vec::new();
    for s in scored {
        if best.iter().all(|b| (b.1 - s.1).norm() > APART_MM) {
            best.push(s);
            if best.len() == CANDIDATES {
                break;
            }
        }
    }
    best
}

/// Rotations (degrees about x, y, z) that each candidate is refined from.
const TURNS: [[f64; 3]; 5] =
    [[0.0, 0.0, 0.0], [15.0, 0.0, 0.0], [-15.0, 0.0, 0.0], [0.0, 0.0, 20.0], [0.0, 0.0, -20.0]];

/// Rigid motion of all bones together that best explains the fraction image.
///
/// `samples` and `fraction` are blurred alike. Returns the motion and its explained share.
///
/// # Errors
/// [`Error::Registration`] when no shift explains the bones: images without common anatomy.
pub fn common_motion(samples: &Samples, fraction: &Tissue, measure: Measure) -> Result<(Rigid, f64)> {
    let candidates = search(samples, &fraction.value);
    let n = samples.points.len().max(1) as f64;
    let centre = Point3::from(samples.points.iter().map(|p| p.coords).sum::<Vector3<f64>>() / n);
    let radius = (samples.points.iter().map(|p| (p - centre).norm_squared()).sum::<f64>() / n).sqrt().max(1.0);
    let mut best: Option<(f64, f64, Rigid)> = None;
    for (rank, (_, shift)) in candidates.iter().enumerate() {
        // Turned starts only for the leading candidates: a wrong shift does not become right by turning.
        for turn in &TURNS[..if rank < 3 { TURNS.len() } else { 1 }] {
            let q = UnitQuaternion::from_scaled_axis(Vector3::from(turn.map(f64::to_radians)));
            let base = Rigid::from_parts(Translation3::from(centre.coords + shift - q * centre.coords), q);
            let problem = || PoseProblem {
                bodies: vec![Body { samples, base, centre, radius }],
                links: Vec::new(),
                fraction: Some(fraction),
                measure,
            };
            let solution = solve(problem(), 0.05, 40)?;
            let t = problem().transforms(&solution.x)[0];
            let share = problem().similarities(&[t], false)[0].explained;
            if best.as_ref().is_none_or(|b| solution.cost < b.0) {
                best = Some((solution.cost, share, t));
            }
        }
    }
    match best {
        Some((_, share, t)) if share >= LEAST_EXPLAINED => Ok((t, share)),
        found => Err(Error::registration(
            format!(
                "the bones of the planning CT explain only {:.0} % of the fraction CT's bone contrast at the best position found (at least {:.0} % are needed)",
                100.0 * found.map_or(0.0, |f| f.1.max(0.0)),
                100.0 * LEAST_EXPLAINED
            ),
            "check that both CTs show the same patient and a common body region, in HU",
        )),
    }
}
