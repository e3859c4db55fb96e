//! What waves bring to the elements that they run through, taken over by elements of other spacings.

use super::super::lattice::Lattice;
use super::average::each_active;
use super::carry::Initiators;
use super::pruning::Pruning;
use crate::volume::Surrounding;
use nalgebra::{Point3, Vector3};
use std::borrow::Cow;
use std::sync::Arc;

/// What waves bring to the elements of a lattice.
pub(in crate::chainmail) struct Prolongation {
    pub(in crate::chainmail) lattice: Arc<Lattice>,
    /// Displacements of the active nodes, in their order, mm; `None` where no wave comes.
    pub(in crate::chainmail) displacement: Vec<Option<[f32; 3]>>,
    /// Where a bound of it is known: with waves whose times alone count.
    pub(in crate::chainmail) pruning: Option<Pruning>,
}

impl Prolongation {
    /// The same at the active nodes of a lattice, in their order: between elements trilinear, from those where a wave comes.
    /// Bones move exactly.
    pub(in crate::chainmail) fn on(&self, lattice: &Lattice, bones: &Initiators<'_>) -> Cow<'_, [Option<[f32; 3]>]> {
        if std::ptr::eq(lattice, &*self.lattice) {
            return Cow::Borrowed(&self.displacement);
        }
        let all = self.lattice.on_all_nodes(self.displacement.iter().copied(), None);
        Cow::Owned(each_active(lattice, bones, |node, _| self.between(&all, &lattice.rest(node))))
    }

    /// The mean of the elements around a place, by nearness, of those where a wave comes.
    fn between(&self, all: &[Option<[f32; 3]>], place: &Point3<f64>) -> Option<[f32; 3]> {
        let around = Surrounding::of(&self.lattice.grid, &self.lattice.grid.index(place))?;
        let (mut weights, mut sum) = (0.0, Vector3::zeros());
        for (voxel, weight) in around.voxels.into_iter().zip(around.weights) {
            if let Some(u) = all[voxel] {
                weights += weight;
                sum += Vector3::from(u.map(f64::from)) * weight;
            }
        }
        (weights > LEAST_WEIGHT).then(|| (sum / weights).map(|v| v as f32).into())
    }
}

/// Elements that weigh less together are too far away.
const LEAST_WEIGHT: f64 = 1e-6;
