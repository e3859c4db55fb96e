//! Fraction voxels with more than one pre-image: those inside a tetrahedron that the push field turned inside out.
//!
//! A map that covers space once and folds covers the fold three times, once with negative orientation; so the voxels
//! inside inverted tetrahedra are those whose pre-image is not unique.

use super::super::PushField;
use super::jacobian::FOLDED;
use super::tetrahedra::{CellSide, cover};
use crate::geometry::Grid;
use crate::volume::{Mask, Spans, Volume};

/// Mask on the fraction grid of voxels with several pre-images. `map` is the Jacobian map of `push`; `region` slides along its border,
/// where the field jumps: a cell that reaches across is none of tissue.
pub fn multiple_preimages(push: &PushField, map: &Spans<f32>, fraction: &Grid, region: Option<&Mask>) -> Mask {
    let grid = push.displacement.grid();
    let mut out = Volume::filled(fraction.clone(), false);
    let [_, nj, nk] = grid.size();
    let corners = grid.cell_corners();
    let across = |cell: usize| region.is_some_and(|r| corners.iter().any(|c| r.data()[cell + c] != r.data()[cell]));
    for row in 0..nj * nk {
        let (cells, values) = map.row(row);
        let first = row * grid.size()[0];
        for (i, _) in cells.zip(values).filter(|(i, j)| **j <= FOLDED && !across(first + i)) {
            cover(push, [i, row % nj, row / nj], fraction, CellSide::Inverted, |voxel| out.data_mut()[voxel] = true);
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::field::jacobian;

    #[test]
    fn a_fold_covers_its_middle_three_times() {
        let grid = Grid::axis_aligned([41, 5, 5], [1.0; 3], [-20.0, 0.0, 0.0]).unwrap();
        // x + u(x) = x - 12 tanh(x / 6): folds between the turning points at +-6 acosh(sqrt 2), images -+3.1.
        let displacement =
            Volume::from_fn(grid.clone(), |l| [-12.0 * ((grid.voxel(l)[0] as f32 - 20.0) / 6.0).tanh(), 0.0, 0.0]);
        let push = PushField { displacement, computed: Volume::filled(grid.clone(), true) };
        let mask = multiple_preimages(&push, &jacobian(&push), &grid, None);
        for i in 0..41 {
            assert_eq!(*mask.at([i, 2, 2]), (i as i32 - 20).abs() <= 3, "voxel {i}");
        }
        // Across a surface along which tissue slides nothing is folded.
        let region = Volume::from_fn(grid.clone(), |l| grid.voxel(l)[0].is_multiple_of(2));
        assert_eq!(multiple_preimages(&push, &jacobian(&push), &grid, Some(&region)).count(), 0);
        let flat = PushField { displacement: Volume::filled(grid.clone(), [1.0, 0.0, 0.0]), ..push };
        assert_eq!(multiple_preimages(&flat, &jacobian(&flat), &grid, None).count(), 0);
    }
}
