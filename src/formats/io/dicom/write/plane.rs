//! A grid as DICOM's planes: orientation, columns and rows, and the order of frames along the normal.

use crate::error::{Error, Result};
use crate::geometry::Grid;
use std::path::Path;

/// Direction cosines of a grid's first two axes.
pub(in crate::io::dicom) fn orientation(grid: &Grid) -> [f64; 6] {
    let d = grid.direction();
    [d[(0, 0)], d[(1, 0)], d[(2, 0)], d[(0, 1)], d[(1, 1)], d[(2, 1)]]
}

/// Columns and rows of a grid's slices.
pub(in crate::io::dicom) fn plane_size(path: &Path, grid: &Grid) -> Result<[u16; 2]> {
    let [columns, rows, _] = grid.size();
    match (columns.try_into(), rows.try_into()) {
        (Ok(columns), Ok(rows)) => Ok([columns, rows]),
        _ => {
            let problem = format!("DICOM has no images of {columns} columns and {rows} rows, more than 65535");
            Err(Error::write(path, problem, "choose a coarser grid"))
        }
    }
}

/// The slices of a grid in the order of the normal of their rows and columns.
#[derive(Debug, Clone, Copy)]
pub(in crate::io::dicom) struct Frames {
    slices: usize,
    voxels: usize,
    backwards: bool,
}

impl Frames {
    /// Of a grid, whose third axis runs along the normal or against it.
    pub(in crate::io::dicom) fn of(grid: &Grid) -> Self {
        let backwards = grid.direction().determinant() < 0.0;
        Self { slices: grid.size()[2], voxels: grid.strides()[2], backwards }
    }

    /// The slice that comes first.
    pub(in crate::io::dicom) fn first(self) -> usize {
        if self.backwards { self.slices - 1 } else { 0 }
    }

    /// All slices.
    pub(in crate::io::dicom) fn order(self) -> impl Iterator<Item = usize> {
        (0..self.slices).map(move |k| if self.backwards { self.slices - 1 - k } else { k })
    }

    /// Values of slice `k`.
    pub(in crate::io::dicom) fn values<T>(self, all: &[T], k: usize) -> &[T] {
        &all[k * self.voxels..][..self.voxels]
    }
}
