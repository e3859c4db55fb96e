//! A smooth function of position: uniform cubic B-splines over a coarse lattice.

use super::shape::{Bounds, V3};
use rayon::prelude::*;

/// Lattice spacing, mm.
const SPACING: f64 = 16.0;
/// Values at each node: a twist and a shift.
pub(super) const CHANNELS: usize = 9;

/// Uniform cubic B-spline (approximating, twice differentiable) with [`CHANNELS`] values; constant outside.
#[derive(Debug, Clone)]
pub(super) struct Lattice {
    low: V3,
    size: [usize; 3],
    nodes: Vec<[f64; CHANNELS]>,
}

impl Lattice {
    /// The lattice over a box, with the coefficients that `value` gives at its nodes.
    pub(super) fn new([low, high]: Bounds, value: impl Fn(&V3) -> [f64; CHANNELS] + Sync) -> Self {
        let low = low.add_scalar(-2.0 * SPACING);
        let size: [usize; 3] = std::array::from_fn(|a| ((high[a] - low[a]) / SPACING).ceil().max(1.0) as usize + 4);
        let count = size[0] * size[1] * size[2];
        let at = |n: usize| {
            low + V3::from([n % size[0], n / size[0] % size[1], n / (size[0] * size[1])].map(|c| c as f64)) * SPACING
        };
        let nodes = (0..count).into_par_iter().map(|n| value(&at(n))).collect();
        Self { low, size, nodes }
    }

    /// Values at a point.
    pub(super) fn at(&self, p: &V3) -> [f64; CHANNELS] {
        let mut base = [0; 3];
        let mut weights = [[0.0; 4]; 3];
        for a in 0..3 {
            let q = ((p[a] - self.low[a]) / SPACING).clamp(1.0, (self.size[a] - 2) as f64 - 1e-9);
            let cell = q as usize;
            base[a] = cell - 1;
            weights[a] = cubic(q - cell as f64);
        }
        let mut out = [0.0; CHANNELS];
        for (k, wz) in weights[2].iter().enumerate() {
            for (j, wy) in weights[1].iter().enumerate() {
                let row = base[0] + self.size[0] * (base[1] + j + self.size[1] * (base[2] + k));
                for (node, wx) in self.nodes[row..row + 4].iter().zip(&weights[0]) {
                    let w = wx * wy * wz;
                    for c in 0..CHANNELS {
                        out[c] += w * node[c];
                    }
                }
            }
        }
        out
    }
}

/// Weights of the four nodes around a place `t` into a cell.
fn cubic(t: f64) -> [f64; 4] {
    let s = 1.0 - t;
    let inner = |t: f64| (4.0 - 6.0 * t * t + 3.0 * t * t * t) / 6.0;
    [s * s * s / 6.0, inner(t), inner(s), t * t * t / 6.0]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reproduces_linear_functions_and_stays_finite_outside() {
        let f = |p: &V3| [p.x, 2.0 * p.y - p.z, 3.0, 0.0, p.x + p.y + p.z, 0.0, 0.0, 0.0, -p.z];
        let l = Lattice::new([V3::repeat(-50.0), V3::new(60.0, 40.0, 90.0)], f);
        for n in 0..500 {
            let p = V3::from([n % 11, n % 9, n % 14].map(|c| f64::from(c) * 10.0 - 50.0));
            for (got, want) in l.at(&p).iter().zip(f(&p)) {
                assert!((got - want).abs() < 1e-9, "{p}");
            }
        }
        assert!(l.at(&V3::repeat(1e6)).iter().all(|v| v.is_finite()));
    }
}
