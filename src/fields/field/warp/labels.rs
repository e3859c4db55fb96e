//! Label maps through a field: each label is a partial-volume image of its own, and the greatest share wins.
//!
//! Where the new voxels are larger than the old ones the share is averaged over samples inside them. A label that
//! wins nowhere, because it is smaller than a voxel or falls between voxels, takes the voxels where its share is
//! greatest, as many as its shares add up to and at least one: small structures survive.

use super::walk::{WalkCorner, WalkHull, WalkPlace, pulled, walked};
use crate::error::Result;
use crate::geometry::Grid;
use crate::volume::interpolation::weights;
use crate::volume::{LabelMap, Volume};
use nalgebra::Vector3;
use std::collections::BTreeMap;

/// Most samples of one new voxel along an axis.
const MOST_SAMPLES: usize = 8;

/// A label map at `y + v(y)` for every voxel `y` of the displacements' grid: the label with the greatest linear share.
///
/// Ties go to the smaller label; outside the map there is background. Names are kept.
///
/// # Errors
/// Only for internal inconsistency of grids.
pub fn resample_labels(v: &Volume<[f32; 3]>, labels: &LabelMap) -> Result<LabelMap> {
    let map = &labels.volume;
    let offsets = offsets(v.grid(), map.grid());
    let greatest =
        |shares: &[(u16, f64)]| shares.iter().max_by(|a, b| a.1.total_cmp(&b.1).then(b.0.cmp(&a.0))).map_or(0, |s| s.0);
    let values = if offsets.len() == 1 {
        let hull = WalkHull::new(map.grid());
        let winner = |place: WalkPlace| {
            let Some(corner) = hull.corner(place) else { return 0 };
            let labels = around(map, &corner, &hull);
            if labels.iter().all(|l| *l == labels[0]) {
                return labels[0];
            }
            let (votes, kinds) = tally(labels, corner.t.map(f64::from));
            greatest(&votes[..kinds])
        };
        walked(v, map.grid(), |places, out| out.iter_mut().enumerate().for_each(|(l, o)| *o = winner(places.at(l))))
    } else {
        pulled(v, map.grid(), |index| match only(map, index, &offsets) {
            Some(label) => label,
            None => greatest(Shares::at(map, index, &offsets).list()),
        })
    };
    let mut out = LabelMap { volume: Volume::new(v.grid().clone(), values)?, names: labels.names.clone() };
    rescue(v, labels, &offsets, &mut out);
    Ok(out)
}

/// Sample positions inside a new voxel, as index offsets in the old grid: one where voxels do not grow.
fn offsets(new: &Grid, old: &Grid) -> Vec<Vector3<f64>> {
    let step = old.inverse_step() * new.step();
    // How many old voxels a new one spans along each of its own axes.
    let count: [usize; 3] =
        std::array::from_fn(|a| ((step.column(a).amax() - 1e-3).ceil() as usize).clamp(1, MOST_SAMPLES));
    let at = |n: usize, a: usize| (n as f64 + 0.5) / count[a] as f64 - 0.5;
    let mut out = Vec::new();
    for k in 0..count[2] {
        for j in 0..count[1] {
            for i in 0..count[0] {
                out.push(step * Vector3::new(at(i, 0), at(j, 1), at(k, 2)));
            }
        }
    }
    out
}

/// Labels with their shares of a new voxel.
struct Shares {
    few: [(u16, f64); 8],
    len: usize,
    more: Vec<(u16, f64)>,
}

impl Shares {
    fn list(&self) -> &[(u16, f64)] {
        if self.more.is_empty() { &self.few[..self.len] } else { &self.more }
    }

