//! Inner structure of tissues: smooth deterministic functions of position, and seeded voxel noise.

use super::shape::V3;

/// 0 below `low`, 1 above `high`, smooth between.
pub(super) fn smoothstep(low: f64, high: f64, x: f64) -> f64 {
    let t = ((x - low) / (high - low)).clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}

/// Smooth waves of about `wavelength` mm in three oblique directions; between -1 and 1, mean near 0.
fn waves(p: &V3, wavelength: f64) -> f64 {
    let k = std::f64::consts::TAU / wavelength;
    let a = (k * (0.81 * p.x + 0.33 * p.y - 0.48 * p.z) + 0.4).sin();
    let b = (k * (-0.37 * p.x + 0.88 * p.y + 0.29 * p.z) + 1.9).sin();
    let c = (k * (0.42 * p.x - 0.27 * p.y + 0.86 * p.z) + 3.1).sin();
    (a + b + c + a * b - b * c) * 0.25
}

/// Marrow: trabecular coarseness.
pub(super) fn trabecular(p: &V3) -> f64 {
    0.6 * waves(p, 7.3) + 0.4 * waves(p, 17.0)
}

/// Muscle: strands along the body.
pub(super) fn fibres(p: &V3) -> f64 {
    let long = V3::new(p.x, p.y, 0.35 * p.z);
    0.5 * waves(&long, 6.1) + 0.5 * waves(p, 23.0)
}

/// Fat in HU: thin septa in it.
pub(super) fn fat(p: &V3) -> f64 {
    let septa = 1.0 - waves(p, 15.0).abs();
    -104.0 + 12.0 * waves(p, 31.0) + 38.0 * smoothstep(0.9, 1.0, septa)
}

/// Glandular tissue.
pub(super) fn lobules(p: &V3) -> f64 {
    0.6 * waves(p, 6.7) + 0.4 * waves(p, 13.0)
}

/// Lung in HU: vessels where two wave sheets cross.
pub(super) fn lung(p: &V3) -> f64 {
    -845.0 + 25.0 * waves(p, 60.0) + 0.25 * (p.y - 20.0) + 620.0 * lung_vessel(p, 1.0)
}

/// Share of a vessel at a point of the lung, 0 to 1; `width` 1 makes them 2 mm wide.
pub(super) fn lung_vessel(p: &V3, width: f64) -> f64 {
    let (a, b) = (waves(p, 26.0), waves(&V3::new(p.y, p.z, p.x), 33.0));
    smoothstep(0.10 * width, 0.03 * width, a.hypot(b))
}

/// Brain in HU: folds in the outer 16 mm, grey rim, white core.
pub(super) fn brain(p: &V3, depth: f64) -> f64 {
    let near = 1.0 - smoothstep(8.0, 17.0, depth);
    let fold = smoothstep(0.14, 0.02, waves(p, 27.0).abs()) * near;
    let grey = 1.0 - smoothstep(3.0, 6.0, depth);
    31.0 + 6.0 * grey + 2.5 * waves(p, 19.0) - 24.0 * fold
}

/// HU as a scanner stores them: whole numbers from -1024 up.
pub(super) fn stored(hu: f64) -> f32 {
    hu.round().max(-1024.0) as f32
}

/// Normally distributed noise of unit variance for a voxel, from a hash of seed and position in storage.
pub(super) fn voxel_noise(seed: u64, voxel: usize) -> f64 {
    let bits = splitmix(seed ^ splitmix(voxel as u64));
    let sum: u64 = (0..4).map(|n| (bits >> (16 * n)) & 0xffff).sum();
    // Sum of four uniform 16-bit numbers: variance 4 (2^32 - 1) / 12.
    (sum as f64 - 2.0 * 65535.0) / (4.0f64 * (65536.0 * 65536.0 - 1.0) / 12.0).sqrt()
}

/// One uniform number in [-1, 1) of a seeded sequence.
pub(super) fn uniform(seed: u64, n: u64) -> f64 {
    let bits = splitmix(seed.wrapping_add(splitmix(n)));
    (bits >> 11) as f64 / (1u64 << 52) as f64 - 1.0
}

/// Steele, Lea and Flood (2014), "Fast splittable pseudorandom number generators": the output function.
fn splitmix(seed: u64) -> u64 {
    let mut z = seed.wrapping_add(0x9e37_79b9_7f4a_7c15);
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn noise_is_white_and_of_unit_variance() {
        let n = 200_000;
        let values: Vec<f64> = (0..n).map(|v| voxel_noise(7, v)).collect();
        let mean = values.iter().sum::<f64>() / n as f64;
        let variance = values.iter().map(|v| v * v).sum::<f64>() / n as f64;
        let lag: f64 = values.windows(2).map(|w| w[0] * w[1]).sum::<f64>() / n as f64;
        assert!(mean.abs() < 0.01 && (variance - 1.0).abs() < 0.02 && lag.abs() < 0.01);
        assert!((voxel_noise(7, 5) - voxel_noise(8, 5)).abs() > 1e-6);
        let u: Vec<f64> = (0..n as u64).map(|v| uniform(3, v)).collect();
        assert!(u.iter().all(|v| (-1.0..1.0).contains(v)) && (u.iter().sum::<f64>() / n as f64).abs() < 0.01);
    }

    #[test]
    fn textures_stay_in_range() {
        for n in 0..20_000 {
            let p = V3::new(f64::from(n % 97), f64::from(n % 89), f64::from(n % 83)) * 1.7;
            assert!(waves(&p, 9.0).abs() <= 1.25 && (-1000.0..-150.0).contains(&lung(&p)));
            assert!((-130.0..-40.0).contains(&fat(&p)) && (0.0..50.0).contains(&brain(&p, 5.0)));
        }
    }
}
