//! Label maps: integer labels on a grid with a name for each.

use super::{Spans, Volume};
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

/// A [`LabelMap`] of which memory holds each row from its first to its last label.
#[derive(Debug, Clone, PartialEq)]
pub struct LabelSpans {
    /// Label of each voxel.
    pub volume: Spans<u16>,
    /// Name of each label that has one.
    pub names: BTreeMap<u16, String>,
}

impl LabelSpans {
    /// The label of every voxel.
    pub fn to_map(&self) -> LabelMap {
        LabelMap { volume: self.volume.to_volume(), names: self.names.clone() }
    }
}

impl From<LabelMap> for LabelSpans {
    fn from(map: LabelMap) -> Self {
        Self { volume: Spans::within(&map.volume, 0), names: map.names }
    }
}

impl LabelMap {
    /// Gives every name one number, the least of its numbers; returns the names of which several numbers occurred.
    pub fn one_number_a_name(&mut self) -> Vec<String> {
        let mut numbers: BTreeMap<&str, Vec<u16>> = BTreeMap::new();
        self.names.iter().for_each(|(label, name)| numbers.entry(name).or_default().push(*label));
        numbers.retain(|_, all| all.len() > 1);
        if numbers.is_empty() {
            return Vec::new();
        }
        let counts = self.counts();
        let mut first: BTreeMap<u16, u16> = BTreeMap::new();
        let mut merged = Vec::new();
        for (name, all) in &numbers {
            if all.iter().filter(|l| counts.contains_key(l)).count() > 1 {
                merged.push((*name).to_owned());
            }
            first.extend(all.iter().skip(1).map(|l| (*l, all[0])));
        }
        self.names.retain(|l, _| !first.contains_key(l));
        self.volume.data_mut().par_iter_mut().with_min_len(PART).for_each(|l| {
            if let Some(one) = first.get(l) {
                *l = *one;
            }
        });
        merged
    }

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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Grid;

    #[test]
    fn a_name_with_two_numbers_becomes_one_structure() {
        let grid = Grid::axis_aligned([4, 1, 1], [1.0; 3], [0.0; 3]).unwrap();
        let names = [(1, "cord"), (3, "lung"), (7, "cord")].map(|(l, n)| (l, n.to_owned()));
        let map = |labels: [u16; 4]| LabelMap {
            volume: Volume::new(grid.clone(), labels.to_vec()).unwrap(),
            names: names.clone().into(),
        };
        let mut both = map([0, 1, 7, 3]);
        assert_eq!(both.one_number_a_name(), ["cord"]);
        assert_eq!((both.volume.data(), both.names.len()), (&[0, 1, 1, 3][..], 2));
        let mut other = map([0, 7, 7, 3]);
        assert!(other.one_number_a_name().is_empty(), "only one of its numbers occurs");
        assert_eq!(other.volume.data(), [0, 1, 1, 3]);
    }
}
