//! Characteristics of a Jacobian map (thesis Tab. 2).

use super::cell::{Cell, CellKinds};
use super::characteristics::Tally;
pub use super::characteristics::{JacobianStats, stats};
use crate::field::{FOLDED, PushField, jacobian_by_planes};
use crate::volume::{LabelMap, Mask, Volume};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;

/// Jacobian characteristics of a whole run. Cells are tissue cells: all 8 corners body above -500 HU.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct JacobianReport {
    /// All tissue cells, contact and interface cells left out.
    pub body: JacobianStats,
    /// Tissue cells with no bone corner, interface cells left out.
    pub soft_tissue: JacobianStats,
    /// Contact cells: corners in two or more bones; where rigid bones slide or meet even the truth folds.
    pub contact: JacobianStats,
    /// Cells of declared sliding interfaces with at most one bone: motion may be discontinuous there. Earlier reports
    /// lack them.
    #[serde(default)]
    pub interface: JacobianStats,
    /// Cells wholly inside one bone, by bone name.
    pub bones: Vec<(String, JacobianStats)>,
    /// Soft-tissue cells that fail the stricter digital criterion (any of 10 finite-difference determinants <= 0).
    pub digital_folded: usize,
    /// Pairs of neighbouring body cells whose Jacobians differ by more than 10 (thesis 2.3.2).
    pub jumps_above_10: usize,
}

/// Jacobians that differ by more than this between neighbours are errors of the field (thesis 2.3.2).
pub const JUMP: f32 = 10.0;

/// HU below which nothing is tissue: air, airway and lung take no part (thesis 4.3.2).
pub const TISSUE_HU: f32 = -500.0;

/// Voxels inside the body above [`TISSUE_HU`]: those that count.
pub fn tissue(body: &Mask, ct: &Volume<f32>) -> Mask {
    let mut out = Volume::filled(body.grid().clone(), false);
    let rows = body.grid().size()[0];
    let from = body.data().par_chunks(rows).zip(ct.data().par_chunks(rows));
    out.data_mut().par_chunks_mut(rows).zip(from).for_each(|(out, (body, ct))| {
        // Rows outside the patient stay as they are, unread.
        if body.iter().fold(false, |any, body| any | body) {
            out.iter_mut().zip(body).zip(ct).for_each(|((out, body), hu)| *out = *body & (*hu > TISSUE_HU));
        }
    });
    out
}

/// Cells that fail the digital criterion ([`crate::field::digital_folds`]), by what they hold.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct DigitalFolds {
    pub(super) soft: usize,
    /// Partly or wholly one bone.
    pub(super) bone: usize,
    pub(super) contact: usize,
    pub(super) interface: usize,
}

/// The Jacobian map of a push field and its characteristics; `cells` says what the cells of its grid hold.
pub fn evaluate(push: &PushField, cells: &CellKinds) -> (Volume<f32>, JacobianReport) {
    let (map, report, _) = with_folds(push, cells);
    (map, report)
}

/// As [`evaluate`], and where digital folds lie.
pub(super) fn with_folds(push: &PushField, cells: &CellKinds) -> (Volume<f32>, JacobianReport, DigitalFolds) {
    let (map, found) = jacobian_by_planes(push, |k, jacobians, folds| Found::of(k, (jacobians, folds), cells));
    let of = |part: fn(&Found) -> &Vec<f32>| found.iter().map(|f| &part(f)[..]).collect::<Vec<_>>();
    let soft = of(|f| &f.soft);
    let bony = [of(|f| &f.edge), of(|f| &f.inside)].concat();
    let of_soft = Tally::of(&soft);
    let soft_tissue = of_soft.stats(&soft);
    let body = of_soft.with(&Tally::of(&bony)).stats(&[soft, bony].concat());
    let mut inside = vec![Vec::new(); cells.names.len()];
    for f in &found {
        let mut rest = &f.inside[..];
        for (bone, number) in &f.bones {
            let (own, others) = rest.split_at(*number);
            inside[usize::from(*bone)].extend_from_slice(own);
            rest = others;
        }
    }
    let of_bones: Vec<JacobianStats> = inside.par_iter().map(|j| stats(&[&j[..]])).collect();
    let folds = |part: fn(&DigitalFolds) -> usize| found.iter().map(|f| part(&f.folds)).sum();
    let folds = DigitalFolds {
        soft: folds(|f| f.soft),
        bone: folds(|f| f.bone),
        contact: folds(|f| f.contact),
        interface: folds(|f| f.interface),
    };
    let report = JacobianReport {
        body,
        soft_tissue,
        contact: stats(&of(|f| &f.contact)),
        interface: stats(&of(|f| &f.interface)),
        bones: cells.names.iter().cloned().zip(of_bones).filter(|(_, s)| s.cells > 0).collect(),
        digital_folded: folds.soft,
        jumps_above_10: jumps(&map, cells, found.iter().flat_map(|f| &f.high).copied()),
    };
    (map, report, folds)
}

