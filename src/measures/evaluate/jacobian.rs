//! Characteristics of a Jacobian map (thesis Tab. 2).

use super::cell::{Cell, CellKinds};
use super::characteristics::CharacteristicTally;
pub use super::characteristics::{JacobianStats, stats};
use crate::field::{FOLDED, PushField, RowOfCells, folded_anywhere, jacobian_by_rows};
use crate::volume::{LabelMap, Mask, Spans, Volume};
use nalgebra::{Point3, Vector3};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};

/// Jacobian characteristics of a whole run. Cells are tissue cells: all 8 corners body above -500 HU.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct JacobianReport {
    /// All tissue cells, contact and interface cells included: what thesis Tab. 2 counts. Earlier reports lack them.
    #[serde(default)]
    pub all: JacobianStats,
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
    /// Folded cells of the written field that are none of the above: outside the patient, or with a corner below -500 HU that
    /// takes no part. Earlier reports lack them.
    #[serde(default)]
    pub folded_outside: usize,
    /// Cells that reach across a surface along which tissue slides (lung, organs along the wall): the field jumps there, and
    /// none of the figures counts them. Earlier reports lack them.
    #[serde(default)]
    pub across: usize,
    /// Cells wholly inside one bone, by bone name.
    pub bones: Vec<(String, JacobianStats)>,
    /// Soft-tissue cells that fail the stricter digital criterion (any of 10 finite-difference determinants <= 0).
    pub digital_folded: usize,
    /// Pairs of neighbouring body cells whose Jacobians differ by more than 10 (thesis 2.3.2).
    pub jumps_above_10: usize,
    /// Where most of the folded cells of `body` lie, LPS mm in the frame of the field's grid; nothing where none is folded.
    /// Earlier reports lack it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub folded_at: Option<Point3<f64>>,
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
pub fn evaluate(push: &PushField, cells: &CellKinds) -> (Spans<f32>, JacobianReport) {
    let (map, report, _) = with_folds(push, cells);
    (map, report)
}

/// As [`evaluate`], and where digital folds lie.
pub(super) fn with_folds(push: &PushField, cells: &CellKinds) -> (Spans<f32>, JacobianReport, DigitalFolds) {
    let at_least = |row: usize| cells.extent(row);
    let (map, found) = jacobian_by_rows(push, at_least, |found: &mut CellsFound, row| found.take(row, cells));
    let CellRuns { soft, bony, inside, contact, interface } = CellRuns::of(&map, cells);
    let of_soft = CharacteristicTally::of(&soft);
    let soft_tissue = of_soft.stats(&soft);
    let (of_body, body_runs) = (of_soft.with(&CharacteristicTally::of(&bony)), [soft, bony].concat());
    let body = of_body.stats(&body_runs);
    let apart = [contact.as_slice(), &interface].concat();
    let of_all = of_body.with(&CharacteristicTally::of(&apart));
    let all = of_all.stats(&[body_runs, apart].concat());
    let of_bones: Vec<JacobianStats> = inside.par_iter().map(|runs| stats(runs)).collect();
    let folds = |part: fn(&DigitalFolds) -> usize| found.iter().map(|f| part(&f.folds)).sum();
    let folds = DigitalFolds {
        soft: folds(|f| f.soft),
        bone: folds(|f| f.bone),
        contact: folds(|f| f.contact),
        interface: folds(|f| f.interface),
    };
    let report = JacobianReport {
        all,
        body,
        soft_tissue,
        contact: stats(&contact),
        interface: stats(&interface),
        folded_outside: outside(&push.displacement, cells),
        across: cells
            .rows()
            .flat_map(|row| cells.row(row))
            .filter(|(_, k)| *k == Cell::Across)
            .map(|(run, _)| run.len())
            .sum(),
        bones: cells.names.iter().cloned().zip(of_bones).filter(|(_, s)| s.cells > 0).collect(),
        digital_folded: folds.soft,
        jumps_above_10: jumps(&map, cells, found.iter().flat_map(|f| &f.high).copied()),
        folded_at: place_of(&map, cells, body.folded),
    };
    (map, report, folds)
}

