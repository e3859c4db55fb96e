//! The five characteristics of a set of Jacobians (thesis Tab. 2), by two passes over the values where they lie, in runs.

use crate::geometry::{LANES, vectorised};
use crate::stats::Bins;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// The five characteristics of thesis Tab. 2 over a set of cells.
///
/// Cells with any negative tetrahedron count as folded (-1); the other four describe the positive cells.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct JacobianStats {
    /// Number of cells.
    pub cells: usize,
    /// Number of folded cells.
    pub folded: usize,
    /// Folded cells in percent.
    pub folded_percent: f64,
    /// Positive cells that more than double their volume, percent.
    pub above_2_percent: f64,
    /// Positive cells that shrink to less than half, percent.
    pub below_half_percent: f64,
    /// Mean over positive cells.
    pub mean: f64,
    /// Smallest value over positive cells.
    pub min: f64,
    /// 1st percentile over positive cells.
    pub p1: f64,
    /// 99th percentile over positive cells.
    pub p99: f64,
    /// Greatest value over positive cells.
    pub max: f64,
}

/// The five characteristics of the Jacobians in `parts`, of which folded ones are negative.
pub fn stats(parts: &[&[f32]]) -> JacobianStats {
    CharacteristicTally::of(parts).stats(parts)
}

/// What the first pass finds of values: the positive ones' bins, and sums.
pub(super) struct CharacteristicTally {
    sums: CharacteristicSums,
    positive: Bins,
}

/// What is counted and added.
#[derive(Clone, Copy)]
struct CharacteristicSums {
    cells: usize,
    above: usize,
    below: usize,
    sum: f64,
    /// Extremes of the positive values.
    min: f32,
    max: f32,
}

impl CharacteristicSums {
    const NONE: Self = Self { cells: 0, above: 0, below: 0, sum: 0.0, min: f32::INFINITY, max: 0.0 };

    fn of(parts: &[&[f32]]) -> Self {
        let mut lanes = Lanes::NONE;
        vectorised(
            #[inline(always)]
            || parts.iter().for_each(|values| lanes.take(values)),
        );
        let all = (0..LANES).map(|l| lanes.lane(l)).fold(Self::NONE, Self::with);
        Self { cells: parts.iter().map(|values| values.len()).sum(), ..all }
    }

    fn with(self, other: Self) -> Self {
        Self {
            cells: self.cells + other.cells,
            above: self.above + other.above,
            below: self.below + other.below,
            sum: self.sum + other.sum,
            min: self.min.min(other.min),
            max: self.max.max(other.max),
        }
    }
}

/// [`CharacteristicSums`] of values in turn: one sum would wait for itself from value to value.
struct Lanes {
    above: [u32; LANES],
    below: [u32; LANES],
    sum: [f64; LANES],
    min: [f32; LANES],
    max: [f32; LANES],
}

impl Lanes {
    const NONE: Self = Self {
        above: [0; LANES],
        below: [0; LANES],
        sum: [0.0; LANES],
        min: [f32::INFINITY; LANES],
        max: [0.0; LANES],
    };

    #[inline(always)]
    fn take(&mut self, values: &[f32]) {
        let (blocks, rest) = values.as_chunks::<LANES>();
        blocks.iter().for_each(|block| self.add(block));
        if !rest.is_empty() {
            // What is not positive adds to nothing.
            let mut last = [0.0; LANES];
            last[..rest.len()].copy_from_slice(rest);
            self.add(&last);
        }
    }

    #[inline(always)]
    fn add(&mut self, values: &[f32; LANES]) {
        for (l, &j) in values.iter().enumerate() {
            let positive = j > 0.0;
            self.above[l] += u32::from(j > 2.0);
            self.below[l] += u32::from(positive & (j < 0.5));
            self.sum[l] += f64::from(if positive { j } else { 0.0 });
            self.min[l] = if positive & (j < self.min[l]) { j } else { self.min[l] };
            self.max[l] = if j > self.max[l] { j } else { self.max[l] };
        }
    }

