//! Gaussian smoothing with a width in mm, so that images on different grids are blurred alike.

use super::Volume;
use crate::geometry::vectorised;
use rayon::prelude::*;

/// Smooths with a Gaussian of standard deviation `sigma` mm along every axis; values are continued at the edges.
///
/// An axis whose spacing exceeds three sigma is left as it is: the sampled kernel would be a single voxel.
pub fn gaussian(volume: &Volume<f32>, sigma: f64) -> Volume<f32> {
    let blur = Blur::new(volume, sigma);
    let mut out = vec![0f32; volume.data().len()];
    out.par_chunks_mut(blur.plane()).enumerate().for_each_init(Vec::new, |spare, (k, out)| {
        vectorised(
            #[inline(always)]
            || blur.of_plane(out, spare, k, volume.data(), same),
        )
    });
    Volume::new(volume.grid().clone(), out).expect("same grid, same length")
}

/// An image of which a function of each voxel counts, not the voxel itself.
#[derive(Debug, Clone, Copy)]
pub struct Counted<'a, F> {
    /// The image.
    pub image: &'a Volume<f32>,
    /// What counts of a voxel's value.
    pub value: F,
}

impl<'a> Counted<'a, ()> {
    /// Of which the voxels themselves count.
    pub fn whole(image: &'a Volume<f32>) -> Counted<'a, impl Fn(f32) -> f32 + Copy + Sync> {
        Counted { image, value: same }
    }
}

/// A [`gaussian`] over another, voxel by voxel, of which neither is kept: `ratio` is taken of the two. They share a grid. `ones` says
/// of which planes along `k` all voxels of the other count 1: where the blur sees no plane else, it is 1 without being blurred.
pub fn gaussian_ratio(
    over: &Counted<'_, impl Fn(f32) -> f32 + Copy + Sync>,
    under: &Counted<'_, impl Fn(f32) -> f32 + Copy + Sync>,
    sigma: f64,
    ones: impl Fn(usize) -> bool + Sync,
    ratio: impl Fn(f32, f32) -> f32 + Sync,
) -> Volume<f32> {
    let blur = Blur::new(over.image, sigma);
    let mut out = vec![0f32; over.image.data().len()];
    let rooms = || (vec![0f32; blur.plane()], Vec::new());
    out.par_chunks_mut(blur.plane()).enumerate().for_each_init(rooms, |(below, spare), (k, out)| {
        vectorised(
            #[inline(always)]
            || {
                blur.of_plane(out, spare, k, over.image.data(), over.value);
                if blur.planes(k).all(&ones) {
                    out.iter_mut().for_each(|o| *o = ratio(*o, 1.0));
                    return;
                }
                blur.of_plane(below, spare, k, under.image.data(), under.value);
                out.iter_mut().zip(below).for_each(|(o, b)| *o = ratio(*o, *b));
            },
        )
    });
    Volume::new(over.image.grid().clone(), out).expect("same grid, same length")
}

#[inline(always)]
fn same(value: f32) -> f32 {
    value
}

/// A blur of images of one grid, plane by plane, so that only the result is as large as the image: between planes first, the
/// rest in the cache.
struct Blur {
    size: [usize; 3],
    kernels: [Vec<f32>; 3],
}

impl Blur {
    fn new(volume: &Volume<f32>, sigma: f64) -> Self {
        let grid = volume.grid();
        Self { size: grid.size(), kernels: grid.spacing().map(|s| kernel(sigma / s)) }
    }

    /// The planes that plane `k` of the blurred image is made from.
    fn planes(&self, k: usize) -> std::ops::Range<usize> {
        let reach = self.kernels[2].len() - 1;
        k.saturating_sub(reach)..(k + reach + 1).min(self.size[2])
    }

    /// Voxels of a plane.
    fn plane(&self) -> usize {
        self.size[0] * self.size[1]
    }

