//! The patient in a CT of fine voxels: found on coarser ones, with the skin where the fine ones have it.

use crate::geometry::Grid;
use crate::volume::{COARSE_MM, Mask, Volume};
use nalgebra::Point3;
use rayon::prelude::*;
use std::ops::Range;

/// Voxels finer than this along any axis show no more of the patient than ones of [`COARSE_MM`], mm.
const FINE_MM: f64 = 0.75;
/// Between these shares of coarse voxels that are patient, the fine voxel itself decides.
const EDGE: Range<f32> = 0.25..0.75;

/// The grid on which the patient is looked for, where it is coarser than that of the CT.
pub(super) fn grid(own: &Grid) -> Option<Grid> {
    own.spacing().iter().any(|s| *s <= FINE_MM).then(|| own.coarsened(COARSE_MM))
}

/// Means over the voxels of a CT that lie nearest to each voxel of a coarser grid.
pub(super) fn means(ct: &Volume<f32>, coarse: &Grid) -> Volume<f32> {
    let fine = ct.grid();
    let [xs, ys, zs] = [0, 1, 2].map(|a| {
        let last = fine.size()[a] - 1;
        let ranges = fine.voxels_by_nearest(coarse, a).into_iter();
        // Where the coarse grid reaches beyond, the nearest voxel counts.
        let filled = |r: Range<usize>| if r.is_empty() { r.start.min(last)..r.start.min(last) + 1 } else { r };
        ranges.map(filled).collect::<Vec<_>>()
    });
    let [ni, nj, _] = fine.size();
    let mut out = Volume::filled(coarse.clone(), 0f32);
    out.data_mut().par_chunks_mut(xs.len() * ys.len()).zip(&zs).for_each(|(plane, z)| {
        for (row, y) in plane.chunks_mut(xs.len()).zip(&ys) {
            let mut sums = vec![0f64; xs.len()];
            for (k, j) in z.clone().flat_map(|k| y.clone().map(move |j| (k, j))) {
                let values = &ct.data()[(j + nj * k) * ni..][..ni];
                for (sum, x) in sums.iter_mut().zip(&xs) {
                    *sum += values[x.clone()].iter().map(|v| f64::from(*v)).sum::<f64>();
                }
            }
            for ((out, sum), x) in row.iter_mut().zip(&sums).zip(&xs) {
                *out = (sum / (x.len() * y.len() * z.len()) as f64) as f32;
            }
        }
    });
    out
}

/// The patient on a fine grid: where coarse voxels around a voxel agree they decide, else whether it is `solid`.
pub(super) fn refined(found: &Mask, fine: &Grid, solid: impl Fn(usize) -> bool + Sync) -> Mask {
    let coarse = found.grid();
    // Directions are the same: each axis by itself.
    let [xs, ys, zs] = [0, 1, 2].map(|a| {
        let at = |n: usize| {
            let mut voxel = [0; 3];
            voxel[a] = n;
            let p: Point3<f64> = fine.centre(voxel);
            let at = coarse.index(&p)[a].clamp(0.0, (coarse.size()[a] - 1) as f64);
            let low = (at.floor() as usize).min(coarse.size()[a].saturating_sub(2));
            (low, (low + 1).min(coarse.size()[a] - 1), (at - low as f64) as f32)
        };
        (0..fine.size()[a]).map(at).collect::<Vec<_>>()
    });
    let [ni, nj, _] = coarse.size();
    let row_of = |j: usize, k: usize| &found.data()[(j + nj * k) * ni..][..ni];
    let mut body = Volume::filled(fine.clone(), false);
    let plane = xs.len() * ys.len();
    body.data_mut().par_chunks_mut(plane).zip(&zs).enumerate().for_each_init(
        || vec![0f32; ni],
        |between, (k, (out, (k0, k1, w)))| {
            for (j, (row, (j0, j1, v))) in out.chunks_mut(xs.len()).zip(&ys).enumerate() {
                let rows = [(*j0, *k0, (1.0 - v) * (1.0 - w)), (*j1, *k0, v * (1.0 - w))];
                let more = [(*j0, *k1, (1.0 - v) * w), (*j1, *k1, v * w)];
                between.fill(0.0);
                for (j, k, weight) in rows.into_iter().chain(more) {
                    between.iter_mut().zip(row_of(j, k)).for_each(|(b, m)| *b += if *m { weight } else { 0.0 });
                }
                let first = plane * k + xs.len() * j;
                for (i, (out, (i0, i1, u))) in row.iter_mut().zip(&xs).enumerate() {
                    let share = between[*i0] * (1.0 - u) + between[*i1] * u;
                    *out = share >= EDGE.end || share > EDGE.start && solid(first + i);
                }
            }
        },
    );
    body
}
