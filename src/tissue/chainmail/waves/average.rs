//! Averages over waves: weights, and what is common to all ways of blending.

use super::super::lattice::Lattice;
use super::super::lattice::Node;
use super::carry::Initiators;
use rayon::prelude::*;

/// One wave from all bones at once, in every detail: the regions of influence and the order of processing.
#[derive(Debug, Clone)]
pub struct FirstWave {
    /// Nodes of soft tissue in the order in which they were processed.
    pub order: Vec<u32>,
    /// Time of each node along its path, mm at relative shear 1; infinite where the wave does not come.
    pub time: Vec<f64>,
    /// Bone (position in the skeleton) that reaches each node first; `None` where no bone does.
    pub owner: Vec<Option<u16>>,
    /// Angle left of the bone's rotation at each node, radians; empty for [`super::super::Carry::Rigid`].
    pub angle: Vec<f32>,
}

/// Weight t^-n of a wave that took `time` ticks, of which there is at least one.
pub(in crate::chainmail) fn weight(time: f64, exponent: f64) -> f64 {
    if is_usual(exponent) { usual_weight(time) } else { time.powf(-exponent) }
}

/// Whether weights are [`usual_weight`].
pub(in crate::chainmail) fn is_usual(exponent: f64) -> bool {
    (exponent - 4.0).abs() < f64::EPSILON
}

/// Weight by the usual exponent of 4, without the cost of a general power.
#[inline(always)]
pub(in crate::chainmail) fn usual_weight(time: f64) -> f64 {
    (time * time * time * time).recip()
}

/// The mean displacement of a sum of weights and one of weighted displacements; `None` without weight.
pub(in crate::chainmail) fn weighted_mean([weight, x, y, z]: [f64; 4]) -> Option<[f32; 3]> {
    (weight > 0.0).then(|| [x, y, z].map(|sum| (sum / weight) as f32))
}

/// Bones' own motion, and `soft(node, voxel)` of every node of soft tissue; in the order of the active nodes.
pub(in crate::chainmail) fn each_active(
    lattice: &Lattice,
    bones: &Initiators<'_>,
    soft: impl Fn(usize, [usize; 3]) -> Option<[f32; 3]> + Sync,
) -> Vec<Option<[f32; 3]>> {
    let of = |&n: &u32| {
        let (node, voxel) = (n as usize, lattice.grid.voxel(n as usize));
        let Node::Bone(b) = lattice.node[node] else { return soft(node, voxel) };
        let x = lattice.grid.centre(voxel);
        let u = bones.transforms[usize::from(b)] * x - x;
        Some([u.x as f32, u.y as f32, u.z as f32])
    };
    lattice.active.par_iter().map(of).collect()
}
