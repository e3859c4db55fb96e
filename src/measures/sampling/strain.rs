//! How much a registration deforms soft tissue: where it does so more than most, the map of uncertainty is too small.

use crate::volume::{Volume, gaussian};
use serde::{Deserialize, Serialize};

/// The change of volume is averaged over this, mm (sigma).
const AVERAGE_MM: f64 = 3.0;
/// The factor at most.
/// Chosen on the cases of docs/decisions/samples.md that had no part in choosing the scale.
const MOST: f64 = 2.0;
/// Volumes are counted within these, relative: what folds tells no more.
const COUNTED: [f32; 2] = [0.05, 20.0];
/// Every so many voxels of soft tissue count.
const STRIDE: usize = 7;

/// How much soft tissue is deformed, and what follows for samples.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Strain {
    /// Median over soft tissue of the magnitude of the logarithm of its volume, relative to planning.
    pub median_log_volume: f64,
    /// Samples deviate so many times as far as the map says by itself, 1 to 2.
    pub factor: f64,
}

impl Default for Strain {
    fn default() -> Self {
        Self { median_log_volume: 0.0, factor: 1.0 }
    }
}

impl Strain {
    /// Registrations of a CT with its planning CT that deform tissue by this or less err as their map says; beyond it errors grow in
    /// proportion (docs/decisions/samples.md).
    pub const USUAL_CT: f64 = 0.03;
    /// The same of a fraction with other grey values, which moves tissue less: a cone-beam CT, an MR.
    pub const USUAL_OTHER: f64 = 0.017;

    /// Of a field's Jacobian over voxels that are `soft`, which are known soft tissue; `usual` is the strain up to which nothing
    /// follows.
    pub fn of(jacobian: &Volume<f32>, usual: f64, soft: impl Fn(usize) -> bool) -> Self {
        let [least, most] = COUNTED;
        let change = jacobian.map(|j| j.clamp(least, most).ln().abs());
        let change = gaussian(&change, AVERAGE_MM);
        let counted = change.data().iter().enumerate().filter(|(l, _)| soft(*l)).step_by(STRIDE);
        let mut all: Vec<f32> = counted.map(|(_, v)| *v).filter(|v| v.is_finite()).collect();
        if all.is_empty() {
            return Self::default();
        }
        let half = all.len() / 2;
        let median = f64::from(*all.select_nth_unstable_by(half, f32::total_cmp).1);
        Self { median_log_volume: median, factor: (median / usual).clamp(1.0, MOST) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Grid;

    #[test]
    fn what_is_deformed_more_is_known_less() {
        let grid = Grid::axis_aligned([20, 20, 20], [2.0; 3], [0.0; 3]).unwrap();
        let of = |ratio: f32| Strain::of(&Volume::filled(grid.clone(), ratio), 0.03, |l| l % 3 == 0);
        for (ratio, factor) in [(1.0, 1.0), (1.02, 1.0), (1.0 / 1.06, 1.942), (1.2, 2.0), (-3.0, 2.0)] {
            let found = of(ratio);
            assert!((found.factor - factor).abs() < 0.01, "{ratio}: {found:?}");
        }
        assert_eq!(Strain::of(&Volume::filled(grid.clone(), 2.0), 0.03, |_| false), Strain::default());
        // A border of air does not count.
        let half = Volume::from_fn(grid.clone(), |l| if grid.voxel(l)[0] < 14 { 1.01 } else { 3.0 });
        assert!(Strain::of(&half, 0.03, |l| grid.voxel(l)[0] < 7).factor < 1.001);
    }
}
