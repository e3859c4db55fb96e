//! Rank 4: how good a field is. Landmark residuals, contours, Jacobian characteristics, folds, curl, consistency, rigidity
//! of bones and image similarity, and one set of rules that judges them; `docs/metrics.md` has the formulas.

pub mod agreement;
mod assess;
mod cell;
mod characteristics;
pub mod consistency;
pub mod contact;
pub mod contour;
pub mod couch;
pub mod curl;
mod interface;
pub mod jacobian;
pub mod landmark;
mod pair;
pub mod regularity;
pub mod rigidity;
mod setup;
pub mod similarity;
mod surface;
pub mod uncertainty;
pub mod verdict;

pub use assess::{Assessment, Maps, Subject, assess};
pub use cell::CellKinds;
pub use pair::{Direction, FieldPair};
pub use setup::MeanShift;
pub use surface::Surface;

use crate::stats::percentile;

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
