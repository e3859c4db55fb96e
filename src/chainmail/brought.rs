//! What waves bring to the elements that they run through, taken over by elements of other spacings.

use super::blend::each_active;
use super::carry::Initiators;
use super::lattice::Lattice;
use super::let_go::LetGo;
use std::borrow::Cow;
use std::sync::Arc;

/// What waves bring to the elements of a lattice.
pub(super) struct Brought {
    pub(super) lattice: Arc<Lattice>,
    /// Displacements of the active nodes, in their order, mm; `None` where no wave comes.
    pub(super) displacement: Vec<Option<[f32; 3]>>,
    /// Where a bound of it is known: with waves whose times alone count.
    pub(super) let_go: Option<LetGo>,
}

impl Brought {
    /// The same at the active nodes of a lattice, in their order: between elements trilinear, from those where a wave comes.
    /// Bones move exactly.
    pub(super) fn on(&self, lattice: &Lattice, bones: &Initiators<'_>) -> Cow<'_, [Option<[f32; 3]>]> {
        if std::ptr::eq(lattice, &*self.lattice) {
            return Cow::Borrowed(&self.displacement);
        }
        let all = self.lattice.on_all_nodes(self.displacement.iter().copied(), None);
        Cow::Owned(each_active(lattice, bones, |node, _| self.between(&all, &lattice.rest(node))))
    }

    /// The mean of the elements around a place, by nearness.
    fn between(&self, all: &[Option<[f32; 3]>], place: &nalgebra::Point3<f64>) -> Option<[f32; 3]> {
        let grid = &self.lattice.grid;
        let (at, size) = (grid.index(place), grid.size());
        let (mut weights, mut sum) = (0.0, [0.0; 3]);
        for corner in 0..8usize {
            let beside: [f64; 3] = std::array::from_fn(|a| at[a].floor() + (corner >> a & 1) as f64);
            if (0..3).any(|a| beside[a] < 0.0 || beside[a] >= size[a] as f64) {
                continue;
            }
            let Some(u) = all[grid.linear(beside.map(|c| c as usize))] else { continue };
            let weight: f64 = (0..3).map(|a| 1.0 - (at[a] - beside[a]).abs()).product();
            weights += weight;
            (0..3).for_each(|a| sum[a] += weight * f64::from(u[a]));
        }
        (weights > LEAST_WEIGHT).then(|| sum.map(|s| (s / weights) as f32))
    }
}

/// Elements that weigh less together are too far away.
const LEAST_WEIGHT: f64 = 1e-6;
