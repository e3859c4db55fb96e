//! Summaries of a slice: mean, percentiles, extremes.

use serde::{Deserialize, Serialize};
use std::cmp::Ordering;

/// Summary of a sample. Percentiles interpolate linearly between order statistics (type 7, as NumPy).
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct Summary {
    /// Number of values.
    pub n: usize,
    /// Arithmetic mean; 0 for an empty sample.
    pub mean: f64,
    /// Sample standard deviation (n - 1); 0 below two values.
    pub std: f64,
    /// Median.
    pub median: f64,
    /// 95th percentile.
    pub p95: f64,
    /// Smallest value.
    pub min: f64,
    /// Largest value.
    pub max: f64,
}

impl Summary {
    /// Summary of `values`, which need not be sorted and must be finite.
    pub fn of(values: &[f64]) -> Self {
        if values.is_empty() {
            return Self::default();
        }
        Self::by_selection(&mut values.to_vec(), f64::total_cmp)
    }

    /// Summary of single-precision `values`, which need not be sorted and must be finite.
    pub fn of_singles(mut values: Vec<f32>) -> Self {
        if values.is_empty() {
            return Self::default();
        }
        Self::by_selection(&mut values, f32::total_cmp)
    }

    /// Sums in the order of the values, then percentiles by selection: sorting millions of values would take longer than all
    /// else.
    fn by_selection<T: Copy + Into<f64>>(values: &mut [T], compare: fn(&T, &T) -> Ordering) -> Self {
        let n = values.len();
        let mean = values.iter().map(|&v| v.into()).sum::<f64>() / n as f64;
        let var = values.iter().map(|&v| (v.into() - mean).powi(2)).sum::<f64>() / (n.max(2) - 1) as f64;
        let mut rank = |p: f64| -> f64 {
            let at = p / 100.0 * (n - 1) as f64;
            let (_, low, above) = values.select_nth_unstable_by(at.floor() as usize, compare);
            let low: f64 = (*low).into();
            let next = above.iter().copied().min_by(compare).map_or(low, Into::into);
            low + (next - low) * at.fract()
        };
        Self { n, mean, std: var.sqrt(), median: rank(50.0), p95: rank(95.0), min: rank(0.0), max: rank(100.0) }
    }
}

/// The `p`-th percentile (0 to 100) of an ascending slice; 0 for an empty one.
pub fn percentile(sorted: &[f64], p: f64) -> f64 {
    let Some(last) = sorted.len().checked_sub(1) else { return 0.0 };
    let at = (p / 100.0).clamp(0.0, 1.0) * last as f64;
    let lo = at.floor() as usize;
    let hi = at.ceil() as usize;
    sorted[lo] + (sorted[hi] - sorted[lo]) * (at - lo as f64)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn summary_matches_hand_values() {
        let s = Summary::of(&[4.0, 1.0, 3.0, 2.0]);
        assert_eq!((s.n, s.mean, s.median, s.min, s.max), (4, 2.5, 2.5, 1.0, 4.0));
        assert!((s.std - (5.0f64 / 3.0).sqrt()).abs() < 1e-12);
        assert!((s.p95 - 3.85).abs() < 1e-12);
        assert_eq!(Summary::of(&[]), Summary::default());
        assert_eq!(
            Summary::of(&[7.0]),
            Summary { n: 1, mean: 7.0, std: 0.0, median: 7.0, p95: 7.0, min: 7.0, max: 7.0 }
        );
        assert_eq!(Summary::of_singles(vec![4.0, 1.0, 3.0, 2.0]), s);
        assert_eq!(Summary::of_singles(Vec::new()), Summary::default());
    }

    #[test]
    fn selection_finds_what_sorting_finds() {
        let values: Vec<f64> = (0..997u64).map(|n| ((n * 7919) % 613) as f64 - 300.5).collect();
        let mut sorted = values.clone();
        sorted.sort_by(f64::total_cmp);
        let s = Summary::of(&values);
        for (got, p) in [(s.min, 0.0), (s.median, 50.0), (s.p95, 95.0), (s.max, 100.0)] {
            assert!((got - percentile(&sorted, p)).abs() < 1e-12, "{p}");
        }
    }
}
