//! What the scans show around soft elements: sums over a few points of each, spread over its neighbourhood.

use crate::chainmail::Lattice;
use crate::volume::{Volume, gaussian};

/// Points of an element's eight that are compared: four that no two share an edge of.
pub(super) const POINTS: [usize; 4] = [0, 3, 5, 6];

/// Sums over points of an element, each summed on its own.
pub(super) fn summed<const N: usize>(points: impl Iterator<Item = [f64; N]>) -> [f32; N] {
    let mut sums = [0f64; N];
    points.for_each(|more| sums.iter_mut().zip(more).for_each(|(sum, more)| *sum += more));
    sums.map(|sum| sum as f32)
}

/// What each soft element of a lattice has (`of`, by its place in `soft`), blurred by `sigma` mm over the lattice; other elements
/// have none.
pub(super) fn spread(lattice: &Lattice, soft: &[u32], sigma: f64, of: impl Fn(usize) -> f32) -> Volume<f32> {
    let mut values = vec![0f32; lattice.node.len()];
    soft.iter().enumerate().for_each(|(s, &node)| values[node as usize] = of(s));
    gaussian(&Volume::new(lattice.grid.clone(), values).expect("one value per node"), sigma)
}
