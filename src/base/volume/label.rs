//! Label maps: integer labels on a grid with a name for each.

use super::{Spans, Volume};
use rayon::prelude::*;
use std::collections::BTreeMap;

/// Voxels that one thread counts at a time: many beside the labels that there may be.
const PART: usize = 1 << 20;

/// Planes of labels are repeated no more often by a finer grid: what is alike over more is a shape.
const MOST_REPEATS: usize = 4;

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

    /// Edges of the voxels that the labels were drawn on, as far as they show, mm: on a finer grid nearest neighbours repeat planes,
    /// each as often as the others or once more. Planes that are alike more than four times are a shape, and the grid's
    /// edges count.
    pub fn drawn_spacing(&self) -> [f64; 3] {
        let (grid, changes) = (self.volume.grid(), self.changes());
        std::array::from_fn(|a| {
            let ends = changes[a].iter().position(|c| *c).zip(changes[a].iter().rposition(|c| *c));
            // Whole runs only: the first and last plane of labels may have been cut.
            let mut runs: Vec<usize> = ends.map_or_else(Vec::new, |(first, last)| {
                changes[a][first + 1..=last].split_inclusive(|c| *c).map(<[bool]>::len).collect()
            });
            // Where a bone is widest a few planes are alike as drawn.
            runs.sort_unstable();
            runs.truncate(runs.len() - runs.len() / 20);
            let (least, most) = (runs.iter().min().copied().unwrap_or(1), runs.iter().max().copied().unwrap_or(1));
            let repeated = most <= MOST_REPEATS && most - least <= 1;
            let mean = if repeated { runs.iter().sum::<usize>() as f64 / runs.len().max(1) as f64 } else { 1.0 };
            grid.spacing()[a] * mean.max(1.0)
        })
    }

    /// Whether each plane differs from the next one, along each axis.
    fn changes(&self) -> [Vec<bool>; 3] {
        let [ni, nj, nk] = self.volume.grid().size();
        let labels = self.volume.data();
        let empty = || [ni, nj, nk].map(|n| vec![false; n]);
        let of_row = |mut found: [Vec<bool>; 3], row: usize| {
            let (j, k, here) = (row % nj, row / nj, &labels[row * ni..][..ni]);
            let other = |next: usize| &labels[next * ni..][..ni] != here;
            found[1][j] |= j + 1 < nj && other(row + 1);
            found[2][k] |= k + 1 < nk && other(row + nj);
            if here.iter().any(|l| *l != 0) {
                here.windows(2).zip(&mut found[0]).for_each(|(pair, change)| *change |= pair[0] != pair[1]);
            }
            found
        };
        let either = |mut a: [Vec<bool>; 3], b: [Vec<bool>; 3]| {
            a.iter_mut().flatten().zip(b.iter().flatten()).for_each(|(a, b)| *a |= b);
            a
        };
        (0..nj * nk).into_par_iter().with_min_len(nj).fold(empty, of_row).reduce(empty, either)
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

    /// Labels that `label` draws on voxels of these edges in mm, brought to others by nearest neighbours.
    fn brought(drawn: [f64; 3], to: [f64; 3], label: impl Fn([f64; 3]) -> bool + Sync) -> LabelMap {
        let size = to.map(|s| (60.0 / s) as usize);
        let grid = Grid::axis_aligned(size, to, to.map(|s| s / 2.0)).unwrap();
        let middle = |x: f64, edge: f64| ((x / edge).floor() + 0.5) * edge;
        let at = |l: usize| {
            let p = grid.centre(grid.voxel(l));
            u16::from(label(std::array::from_fn(|a| middle(p[a], drawn[a]))))
        };
        LabelMap { volume: Volume::from_fn(grid.clone(), at), names: BTreeMap::new() }
    }

    #[test]
    fn labels_tell_the_voxels_that_they_were_drawn_on() {
        let ball = |[x, y, z]: [f64; 3]| (x - 31.0).powi(2) + (y - 29.3).powi(2) + (z - 28.2).powi(2) < 500.0;
        let near = |found: [f64; 3], want: [f64; 3]| {
            assert!((0..3).all(|a| (found[a] / want[a] - 1.0).abs() < 0.03), "{found:?} for {want:?}");
        };
        // As drawn, and brought to finer voxels in part of the axes.
        near(brought([1.0, 1.0, 3.0], [1.0, 1.0, 3.0], ball).drawn_spacing(), [1.0, 1.0, 3.0]);
        near(brought([1.0, 1.0, 3.0], [0.7, 0.7, 1.5], ball).drawn_spacing(), [1.0, 1.0, 3.0]);
        near(brought([1.0, 1.0, 3.0], [1.0, 0.5, 0.9], ball).drawn_spacing(), [1.0, 1.0, 3.0]);
        // Alike over more planes than any finer grid repeats: a shape, and nothing at all.
        let post = |[x, y, _]: [f64; 3]| (x - 31.0).powi(2) + (y - 29.3).powi(2) < 500.0;
        assert!((brought([1.0; 3], [1.0; 3], post).drawn_spacing()[2] - 1.0).abs() < 1e-12);
        near(brought([1.0; 3], [1.0; 3], |_| false).drawn_spacing(), [1.0; 3]);
    }

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
