//! Gaussian smoothing with a width in mm, so that images on different grids are blurred alike.

use super::Volume;
use crate::geometry::vectorised;
use rayon::prelude::*;

/// Smooths with a Gaussian of standard deviation `sigma` mm along every axis; values are continued at the edges.
///
/// An axis whose spacing exceeds three sigma is left as it is: the sampled kernel would be a single voxel.
pub fn gaussian(volume: &Volume<f32>, sigma: f64) -> Volume<f32> {
    let [nx, ny, nz] = volume.grid().size();
    let [across, down, through] = volume.grid().spacing().map(|s| kernel(sigma / s));
    let plane = nx * ny;
    let mut out = vec![0f32; volume.data().len()];
    // Plane by plane, so that only the result is as large as the image: between planes first, the rest in the cache.
    out.par_chunks_mut(plane).enumerate().for_each_init(Vec::new, |spare: &mut Vec<f32>, (k, out)| {
        vectorised(
            #[inline(always)]
            || {
                let source = |k: usize| &volume.data()[k * plane..][..plane];
                sum_lines(out, &through, (k, nz), source);
                if down.len() > 1 {
                    spare.resize(plane, 0.0);
                    for (j, row) in spare.chunks_mut(nx).enumerate() {
                        sum_lines(row, &down, (j, ny), |j| &out[j * nx..][..nx]);
                    }
                    out.copy_from_slice(spare);
                }
                if across.len() > 1 {
                    spare.clear();
                    spare.extend_from_slice(out);
                    out.chunks_mut(nx).zip(spare.chunks(nx)).for_each(|(row, from)| along_row(row, from, &across));
                }
            },
        )
    });
    Volume::new(volume.grid().clone(), out).expect("same grid, same length")
}

/// Normalised half kernel, centre first, cut at three sigma.
fn kernel(sigma_voxels: f64) -> Vec<f32> {
    if sigma_voxels <= 0.0 {
        return vec![1.0];
    }
    let half = (3.0 * sigma_voxels).floor() as usize;
    let raw: Vec<f64> = (0..=half).map(|i| (-0.5 * (i as f64 / sigma_voxels).powi(2)).exp()).collect();
    let sum = raw[0] + 2.0 * raw[1..].iter().sum::<f64>();
    raw.iter().map(|v| (v / sum) as f32).collect()
}

/// The convolution at line `at` of `count`; `line` gives the lines.
///
/// Memory that is fresh from the system must be written before it is read: else every page of it faults twice.
#[inline(always)]
fn sum_lines<'a>(out: &mut [f32], kernel: &[f32], (at, count): (usize, usize), line: impl Fn(usize) -> &'a [f32]) {
    for (d, &w) in kernel.iter().enumerate() {
        let (before, after) = (line(at.saturating_sub(d)), line((at + d).min(count - 1)));
        if d == 0 {
            out.iter_mut().zip(before).for_each(|(o, b)| *o = w * b);
        } else {
            out.iter_mut().zip(before).zip(after).for_each(|((o, b), a)| *o += w * (b + a));
        }
    }
}

/// Convolution of a row.
#[inline(always)]
fn along_row(out: &mut [f32], from: &[f32], kernel: &[f32]) {
    let (n, reach) = (from.len(), kernel.len() - 1);
    let held = |i: usize| {
        let pair = |(d, w): (usize, &f32)| w * (from[i.saturating_sub(d)] + from[(i + d).min(n - 1)]);
        kernel[0] * from[i] + kernel.iter().enumerate().skip(1).map(pair).sum::<f32>()
    };
    if n <= 2 * reach {
        out.iter_mut().enumerate().for_each(|(i, o)| *o = held(i));
        return;
    }
    for i in (0..reach).chain(n - reach..n) {
        out[i] = held(i);
    }
    let inner = &mut out[reach..n - reach];
    inner.iter_mut().zip(&from[reach..]).for_each(|(o, f)| *o = kernel[0] * f);
    for (d, w) in kernel.iter().enumerate().skip(1) {
        let (before, after) = (&from[reach - d..], &from[reach + d..]);
        inner.iter_mut().zip(before).zip(after).for_each(|((o, b), a)| *o += w * (b + a));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Grid;

    #[test]
    fn keeps_constants_and_widens_a_point_by_sigma() {
        let grid = Grid::axis_aligned([41, 41, 21], [1.0, 1.0, 2.0], [0.0; 3]).unwrap();
        let flat = gaussian(&Volume::filled(grid.clone(), 7.0), 3.0);
        assert!(flat.data().iter().all(|v| (v - 7.0).abs() < 1e-4));
        let mut point = Volume::filled(grid.clone(), 0.0);
        let at = grid.linear([20, 20, 10]);
        point.data_mut()[at] = 1.0;
        let wide = gaussian(&point, 3.0);
        for axis in 0..3 {
            let (mut sum, mut second) = (0.0, 0.0);
            for (l, &v) in wide.data().iter().enumerate() {
                let d = (grid.voxel(l)[axis] as f64 - [20.0, 20.0, 10.0][axis]) * grid.spacing()[axis];
                sum += f64::from(v);
                second += f64::from(v) * d * d;
            }
            assert!((sum - 1.0).abs() < 1e-4);
            assert!((second.sqrt() - 3.0).abs() < 0.1, "axis {axis}: {}", second.sqrt());
        }
    }
}
