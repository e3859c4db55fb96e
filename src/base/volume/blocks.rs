//! Blocks of voxels and their means: what is blurred anyway needs no finer ones.

use super::Volume;
use crate::geometry::Grid;
use nalgebra::Vector3;
use rayon::prelude::*;

/// Voxels this wide, mm, show soft tissue and bone as well as finer ones once they are blurred.
pub const COARSE_MM: f64 = 1.5;

/// Voxels along each axis in the widest block of at most `widest` mm, and of one voxel at least.
pub fn block_within(grid: &Grid, widest: f64) -> [usize; 3] {
    grid.spacing().map(|s| ((widest / s).floor() as usize).max(1))
}

/// What is left of a blur of `sigma` mm after blocks have blurred as well (variance of a box), mm.
pub fn blur_after(grid: &Grid, block: [usize; 3], sigma: f64) -> f64 {
    let grown = (0..3).map(|a| (grid.spacing()[a] * block[a] as f64).powi(2) - grid.spacing()[a].powi(2));
    (sigma * sigma - grown.fold(0.0, f64::max) / 12.0).max(0.0).sqrt()
}

/// The grid of the blocks' middles. The last block of an axis may reach beyond the grid.
pub fn blocks(fine: &Grid, block: [usize; 3]) -> Grid {
    let size = std::array::from_fn(|a| fine.size()[a].div_ceil(block[a]));
    let shift = Vector3::from(block.map(|b| 0.5 * (b as f64 - 1.0)));
    let spacing = std::array::from_fn(|a| fine.spacing()[a] * block[a] as f64);
    Grid::new(size, spacing, fine.world(&shift), *fine.direction()).expect("blocks of a legal grid make a legal grid")
}

/// Means over blocks of two figures of each voxel, on the grid of [`blocks`]; `of` is given a voxel's place in storage and value.
pub fn block_means(
    image: &Volume<f32>,
    block: [usize; 3],
    of: impl Fn(usize, f32) -> [f32; 2] + Sync,
) -> [Volume<f32>; 2] {
    let fine = image.grid();
    let grid = blocks(fine, block);
    let size = grid.size();
    let plane = size[0] * size[1];
    let (mut first, mut second) = (vec![0f32; grid.len()], vec![0f32; grid.len()]);
    let of_plane = |tally: &mut Vec<[f32; 3]>, k: usize, (first, second): (&mut [f32], &mut [f32])| {
        tally.clear();
        tally.resize(plane, [0.0; 3]);
        for fk in k * block[2]..((k + 1) * block[2]).min(fine.size()[2]) {
            for fj in 0..fine.size()[1] {
                let start = fine.linear([0, fj, fk]);
                let row = &image.data()[start..start + fine.size()[0]];
                let tallies = &mut tally[size[0] * (fj / block[1])..];
                for (n, (sum, voxels)) in tallies.iter_mut().zip(row.chunks(block[0])).enumerate() {
                    for (i, v) in voxels.iter().enumerate() {
                        let [a, b] = of(start + n * block[0] + i, *v);
                        *sum = [sum[0] + a, sum[1] + b, sum[2] + 1.0];
                    }
                }
            }
        }
        for ((a, b), sum) in first.iter_mut().zip(second).zip(tally) {
            (*a, *b) = (sum[0] / sum[2], sum[1] / sum[2]);
        }
    };
    let planes = first.par_chunks_mut(plane).zip(second.par_chunks_mut(plane)).enumerate();
    planes.for_each_init(Vec::new, |tally, (k, out)| of_plane(tally, k, out));
    [first, second].map(|data| Volume::new(grid.clone(), data).expect("one value per block"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Point3;

    #[test]
    fn means_lie_where_their_voxels_do() {
        let grid = Grid::axis_aligned([7, 4, 6], [0.5, 0.7, 2.0], [3.0, -5.0, 8.0]).unwrap();
        let block = block_within(&grid, 1.5);
        assert_eq!(block, [3, 2, 1]);
        let slope = |p: &Point3<f64>| (2.0 * p.x - 3.0 * p.y + 0.5 * p.z) as f32;
        let image = Volume::from_fn(grid.clone(), |l| slope(&grid.centre(grid.voxel(l))));
        let [mean, odd] = block_means(&image, block, |l, v| [v, (l % 2) as f32]);
        let coarse = mean.grid();
        assert_eq!(coarse.size(), [3, 2, 6]);
        for l in 0..coarse.len() {
            let at = coarse.voxel(l);
            // Of the last block along i only one voxel is in the image.
            if at[0] < 2 {
                assert!((mean.data()[l] - slope(&coarse.centre(at))).abs() < 1e-4, "{at:?}");
            } else {
                let left = [6, 13].map(|n| image.data()[n + 14 * at[1] + 28 * at[2]]);
                assert!((mean.data()[l] - (left[0] + left[1]) / 2.0).abs() < 1e-4, "{at:?}");
            }
        }
        assert!(odd.data().iter().all(|share| (0.0..=1.0).contains(share)));
    }
}
