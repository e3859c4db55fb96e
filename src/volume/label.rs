//! Label maps: integer labels on a grid with a name for each.

use super::Volume;
use std::collections::BTreeMap;

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
        let mut table = vec![0usize; usize::from(u16::MAX) + 1];
        for &l in self.volume.data() {
            table[usize::from(l)] += 1;
        }
        (1..=u16::MAX).filter(|&l| table[usize::from(l)] > 0).map(|l| (l, table[usize::from(l)])).collect()
    }
}
