//! Label maps: integer labels on a grid with a name for each.

use super::Volume;
use rayon::prelude::*;
use std::collections::BTreeMap;

/// Voxels that one thread counts at a time: many beside the labels that there may be.
const PART: usize = 1 << 20;

/// Integer labels with their names; 0 is background.
#[derive(Debug, Clone, PartialEq)]
pub struct LabelMap {
    /// Label of each voxel.
    pub volume: Volume<u16>,
    /// Name of each label that has one; names are TotalSegmentator v2's.
    pub names: BTreeMap<u16, String>,
}

impl LabelMap {
    /// Number of voxels of each label that occurs, background left out.
    pub fn counts(&self) -> BTreeMap<u16, usize> {
        let empty = || vec![0usize; usize::from(u16::MAX) + 1];
        let count = |mut table: Vec<usize>, labels: &[u16]| {
            labels.iter().for_each(|&l| table[usize::from(l)] += 1);
            table
        };
        let add = |mut a: Vec<usize>, b: Vec<usize>| {
            a.iter_mut().zip(b).for_each(|(a, b)| *a += b);
            a
        };
        let table = self.volume.data().par_chunks(PART).fold(empty, count).reduce(empty, add);
        (1..=u16::MAX).filter(|&l| table[usize::from(l)] > 0).map(|l| (l, table[usize::from(l)])).collect()
    }
}
