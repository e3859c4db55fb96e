//! What the cells of the planning grid hold, by the bones and tissue at their corners.

use super::interface::Interfaces;
use crate::geometry::{Grid, vectorised};
use crate::volume::{LabelMap, Mask, Volume};
use rayon::prelude::*;
use std::ops::Range;

/// What a cell holds, by its 8 corners.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Cell {
    /// A corner that is not tissue, or no cell at all.
    Outside,
    /// No bone.
    Soft,
    /// Partly one bone.
    Edge,
    /// Wholly one bone, by its index.
    Inside(u16),
    /// Two or more bones.
    Contact,
    /// At most one bone, where two bones slide on each other, or an organ along the wall.
    Interface,
    /// Corners on both sides of where tissue slides: the field jumps there, and no tissue fills the cell.
    Across,
}

impl Cell {
    /// Whether the field is to be smooth here.
    pub(super) fn body(self) -> bool {
        !matches!(self, Self::Outside | Self::Contact | Self::Interface | Self::Across)
    }
}

/// What the cells of a planning grid hold: the same for all fields on it.
///
/// Cells of one kind lie together in rows, so runs of them are kept instead of cells.
#[derive(Debug, Clone)]
pub struct CellKinds {
    grid: Grid,
    /// Names of the bones, by index.
    pub(super) names: Vec<String>,
    /// Runs of the rows, in storage order; cells between them lie outside.
    runs: Vec<CellRun>,
    /// Where each row of cells begins in `runs`, and the end.
    rows: Vec<usize>,
}

/// Neighbouring cells of a row that hold the same.
#[derive(Debug, Clone, Copy)]
struct CellRun {
    /// Along the row.
    first: u32,
    end: u32,
    kind: Cell,
}

impl CellKinds {
    /// The cells of the grid of `tissue`, which says which voxels are body above -500 HU. `rigid` lists label and name of each
    /// rigid bone of `bones`, other labels count as soft tissue; labels of the same name are one bone. `sliding` are pairs of
    /// labels that slide on each other, with the reach of the interface in mm. All on the planning grid.
    pub fn new(tissue: &Mask, bones: &LabelMap, rigid: &[(u16, String)], sliding: &[([u16; 2], f64)]) -> Self {
        Self::with_region(tissue, bones, rigid, sliding, [None; 2])
    }

    /// As [`CellKinds::new`]; `region` slides along its border, and the field jumps along that of `jumps`.
    pub fn with_region(
        tissue: &Mask,
        bones: &LabelMap,
        rigid: &[(u16, String)],
        sliding: &[([u16; 2], f64)],
        [region, jumps]: [Option<&Mask>; 2],
    ) -> Self {
        let (names, bone_of) = index_bones(rigid);
        let interfaces = Interfaces::new(bones, |l| bone_of[usize::from(l)] > 0, sliding, region);
        let grid = tissue.grid().clone();
        let [_, nj, nk] = grid.size();
        let look = Look {
            grid: &grid,
            tissue: tissue.data(),
            labels: bones.volume.data(),
            bone_of: &bone_of,
            interfaces,
            jumps: jumps.map(Volume::data),
        };
        let planes: Vec<(Vec<CellRun>, Vec<usize>)> = (0..nk).into_par_iter().map(|k| look.plane(k)).collect();
        let (mut runs, mut rows) =
            (Vec::with_capacity(planes.iter().map(|p| p.0.len()).sum()), Vec::with_capacity(nj * nk + 1));
        for (of_plane, begins) in planes {
            rows.extend(begins.into_iter().map(|begin| runs.len() + begin));
            runs.extend(of_plane);
        }
        rows.push(runs.len());
        Self { grid, names, runs, rows }
    }

    /// The runs of a row of cells: where each lies along it, and what it holds.
    pub(super) fn row(&self, row: usize) -> impl Iterator<Item = (Range<usize>, Cell)> + Clone + '_ {
        self.of_row(row).iter().map(|r| (r.first as usize..r.end as usize, r.kind))
    }

    fn of_row(&self, row: usize) -> &[CellRun] {
        &self.runs[self.rows[row]..self.rows[row + 1]]
    }

    /// From the first to the last cell of a row that is not outside.
    pub(super) fn extent(&self, row: usize) -> Range<usize> {
        let of_row = self.of_row(row);
        let ends = of_row.first().zip(of_row.last());
        ends.map_or(0..0, |(first, last)| first.first as usize..last.end as usize)
    }

    /// All rows, in storage order.
    pub(super) fn rows(&self) -> Range<usize> {
        0..self.rows.len() - 1
    }

    /// j and k of a row.
    pub(super) fn place_of(&self, row: usize) -> [usize; 2] {
        let nj = self.grid.size()[1];
        [row % nj, row / nj]
    }

    /// What the cell with this lowest corner holds.
    pub(super) fn at(&self, [i, j, k]: [usize; 3]) -> Cell {
        let row = j + k * self.grid.size()[1];
        let of_row = self.of_row(row);
        let holds = of_row.iter().find(|r| (r.first as usize..r.end as usize).contains(&i));
        holds.map_or(Cell::Outside, |r| r.kind)
    }
}