/// What a plane of cells holds.
#[derive(Default)]
struct Found {
    soft: Vec<f32>,
    /// Partly one bone.
    edge: Vec<f32>,
    /// Wholly inside a bone.
    inside: Vec<f32>,
    /// Whose bones these are: index and number of cells, in turn.
    bones: Vec<(u16, usize)>,
    contact: Vec<f32>,
    interface: Vec<f32>,
    folds: DigitalFolds,
    /// Storage positions of body cells whose Jacobian is large enough to differ from another by more than [`JUMP`].
    high: Vec<usize>,
}

impl Found {
    /// The cells between planes `k` and `k + 1`, from that plane of the map and of the digital folds.
    fn of(k: usize, (jacobians, folds): (&[f32], &[bool]), cells: &CellKinds) -> Self {
        let runs = || cells.rows_of_plane(k).flat_map(|row| cells.row(row));
        let soft = runs().filter(|r| r.1 == Cell::Soft).map(|r| r.0.len()).sum();
        let mut found = Self { soft: Vec::with_capacity(soft), ..Self::default() };
        let before = k * jacobians.len();
        for (run, kind) in runs() {
            let here = run.start - before..run.end - before;
            found.take(kind, run.start, &jacobians[here.clone()], &folds[here]);
        }
        found
    }

    /// Takes up a run of cells of one kind that begins at `start` in storage.
    fn take(&mut self, kind: Cell, start: usize, jacobians: &[f32], folds: &[bool]) {
        let (to, folded) = match kind {
            Cell::Outside => return,
            Cell::Soft => (&mut self.soft, &mut self.folds.soft),
            Cell::Edge => (&mut self.edge, &mut self.folds.bone),
            Cell::Inside(bone) => {
                self.bones.push((bone, jacobians.len()));
                (&mut self.inside, &mut self.folds.bone)
            }
            Cell::Contact => (&mut self.contact, &mut self.folds.contact),
            Cell::Interface => (&mut self.interface, &mut self.folds.interface),
        };
        to.extend_from_slice(jacobians);
        *folded += folds.iter().map(|fold| usize::from(*fold)).sum::<usize>();
        let high = |j: &f32| *j > JUMP + FOLDED;
        if kind.body() && jacobians.iter().fold(false, |any, j| any | high(j)) {
            self.high.extend(jacobians.iter().enumerate().filter(|(_, j)| high(j)).map(|(i, _)| start + i));
        }
    }
}

/// Volume of a structure after over before, from a Jacobian map on the labels' grid: the mean over cells by the share of their
/// corners that carry the label. `None` where no cell does or all are folded.
pub fn relative_volume(map: &Volume<f32>, labels: &LabelMap, label: u16) -> Option<f64> {
    let grid = map.grid();
    let data = labels.volume.data();
    let mut sums: std::collections::BTreeMap<usize, f64> = std::collections::BTreeMap::new();
    for (l, _) in data.iter().enumerate().filter(|(_, l)| **l == label) {
        for cell in grid.cells_around(grid.voxel(l)) {
            *sums.entry(cell).or_default() += 0.125;
        }
    }
    let cells = sums.iter().filter(|(c, _)| map.data()[**c] > 0.0);
    let (sum, weight) = cells.fold((0.0, 0.0), |(s, w), (c, share)| (s + share * f64::from(map.data()[*c]), w + share));
    (weight > 0.0).then(|| sum / weight)
}

