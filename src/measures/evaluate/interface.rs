//! Cells of declared sliding interfaces: where tissue may glide, a folded cell is no error of the field.
//!
//! A place belongs to an interface when its nearest bone changes there from one bone of a declared pair to the other:
//! in a grid of 3 mm, a voxel whose nearest bone and that of one of its 26 neighbours are such a pair. That is a layer about
//! 6 mm thick on the surface that is equally far from both bones; it ends at the pair's reach.

use crate::geometry::Grid;
use crate::geometry::stencil::NEIGHBOURS_26;
use crate::volume::distance::{nearest_label, squared_distance_within};
use crate::volume::{LabelMap, Mask, Volume};
use rayon::prelude::*;
use std::collections::{BTreeMap, BTreeSet};

/// Spacing at which interfaces are found, mm: that of the chain mail's elements.
const SPACING_MM: f64 = 3.0;

/// The interfaces on a coarse grid that shares origin and axes with the labels'.
pub(super) struct Interfaces {
    mask: Mask,
    /// Coarse index of each cell's middle along each axis of the labels' grid.
    place: [Vec<usize>; 3],
}

impl Interfaces {
    /// Those between pairs of bones of a label map, with the reach of each in mm, and the border of `region` (on the labels'
    /// grid); `None` when neither occurs.
    pub(super) fn new(
        bones: &LabelMap,
        is_bone: impl Fn(u16) -> bool,
        pairs: &[([u16; 2], f64)],
        region: Option<&Mask>,
    ) -> Option<Self> {
        let fine = bones.volume.grid();
        let grid = fine.coarsened(SPACING_MM);
        let between = layer(bones, is_bone, pairs, &grid);
        let data = match (between, region.map(|region| border(region, &grid))) {
            (Some(a), Some(b)) => a.into_iter().zip(b).map(|(a, b)| a || b).collect(),
            (a, b) => a.or(b)?,
        };
        let size = grid.size();
        let place = std::array::from_fn(|a| {
            let step = fine.spacing()[a] / grid.spacing()[a];
            (0..fine.size()[a]).map(|i| (((i as f64 + 0.5) * step).round() as usize).min(size[a] - 1)).collect()
        });
        let any = data.contains(&true);
        any.then(|| Self { mask: Volume::new(grid, data).expect("one value per voxel"), place })
    }

    /// Whether the cell with this lowest corner belongs to an interface.
    pub(super) fn holds(&self, [i, j, k]: [usize; 3]) -> bool {
        *self.mask.at([self.place[0][i], self.place[1][j], self.place[2][k]])
    }
}

/// The voxels of a grid, as fine as the region's or coarser, at its border: of which one of the 26 neighbours lies on the other side.
pub(super) fn border(region: &Mask, grid: &Grid) -> Vec<bool> {
    let fine = region.grid();
    let size = grid.size();
    let inside: Vec<bool> = (0..grid.len())
        .into_par_iter()
        .map(|l| fine.voxel_at(&grid.centre(grid.voxel(l))).is_some_and(|at| *region.at(at)))
        .collect();
    let at_border = |l: usize| {
        let at = grid.voxel(l);
        NEIGHBOURS_26.iter().any(|o| {
            let to: [usize; 3] = std::array::from_fn(|a| at[a].wrapping_add_signed(o[a] as isize));
            (0..3).all(|a| to[a] < size[a]) && inside[grid.linear(to)] != inside[l]
        })
    };
    (0..grid.len()).into_par_iter().map(at_border).collect()
}