/// Folded cells of a field that lie outside of all that counts.
fn outside(displacement: &Volume<[f32; 3]>, cells: &CellKinds) -> usize {
    let grid = displacement.grid();
    folded_anywhere(displacement).into_iter().filter(|&n| cells.at(grid.voxel(n)) == Cell::Outside).count()
}

/// Folded cells that lie in one cube of this edge are one place, mm.
const PLACE_MM: f64 = 15.0;

/// The middle of the folded cells of the body where most of them lie; nothing where there are none.
fn place_of(map: &Spans<f32>, cells: &CellKinds, folded: usize) -> Option<Point3<f64>> {
    if folded == 0 {
        return None;
    }
    let mut places: BTreeMap<[i64; 3], (usize, Vector3<f64>)> = BTreeMap::new();
    for row in cells.rows() {
        let (span, values) = map.row(row);
        let [j, k] = cells.place_of(row);
        for (run, _) in cells.row(row).filter(|(_, kind)| kind.body()) {
            for i in run.filter(|i| values[i - span.start] <= 0.0) {
                let p = map.grid().world(&Vector3::new(i as f64 + 0.5, j as f64 + 0.5, k as f64 + 0.5));
                let place = places.entry([p.x, p.y, p.z].map(|x| (x / PLACE_MM).floor() as i64)).or_default();
                *place = (place.0 + 1, place.1 + p.coords);
            }
        }
    }
    let (n, sum) = places.into_values().max_by_key(|(n, _)| *n)?;
    Some(Point3::from(sum / n as f64))
}

/// What a plane of cells holds that is not in the map.
#[derive(Default)]
struct CellsFound {
    folds: DigitalFolds,
    /// Lowest corners of body cells whose Jacobian is large enough to differ from another by more than [`JUMP`].
    high: Vec<[usize; 3]>,
}

impl CellsFound {
    /// Takes up a row of cells.
    fn take(&mut self, of: RowOfCells<'_, f32, bool>, cells: &CellKinds) {
        for (run, kind) in cells.row(of.row) {
            let here = run.start - of.cells.start..run.end - of.cells.start;
            let folded = of.other[here.clone()].iter().map(|fold| usize::from(*fold)).sum::<usize>();
            match kind {
                Cell::Outside | Cell::Across => {}
                Cell::Soft => self.folds.soft += folded,
                Cell::Edge | Cell::Inside(_) => self.folds.bone += folded,
                Cell::Contact => self.folds.contact += folded,
                Cell::Interface => self.folds.interface += folded,
            }
            let high = |j: &f32| *j > JUMP + FOLDED;
            let jacobians = &of.kept[here];
            if kind.body() && jacobians.iter().fold(false, |any, j| any | high(j)) {
                let [j, k] = cells.place_of(of.row);
                self.high.extend(run.zip(jacobians).filter(|(_, j)| high(j)).map(|(i, _)| [i, j, k]));
            }
        }
    }
}

/// The values of a map by what its cells hold, in runs where they lie.
#[derive(Default)]
struct CellRuns<'a> {
    soft: Vec<&'a [f32]>,
    /// Partly or wholly one bone.
    bony: Vec<&'a [f32]>,
    /// Wholly inside a bone, by its index.
    inside: Vec<Vec<&'a [f32]>>,
    contact: Vec<&'a [f32]>,
    interface: Vec<&'a [f32]>,
}

impl<'a> CellRuns<'a> {
    fn of(map: &'a Spans<f32>, cells: &CellKinds) -> Self {
        let mut all = Self { inside: vec![Vec::new(); cells.names.len()], ..Self::default() };
        for row in cells.rows() {
            let (span, values) = map.row(row);
            for (run, kind) in cells.row(row) {
                let run = &values[run.start - span.start..run.end - span.start];
                match kind {
                    Cell::Outside | Cell::Across => {}
                    Cell::Soft => all.soft.push(run),
                    Cell::Edge => all.bony.push(run),
                    Cell::Inside(bone) => {
                        all.bony.push(run);
                        all.inside[usize::from(bone)].push(run);
                    }
                    Cell::Contact => all.contact.push(run),
                    Cell::Interface => all.interface.push(run),
                }
            }
        }
        all
    }
}

