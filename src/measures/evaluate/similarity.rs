//! How alike two CTs look inside a mask, before and after mapping.

use super::pair::{displacement, inner, nearest};
use crate::volume::{Mask, Volume, trilinear};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// Bins of the joint histogram along each axis, and what they cover, HU.
const BINS: usize = 64;
const RANGE: [f64; 2] = [-1024.0, 2048.0];

/// Similarity of two images over the same voxels.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct Similarity {
    /// Voxels compared.
    pub voxels: usize,
    /// Normalised cross-correlation (Pearson), -1 to 1.
    pub ncc: f64,
    /// Mean squared difference, HU^2.
    pub mse: f64,
    /// Root of it, HU.
    pub rms_hu: f64,
    /// Mean absolute difference, HU.
    pub mae_hu: f64,
    /// Normalised mutual information (H(A) + H(B)) / H(A, B) (Studholme 1999), 1 (none) to 2; 64 bins of 48 HU.
    pub nmi: f64,
}

/// Before and after, over the same fraction voxels.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct SimilarityReport {
    /// Planning as scanned, over the voxels it covers.
    pub before: Similarity,
    /// Planning mapped by the field.
    pub after: Similarity,
}

/// Compares `planning`, mapped by `pull`, with `fraction` at the fraction voxels whose pre-image lies in `mask` (planning grid).
pub fn evaluate(
    pull: &Volume<[f32; 3]>,
    planning: &Volume<f32>,
    fraction: &Volume<f32>,
    mask: &Mask,
) -> SimilarityReport {
    let grid = fraction.grid();
    let plane = grid.strides()[2];
    let sums: Vec<[SimilaritySums; 2]> = (0..grid.size()[2])
        .into_par_iter()
        .map(|k| {
            let mut sums = [SimilaritySums::default(), SimilaritySums::default()];
            for l in k * plane..(k + 1) * plane {
                let y = grid.centre(grid.voxel(l));
                let Some(x) = displacement(pull, &y).map(|v| y + v).filter(|x| nearest(mask, x)) else { continue };
                let b = f64::from(fraction.data()[l]);
                for (sums, at) in sums.iter_mut().zip([y, x]) {
                    if let Some(a) = trilinear(planning, &inner(planning.grid(), &at)) {
                        sums.add(a, b);
                    }
                }
            }
            sums
        })
        .collect();
    let mut all = [SimilaritySums::default(), SimilaritySums::default()];
    for plane in &sums {
        all.iter_mut().zip(plane).for_each(|(a, p)| a.join(p));
    }
    SimilarityReport { before: all[0].result(), after: all[1].result() }
}

/// SimilaritySums over voxel pairs.
#[derive(Clone)]
struct SimilaritySums {
    n: usize,
    /// a, b, aa, bb, ab, (a - b)^2, |a - b|.
    of: [f64; 7],
    joint: Vec<u32>,
}

impl Default for SimilaritySums {
    fn default() -> Self {
        Self { n: 0, of: [0.0; 7], joint: vec![0; BINS * BINS] }
    }
}

impl SimilaritySums {
    fn add(&mut self, a: f64, b: f64) {
        self.n += 1;
        let d = a - b;
        for (sum, v) in self.of.iter_mut().zip([a, b, a * a, b * b, a * b, d * d, d.abs()]) {
            *sum += v;
        }
        let bin = |v: f64| (((v - RANGE[0]) / (RANGE[1] - RANGE[0]) * BINS as f64) as usize).min(BINS - 1);
        self.joint[bin(a) + BINS * bin(b)] += 1;
    }

    fn join(&mut self, other: &Self) {
        self.n += other.n;
        self.of.iter_mut().zip(other.of).for_each(|(a, b)| *a += b);
        self.joint.iter_mut().zip(&other.joint).for_each(|(a, b)| *a += b);
    }

    fn result(&self) -> Similarity {
        if self.n == 0 {
            return Similarity::default();
        }
        let n = self.n as f64;
        let [a, b, aa, bb, ab, dd, abs] = self.of.map(|s| s / n);
        let spread = ((aa - a * a) * (bb - b * b)).max(0.0).sqrt();
        let ncc = if spread > 0.0 { (ab - a * b) / spread } else { 0.0 };
        let entropy = |counts: &mut dyn Iterator<Item = u32>| -> f64 {
            counts.filter(|c| *c > 0).map(|c| -f64::from(c) / n * (f64::from(c) / n).ln()).sum()
        };
        let of_a = entropy(&mut (0..BINS).map(|i| (0..BINS).map(|j| self.joint[i + BINS * j]).sum()));
        let of_b = entropy(&mut self.joint.chunks(BINS).map(|row| row.iter().sum()));
        let of_both = entropy(&mut self.joint.iter().copied());
        let nmi = if of_both > 0.0 { (of_a + of_b) / of_both } else { 0.0 };
        Similarity { voxels: self.n, ncc, mse: dd, rms_hu: dd.sqrt(), mae_hu: abs, nmi }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Grid;

    #[test]
    fn figures_by_hand() {
        let grid = Grid::axis_aligned([20, 10, 8], [1.0; 3], [0.0; 3]).unwrap();
        let planning = Volume::from_fn(grid.clone(), |l| 100.0 * (grid.voxel(l)[0] as f32) - 900.0);
        // The fraction is the planning CT moved by 2 voxels along x, and 10 HU brighter.
        let fraction = Volume::from_fn(grid.clone(), |l| 100.0 * (grid.voxel(l)[0] as f32 - 2.0) - 890.0);
        let pull = Volume::filled(grid.clone(), [-2.0f32, 0.0, 0.0]);
        let r = evaluate(&pull, &planning, &fraction, &Volume::filled(grid.clone(), true));
        assert_eq!(r.after.voxels, 18 * 80);
        assert!(
            (r.after.mse - 100.0).abs() < 1e-6
                && (r.after.rms_hu - 10.0).abs() < 1e-6
                && (r.after.mae_hu - 10.0).abs() < 1e-6
        );
        assert!((r.after.ncc - 1.0).abs() < 1e-9);
        assert!((r.before.mae_hu - 190.0).abs() < 1e-3, "{r:?}");
        // One value of b for each of a: complete information.
        assert!((r.after.nmi - 2.0).abs() < 1e-9, "{r:?}");
        let flat = evaluate(&pull, &planning, &Volume::filled(grid.clone(), 5.0), &Volume::filled(grid, true));
        assert!(flat.after.ncc.abs() < 1e-12 && (flat.after.nmi - 1.0).abs() < 1e-9);
    }
}
