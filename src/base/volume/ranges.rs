//! Ranges of HU that another modality tells apart, and how much of a value belongs to each.
//!
//! The grey value of a tissue in an MR has no relation to its HU but that the same tissue looks alike. A function of HU that is
//! linear between a few knots says that: its values at the knots are the grey values.

/// Number of ranges.
pub const RANGES: usize = 6;
/// HU at which a range alone counts: fat, water, muscle, marrow, thin and thick cortical bone.
const KNOTS: [f32; RANGES] = [FAT_HU, -10.0, 60.0, 250.0, 600.0, 1100.0];
/// Fat, HU: what is less dense is partly air.
pub const FAT_HU: f32 = -110.0;

/// Membership of a value (HU) in each range; they add up to 1.
pub fn memberships(hu: f32) -> [f32; RANGES] {
    let mut out = [0.0; RANGES];
    match KNOTS.iter().position(|knot| hu < *knot) {
        Some(0) => out[0] = 1.0,
        None => out[RANGES - 1] = 1.0,
        Some(n) => {
            let share = (hu - KNOTS[n - 1]) / (KNOTS[n] - KNOTS[n - 1]);
            (out[n - 1], out[n]) = (1.0 - share, share);
        }
    }
    out
}

/// The same of one range.
pub fn membership(hu: f32, range: usize) -> f32 {
    let share = |n: usize| (hu - KNOTS[n - 1]) / (KNOTS[n] - KNOTS[n - 1]);
    let below = if range == 0 { hu < KNOTS[0] } else { hu < KNOTS[range] && hu >= KNOTS[range - 1] };
    if below {
        return if range == 0 { 1.0 } else { share(range) };
    }
    match KNOTS.get(range + 1) {
        Some(next) if hu >= KNOTS[range] && hu < *next => 1.0 - share(range + 1),
        // As of all of them, no number counts as the densest.
        None if hu >= KNOTS[range] || hu.is_nan() => 1.0,
        _ => 0.0,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_membership_is_that_of_all() {
        let on_knots = KNOTS.iter().flat_map(|k| [k - 1e-3, *k, k + 1e-3]);
        for hu in (-400..1400).map(|n| n as f32 * 1.37).chain(on_knots).chain([f32::NAN, f32::INFINITY]) {
            let all = memberships(hu);
            (0..RANGES).for_each(|k| assert_eq!(membership(hu, k).to_bits(), all[k].to_bits(), "{hu} {k}"));
        }
    }

    #[test]
    fn memberships_add_up_to_one_and_interpolate_between_the_knots() {
        for hu in [-2000.0, -110.0, -60.0, 0.0, 40.0, 155.0, 800.0, 1100.0, 3000.0f32] {
            let found = memberships(hu);
            assert!(
                (found.iter().sum::<f32>() - 1.0).abs() < 1e-6 && found.iter().all(|m| *m >= 0.0),
                "{hu}: {found:?}"
            );
            let back: f32 = found.iter().zip(KNOTS).map(|(m, knot)| m * knot).sum();
            assert!((back - hu.clamp(FAT_HU, KNOTS[RANGES - 1])).abs() < 1e-3, "{hu}: {back}");
        }
    }
}