    fn at(map: &Volume<u16>, index: &Vector3<f64>, offsets: &[Vector3<f64>]) -> Self {
        if offsets.len() == 1 {
            let (few, len) = corners(map, index);
            return Self { few, len, more: Vec::new() };
        }
        let mut more: Vec<(u16, f64)> = Vec::with_capacity(8);
        for offset in offsets {
            let (few, len) = corners(map, &(index + offset));
            // What is outside the map is background.
            let sample = if len == 0 { &[(0, 1.0)][..] } else { &few[..len] };
            for &(label, weight) in sample {
                match more.iter_mut().find(|v| v.0 == label) {
                    Some(v) => v.1 += weight / offsets.len() as f64,
                    None => more.push((label, weight / offsets.len() as f64)),
                }
            }
        }
        Self { few: [(0, 0.0); 8], len: 0, more }
    }
}

/// The label that all samples of a new voxel have around them, if there is such a one.
fn only(map: &Volume<u16>, index: &Vector3<f64>, offsets: &[Vector3<f64>]) -> Option<u16> {
    let mut found = None;
    for offset in offsets {
        let (few, len) = corners(map, &(index + offset));
        let label = if len == 0 { 0 } else { few[0].0 };
        if len > 1 || found.is_some_and(|found| found != label) {
            return None;
        }
        found = Some(label);
    }
    found
}

/// The labels around a continuous index with their trilinear weights; none outside the map.
fn corners(map: &Volume<u16>, index: &Vector3<f64>) -> ([(u16, f64); 8], usize) {
    let grid = map.grid();
    let mut votes = [(0u16, 0f64); 8];
    if !grid.contains(index) {
        return (votes, 0);
    }
    let low = index.map(f64::floor);
    let place = WalkPlace { low: [0, 1, 2].map(|a| low[a] as i32), t: [0, 1, 2].map(|a| (index[a] - low[a]) as f32) };
    let hull = WalkHull::new(grid);
    let Some(corner) = hull.corner(place) else { return (votes, 0) };
    let labels = around(map, &corner, &hull);
    if labels.iter().all(|l| *l == labels[0]) {
        votes[0] = (labels[0], 1.0);
        return (votes, 1);
    }
    tally(labels, corner.t.map(f64::from))
}

/// The labels at the eight corners.
#[inline(always)]
fn around(map: &Volume<u16>, corner: &WalkCorner, hull: &WalkHull) -> [u16; 8] {
    let [x, y, z] = hull.up;
    let at = |n: usize| map.data().get(corner.base + n).copied().unwrap_or_default();
    [at(0), at(x), at(y), at(x + y), at(z), at(x + z), at(y + z), at(x + y + z)]
}

/// Labels with the sum of their trilinear weights, and how many there are.
fn tally(labels: [u16; 8], t: [f64; 3]) -> ([(u16, f64); 8], usize) {
    let mut votes = [(0u16, 0f64); 8];
    let mut kinds = 0;
    for (label, weight) in labels.into_iter().zip(weights(t)) {
        match votes[..kinds].iter_mut().find(|v| v.0 == label) {
            Some(v) => v.1 += weight,
            None => {
                votes[kinds] = (label, weight);
                kinds += 1;
            }
        }
    }
    (votes, kinds)
}

