//! How probable it is that the bones lie where a fit has them, where fits at other places have evidence too.

// Learnt from random views with known truth by tests/peers/levels.py (docs/validation.md, "Random views").
/// Weight of another place with as much evidence as the result, which weighs 1.
const OTHER: f64 = 0.25;
/// How fast that weight falls with the share of the result's evidence that a place lacks.
const SLOPE: f64 = 5.6;
/// Weight of all places that were not fitted: of 171 views with one place alone none was wrong.
const NONE: f64 = 0.006;
/// A result that is less probable is to be looked at.
pub(super) const SURE: f64 = 0.95;

/// Probability of each of the places with these costs, the result first: the less its cost, the more evidence a place has. What is
/// left of 1 belongs to places that were not fitted.
pub(super) fn probabilities(costs: &[f64]) -> Vec<f64> {
    let Some(&best) = costs.first() else { return Vec::new() };
    let lacks = |cost: f64| if best < 0.0 { 1.0 - cost / best } else { 1.0 };
    let weight = |(n, cost): (usize, &f64)| if n == 0 { 1.0 } else { OTHER * (-SLOPE * lacks(*cost)).exp() };
    let weights: Vec<f64> = costs.iter().enumerate().map(weight).collect();
    let all = NONE + weights.iter().sum::<f64>();
    weights.into_iter().map(|w| w / all).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn more_evidence_is_more_probable_and_all_add_up() {
        let all = probabilities(&[-100.0, -95.0, -60.0, 10.0]);
        assert!(all.windows(2).all(|w| w[0] > w[1]) && all.iter().all(|p| (0.0..1.0).contains(p)), "{all:?}");
        let sum: f64 = all.iter().sum();
        assert!(sum < 1.0 && sum > 0.95, "{sum}");
        // The scale of the evidence does not matter.
        let scaled = probabilities(&[-1e4, -9.5e3, -6e3, 1e3]);
        assert!(all.iter().zip(&scaled).all(|(a, b)| (a - b).abs() < 1e-12));
        assert!(probabilities(&[-1.0])[0] > probabilities(&[-1.0, -0.5])[0]);
        assert!(probabilities(&[]).is_empty());
        // Without evidence nothing is preferred by it.
        assert!(probabilities(&[0.0, 0.0]).iter().all(|p| p.is_finite()));
    }
}
