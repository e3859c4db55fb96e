//! As [`super::correlate`], for an image of another modality: the correlation ratio of its grey values given ranges of HU, and how
//! alike descriptors are.

use super::super::shape::CHANNELS;
use super::correlate::{LEAST_SHARE, MOST_CORRELATION, Ready, Row};
use super::template::{DESCRIBED, GROUPS, Turned};
use nalgebra::{SMatrix, SVector};

const PAIRS: usize = GROUPS * (GROUPS + 1) / 2;
/// What holds the grey value of a range that a bone hardly has, as a share of all voxels.
const RIDGE: f32 = 1e-3;

/// Least share of descriptors that differ.
const LEAST_APART: f32 = 1e-3;
/// Sums of values: products of memberships, of memberships and the fraction's values, these values and their squares.
const OF_VALUES: usize = PAIRS + GROUPS + 2;

/// Sums of a row of places: of values; then of descriptors: their number, squares of planning's, of the fraction's, products, and
/// products of planning's with the fraction's mean.
pub struct RatioSums([Vec<f32>; OF_VALUES + 5]);

impl Row for RatioSums {
    const STRIDE: usize = 2;
    const TURNS: Option<usize> = Some(4);

    fn new(width: usize) -> Self {
        Self(std::array::from_fn(|_| vec![0.0; width]))
    }

    #[inline(always)]
    fn row(&mut self, turned: &Turned, image: &Ready, margin: i32, [j, k]: [i32; 2]) {
        self.0.iter_mut().for_each(|s| s.fill(0.0));
        let width = self.0[0].len();
        for (offset, m) in turned.offsets.iter().zip(&turned.memberships) {
            let Some((start, low, n)) = image.span(*offset, margin, [j, k], width) else { continue };
            let (seen, value, square) =
                (&image.seen[start..start + n], &image.value[start..start + n], &image.square[start..start + n]);
            let mut q = 0;
            for a in 0..GROUPS {
                for b in a..GROUPS {
                    let product = m[a] * m[b];
                    if product > 0.0 {
                        for (sum, seen) in self.0[q][low..low + n].iter_mut().zip(seen) {
                            *sum += product * seen;
                        }
                    }
                    q += 1;
                }
            }
            for (a, m) in m.iter().enumerate().filter(|(_, m)| **m > 0.0) {
                for (sum, value) in self.0[PAIRS + a][low..low + n].iter_mut().zip(value) {
                    *sum += m * value;
                }
            }
            for (q, values) in [(PAIRS + GROUPS, value), (PAIRS + GROUPS + 1, square)] {
                for (sum, value) in self.0[q][low..low + n].iter_mut().zip(values) {
                    *sum += value;
                }
            }
        }
        self.shapes(turned, image, margin, [j, k]);
    }

    fn evidence(&self, i: usize, voxels: usize) -> f32 {
        let at = |q: usize| self.0[q][i];
        let mut own = SMatrix::<f32, GROUPS, GROUPS>::zeros();
        let mut q = 0;
        for a in 0..GROUPS {
            for b in a..GROUPS {
                (own[(a, b)], own[(b, a)]) = (at(q), at(q));
                q += 1;
            }
        }
        // Memberships add up to one.
        let weight: SVector<f32, GROUPS> = own.column_sum();
        let n = weight.sum();
        let share = n / voxels.max(1) as f32;
        if share < LEAST_SHARE {
            return 0.0;
        }
        let (sum, square) = (at(PAIRS + GROUPS), at(PAIRS + GROUPS + 1));
        let mean = sum / n;
        let total = square - sum * mean;
        if total <= 1e-4 * n {
            return 0.0;
        }
        let both = SVector::<f32, GROUPS>::from_fn(|a, _| at(PAIRS + a)) - weight * mean;
        own += SMatrix::<f32, GROUPS, GROUPS>::identity() * (RIDGE * n);
        let Some(grey) = own.cholesky().map(|c| c.solve(&both)) else { return 0.0 };
        let alike = self.alike(i, voxels);
        alike - share * (1.0 - (both.dot(&grey) / total).clamp(0.0, MOST_CORRELATION)).ln()
    }
}

impl RatioSums {
    /// Sums of descriptors.
    #[inline(always)]
    fn shapes(&mut self, turned: &Turned, image: &Ready, margin: i32, at: [i32; 2]) {
        let Some(shape) = &image.shape else { return };
        let width = self.0[0].len();
        for (offset, planning) in turned.offsets.iter().zip(&turned.descriptors) {
            let Some(planning) = planning else { continue };
            let Some((start, low, n)) = image.span(*offset, margin, at, width) else { continue };
            let square: f32 = planning.iter().map(|p| p * p).sum();
            let with_mean: f32 = planning.iter().zip(&shape.mean).map(|(p, m)| p * m).sum();
            let is = &shape.is[start..start + n];
            for (q, factor) in [(0, 1.0), (1, square), (4, with_mean)] {
                for (sum, is) in self.0[OF_VALUES + q][low..low + n].iter_mut().zip(is) {
                    *sum += factor * is;
                }
            }
            for (sum, square) in self.0[OF_VALUES + 2][low..low + n].iter_mut().zip(&shape.square[start..start + n]) {
                *sum += square;
            }
            for c in 0..CHANNELS {
                let values = &shape.channels[c][start..start + n];
                for (sum, value) in self.0[OF_VALUES + 3][low..low + n].iter_mut().zip(values) {
                    *sum += planning[c] * value;
                }
            }
        }
    }

    /// Evidence of the descriptors for the i-th place.
    fn alike(&self, i: usize, voxels: usize) -> f32 {
        let [n, planning, fraction, both, mean] = std::array::from_fn(|q| self.0[OF_VALUES + q][i]);
        let share = (n * DESCRIBED as f32 / voxels.max(1) as f32).min(1.0);
        let unrelated = planning + fraction - 2.0 * mean;
        if share < LEAST_SHARE || unrelated <= 1e-4 * n {
            return 0.0;
        }
        -share * ((planning + fraction - 2.0 * both) / unrelated).clamp(LEAST_APART, 1.0).ln()
    }
}