/// The voxels of a coarse grid between pairs of bones, if any of the pairs occurs.
fn layer(bones: &LabelMap, is_bone: impl Fn(u16) -> bool, pairs: &[([u16; 2], f64)], grid: &Grid) -> Option<Vec<bool>> {
    let most = pairs.iter().map(|p| p.1).max_by(f64::total_cmp)?;
    let labels = coarse(bones, grid, is_bone);
    let owner = nearest_label(&labels);
    let near = squared_distance_within(&labels.map(|&l| l != 0), true, most);
    let reach: BTreeMap<[u16; 2], f64> = pairs.iter().flat_map(|&([a, b], r)| [([a, b], r), ([b, a], r)]).collect();
    let concerned: BTreeSet<u16> = reach.keys().map(|p| p[0]).collect();
    let size = grid.size();
    let set = |l: usize| {
        let (own, square) = (owner.data()[l], f64::from(near.data()[l]));
        if square > most * most || !concerned.contains(&own) {
            return false;
        }
        let at = grid.voxel(l);
        NEIGHBOURS_26.iter().any(|o| {
            let to: [usize; 3] = std::array::from_fn(|a| at[a].wrapping_add_signed(o[a] as isize));
            (0..3).all(|a| to[a] < size[a]) && reach.get(&[own, *owner.at(to)]).is_some_and(|r| square <= r * r)
        })
    };
    let data: Vec<bool> = (0..grid.len()).into_par_iter().map(set).collect();
    Some(data)
}

/// The bone of each coarse voxel: the first of the fine voxels that it holds.
fn coarse(bones: &LabelMap, grid: &Grid, is_bone: impl Fn(u16) -> bool) -> Volume<u16> {
    let fine = bones.volume.grid();
    let mut out = Volume::filled(grid.clone(), 0u16);
    let last = grid.size().map(|n| n - 1);
    for (l, &label) in bones.volume.data().iter().enumerate().filter(|(_, l)| **l > 0 && is_bone(**l)) {
        let voxel = fine.voxel(l);
        let at = std::array::from_fn(|a| {
            ((voxel[a] as f64 * fine.spacing()[a] / grid.spacing()[a]).round() as usize).min(last[a])
        });
        let at = grid.linear(at);
        if out.data()[at] == 0 {
            out.data_mut()[at] = label;
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_layer_lies_between_the_declared_bones_and_ends() {
        // Two plates at x = 0..4 and x = 44..48 up to z = 40, a third bone above them; 1 x 1 x 2 mm.
        let grid = Grid::axis_aligned([49, 30, 61], [1.0, 1.0, 2.0], [5.0, -7.0, 3.0]).unwrap();
        let volume = Volume::from_fn(grid.clone(), |l| {
            let [i, _, k] = grid.voxel(l);
            match (i, 2 * k) {
                (0..=4, 0..=40) => 1,
                (44..=48, 0..=40) => 2,
                (20..=28, 110..=120) => 3,
                _ => 0u16,
            }
        });
        let bones = LabelMap { volume, names: BTreeMap::new() };
        let found = Interfaces::new(&bones, |_| true, &[([2, 1], 25.0)], None).unwrap();
        for i in 0..48 {
            let middle = f64::from(i as u32) + 0.5;
            if (middle - 24.0).abs() < 2.0 {
                assert!(found.holds([i, 10, 10]), "{i}");
            }
            if (middle - 24.0).abs() > 5.0 {
                assert!(!found.holds([i, 10, 10]), "{i}");
            }
        }
        // 20 mm from both plates it is still there, 30 mm above their edges it is not.
        assert!(found.holds([24, 10, 20]) && !found.holds([24, 10, 36]));
        assert!(Interfaces::new(&bones, |_| true, &[], None).is_none());
        assert!(Interfaces::new(&bones, |_| true, &[([1, 3], 25.0)], None).is_none_or(|f| !f.holds([24, 10, 10])));
        // A label that is no bone takes no part.
        assert!(Interfaces::new(&bones, |l| l != 2, &[([1, 2], 25.0)], None).is_none());
        // The border of a region is one by itself.
        let region = Volume::from_fn(grid.clone(), |l| grid.voxel(l)[1] < 15);
        let found = Interfaces::new(&bones, |_| true, &[], Some(&region)).unwrap();
        assert!(found.holds([24, 14, 40]) && found.holds([2, 14, 2]) && !found.holds([24, 22, 40]));
        assert!(!found.holds([24, 6, 40]));
        // The plates are 40 mm apart.
        assert!(Interfaces::new(&bones, |_| true, &[([1, 2], 15.0)], None).is_none());
    }
}
