//! How much memory a registration will need, before it begins.

use crate::chainmail::Carry;
use crate::config::Config;
use crate::geometry::Grid;

/// Bytes per planning voxel where most is held: CT 4, labels 2, patient and where bones touch 2, push field 12 and its mask 1; of the
/// patient alone Jacobian and uncertainty. What comes and goes before is less.
const PLANNING: f64 = 24.0;
/// Bytes per fraction voxel then: CT 4, what of it was measured 4 and, when that is gone, planning CT 4, pull field 12 and its mask
/// 1.
const FRACTION: f64 = 22.0;
/// Bytes per planning voxel that stay for further fractions: where bones touch, their surfaces, what elements show.
const KEPT: f64 = 8.0;
/// Bytes per element of the chain mail: kind, constraint, displacement, rotation, stiffness and pull.
const ELEMENT: f64 = 170.0;
/// Bytes per element of the chain mail's links at rest: 155 for a soft one.
const RESTING: f64 = 160.0;
/// Bytes of everything else. A small scan that the patient fills takes 0.1 GB more.
const REST: f64 = 120e6;

/// Estimated peak resident memory of a registration, bytes, alone or of one that `more` fractions follow; docs/performance.md has
/// it beside measured peaks.
pub fn memory_estimate(planning: &Grid, fraction: &Grid, more: bool, config: &Config) -> u64 {
    let elements = planning.coarsened(config.chainmail.spacing_mm).len() as f64;
    let of_waves = planning.coarsened(config.chainmail.spacing_of_waves()).len() as f64;
    let variant = if config.chainmail.variant.carry == Carry::Rigid { 0.0 } else { 60.0 };
    let resting = if config.chainmail.relaxation.is_empty() { 0.0 } else { elements * RESTING };
    let kept = if more { KEPT } else { 0.0 };
    let scans = planning.len() as f64 * (PLANNING + kept) + fraction.len() as f64 * FRACTION;
    (scans + resting + of_waves * (ELEMENT + variant) + REST) as u64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn is_a_little_more_than_what_was_measured() {
        // docs/data/sizes.csv: grids, GB.
        for (size, spacing, measured) in [
            ([335, 190, 64], [1.4, 1.4, 4.2], 0.33),
            ([469, 267, 90], [1.0, 1.0, 3.0], 0.65),
            ([670, 381, 180], [0.7, 0.7, 1.5], 2.17),
            ([945, 537, 256], [0.5, 0.5, 1.05], 5.8),
        ] {
            let grid = Grid::axis_aligned(size, spacing, [0.0; 3]).unwrap();
            let over = memory_estimate(&grid, &grid, false, &Config::default()) as f64 / (1e9 * measured);
            assert!((1.0..1.35).contains(&over), "{size:?}: {over}");
        }
    }

    #[test]
    fn grows_with_the_scans_and_with_every_voxel_an_element() {
        let grid = |n: usize| Grid::axis_aligned([n, n, n / 2], [1.0, 1.0, 2.0], [0.0; 3]).unwrap();
        let estimate = |n: usize, config: &Config| memory_estimate(&grid(n), &grid(n), false, config);
        let config = Config::default();
        let (small, large) = (estimate(100, &config), estimate(200, &config));
        let ratio = (large - REST as u64) as f64 / (small - REST as u64) as f64;
        assert!((ratio - 8.0).abs() < 1.0, "{ratio}");
        assert!(memory_estimate(&grid(200), &grid(200), true, &config) > large);
        let mut fine = config;
        fine.chainmail.spacing_mm = 0.0;
        assert!(estimate(200, &fine) > large);
        let mut waves = Config::default();
        waves.chainmail.variant.waves_mm = 0.0;
        assert!(estimate(200, &waves) > large);
    }
}
