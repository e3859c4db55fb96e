//! Gaussian smoothing with a width in mm, so that images on different grids are blurred alike.

use super::Volume;
use rayon::prelude::*;

/// Smooths with a Gaussian of standard deviation `sigma` mm along every axis; values are continued at the edges.
///
/// An axis whose spacing exceeds three sigma is left as it is: the sampled kernel would be a single voxel.
pub fn gaussian(volume: &Volume<f32>, sigma: f64) -> Volume<f32> {
    let mut out = volume.clone();
    for axis in 0..3 {
        let kernel = kernel(sigma / volume.grid().spacing()[axis]);
        if kernel.len() > 1 {
            out = along(&out, axis, &kernel);
        }
    }
    out
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

/// Convolution along one axis, row by row, so that memory is read in storage order.
fn along(volume: &Volume<f32>, axis: usize, kernel: &[f32]) -> Volume<f32> {
    let [nx, ny, nz] = volume.grid().size();
    let src = volume.data();
    let mut out = vec![0f32; src.len()];
    out.par_chunks_mut(nx).enumerate().for_each(|(row, line)| {
        let (j, k) = (row % ny, row / ny);
        if axis == 0 {
            let from = &src[row * nx..(row + 1) * nx];
            for (i, v) in line.iter_mut().enumerate() {
                let mut sum = kernel[0] * from[i];
                for (d, w) in kernel.iter().enumerate().skip(1) {
                    sum += w * (from[i.saturating_sub(d)] + from[(i + d).min(nx - 1)]);
                }
                *v = sum;
            }
        } else {
            for (d, w) in kernel.iter().enumerate() {
                for sign in if d == 0 { &[1i64][..] } else { &[-1, 1] } {
                    let shift = |at: usize, n: usize| (at as i64 + sign * d as i64).clamp(0, n as i64 - 1) as usize;
                    let other = if axis == 1 { shift(j, ny) + ny * k } else { j + ny * shift(k, nz) };
                    for (v, s) in line.iter_mut().zip(&src[other * nx..(other + 1) * nx]) {
                        *v += w * s;
                    }
                }
            }
        }
    });
    Volume::new(volume.grid().clone(), out).expect("same grid, same length")
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
