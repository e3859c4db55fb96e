//! How much memory a registration will need, before it begins.

use crate::chainmail::Carry;
use crate::config::Config;
use crate::geometry::Grid;

/// Bytes per planning voxel where most is held, after the fields: CT 4, labels 2, patient, tissue and where bones touch 3, push
/// field 12 and its mask 1, uncertainty 4, Jacobian, bones' surfaces and what else is kept of the planning side 4. What comes and
/// goes before is less.
const PLANNING: f64 = 30.0;
/// Bytes per fraction voxel then: CT 4, what of it was measured 4, patient 1, pull field 12 and its mask 1, planning CT 4 and labels
/// 2.
const FRACTION: f64 = 28.0;
/// Bytes per element of the chain mail: kind, constraint, displacement, rotation, stiffness and pull.
const ELEMENT: f64 = 170.0;
/// Bytes per element of the chain mail's links at rest: 155 for a soft one.
const RESTING: f64 = 160.0;
/// Bytes of everything else. A small scan that the patient fills takes 0.1 GB more.
const REST: f64 = 200e6;

/// Estimated peak resident memory of a registration, bytes; docs/performance.md has it beside measured peaks.
pub fn memory_estimate(planning: &Grid, fraction: &Grid, config: &Config) -> u64 {
    let elements = planning.coarsened(config.chainmail.spacing_mm).len() as f64;
    let of_waves = planning.coarsened(config.chainmail.spacing_of_waves()).len() as f64;
    let variant = if config.chainmail.variant.carry == Carry::Rigid { 0.0 } else { 60.0 };
    let resting = if config.chainmail.relaxation.is_empty() { 0.0 } else { elements * RESTING };
    let scans = planning.len() as f64 * PLANNING + fraction.len() as f64 * FRACTION;
    (scans + resting + of_waves * (ELEMENT + variant) + REST) as u64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn is_a_little_more_than_what_was_measured() {
        // docs/data/sizes.csv: grids, GB.
        for (size, spacing, measured) in [
            ([335, 190, 64], [1.4, 1.4, 4.2], 0.43),
            ([469, 267, 90], [1.0, 1.0, 3.0], 0.80),
            ([670, 381, 180], [0.7, 0.7, 1.5], 2.74),
            ([945, 537, 256], [0.5, 0.5, 1.05], 7.4),
        ] {
            let grid = Grid::axis_aligned(size, spacing, [0.0; 3]).unwrap();
            let over = memory_estimate(&grid, &grid, &Config::default()) as f64 / (1e9 * measured);
            assert!((1.0..1.35).contains(&over), "{size:?}: {over}");
        }
    }

    #[test]
    fn grows_with_the_scans_and_with_every_voxel_an_element() {
        let grid = |n: usize| Grid::axis_aligned([n, n, n / 2], [1.0, 1.0, 2.0], [0.0; 3]).unwrap();
        let config = Config::default();
        let (small, large) =
            (memory_estimate(&grid(100), &grid(100), &config), memory_estimate(&grid(200), &grid(200), &config));
        let ratio = (large - REST as u64) as f64 / (small - REST as u64) as f64;
        assert!((ratio - 8.0).abs() < 1.0, "{ratio}");
        let mut fine = config;
        fine.chainmail.spacing_mm = 0.0;
        assert!(memory_estimate(&grid(200), &grid(200), &fine) > large);
        let mut waves = Config::default();
        waves.chainmail.variant.waves_mm = 0.0;
        assert!(memory_estimate(&grid(200), &grid(200), &waves) > large);
    }
}