/// Jacobians of the cells of the body, contact and sliding interfaces left out, in storage order.
pub(super) fn of_body(map: &Spans<f32>, cells: &CellKinds) -> Vec<f32> {
    let of_row = |row: usize| {
        let (span, values) = map.row(row);
        let runs = cells.row(row).filter(|(_, kind)| kind.body());
        runs.flat_map(move |(run, _)| &values[run.start - span.start..run.end - span.start])
    };
    cells.rows().flat_map(of_row).copied().collect()
}

/// Volume of a structure after over before, from a Jacobian map on the labels' grid: the mean over cells by the share of their
/// corners that carry the label. `None` where no cell does or all are folded.
pub fn relative_volume(map: &Spans<f32>, labels: &LabelMap, label: u16) -> Option<f64> {
    let grid = map.grid();
    let data = labels.volume.data();
    let mut sums: std::collections::BTreeMap<usize, f64> = std::collections::BTreeMap::new();
    for (l, _) in data.iter().enumerate().filter(|(_, l)| **l == label) {
        for cell in grid.cells_around(grid.voxel(l)) {
            *sums.entry(cell).or_default() += 0.125;
        }
    }
    let cells = sums.into_iter().map(|(c, share)| (map.at(grid.voxel(c)), share)).filter(|(j, _)| *j > 0.0);
    let (sum, weight) = cells.fold((0.0, 0.0), |(s, w), (j, share)| (s + share * f64::from(j), w + share));
    (weight > 0.0).then(|| sum / weight)
}

