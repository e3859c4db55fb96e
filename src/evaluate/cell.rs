//! What the cells of the planning grid hold, by the bones and tissue at their corners.

use super::interface::Interfaces;
use crate::geometry::Grid;
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
    /// At most one bone, where two bones slide on each other.
    Interface,
}

impl Cell {
    /// Whether the field is to be smooth here.
    pub(super) fn body(self) -> bool {
        !matches!(self, Self::Outside | Self::Contact | Self::Interface)
    }
}

/// Names of the bones, and for each label its bone's index plus one; 0 for labels that are no bones.
pub(super) fn index_bones(rigid: &[(u16, String)]) -> (Vec<String>, Vec<u16>) {
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

/// The kind of each cell, at its lowest-index corner, where `rigid` are the bones and `sliding` pairs of their labels
/// with their reach in mm.
pub(super) fn kinds(
    tissue: &Mask,
    bones: &LabelMap,
    rigid: &[(u16, String)],
    sliding: &[([u16; 2], f64)],
) -> Volume<Cell> {
    let bone_of = index_bones(rigid).1;
    let kinds = Kinds::new(tissue, bones, &bone_of, sliding);
    let mut out = Volume::filled(tissue.grid().clone(), Cell::Outside);
    let [ni, nj, _] = tissue.grid().size();
    out.data_mut().par_chunks_mut(ni).enumerate().for_each(|(row, cells)| {
        kinds.row(row % nj, row / nj, cells);
    });
    out
}

/// The kinds of cells, row by row.
pub(super) struct Kinds<'a> {
    grid: &'a Grid,
    corners: [usize; 8],
    tissue: &'a [bool],
    labels: &'a [u16],
    bone_of: &'a [u16],
    interfaces: Option<Interfaces>,
}

impl<'a> Kinds<'a> {
    pub(super) fn new(tissue: &'a Mask, bones: &'a LabelMap, bone_of: &'a [u16], sliding: &[([u16; 2], f64)]) -> Self {
        let interfaces = Interfaces::new(bones, |l| bone_of[usize::from(l)] > 0, sliding);
        let grid = tissue.grid();
        let labels = bones.volume.data();
        Self { grid, corners: grid.cell_corners(), tissue: tissue.data(), labels, bone_of, interfaces }
    }

    /// Fills the row of cells (j, k) from the first column of tissue to the last, and returns which cells these are: the others
    /// lie outside, and are left as they were.
    pub(super) fn row(&self, j: usize, k: usize, cells: &mut [Cell]) -> Range<usize> {
        let [ni, nj, nk] = self.grid.size();
        if j + 1 == nj || k + 1 == nk {
            return 0..0;
        }
        let start = self.grid.linear([0, j, k]);
        let [_, up, above] = self.grid.strides();
        let rows = [0, up, above, above + up].map(|o| start + o);
        let [a, b, c, d] = rows.map(|r| &self.tissue[r..][..ni]);
        let solid = || a.iter().zip(b).zip(c).zip(d).map(|(((a, b), c), d)| a & b & c & d);
        if !solid().fold(false, |any, column| any | column) {
            return 0..0;
        }
        let first = solid().position(|column| column).unwrap_or(ni);
        let last = solid().rposition(|column| column).unwrap_or(0);
        let [p, q, r, s] = rows.map(|r| &self.labels[r..][..ni]);
        let column = |i: usize| (a[i] & b[i] & c[i] & d[i], p[i] | q[i] | r[i] | s[i]);
        // A cell lies between one column of voxels and the next.
        let mut before = column(first);
        for (i, cell) in (first..last).zip(&mut cells[first..]) {
            let next = column(i + 1);
            *cell = match before.0 & next.0 {
                false => Cell::Outside,
                true if before.1 | next.1 == 0 => self.where_it_slides(Cell::Soft, [i, j, k]),
                true => self.kind([i, j, k]),
            };
            before = next;
        }
        first..last
    }

    /// The kind of the cell with this lowest corner.
    pub(super) fn at(&self, cell: [usize; 3]) -> Cell {
        let low = self.grid.linear(cell);
        let tissue =
            (0..3).all(|a| cell[a] + 1 < self.grid.size()[a]) && self.corners.iter().all(|c| self.tissue[low + c]);
        if tissue { self.kind(cell) } else { Cell::Outside }
    }

    /// The kind of a cell of tissue.
    fn kind(&self, cell: [usize; 3]) -> Cell {
        let low = self.grid.linear(cell);
        self.where_it_slides(kind(self.corners.map(|c| self.bone_of[usize::from(self.labels[low + c])])), cell)
    }

    /// The same kind, or [`Cell::Interface`].
    fn where_it_slides(&self, kind: Cell, cell: [usize; 3]) -> Cell {
        let open = matches!(kind, Cell::Soft | Cell::Edge);
        if open && self.interfaces.as_ref().is_some_and(|s| s.holds(cell)) { Cell::Interface } else { kind }
    }
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