/// Pairs of body cells that share a face and whose Jacobians differ by more than [`JUMP`]; one of each is among `high`.
fn jumps(map: &Volume<f32>, cells: &CellKinds, high: impl Iterator<Item = usize>) -> usize {
    let grid = map.grid();
    let mut pairs = BTreeSet::new();
    for l in high {
        let v = grid.voxel(l);
        for (a, stride) in grid.strides().into_iter().enumerate() {
            for forward in [true, false] {
                let mut other = v;
                other[a] = if forward { v[a] + 1 } else { v[a].wrapping_sub(1) };
                if other[a] < grid.size()[a] && cells.at(other).body() {
                    let o = grid.linear(other);
                    if (map.data()[l] - map.data()[o]).abs() > JUMP {
                        pairs.insert((l.min(o), stride));
                    }
                }
            }
        }
    }
    pairs.len()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Grid;
    use std::collections::BTreeMap;

    #[test]
    fn cells_go_to_the_right_tissue() {
        // A row of 12 voxels, 2 thick: label 1 at 1..=3, label 2 at 4..=5 (touching), label 9 (no bone) at 7, skin at 10.
        let grid = Grid::axis_aligned([12, 2, 2], [1.0; 3], [0.0; 3]).unwrap();
        let labels = Volume::from_fn(grid.clone(), |l| match l % 12 {
            1..=3 => 1,
            4..=5 => 2,
            7 => 9,
            _ => 0u16,
        });
        let tissue = Volume::from_fn(grid.clone(), |l| l % 12 <= 10);
        let bones = LabelMap { volume: labels, names: BTreeMap::new() };
        let rigid = [(1, "a".to_owned()), (2, "b".to_owned())];
        // Stretch by 2 from x = 6 on, so that cells 6.. have Jacobian 2; cell 8 jumps to 26.
        let x = |i: usize| match i {
            0..=6 => i as f32,
            7 | 8 => (i * 2 - 6) as f32,
            _ => (i * 2 - 6 + 24) as f32,
        };
        let displacement = Volume::from_fn(grid.clone(), |l| [x(l % 12) - (l % 12) as f32, 0.0, 0.0]);
        let push = PushField { displacement, computed: Volume::filled(grid, true) };
        let (_, r) = evaluate(&push, &CellKinds::new(&tissue, &bones, &rigid, &[]));
        assert_eq!(r.contact.cells, 1); // between 3 and 4
        assert_eq!(r.body.cells, 9); // cells 0..=9 without the contact cell
        assert_eq!(r.soft_tissue.cells, 4); // 6..=9; 0 and 5 touch one bone
        assert_eq!(r.bones.iter().map(|(n, s)| (n.as_str(), s.cells)).collect::<Vec<_>>(), [("a", 2), ("b", 1)]);
        assert!((r.soft_tissue.mean - (2.0 + 2.0 + 26.0 + 2.0) / 4.0).abs() < 1e-5);
        assert_eq!(r.jumps_above_10, 2);
        assert_eq!((r.digital_folded, r.body.folded), (0, 0));
        // The same labels under one name are one bone: no contact.
        let one = CellKinds::new(&tissue, &bones, &[(1, "a".to_owned()), (2, "a".to_owned())], &[]);
        let joined = evaluate(&push, &one).1;
        assert_eq!((joined.contact.cells, joined.bones[0].1.cells), (0, 4));
    }
    #[test]
    fn folds_between_sliding_bones_are_counted_apart() {
        // Two plates at x = 0..6 and x = 30..36; the second slides along y by 40 mm, the tissue in the middle takes the jump.
        let grid = Grid::axis_aligned([37, 20, 20], [1.0; 3], [0.0; 3]).unwrap();
        let labels = Volume::from_fn(grid.clone(), |l| match grid.voxel(l)[0] {
            0..=6 => 1,
            30..=36 => 2u16,
            _ => 0,
        });
        let bones = LabelMap { volume: labels, names: BTreeMap::new() };
        let rigid = [(1, "a".to_owned()), (2, "b".to_owned())];
        let slide = |l: usize| {
            let [i, j, _] = grid.voxel(l);
            // A shear of the middle layer that also turns its cells over.
            [if i == 18 { 3.0 * (j % 2) as f32 } else { 0.0 }, if i > 18 { 40.0 } else { 0.0 }, 0.0]
        };
        let push = PushField {
            displacement: Volume::from_fn(grid.clone(), slide),
            computed: Volume::filled(grid.clone(), true),
        };
        let tissue = Volume::filled(grid, true);
        let with = evaluate(&push, &CellKinds::new(&tissue, &bones, &rigid, &[([1, 2], 25.0)])).1;
        let without = evaluate(&push, &CellKinds::new(&tissue, &bones, &rigid, &[])).1;
        assert!(without.body.folded > 100 && without.interface.cells == 0);
        assert_eq!((with.body.folded, with.interface.folded), (0, without.body.folded));
        assert_eq!(with.body.cells + with.interface.cells, without.body.cells);
        assert!(with.digital_folded == 0 && without.digital_folded > 0);
    }
    #[test]
    fn a_structure_has_the_volume_that_its_cells_have() {
        let grid = Grid::axis_aligned([10, 4, 4], [1.0; 3], [0.0; 3]).unwrap();
        let volume = Volume::from_fn(grid.clone(), |l| if (3..=5).contains(&(l % 10)) { 7 } else { 0u16 });
        let labels = LabelMap { volume, names: BTreeMap::new() };
        // Cells 3 and 4 lie inside, 2 and 5 by half.
        let map = Volume::from_fn(grid, |l| [1.0, 1.0, 2.0, 0.5, 0.5, 2.0, 9.0, 1.0, 1.0, 1.0][l % 10]);
        assert!((relative_volume(&map, &labels, 7).unwrap() - (2.0 * 0.5 + 2.0 * 0.5 * 2.0) / 3.0).abs() < 1e-6);
        assert_eq!(relative_volume(&map, &labels, 3), None);
    }
}
