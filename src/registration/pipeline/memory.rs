//! How much memory a registration will need, before it begins.

use crate::chainmail::Carry;
use crate::config::{Config, SoftTissue};
use crate::geometry::Grid;

/// Bytes per planning voxel of what is there in the end: CT 4, labels 2, patient 1, push field 12 and its mask 1,
/// Jacobian 4, bones and chain mail at rest 4, planning side of the uncertainty 2.
const PLANNING: f64 = 30.0;
/// Bytes per fraction voxel of what is there in the end: CT 4, pull field 12 and its mask 1, planning CT 4 and labels 2.
const FRACTION: f64 = 23.0;
/// Bytes per planning voxel that come and go in the greediest stage, evaluation or fit.
const PASSING: f64 = 18.0;
/// Bytes per element of the chain mail: kind, constraint, displacement, rotation, stiffness and pull.
const ELEMENT: f64 = 170.0;
/// Bytes per element of the chain mail's links at rest: 155 for a soft one, which half of them are.
const RESTING: f64 = 80.0;
/// Bytes of everything else.
const REST: f64 = 60e6;

/// Estimated peak resident memory of a registration, bytes; docs/performance.md has it beside measured peaks.
pub fn memory_estimate(planning: &Grid, fraction: &Grid, config: &Config) -> u64 {
    let elements = planning.coarsened(config.chainmail.spacing_mm).len() as f64;
    let of_waves = planning.coarsened(config.chainmail.spacing_of_waves()).len() as f64;
    let r = &config.refine;
    let pulling = [r.weight, r.skin.weight].into_iter().filter(|w| *w > 0.0).count();
    let images = if config.soft_tissue == SoftTissue::ChainMail { 4.0 * pulling as f64 } else { 0.0 };
    let variant = if config.chainmail.variant.carry == Carry::Rigid { 0.0 } else { 60.0 };
    let kept = planning.len() as f64 * (PLANNING + images) + fraction.len() as f64 * (FRACTION + images);
    let resting = if config.chainmail.relaxation.is_empty() { 0.0 } else { elements * RESTING };
    let passing = planning.len() as f64 * PASSING;
    (kept + resting + passing.max(of_waves * (ELEMENT + variant)) + REST) as u64
}

#[cfg(test)]
mod tests {
    use super::*;

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
