//! Smooth random fields of unit deviation on a grid.

use crate::geometry::Grid;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

/// A kernel is cut at this many of its deviations.
const CUT: f64 = 3.0;

/// Gaussian fields whose values at a distance d are correlated by exp(-(d / length)^2), the same everywhere, at the grid's edges
/// too. Read trilinearly their deviation is 1 on the mean over a cell; at nodes it is a little more.
pub(super) struct Noise {
    /// Nodes of white noise along each axis: the grid and the kernel's reach on both sides.
    wide: [usize; 3],
    size: [usize; 3],
    kernels: [Vec<f32>; 3],
}

impl Noise {
    pub(super) fn new(grid: &Grid, length_mm: f64) -> Self {
        // White noise smoothed with a deviation s is correlated by exp(-d^2 / (4 s^2)).
        let kernels = grid.spacing().map(|spacing| {
            // Between two nodes the mean square of the linear mixture is 2/3, and 1/3 of what they have in common.
            let kept = (2.0 + (-(spacing / length_mm).powi(2)).exp()) / 3.0;
            kernel(0.5 * length_mm / spacing, kept.sqrt().recip())
        });
        let size = grid.size();
        Self { wide: [0, 1, 2].map(|a| size[a] + kernels[a].len() - 1), size, kernels }
    }

    /// One field, in the grid's order.
    pub(super) fn draw(&self, rng: &mut ChaCha8Rng) -> Vec<f32> {
        let ([wi, wj, wk], [ni, nj, nk]) = (self.wide, self.size);
        let white: Vec<f32> = (0..wi * wj * wk).map(|_| StandardNormal.sample(rng)).collect();
        let [by_i, by_j, by_k] = &self.kernels;
        let mut rows = vec![0f32; ni * wj * wk];
        for (out, row) in rows.chunks_mut(ni).zip(white.chunks(wi)) {
            for (n, w) in by_i.iter().enumerate() {
                out.iter_mut().zip(&row[n..]).for_each(|(o, v)| *o += w * v);
            }
        }
        let mut planes = vec![0f32; ni * nj * wk];
        for (out, plane) in planes.chunks_mut(ni * nj).zip(rows.chunks(ni * wj)) {
            for (n, w) in by_j.iter().enumerate() {
                out.iter_mut().zip(&plane[n * ni..]).for_each(|(o, v)| *o += w * v);
            }
        }
        let mut field = vec![0f32; ni * nj * nk];
        for (n, w) in by_k.iter().enumerate() {
            field.iter_mut().zip(&planes[n * ni * nj..]).for_each(|(o, v)| *o += w * v);
        }
        field
    }
}

/// A Gaussian of deviation `sigma` voxels that gives white noise this deviation: the root of the sum of its squares.
fn kernel(sigma: f64, deviation: f64) -> Vec<f32> {
    let reach = (CUT * sigma).ceil() as usize;
    let at = |n: usize| if sigma > 0.0 { (-0.5 * ((n as f64 - reach as f64) / sigma).powi(2)).exp() } else { 1.0 };
    let values: Vec<f64> = (0..=2 * reach).map(at).collect();
    let norm = values.iter().map(|v| v * v).sum::<f64>().sqrt();
    values.iter().map(|v| (v * deviation / norm) as f32).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand_chacha::rand_core::SeedableRng;

    #[test]
    fn deviation_is_one_and_the_correlation_falls_as_it_should_at_the_edges_too() {
        let grid = Grid::axis_aligned([24, 20, 16], [6.0, 6.0, 5.0], [0.0; 3]).unwrap();
        let noise = Noise::new(&grid, 20.0);
        let mut rng = ChaCha8Rng::seed_from_u64(11);
        let fields: Vec<Vec<f32>> = (0..300).map(|_| noise.draw(&mut rng)).collect();
        let mean = |a: [usize; 3], b: [usize; 3]| {
            let (a, b) = (grid.linear(a), grid.linear(b));
            fields.iter().map(|f| f64::from(f[a] * f[b])).sum::<f64>() / 300.0
        };
        for at in [[0, 0, 0], [12, 10, 8], [23, 19, 15]] {
            assert!((mean(at, at) / 1.088 - 1.0).abs() < 0.25, "{at:?}: {}", mean(at, at));
        }
        // Over many pairs: 18 mm along i, 20 mm along k.
        let pairs = |step: [usize; 3]| {
            let all = (0..20).flat_map(|i| (0..20).flat_map(move |j| (0..12).map(move |k| [i, j, k])));
            let to = |v: [usize; 3]| [v[0] + step[0], v[1] + step[1], v[2] + step[2]];
            all.clone().map(|v| mean(v, to(v))).sum::<f64>() / all.count() as f64
        };
        let (one, along_i, along_k) = (pairs([0; 3]), pairs([3, 0, 0]), pairs([0, 0, 4]));
        let kept = |spacing: f64| (2.0 + (-(spacing / 20.0).powi(2)).exp()) / 3.0;
        assert!((one * kept(6.0).powi(2) * kept(5.0) - 1.0).abs() < 0.03, "{one}");
        let [along_i, along_k] = [along_i / one, along_k / one];
        assert!((along_i - (-0.81f64).exp()).abs() < 0.05, "{along_i}");
        assert!((along_k - (-1f64).exp()).abs() < 0.05, "{along_k}");
    }
}
