//! Cavities of the patient: airway, sinuses, ear canals, lungs, bowel gas.

use crate::geometry::Grid;
use crate::volume::components::{Components, Connectivity};
use crate::volume::morphology::dilate;
use crate::volume::{Mask, Volume};
use nalgebra::Vector3;

/// The mask, and all air that outside air does not reach through passages wider than twice `radius` mm.
///
/// A cavity that the image's edge cuts (trachea, lung) counts as closed when the mask encloses it within that
/// face of the image, by the same rule.
pub(super) fn cavities(mask: &Mask, radius: f64) -> Mask {
    let mut sealed = mask.clone();
    for axis in 0..3 {
        let last = mask.grid().size()[axis] - 1;
        seal_face(&mut sealed, axis, 0, radius);
        seal_face(&mut sealed, axis, last, radius);
    }
    enclosed_by(&sealed, radius)
}

/// The mask and what balls of air of `radius` mm that come from outside the image do not reach.
fn enclosed_by(mask: &Mask, radius: f64) -> Mask {
    let padded = Padded::new(mask, radius);
    // Centres of balls of air that touch nothing.
    let free = dilate(&padded.mask, radius).map(|&m| !m);
    let parts = Components::of(&free, false, Connectivity::Face);
    let outside = at_edge(&parts, free.grid());
    let reached = dilate(&parts.select(&free, |c| outside[c]), radius);
    let mut out = mask.clone();
    let ni = mask.grid().size()[0];
    for (row, values) in out.data_mut().chunks_mut(ni).enumerate() {
        let from = padded.row(row, mask.grid());
        for (v, r) in values.iter_mut().zip(&reached.data()[from..from + ni]) {
            *v |= !r;
        }
    }
    out
}

/// Which components touch the edge of the image; an axis of one voxel has no edge.
fn at_edge(parts: &Components<bool>, grid: &Grid) -> Vec<bool> {
    let mut out = vec![false; parts.len()];
    let ends = |a: usize, low: usize, high: usize| {
        let n = grid.size()[a];
        n > 1 && (low == 0 || high + 1 == n)
    };
    for run in &parts.runs {
        let ([i, j, k], [last, ..]) = (grid.voxel(run.start), grid.voxel(run.end - 1));
        out[run.component] |= ends(0, i, last) || ends(1, j, j) || ends(2, k, k);
    }
    out
}

/// A mask continued beyond its edge as it is there, except along axes of one voxel.
struct Padded {
    mask: Mask,
    pad: [usize; 3],
}

impl Padded {
    fn new(mask: &Mask, radius: f64) -> Self {
        let grid = mask.grid();
        let [ni, nj, nk] = grid.size();
        let pad = std::array::from_fn(|a| match grid.size()[a] {
            1 => 0,
            _ => (radius / grid.spacing()[a]).ceil() as usize + 1,
        });
        let size: [usize; 3] = std::array::from_fn(|a| grid.size()[a] + 2 * pad[a]);
        let origin = grid.world(&-Vector3::from(pad.map(|p| p as f64)));
        let bigger = Grid::new(size, grid.spacing(), origin, *grid.direction())
            .expect("a valid grid stays valid with more voxels");
        let nearest = |at: usize, a: usize, n: usize| at.saturating_sub(pad[a]).min(n - 1);
        let mut data = Vec::with_capacity(bigger.len());
        for row in 0..size[1] * size[2] {
            let (j, k) = (nearest(row % size[1], 1, nj), nearest(row / size[1], 2, nk));
            let values = &mask.data()[(j + nj * k) * ni..][..ni];
            data.resize(data.len() + pad[0], values[0]);
            data.extend_from_slice(values);
            data.resize(data.len() + pad[0], values[ni - 1]);
        }
        let mask = Volume::new(bigger, data).expect("each row has the padded length");
        Self { mask, pad }
    }

    /// Storage position in the padded grid where a row of the original grid begins.
    fn row(&self, row: usize, original: &Grid) -> usize {
        let nj = original.size()[1];
        self.mask.grid().linear([self.pad[0], row % nj + self.pad[1], row / nj + self.pad[2]])
    }
}

/// Sets what the mask encloses within slice `n` across `axis`.
pub(super) fn seal_face(mask: &mut Mask, axis: usize, n: usize, radius: f64) {
    let grid = mask.grid();
    let mut size = grid.size();
    size[axis] = 1;
    let flat = Grid::new(size, grid.spacing(), grid.origin(), *grid.direction())
        .expect("a slice of a valid grid is a valid grid");
    let shift = n * grid.strides()[axis];
    let whole: Vec<usize> = (0..flat.len()).map(|l| grid.linear(flat.voxel(l)) + shift).collect();
    let slice = Volume::from_fn(flat, |l| mask.data()[whole[l]]);
    for (l, set) in whole.into_iter().zip(enclosed_by(&slice, radius).into_data()) {
        mask.data_mut()[l] = set;
    }
}