/// Names of the bones, and for each label its bone's index plus one; 0 for labels that are no bones.
fn index_bones(rigid: &[(u16, String)]) -> (Vec<String>, Vec<u16>) {
    let mut names: Vec<String> = Vec::new();
    let mut bone_of = vec![0u16; usize::from(u16::MAX) + 1];
    for (label, name) in rigid.iter().filter(|(label, _)| *label != 0) {
        let at = names.iter().position(|n| n == name).unwrap_or_else(|| {
            names.push(name.clone());
            names.len() - 1
        });
        bone_of[usize::from(*label)] = at as u16 + 1;
    }
    (names, bone_of)
}

/// What the kinds of cells are found from.
struct Look<'a> {
    grid: &'a Grid,
    tissue: &'a [bool],
    labels: &'a [u16],
    /// A label's bone plus one.
    bone_of: &'a [u16],
    interfaces: Option<Interfaces>,
    /// The field jumps along its border.
    jumps: Option<&'a [bool]>,
}

impl Look<'_> {
    /// The runs of the cells between planes `k` and `k + 1`, and where each row begins in them.
    fn plane(&self, k: usize) -> (Vec<CellRun>, Vec<usize>) {
        let [ni, nj, nk] = self.grid.size();
        let (mut runs, mut rows) = (Vec::new(), Vec::with_capacity(nj));
        if k + 1 == nk {
            return (runs, vec![0; nj]);
        }
        // Columns of four voxels, between which the cells of a row lie.
        let (mut solid, mut labelled, mut sides) = (vec![false; ni], vec![0; ni], vec![0; ni]);
        let [_, up, above] = self.grid.strides();
        for j in 0..nj - 1 {
            rows.push(runs.len());
            let start = self.grid.linear([0, j, k]);
            let corners = [0, up, above, above + up].map(|o| start + o);
            if vectorised(
                #[inline(always)]
                || columns(&mut solid, corners.map(|c| &self.tissue[c..][..ni]), |a, b| a & b),
            ) {
                vectorised(
                    #[inline(always)]
                    || columns(&mut labelled, corners.map(|c| &self.labels[c..][..ni]), |a, b| a | b),
                );
                if let Some(region) = self.jumps {
                    let inside = |i: usize| corners.iter().filter(|c| region[**c + i]).count() as u8;
                    sides.iter_mut().enumerate().for_each(|(i, side)| *side = inside(i));
                }
                self.row([j, k], &solid, &labelled, &sides, &mut runs);
            }
        }
        rows.push(runs.len());
        (runs, rows)
    }

    /// Adds the runs of a row of cells; `sides`: how many of a column's four voxels slide.
    fn row(&self, [j, k]: [usize; 2], solid: &[bool], labelled: &[u16], sides: &[u8], runs: &mut Vec<CellRun>) {
        let mut open: Option<CellRun> = None;
        let pairs = solid.iter().zip(&solid[1..]).zip(labelled.iter().zip(&labelled[1..])).enumerate();
        for (i, ((a, b), (p, q))) in pairs {
            let kind = match a & b {
                _ if !matches!(sides[i] + sides[i + 1], 0 | 8) => Cell::Across,
                false => Cell::Outside,
                true if p | q == 0 => self.where_it_slides(Cell::Soft, [i, j, k]),
                true => self.kind([i, j, k]),
            };
            if open.is_some_and(|run| run.kind == kind) {
                continue;
            }
            runs.extend(open.take().map(|run| CellRun { end: i as u32, ..run }));
            open = (kind != Cell::Outside).then_some(CellRun { first: i as u32, end: 0, kind });
        }
        runs.extend(open.map(|run| CellRun { end: solid.len() as u32 - 1, ..run }));
    }

    /// The kind of a cell of tissue.
    fn kind(&self, cell: [usize; 3]) -> Cell {
        let low = self.grid.linear(cell);
        self.where_it_slides(
            kind(self.grid.cell_corners().map(|c| self.bone_of[usize::from(self.labels[low + c])])),
            cell,
        )
    }

    /// The same kind, or [`Cell::Interface`].
    fn where_it_slides(&self, kind: Cell, cell: [usize; 3]) -> Cell {
        let open = matches!(kind, Cell::Soft | Cell::Edge);
        if open && self.interfaces.as_ref().is_some_and(|s| s.holds(cell)) { Cell::Interface } else { kind }
    }
}

/// Joins the values of four rows; tells whether any differs from the default.
#[inline(always)]
fn columns<T: Copy + Default + PartialEq>(out: &mut [T], [a, b, c, d]: [&[T]; 4], join: impl Fn(T, T) -> T) -> bool {
    let mut any = false;
    for ((((out, a), b), c), d) in out.iter_mut().zip(a).zip(b).zip(c).zip(d) {
        *out = join(join(*a, *b), join(*c, *d));
        any |= *out != T::default();
    }
    any
}

/// The kind of a tissue cell from its corners' bones (0: none).
fn kind(corners: [u16; 8]) -> Cell {
    let most = corners.into_iter().fold(0, u16::max);
    match corners.into_iter().filter(|&b| b > 0).min() {
        None => Cell::Soft,
        Some(least) if least != most => Cell::Contact,
        Some(_) if corners.contains(&0) => Cell::Edge,
        Some(bone) => Cell::Inside(bone - 1),
    }
}
