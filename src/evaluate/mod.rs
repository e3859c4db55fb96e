//! Rank 4: how good a field is. Landmark residuals, contours, Jacobian characteristics, folds, curl, consistency, rigidity
//! of bones and image similarity, each beside its tolerance; `docs/metrics.md` has the formulas.

mod assess;
pub mod consistency;
pub mod contact;
pub mod contour;
pub mod curl;
mod interface;
pub mod jacobian;
pub mod landmark;
mod pair;
pub mod regularity;
pub mod rigidity;
pub mod similarity;
mod surface;
pub mod tolerance;
pub mod uncertainty;

pub use assess::{Assessment, Subject, assess};
pub use pair::{Direction, FieldPair};
pub use surface::Surface;

use crate::stats::{Summary, percentile};
use rayon::prelude::*;

/// Summary of many single-precision values.
fn summary(mut values: Vec<f32>) -> Summary {
    let n = values.len();
    if n == 0 {
        return Summary::default();
    }
    values.par_sort_unstable_by(f32::total_cmp);
    let mean = values.iter().map(|v| f64::from(*v)).sum::<f64>() / n as f64;
    let var = values.iter().map(|v| (f64::from(*v) - mean).powi(2)).sum::<f64>() / (n.max(2) - 1) as f64;
    let rank = |p: f64| {
        let at = p / 100.0 * (n - 1) as f64;
        let ends = [values[at.floor() as usize], values[at.ceil() as usize]].map(f64::from);
        ends[0] + (ends[1] - ends[0]) * at.fract()
    };
    Summary { n, mean, std: var.sqrt(), median: rank(50.0), p95: rank(95.0), min: rank(0.0), max: rank(100.0) }
}

/// The `p`-th percentile of weighted values: the least value at which the weight up to it reaches the share.
fn weighted_percentile(sorted: &[(f64, f64)], p: f64) -> f64 {
    let total: f64 = sorted.iter().map(|v| v.1).sum();
    let mut sum = 0.0;
    for (value, weight) in sorted {
        sum += weight;
        if sum >= total * p / 100.0 {
            return *value;
        }
    }
    percentile(&sorted.iter().map(|v| v.0).collect::<Vec<_>>(), 100.0)
}
