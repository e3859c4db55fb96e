//! Images as the search and descriptors see them: means of blocks, and which of them were measured.

use crate::geometry::Grid;
use crate::volume::{Volume, blocks};
use rayon::prelude::*;

/// Width of a block, mm.
pub const BLOCK_MM: f64 = 4.0;
/// HU outside of this range count as its ends: air and fat of little weight, teeth as bone.
const RANGE_HU: [f32; 2] = [-150.0, 900.0];

/// Block means of a CT.
#[derive(Debug, Clone)]
pub struct Coarse {
    /// Mean HU of what was measured, cut to a range.
    pub value: Volume<f32>,
    /// Whether more than half of a block was measured: a scan is filled up with its least value.
    pub seen: Vec<bool>,
}

/// Voxels of a grid that make a block about so wide (mm), along each axis.
pub fn block(grid: &Grid, width_mm: f64) -> [usize; 3] {
    grid.spacing().map(|s| ((width_mm / s).round() as usize).max(1))
}

/// For each block what `of` makes of the positions of its voxels.
pub fn of_blocks<T: Send>(fine: &Grid, block: [usize; 3], grid: &Grid, of: impl Fn(&[usize]) -> T + Sync) -> Vec<T> {
    let each = |voxels: &mut Vec<usize>, l: usize| {
        voxels.clear();
        let at = grid.voxel(l);
        let end = |a: usize| ((at[a] + 1) * block[a]).min(fine.size()[a]);
        for k in at[2] * block[2]..end(2) {
            for j in at[1] * block[1]..end(1) {
                let row = fine.linear([at[0] * block[0], j, k]);
                voxels.extend(row..row + end(0) - at[0] * block[0]);
            }
        }
        of(voxels)
    };
    (0..grid.len()).into_par_iter().map_init(Vec::new, each).collect()
}

impl Coarse {
    /// The blocks of a CT (HU).
    pub fn new(ct: &Volume<f32>) -> Self {
        let [least, _] = ct.extremes();
        let block = block(ct.grid(), BLOCK_MM);
        let grid = blocks(ct.grid(), block);
        let of = |voxels: &[usize]| {
            let measured = voxels.iter().map(|&v| ct.data()[v]).filter(|v| *v > least);
            let (sum, n) = measured.fold((0.0, 0), |(s, n), v| (s + v.clamp(RANGE_HU[0], RANGE_HU[1]), n + 1));
            (if n > 0 { sum / n as f32 } else { RANGE_HU[0] }, 2 * n > voxels.len())
        };
        let (values, seen) = of_blocks(ct.grid(), block, &grid, of).into_iter().unzip();
        Self { value: Volume::new(grid, values).expect("one value per block"), seen }
    }
}