    /// What was found in one of them.
    fn lane(&self, l: usize) -> CharacteristicSums {
        let [above, below] = [self.above[l], self.below[l]].map(|n| n as usize);
        CharacteristicSums { cells: 0, above, below, sum: self.sum[l], min: self.min[l], max: self.max[l] }
    }
}

/// Runs of values that one task adds up; their number decides in which order sums are added.
const TASK: usize = 2048;

impl CharacteristicTally {
    /// Of the values in `parts`.
    pub(super) fn of(parts: &[&[f32]]) -> Self {
        let sums: Vec<CharacteristicSums> = parts.par_chunks(TASK).map(CharacteristicSums::of).collect();
        Self {
            sums: sums.into_iter().fold(CharacteristicSums::NONE, CharacteristicSums::with),
            positive: Bins::of(parts, |j| j > 0.0),
        }
    }

    /// Of the values of both.
    pub(super) fn with(self, other: &Self) -> Self {
        Self { sums: self.sums.with(other.sums), positive: self.positive.with(&other.positive) }
    }

    /// The characteristics; `parts` are the values that were counted.
    pub(super) fn stats(&self, parts: &[&[f32]]) -> JacobianStats {
        let CharacteristicSums { cells, above, below, sum, min, max } = self.sums;
        let n = self.positive.count();
        let percent = |count: usize, of: usize| if of == 0 { 0.0 } else { 100.0 * count as f64 / of as f64 };
        let at = |share: f64| (share * n.saturating_sub(1) as f64).round() as usize;
        let [p1, p99] = self.positive.ranks([at(0.01), at(0.99)], parts, |j| j > 0.0);
        let [min, p1, p99, max] = if n == 0 { [0.0; 4] } else { [min, p1, p99, max].map(f64::from) };
        JacobianStats {
            cells,
            folded: cells - n,
            folded_percent: percent(cells - n, cells),
            above_2_percent: percent(above, n),
            below_half_percent: percent(below, n),
            mean: sum / n.max(1) as f64,
            min,
            p1,
            p99,
            max,
        }
    }
}

#[cfg(test)]
#[expect(clippy::float_cmp, reason = "the same values, found in another way")]
mod tests {
    use super::*;
    use crate::field::FOLDED;
    use proptest::prelude::*;

    #[test]
    fn characteristics_by_hand() {
        let s = stats(&[&[FOLDED, 0.25, 0.75], &[], &[1.0, 3.0, 5.0]]);
        assert_eq!((s.cells, s.folded), (6, 1));
        let close = |a: f64, b: f64| assert!((a - b).abs() < 1e-9, "{a} {b}");
        close(s.folded_percent, 100.0 / 6.0);
        close(s.above_2_percent, 40.0);
        close(s.below_half_percent, 20.0);
        close(s.mean, 2.0);
        close(s.min, 0.25);
        close(s.max, 5.0);
        assert_eq!(stats(&[]), JacobianStats::default());
        close(stats(&[&[FOLDED]]).folded_percent, 100.0);
    }

    proptest! {
        #[test]
        fn percentiles_are_those_of_sorted_values(
            mut values in prop::collection::vec(prop_oneof![Just(FOLDED), 0.0f32..3.0, 0.99f32..1.01], 1..400), parts in 1usize..9,
        ) {
            let found = stats(&values.chunks(parts).collect::<Vec<_>>());
            values.retain(|j| *j > 0.0);
            values.sort_by(f32::total_cmp);
            let at = |share: f64| values.get((share * values.len().saturating_sub(1) as f64).round() as usize);
            let expected = [0.0, 0.01, 0.99, 1.0].map(|share| f64::from(at(share).copied().unwrap_or(0.0)));
            prop_assert_eq!([found.min, found.p1, found.p99, found.max], expected);
        }
    }
}