/// Gives labels that won nowhere the voxels where their share is greatest.
fn rescue(v: &Volume<[f32; 3]>, labels: &LabelMap, offsets: &[Vector3<f64>], out: &mut LabelMap) {
    let mut kept = out.counts();
    let lost: Vec<u16> = labels.counts().into_keys().filter(|l| !kept.contains_key(l)).collect();
    if lost.is_empty() {
        return;
    }
    let map = &labels.volume;
    // Only voxels whose samples reach the lost labels have a share of them.
    let grid = map.grid();
    let voxels = (0..grid.len()).filter(|n| lost.contains(&map.data()[*n])).map(|n| grid.voxel(n));
    let (low, high) = voxels.fold(([usize::MAX; 3], [0; 3]), |(low, high), at: [usize; 3]| {
        (std::array::from_fn(|a| low[a].min(at[a])), std::array::from_fn(|a| high[a].max(at[a])))
    });
    let reach: [f64; 3] = std::array::from_fn(|a| 1.0 + offsets.iter().map(|o| o[a].abs()).fold(0.0, f64::max));
    let near = |index: &Vector3<f64>| {
        (0..3).all(|a| index[a] >= low[a] as f64 - reach[a] && index[a] <= high[a] as f64 + reach[a])
    };
    let shares = pulled(v, grid, |index| {
        if !near(index) {
            return Vec::new();
        }
        let shares = Shares::at(map, index, offsets);
        shares.list().iter().filter(|s| s.1 > 0.0 && lost.contains(&s.0)).copied().collect()
    });
    let mut places: BTreeMap<u16, Vec<(f64, usize)>> = BTreeMap::new();
    for (n, found) in shares.into_iter().enumerate() {
        for (label, share) in found {
            places.entry(label).or_default().push((share, n));
        }
    }
    for (label, mut places) in places {
        places.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
        let mut wanted = (places.iter().map(|p| p.0).sum::<f64>().round() as usize).max(1);
        for (_, n) in places {
            let owner = &mut out.volume.data_mut()[n];
            // The last voxel of another label is not taken.
            if wanted == 0 || kept.get(owner).is_some_and(|&count| count < 2) {
                continue;
            }
            if let Some(count) = kept.get_mut(owner) {
                *count -= 1;
            }
            *owner = label;
            *kept.entry(label).or_insert(0) += 1;
            wanted -= 1;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn map(spots: &[([usize; 3], u16)]) -> LabelMap {
        let grid = Grid::axis_aligned([12, 10, 8], [1.0, 2.0, 3.0], [5.0, -7.0, 11.0]).unwrap();
        let mut volume = Volume::filled(grid.clone(), 0u16);
        for (at, label) in spots {
            volume.data_mut()[grid.linear(*at)] = *label;
        }
        LabelMap { volume, names: spots.iter().map(|(_, l)| (*l, format!("l{l}"))).collect() }
    }

    proptest! {
        #[test]
        fn a_single_voxel_survives_any_shift(shift in prop::array::uniform3(-3.0f32..3.0)) {
            let labels = map(&[([5, 4, 3], 7)]);
            let v = Volume::filled(labels.volume.grid().clone(), shift);
            let out = resample_labels(&v, &labels).unwrap();
            prop_assert_eq!(out.counts().get(&7).copied(), Some(1));
            prop_assert_eq!(&out.names[&7], "l7");
            // It lies where the voxel's centre is taken, within a voxel.
            let at = out.volume.grid().voxel(out.volume.data().iter().position(|l| *l == 7).unwrap());
            let (centre, target) = (labels.volume.grid().centre([5, 4, 3]), out.volume.grid().centre(at));
            let spacing = [1.0, 2.0, 3.0];
            for a in 0..3 {
                prop_assert!((target[a] - (centre[a] - f64::from(shift[a]))).abs() <= 0.5 * spacing[a] + 1e-3);
            }
        }
    }

    #[test]
    fn small_labels_survive_a_coarser_grid() {
        let labels = map(&[([5, 4, 3], 7), ([6, 4, 3], 8), ([1, 1, 1], 9)]);
        let coarse = Grid::axis_aligned([3, 3, 3], [4.0, 7.0, 9.0], [5.0, -7.0, 11.0]).unwrap();
        let out = resample_labels(&Volume::filled(coarse, [0.0; 3]), &labels).unwrap();
        assert_eq!(out.counts(), [(7, 1), (8, 1), (9, 1)].into());
    }

    #[test]
    fn each_label_has_one_vote_whatever_its_number() {
        // Label 9 has half of the share in two voxels, more than label 3, which nearest neighbour would choose.
        let labels = map(&[([5, 4, 3], 3), ([6, 4, 3], 9), ([5, 5, 3], 9), ([6, 5, 3], 4)]);
        let v = Volume::filled(labels.volume.grid().clone(), [0.45, 0.9, 0.0]);
        let out = resample_labels(&v, &labels).unwrap();
        assert_eq!(*out.volume.at([5, 4, 3]), 9);
    }
}
