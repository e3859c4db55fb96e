//! Folds that are left on the full grid, where voxels between elements and exact bones meet: the tissue around each
//! settles anew by mechanics alone, voxel by voxel.

use super::lattice::material::Organs;
use super::lattice::{Lattice, Tissue};
use super::options::ChainmailOptions;
use super::relaxation::relax::Relaxation;
use super::relaxation::rest::RestingLinks;
use super::relaxation::untangle::{around, tangled};
use crate::field::{PushField, folded_cells};
use nalgebra::Matrix3;
use std::collections::BTreeMap;

/// Folded cells beyond which the field is not mended: then the motion itself is at fault, and it would take long.
const MOST_CELLS: usize = 5000;
/// Cells in one block of this many voxels a side are mended together.
const BLOCK: usize = 12;
/// Voxels around the folded cells of a block that links reach.
const MARGIN: usize = 8;
/// Voxels around a folded cell that settle anew at the first attempt, and how many more at each further one.
const REACH: usize = 3;
/// Rounds of relaxation.
const ROUNDS: usize = 15;

/// Unfolds cells of the digital criterion ([`folded_cells`]) that do not lie between bones; a cell that does not
/// unfold stays as it is. Bones do not move; `turns` are their rotations.
pub(super) fn mend(
    tissue: &Tissue<'_>,
    turns: &[Matrix3<f64>],
    options: &ChainmailOptions,
    organs: &Organs,
    push: &mut PushField,
) {
    for attempt in 0..options.mend {
        let cells = folded(tissue, push);
        if cells.is_empty() || cells.len() > MOST_CELLS {
            return;
        }
        let grid = push.displacement.grid().clone();
        let mut blocks: BTreeMap<[usize; 3], Vec<usize>> = BTreeMap::new();
        for cell in cells {
            blocks.entry(grid.voxel(cell).map(|c| c / BLOCK)).or_default().push(cell);
        }
        for cells in blocks.values() {
            let [low, high] = bounds(cells.iter().map(|&c| grid.voxel(c)), grid.size());
            let lattice = Lattice::patch(tissue, &options.material, organs, low, high);
            settle(&Patch { lattice, low, cells }, turns, options, REACH * (attempt + 1), push);
        }
    }
}

/// Folded cells of tissue that touch at most one bone and lie on one side of where tissue slides.
fn folded(tissue: &Tissue<'_>, push: &PushField) -> Vec<usize> {
    let grid = push.displacement.grid();
    let corners = grid.cell_corners();
    let mendable = |&cell: &usize| {
        let nodes = corners.map(|c| cell + c);
        let mut bones = nodes.iter().filter_map(|&v| tissue.bone(v));
        let first = bones.next();
        nodes.iter().all(|&v| tissue.active(v))
            && tissue
                .sliding
                .is_none_or(|s| !s.jumps || nodes.iter().all(|&v| s.region.data()[v] == s.region.data()[cell]))
            && bones.all(|b| Some(b) == first)
            && nodes.iter().any(|&v| tissue.bone(v).is_none())
    };
    let mut cells = folded_cells(push);
    cells.retain(mendable);
    cells
}

/// First and last voxel of a box around cells.
fn bounds(cells: impl Iterator<Item = [usize; 3]>, size: [usize; 3]) -> [[usize; 3]; 2] {
    let (mut low, mut high) = ([usize::MAX; 3], [0; 3]);
    for at in cells {
        for a in 0..3 {
            low[a] = low[a].min(at[a].saturating_sub(MARGIN));
            high[a] = high[a].max((at[a] + 1 + MARGIN).min(size[a] - 1));
        }
    }
    [low, high]
}

/// A block of the full grid.
struct Patch<'a> {
    lattice: Lattice,
    /// Its first voxel.
    low: [usize; 3],
    /// Folded cells of the full grid that lie in it.
    cells: &'a [usize],
}

