//! Gain and offset of the fraction's grey values place by place: what is left of shading, finer than it was taken out.
//!
//! With them the squared difference of two neighbourhoods is what their correlation leaves unexplained (the squared differences
//! of Cachier et al. 2003 for local correlation), and stays a quadratic in an element's step.

use super::around::{POINTS, spread, summed};
use crate::chainmail::Lattice;
use crate::volume::Volume;
use rayon::prelude::*;

/// Least share of a neighbourhood that both scans must show.
const LEAST: f64 = 1e-4;
/// A neighbourhood's gain departs from the common one by this factor at most.
/// At 1 a cone-beam CT errs by 0.764 mm for 0.772; at 4 nothing changes.
const FACTOR: f64 = 2.0;

/// How the fraction's grey values lie to planning's.
#[derive(Debug, Clone, Copy)]
pub(super) struct Grey {
    /// Planning's HU per HU of the fraction.
    pub(super) gain: f64,
    /// HU that come on top.
    pub(super) offset: f64,
    /// Standard deviation of what is left, HU.
    pub(super) noise: f64,
}

/// Gain, offset and noise at each soft element (in the order of `soft`, nodes of the lattice), given the common ones. `pair` is
/// planning's and the fraction's HU at a point of an element, where both show it.
pub(super) fn grey_values(
    lattice: &Lattice,
    soft: &[u32],
    neighbourhood_mm: f64,
    common: Grey,
    pair: impl Fn(usize, usize) -> Option<(f64, f64)> + Sync,
) -> Vec<Grey> {
    let Grey { gain, noise, .. } = common;
    let sigma = neighbourhood_mm.max(lattice.grid.mean_edge());
    let sums: Vec<[f32; 5]> = (0..soft.len())
        .into_par_iter()
        .map(|s| {
            let shown = POINTS.iter().filter_map(|point| pair(s, *point));
            summed(shown.map(|(p, f)| [1.0, p, f, p * f, f * f]))
        })
        .collect();
    let around = |q: usize| spread(lattice, soft, sigma, |s| sums[s][q]);
    let sums: Vec<Volume<f32>> = (0..5).into_par_iter().map(around).collect();
    // Where there is little contrast the common gain holds.
    let ridge = noise * noise;
    let of = |&node: &u32| {
        let [n, p, f, pf, ff]: [f64; 5] = std::array::from_fn(|q| f64::from(sums[q].data()[node as usize]));
        if n < LEAST {
            return common;
        }
        let (p, f) = (p / n, f / n);
        let (both, own) = (pf / n - p * f, (ff / n - f * f).max(0.0));
        let here = ((both + ridge * gain) / (own + ridge)).clamp(gain / FACTOR, gain * FACTOR);
        Grey { gain: here, offset: p - here * f, noise }
    };
    soft.par_iter().map(of).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::chainmail::{Material, Node};
    use crate::geometry::Grid;

    #[test]
    fn gain_and_offset_follow_the_shading_and_hold_where_nothing_is_seen() {
        let grid = Grid::axis_aligned([24, 12, 12], [4.0; 3], [0.0; 3]).unwrap();
        let node = |n: usize| match grid.voxel(n) {
            at if at.iter().zip(grid.size()).any(|(&c, n)| c == 0 || c + 1 == n) => Node::Outside,
            _ => Node::Soft,
        };
        let node: Vec<Node> = (0..grid.len()).map(node).collect();
        let lattice = Lattice::from_nodes(grid.clone(), node, vec![Material::default().at(20.0); grid.len()]);
        let soft: Vec<u32> = lattice.soft().collect();
        let x = |s: usize| lattice.rest(soft[s] as usize).x;
        // Contrast of 120 HU from point to point; the fraction is 1.25 times weaker and grows darker along x.
        let truth = |s: usize, point: usize| if (s + point).is_multiple_of(3) { 80.0 } else { -40.0 };
        let shade = |s: usize| -0.5 * x(s);
        let pair = |s: usize, point: usize| (x(s) < 70.0).then(|| (truth(s, point), 0.8 * truth(s, point) + shade(s)));
        let found = grey_values(&lattice, &soft, 6.0, Grey { gain: 1.0, offset: 0.0, noise: 6.0 }, pair);
        for (s, Grey { gain, offset, .. }) in found.iter().enumerate() {
            if x(s) > 92.0 {
                assert!((gain - 1.0).abs() < 1e-9 && offset.abs() < 1e-9, "nothing is seen near: {gain} {offset}");
            } else if (36.0..50.0).contains(&x(s)) {
                let back = gain * (0.8 * 80.0 + shade(s)) + offset;
                assert!((back - 80.0).abs() < 10.0, "{} {gain} {offset}", x(s));
            }
        }
    }

    #[test]
    fn the_gain_of_a_neighbourhood_stays_within_a_factor_of_the_common_one() {
        let grid = Grid::axis_aligned([10; 3], [4.0; 3], [0.0; 3]).unwrap();
        let lattice = Lattice::from_nodes(
            grid.clone(),
            vec![Node::Soft; grid.len()],
            vec![Material::default().at(20.0); grid.len()],
        );
        let soft: Vec<u32> = lattice.soft().collect();
        let found = |slope: f64| {
            let pair = |s: usize, point: usize| {
                let f = if (s + point).is_multiple_of(3) { 80.0 } else { -40.0 };
                Some((slope * f, f))
            };
            let common = Grey { gain: 1.2, offset: 0.0, noise: 3.0 };
            grey_values(&lattice, &soft, 6.0, common, pair)[soft.len() / 2].gain
        };
        assert!((found(5.0) - 2.4).abs() < 1e-9 && (found(-1.0) - 0.6).abs() < 1e-9, "{} {}", found(5.0), found(-1.0));
        assert!((found(1.5) - 1.5).abs() < 0.01, "{}", found(1.5));
    }
}
