//! As [`super::correlate`], for an image of another modality: the correlation ratio of its grey values given ranges of HU.

use super::correlate::{LEAST_SHARE, MOST_CORRELATION, Ready, Row};
use super::template::Turned;
use nalgebra::{SMatrix, SVector};

/// Ranges of HU that the search tells apart: fat, soft tissue, marrow, cortical bone.
pub const GROUPS: usize = 4;
const PAIRS: usize = GROUPS * (GROUPS + 1) / 2;
/// What holds the grey value of a range that a bone hardly has, as a share of all voxels.
const RIDGE: f32 = 1e-3;

/// Sums of a row of places: products of memberships, of memberships and the fraction's values, these values and their squares.
pub struct RatioSums([Vec<f32>; PAIRS + GROUPS + 2]);

impl Row for RatioSums {
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
        -share * (1.0 - (both.dot(&grey) / total).clamp(0.0, MOST_CORRELATION)).ln()
    }
}