/// Lets the soft voxels around a patch's folded cells settle; keeps the result if fewer cells are folded.
fn settle(patch: &Patch<'_>, turns: &[Matrix3<f64>], options: &ChainmailOptions, reach: usize, push: &mut PushField) {
    let Patch { lattice, low, cells } = patch;
    let grid = push.displacement.grid().clone();
    let size = lattice.grid.size();
    // The patch has a border of one node.
    let voxel = |n: usize| {
        let at = lattice.grid.voxel(n);
        let inside = (0..3).all(|a| at[a] > 0 && at[a] + 1 < size[a]);
        inside.then(|| grid.linear(std::array::from_fn(|a| at[a] + low[a] - 1)))
    };
    let u: Vec<[f32; 3]> =
        (0..lattice.node.len()).map(|n| voxel(n).map_or([0.0; 3], |v| push.displacement.data()[v])).collect();
    let local: Vec<u32> = cells
        .iter()
        .map(|&c| {
            let at = grid.voxel(c);
            lattice.grid.linear(std::array::from_fn(|a| at[a] + 1 - low[a])) as u32
        })
        .collect();
    let near = around(lattice, &local, reach);
    let rest = RestingLinks::new(lattice, options.variant.elasticity);
    let mut relaxation = Relaxation::new(lattice, &rest, &u, turns, options.poisson);
    let region = relaxation.among(&near);
    relaxation.run(ROUNDS, &region, None);
    let settled = relaxation.displacements();
    let folds = |u: &[[f32; 3]]| tangled(lattice, u, &lattice.active, 0.0).len();
    if folds(&settled) >= folds(&u) {
        return;
    }
    for n in lattice.soft().map(|n| n as usize).filter(|&n| near[n]) {
        if let Some(v) = voxel(n) {
            push.displacement.data_mut()[v] = settled[n];
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Grid;
    use crate::volume::{LabelMap, Mask, Volume};

    #[test]
    fn a_fold_in_soft_tissue_is_unfolded_and_bones_stay() {
        let grid = Grid::axis_aligned([20, 18, 16], [2.0, 2.0, 3.0], [0.0; 3]).unwrap();
        let bone = |l: usize| grid.voxel(l)[0] < 4;
        let ct = Volume::from_fn(grid.clone(), |l| if bone(l) { 700.0 } else { 20.0 });
        let body = Mask::filled(grid.clone(), true);
        let labels = LabelMap {
            volume: Volume::from_fn(grid.clone(), |l| u16::from(bone(l))),
            names: [(1, "skull".to_owned())].into(),
        };
        let bone_of_label: Vec<Option<u16>> = (0..=u16::MAX).map(|l| (l == 1).then_some(0)).collect();
        let tissue = Tissue {
            ct: &ct,
            body: &body,
            labels: &labels,
            bone_of_label: &bone_of_label,
            lung: None,
            sliding: None,
            least_hu: -500.0,
        };
        // One voxel runs through its neighbours.
        let torn = |mend: usize| {
            let mut u = Volume::filled(grid.clone(), [0.0f32; 3]);
            *u.data_mut().get_mut(grid.linear([10, 9, 8])).unwrap() = [5.0, 0.0, 0.0];
            let mut push = PushField { displacement: u, computed: body.clone() };
            let options = ChainmailOptions { mend, ..ChainmailOptions::default() };
            super::mend(&tissue, &[Matrix3::identity()], &options, &Organs::default(), &mut push);
            push
        };
        assert!(!folded(&tissue, &torn(0)).is_empty(), "left alone it stays folded");
        let mended = torn(ChainmailOptions::default().mend);
        assert!(folded(&tissue, &mended).is_empty(), "{:?}", folded(&tissue, &mended));
        let moved = mended.displacement.data().iter().enumerate().filter(|(l, _)| bone(*l));
        assert!(moved.into_iter().all(|(_, u)| u.iter().all(|c| c.abs() <= 0.0)));
    }
}
