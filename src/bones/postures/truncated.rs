//! The normal distribution, cut off on both sides.

use statrs::function::erf::{erfc, erfc_inv};
use std::f64::consts::SQRT_2;

/// Share of the standard normal distribution below `x`.
fn below(x: f64) -> f64 {
    0.5 * erfc(-x / SQRT_2)
}

/// The value of a normal distribution about 0, of standard deviation `sd` before it is cut to `[low, high]`, below which
/// the share `u` (0 to 1) of it lies. The limits hold 0 or end at it; `low` where nothing is left between them.
pub(super) fn quantile(u: f64, sd: f64, [low, high]: [f64; 2]) -> f64 {
    if sd <= 0.0 || low >= high {
        return 0f64.clamp(low.min(high), low.max(high));
    }
    let [a, b] = [low, high].map(|edge| below(edge / sd));
    let value = -SQRT_2 * erfc_inv(2.0 * (a + u * (b - a)));
    (sd * value).clamp(low, high)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_are_those_of_tables() {
        let wide = [-60.0, 60.0];
        for (u, z) in [(0.5, 0.0), (0.841_344_746_068_543, 1.0), (0.025, -1.959_963_984_540_054), (0.99, 2.326_347_874)]
        {
            assert!((quantile(u, 2.0, wide) - 2.0 * z).abs() < 1e-8, "{u}");
        }
        // A half of the distribution: the median of its upper side.
        assert!((quantile(0.5, 1.0, [0.0, 60.0]) - 0.674_489_750_196).abs() < 1e-8);
        assert!((quantile(0.0, 1.0, [-2.0, 3.0]) + 2.0).abs() < 1e-9);
        assert!((quantile(1.0, 1.0, [-2.0, 3.0]) - 3.0).abs() < 1e-9);
        assert!(quantile(0.3, 0.0, [-1.0, 1.0]).abs() < f64::EPSILON);
    }
}
