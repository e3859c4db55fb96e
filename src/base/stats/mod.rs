//! Summaries of a slice: mean, percentiles, extremes; lines between grey values.

mod bins;
mod grey;

pub use bins::Bins;
pub use grey::{Line, gain_and_offset};

use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// A volume in words, ml: with a decimal below 10 ml, so that a little is not nothing.
pub fn millilitres(ml: f64) -> String {
    match ml {
        0.0 => "0 ml".into(),
        little if little < 0.05 => "less than 0.1 ml".into(),
        some if some < 9.95 => format!("{some:.1} ml"),
        much => format!("{much:.0} ml"),
    }
}

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
        let n = values.len();
        let mean = values.iter().sum::<f64>() / n as f64;
        let var = values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / (n.max(2) - 1) as f64;
        // Selection: sorting the millions of values of a dose would take longer than all else.
        let mut held = values.to_vec();
        let mut rank = |p: f64| {
            let at = p / 100.0 * (n - 1) as f64;
            let (_, low, above) = held.select_nth_unstable_by(at.floor() as usize, f64::total_cmp);
            let next = above.iter().copied().min_by(f64::total_cmp).unwrap_or(*low);
            *low + (next - *low) * at.fract()
        };
        Self { n, mean, std: var.sqrt(), median: rank(50.0), p95: rank(95.0), min: rank(0.0), max: rank(100.0) }
    }

    /// Summary of the single-precision values in `parts`, which must be finite: sums part by part, percentiles without
    /// sorting, which would take longer than all else where there are millions.
    pub fn of_singles(parts: &[&[f32]]) -> Self {
        let n: usize = parts.iter().map(|p| p.len()).sum();
        if n == 0 {
            return Self::default();
        }
        let mean = total(parts, |v| v) / n as f64;
        let var = total(parts, |v| (v - mean).powi(2)) / (n.max(2) - 1) as f64;
        let all = |_: f32| true;
        let place = |p: f64| p / 100.0 * (n - 1) as f64;
        let ranks = [50.0, 95.0].map(|p| [place(p).floor() as usize, place(p).ceil() as usize]);
        let [[m0, m1], [p0, p1]] = ranks;
        let [min, m0, m1, p0, p1, max] =
            Bins::of(parts, all).ranks([0, m0, m1, p0, p1, n - 1], parts, all).map(f64::from);
        let between = |low: f64, high: f64, p: f64| low + (high - low) * place(p).fract();
        Self { n, mean, std: var.sqrt(), median: between(m0, m1, 50.0), p95: between(p0, p1, 95.0), min, max }
    }
}

/// Sum of what `value` makes of each number, part by part.
fn total(parts: &[&[f32]], value: impl Fn(f64) -> f64 + Sync) -> f64 {
    let sums: Vec<f64> = parts.par_iter().map(|p| p.iter().map(|v| value(f64::from(*v))).sum()).collect();
    sums.iter().sum()
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
    fn a_little_is_not_nothing() {
        let told = [0.0, 0.02, 0.31, 9.96, 41.4].map(millilitres);
        assert_eq!(told, ["0 ml", "less than 0.1 ml", "0.3 ml", "10 ml", "41 ml"]);
    }

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
        assert_eq!(Summary::of_singles(&[&[4.0, 1.0], &[], &[3.0, 2.0]]), s);
        assert_eq!(Summary::of_singles(&[]), Summary::default());
    }

    #[test]
    fn selection_finds_what_sorting_finds() {
        let values: Vec<f64> = (0..997u64).map(|n| ((n * 7919) % 613) as f64 - 300.5).collect();
        let mut sorted = values.clone();
        sorted.sort_by(f64::total_cmp);
        let singles: Vec<f32> = values.iter().map(|v| *v as f32).collect();
        for s in [Summary::of(&values), Summary::of_singles(&singles.chunks(100).collect::<Vec<_>>())] {
            for (got, p) in [(s.min, 0.0), (s.median, 50.0), (s.p95, 95.0), (s.max, 100.0)] {
                assert!((got - percentile(&sorted, p)).abs() < 1e-12, "{p}");
            }
        }
    }
}
