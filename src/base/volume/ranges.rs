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

#[cfg(test)]
mod tests {
    use super::*;

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
