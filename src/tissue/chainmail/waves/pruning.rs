//! What waves that were pruned could have changed: the bound that a run prints.

use super::super::lattice::Lattice;
use super::super::variants::Variant;
use super::shortest::arrival::active_box;
use crate::geometry::Rigid;
use serde::{Deserialize, Serialize};
use std::fmt;

/// Waves that were pruned where they hardly weigh, and the most that this can change.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct Pruning {
    /// Waves that were pruned somewhere.
    pub waves: usize,
    /// All waves.
    pub of: usize,
    /// The most that one of them weighs where it was pruned, percent of the first: ratio to the power -n.
    pub each_percent: f64,
    /// The most that they weigh together at any element, percent of the first.
    pub together_percent: f64,
    /// The most by which an element's displacement differs for it before relaxation, mm: that share of the greatest
    /// difference between two bones' displacements in the box of the elements.
    pub most_mm: f64,
}

impl Pruning {
    /// Of so many waves of these bones, of which each is pruned as the variant say.
    pub(in crate::chainmail) fn new(waves: usize, lattice: &Lattice, bones: &[Rigid], variant: &Variant) -> Self {
        let each = if waves > 0 { variant.prune_ratio.powf(-variant.exponent) } else { 0.0 };
        let together = waves as f64 * each;
        let apart = if waves > 0 { apart(lattice, bones) } else { 0.0 };
        Self {
            waves,
            of: bones.len(),
            each_percent: 100.0 * each,
            together_percent: 100.0 * together,
            most_mm: together * apart,
        }
    }
}

impl fmt::Display for Pruning {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { waves, of, each_percent, most_mm, .. } = self;
        if *waves == 0 {
            return write!(f, "influence of none of {of} bones was pruned");
        }
        let changes = format!("no node changes by more than {most_mm:.2} mm");
        write!(f, "influence of {waves} of {of} bones ends where it weighs {each_percent:.4} % at most; {changes}")
    }
}

/// The greatest difference between two bones' displacements in the box of the active elements, mm. It is linear in the place, so
/// that its length is greatest at a corner.
fn apart(lattice: &Lattice, bones: &[Rigid]) -> f64 {
    let [low, size] = active_box(lattice);
    let corner = |n: usize| lattice.grid.centre(std::array::from_fn(|a| low[a] + (n >> a & 1) * (size[a] - 1)));
    let mut most: f64 = 0.0;
    for x in (0..8).map(corner) {
        let moved: Vec<_> = bones.iter().map(|bone| bone * x).collect();
        for (n, a) in moved.iter().enumerate() {
            most = moved[n + 1..].iter().map(|b| (a - b).norm()).fold(most, f64::max);
        }
    }
    most
}