    /// Plane `k` of the blurred image; `value` counts of each of its voxels.
    #[inline(always)]
    fn of_plane(&self, out: &mut [f32], spare: &mut Vec<f32>, k: usize, data: &[f32], value: impl Fn(f32) -> f32) {
        let ([nx, ny, nz], plane) = (self.size, self.plane());
        let [across, down, through] = &self.kernels;
        sum_lines(out, through, k, nz, |k| &data[k * plane..][..plane], value);
        if down.len() > 1 {
            spare.resize(plane, 0.0);
            for (j, row) in spare.chunks_mut(nx).enumerate() {
                sum_lines(row, down, j, ny, |j| &out[j * nx..][..nx], same);
            }
            out.copy_from_slice(spare);
        }
        if across.len() > 1 {
            spare.clear();
            spare.extend_from_slice(out);
            out.chunks_mut(nx).zip(spare.chunks(nx)).for_each(|(row, from)| along_row(row, from, across));
        }
    }
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

/// The convolution at line `at` of `count`; `line` gives the lines, `value` what counts of their voxels.
///
/// Memory that is fresh from the system must be written before it is read: else every page of it faults twice.
#[inline(always)]
fn sum_lines<'a>(
    out: &mut [f32],
    kernel: &[f32],
    at: usize,
    count: usize,
    line: impl Fn(usize) -> &'a [f32],
    value: impl Fn(f32) -> f32,
) {
    for (d, &w) in kernel.iter().enumerate() {
        let (before, after) = (line(at.saturating_sub(d)), line((at + d).min(count - 1)));
        if d == 0 {
            out.iter_mut().zip(before).for_each(|(o, b)| *o = w * value(*b));
        } else {
            out.iter_mut().zip(before).zip(after).for_each(|((o, b), a)| *o += w * (value(*b) + value(*a)));
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
    fn a_ratio_is_the_quotient_of_both_blurred() {
        let grid = Grid::axis_aligned([9, 7, 5], [1.0, 1.5, 2.0], [0.0; 3]).unwrap();
        let image = Volume::from_fn(grid.clone(), |l| ((l * 37) % 101) as f32 - 30.0);
        let (high, known) = (|v: f32| if v > 0.0 { v } else { 0.0 }, |v: f32| if v > 0.0 { 1.0 } else { 0.0 });
        let (over, under) = (gaussian(&image.map(|v| high(*v)), 1.3), gaussian(&image.map(|v| known(*v)), 1.3));
        let quotient = over.data().iter().zip(under.data()).map(|(o, u)| o / u);
        let ratio = gaussian_ratio(
            &Counted { image: &image, value: high },
            &Counted { image: &image, value: known },
            1.3,
            |_| false,
            |o, u| o / u,
        );
        assert!(ratio.data().iter().zip(quotient).all(|(r, q)| (r - q).abs() < 1e-5));
    }

    #[test]
    fn a_ratio_over_ones_is_the_same_without_blurring_them() {
        let grid = Grid::axis_aligned([9, 7, 24], [1.0, 1.5, 2.0], [0.0; 3]).unwrap();
        // No number in the last plane.
        let hole = |l: usize| grid.voxel(l)[2] == 23;
        let image = Volume::from_fn(grid.clone(), |l| if hole(l) { f32::NAN } else { ((l * 37) % 101) as f32 });
        let (value, known) = (|v: f32| if v.is_nan() { 0.0 } else { v }, |v: f32| f32::from(u8::from(!v.is_nan())));
        let [all, short] = [false, true].map(|shortened| {
            let (over, under) = (Counted { image: &image, value }, Counted { image: &image, value: known });
            gaussian_ratio(&over, &under, 3.0, |k| shortened && k < 23, |o, u| o / u)
        });
        assert!(all.data().iter().zip(short.data()).all(|(a, s)| (a - s).abs() < 1e-4));
        // Beyond the blur's reach from the hole nothing is divided.
        assert!(short.at([4, 3, 12]).to_bits() == gaussian(&image.map(|v| value(*v)), 3.0).at([4, 3, 12]).to_bits());
    }

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