/// Pairs of body cells that share a face and whose Jacobians differ by more than [`JUMP`]; one of each is among `high`.
fn jumps(map: &Spans<f32>, cells: &CellKinds, high: impl Iterator<Item = [usize; 3]>) -> usize {
    let size = map.grid().size();
    let mut pairs = BTreeSet::new();
    for v in high {
        for a in 0..3 {
            for forward in [true, false] {
                let mut other = v;
                other[a] = if forward { v[a] + 1 } else { v[a].wrapping_sub(1) };
                if other[a] < size[a] && cells.at(other).body() && (map.at(v) - map.at(other)).abs() > JUMP {
                    pairs.insert((v.min(other), a));
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
        assert_eq!((r.all.cells, r.all.folded), (10, 0));
        assert!((r.all.mean - (6.0 + 2.0 + 2.0 + 26.0 + 2.0) / 10.0).abs() < 1e-5);
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
    fn folds_outside_tissue_are_counted_by_themselves() {
        // A line of voxels, 3 thick; tissue up to x = 5. Beyond, where nothing was computed, one voxel passes the next.
        let grid = Grid::axis_aligned([12, 3, 3], [1.0; 3], [0.0; 3]).unwrap();
        let tissue = Volume::from_fn(grid.clone(), |l| l % 12 <= 5);
        let bones = LabelMap { volume: Volume::filled(grid.clone(), 0), names: BTreeMap::new() };
        let displacement = Volume::from_fn(grid.clone(), |l| if l % 12 == 8 { [1.5, 0.0, 0.0] } else { [0.0; 3] });
        let push = PushField { displacement, computed: tissue.clone() };
        let kinds = CellKinds::new(&tissue, &bones, &[], &[]);
        let (_, r) = evaluate(&push, &kinds);
        // The four cells of 8 to 9, whose corners pass each other; those before it are stretched.
        assert_eq!((r.folded_outside, r.all.folded), (4, 0));
        // Where it moves as one nothing folds; the same fold in tissue is no fold outside.
        let still = PushField { displacement: Volume::filled(grid.clone(), [3.0, 1.0, 0.0]), computed: tissue };
        assert_eq!(evaluate(&still, &kinds).1.folded_outside, 0);
        let all = Volume::filled(grid, true);
        let within = PushField { computed: all.clone(), ..push };
        let r = evaluate(&within, &CellKinds::new(&all, &bones, &[], &[])).1;
        assert_eq!((r.folded_outside, r.all.folded), (0, 4));
    }

    #[test]
    fn cells_across_a_sliding_surface_are_no_folds() {
        // What lies beyond x = 6 slides along y by 7 mm; the voxels next to the surface also pass it.
        let grid = Grid::axis_aligned([14, 12, 3], [1.0; 3], [0.0; 3]).unwrap();
        let region = Volume::from_fn(grid.clone(), |l| l % 14 > 6);
        let displacement = region.map(|inside| if *inside { [-1.5, 7.0, 0.0] } else { [0.0; 3] });
        let all = Volume::filled(grid.clone(), true);
        let bones = LabelMap { volume: Volume::filled(grid, 0), names: BTreeMap::new() };
        let push = PushField { displacement, computed: all.clone() };
        let told = |region| {
            let (_, r) = evaluate(&push, &CellKinds::with_region(&all, &bones, &[], &[], [region; 2]));
            (r.across, r.all.folded, r.folded_outside)
        };
        assert_eq!(told(None), (0, 22, 0));
        assert_eq!(told(Some(&region)), (22, 0, 0));
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
        assert!(without.folded_at.is_some_and(|p| (p.x - 18.0).abs() < 2.0), "{:?}", without.folded_at);
        assert_eq!(with.folded_at, None);
        assert_eq!((with.body.folded, with.interface.folded), (0, without.body.folded));
        assert_eq!(with.body.cells + with.interface.cells, without.body.cells);
        assert_eq!(with.all, without.all);
        assert!(with.digital_folded == 0 && without.digital_folded > 0);
    }
    #[test]
    fn tissue_is_what_lies_in_the_patient_above_its_limit() {
        let grid = Grid::axis_aligned([4, 2, 1], [1.0; 3], [0.0; 3]).unwrap();
        let body = Volume::from_fn(grid.clone(), |l| l % 4 > 0 && l < 4);
        let ct = Volume::from_fn(grid, |l| [40.0, TISSUE_HU, TISSUE_HU + 1.0, 900.0][l % 4]);
        assert_eq!(tissue(&body, &ct).data(), [false, false, true, true, false, false, false, false]);
    }

    #[test]
    fn digital_folds_are_counted_by_what_the_cells_hold() {
        // Bones at 0..=3 and 4..=7 that touch, soft tissue behind; every cell is turned over.
        let grid = Grid::axis_aligned([12, 3, 2], [1.0; 3], [0.0; 3]).unwrap();
        let labels = Volume::from_fn(grid.clone(), |l| match l % 12 {
            0..=3 => 1,
            4..=7 => 2u16,
            _ => 0,
        });
        let bones = LabelMap { volume: labels, names: BTreeMap::new() };
        let rigid = [(1, "a".to_owned()), (2, "b".to_owned())];
        let displacement = Volume::from_fn(grid.clone(), |l| [-2.0 * (l % 12) as f32, 0.0, 0.0]);
        let push = PushField { displacement, computed: Volume::filled(grid.clone(), true) };
        let cells = CellKinds::new(&Volume::filled(grid, true), &bones, &rigid, &[]);
        let (_, report, folds) = with_folds(&push, &cells);
        // Two cells along y, one along z: 3 inside each bone and the edge of the second, one of contact, 3 soft.
        assert_eq!((folds.bone, folds.contact, folds.soft, folds.interface), (14, 2, 6, 0));
        assert_eq!((report.contact.folded, report.soft_tissue.folded, report.body.folded), (2, 6, 20));
    }

    #[test]
    fn a_structure_has_the_volume_that_its_cells_have() {
        let grid = Grid::axis_aligned([10, 4, 4], [1.0; 3], [0.0; 3]).unwrap();
        let volume = Volume::from_fn(grid.clone(), |l| if (3..=5).contains(&(l % 10)) { 7 } else { 0u16 });
        let labels = LabelMap { volume, names: BTreeMap::new() };
        // Cells 3 and 4 lie inside, 2 and 5 by half.
        let map = Volume::from_fn(grid, |l| [1.0f32, 1.0, 2.0, 0.5, 0.5, 2.0, 9.0, 1.0, 1.0, 1.0][l % 10]);
        let map = Spans::of_volume(&map);
        assert!((relative_volume(&map, &labels, 7).unwrap() - (2.0 * 0.5 + 2.0 * 0.5 * 2.0) / 3.0).abs() < 1e-6);
        assert_eq!(relative_volume(&map, &labels, 3), None);
    }
}
