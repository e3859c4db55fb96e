//! Which values of a sample stand apart from the rest.

use super::figures::Worse;

/// A modified z-score beyond this is an outlier (Iglewicz & Hoaglin, "How to detect and handle outliers", ASQC 1993).
const LIMIT: f64 = 3.5;
/// Scales the median absolute deviation to the standard deviation of a normal distribution.
const NORMAL: f64 = 0.6745;
/// Fewer values do not tell what is usual.
const FEWEST: usize = 5;

/// The median; nothing for no values.
pub(super) fn median(values: impl Iterator<Item = f64>) -> Option<f64> {
    let mut values: Vec<f64> = values.collect();
    values.sort_by(f64::total_cmp);
    let upper = *values.get(values.len() / 2)?;
    let lower = values[(values.len() - 1) / 2];
    // Between a number and what is more than can be told, the number is a median, too.
    Some(if upper.is_finite() { f64::midpoint(lower, upper) } else { lower })
}

/// Whether each value stands apart: by its distance from the median in median absolute deviations, on the side that is worse, and by more than
/// `least`. Where most values are alike the deviation is 0, and `least` alone decides.
pub(super) fn outliers(values: &[Option<f64>], worse: Worse, least: f64) -> Vec<bool> {
    let known = || values.iter().flatten().copied();
    let none = vec![false; values.len()];
    let Some(middle) = median(known()).filter(|_| known().count() >= FEWEST) else { return none };
    let spread = median(known().map(|v| (v - middle).abs())).unwrap_or(0.0);
    let apart = |v: f64| {
        let by = match worse {
            Worse::High => v - middle,
            Worse::Low => middle - v,
            Worse::Unlike => (v - middle).abs(),
        };
        by > least && by * NORMAL > LIMIT * spread
    };
    values.iter().map(|v| v.is_some_and(apart)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn which(values: &[f64], worse: Worse, least: f64) -> Vec<usize> {
        let values: Vec<Option<f64>> = values.iter().map(|v| Some(*v)).collect();
        let odd = outliers(&values, worse, least);
        (0..values.len()).filter(|n| odd[*n]).collect()
    }

    #[test]
    fn only_the_worse_side_counts_and_only_what_matters() {
        let values = [1.0, 1.1, 0.9, 1.05, 0.95, 4.0, -2.0];
        assert_eq!(which(&values, Worse::High, 0.2), [5]);
        assert_eq!(which(&values, Worse::Low, 0.2), [6]);
        assert_eq!(which(&values, Worse::Unlike, 0.2), [5, 6]);
        assert!(which(&values, Worse::High, 5.0).is_empty());
    }

    #[test]
    fn by_hand() {
        // Median 3, absolute deviations 2, 1, 0, 1, x - 3: median 1. The limit is at 3 + 3.5 / 0.6745 = 8.19.
        assert!(which(&[1.0, 2.0, 3.0, 4.0, 8.1], Worse::High, 0.0).is_empty());
        assert_eq!(which(&[1.0, 2.0, 3.0, 4.0, 8.3], Worse::High, 0.0), [4]);
    }

    #[test]
    fn of_many_alike_what_differs_stands_apart_and_few_tell_nothing() {
        assert_eq!(which(&[0.0, 0.0, 0.0, 0.0, 0.0, 0.4], Worse::High, 0.01), [5]);
        assert!(which(&[0.0, 0.0, 0.0, 9.0], Worse::High, 0.01).is_empty());
        assert_eq!(outliers(&[None, Some(1.0)], Worse::High, 0.0), [false, false]);
    }

    #[test]
    fn medians() {
        assert_eq!(median([3.0, 1.0, 2.0].into_iter()), Some(2.0));
        assert_eq!(median([4.0, 1.0, 2.0, 3.0].into_iter()), Some(2.5));
        assert_eq!(median(std::iter::empty()), None);
        let more = f64::INFINITY;
        assert_eq!([median([1.0, more].into_iter()), median([more, 1.0, more].into_iter())], [Some(1.0), Some(more)]);
        assert_eq!(which(&[1.0, 1.1, 0.9, more, 1.05], Worse::High, 0.5), [3], "more than can be told stands apart");
        assert!(which(&[more, more, more, 0.9, 1.05], Worse::High, 0.5).is_empty());
    }
}
