//! Grey values that are not the patient's: shading and streaks.

use super::super::shape::V3;
use super::super::texture::uniform;
use super::options::CbctOptions;
use super::view::CircleSeen;
use std::f64::consts::TAU;

/// Thickness of the slabs that share their streaks, mm.
const SLAB_MM: f64 = 6.0;
/// Streaks of a slab.
const STREAKS: u64 = 8;
/// Width of a streak, mm: standard deviation of its profile.
const STREAK_MM: f64 = 1.5;

/// Two slow waves in seeded oblique directions.
pub(super) struct Shading {
    half_hu: f64,
    waves: [(V3, f64); 2],
}

impl Shading {
    pub(super) fn new(options: &CbctOptions, seed: u64) -> Self {
        let wave = |n: u64| {
            let r = |m: u64| uniform(seed ^ 0x5AAD, 8 * n + m);
            // One mostly across, one mostly along: neither is constant over the scan.
            let tilt = [0.35, 0.9][n as usize % 2];
            let (sin, cos) = (TAU * r(0)).sin_cos();
            let direction = V3::new(cos, sin, tilt).normalize();
            (direction * (TAU / options.shading_mm), TAU * r(1))
        };
        Self { half_hu: 0.5 * options.shading_hu, waves: [wave(0), wave(1)] }
    }

    pub(super) fn at(&self, from_axis: &V3, height: f64) -> f64 {
        let p = V3::new(from_axis.x, from_axis.y, height);
        self.waves.iter().map(|(k, phase)| self.half_hu * (k.dot(&p) + phase).sin()).sum()
    }
}

/// Bright and dark straight lines within slices.
pub(super) struct Streaks {
    hu: f64,
    seed: u64,
    reach: f64,
}

impl Streaks {
    pub(super) fn new(options: &CbctOptions, seed: u64) -> Self {
        let reach = if options.circle_radius_mm > 0.0 { options.circle_radius_mm } else { options.cupping_radius_mm };
        Self { hu: options.streak_hu, seed: seed ^ 0x57EA, reach: 0.6 * reach }
    }

    pub(super) fn at(&self, seen: &CircleSeen) -> f64 {
        if self.hu == 0.0 {
            return 0.0;
        }
        let slab = (seen.height / SLAB_MM).floor() as i64 as u64;
        let one = |n: u64| {
            let r = |m: u64| uniform(self.seed, slab.wrapping_mul(8 * STREAKS).wrapping_add(8 * n + m));
            let (sin, cos) = (TAU * 0.5 * r(0)).sin_cos();
            let d = cos * seen.from_axis.x + sin * seen.from_axis.y - self.reach * r(1);
            self.hu * r(2) * (-0.5 * (d / STREAK_MM).powi(2)).exp()
        };
        (0..STREAKS).map(one).sum()
    }
}
