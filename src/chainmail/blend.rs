//! Superposition of the bones' motions with weights t^-n (thesis 5.4.2, eq. 5.7).

use super::carry::{BoneMotion, Carry, decayed};
use super::front::{FrontRules, Source, TimeMap, time_map};
use super::lattice::{Lattice, Node};
use super::propagate::ChainmailOptions;
use crate::geometry::Rigid;
use nalgebra::Point3;
use rayon::prelude::*;

/// One bone's wave: when it arrives and, unless that is the rigid motion itself, what it brings.
struct Wave {
    map: TimeMap,
    transform: Rigid,
    displacement: Option<Vec<[f32; 3]>>,
}

impl Wave {
    fn new(
        lattice: &Lattice,
        bone: u16,
        transforms: &[Rigid],
        centroids: &[Point3<f64>],
        rules: &FrontRules,
        bound: Option<(&[u32], f64)>,
        carry: Carry,
    ) -> Self {
        let map = time_map(lattice, Source::Bone(bone), rules, bound);
        let transform = transforms[usize::from(bone)];
        let displacement = (carry == Carry::LinearDecay).then(|| {
            let motion = BoneMotion::new(&transform, centroids[usize::from(bone)], lattice.grid.direction());
            decayed(lattice, bone, &motion, &map, rules)
        });
        Self { map, transform, displacement }
    }

    fn weight(time: u32, exponent: f64) -> f64 {
        let t = f64::from(time.max(1));
        // The usual exponent, without the cost of a general power.
        if (exponent - 4.0).abs() < f64::EPSILON { (t * t * t * t).recip() } else { t.powf(-exponent) }
    }

    /// Adds the weighted rigid motion.
    fn add_rigid(&self, lattice: &Lattice, exponent: f64, sums: &mut [[f64; 4]]) {
        for &n in &self.map.order {
            let x = lattice.rest(n as usize);
            let u = self.transform * x - x;
            let w = Self::weight(self.map.time[n as usize], exponent);
            let s = &mut sums[n as usize];
            s[0] += w;
            (0..3).for_each(|a| s[1 + a] += w * u[a]);
        }
    }

    /// Adds the weighted displacements that the front brings.
    fn add(&self, u: &[[f32; 3]], exponent: f64, sums: &mut [[f64; 4]]) {
        for (&n, u) in self.map.order.iter().zip(u) {
            let w = Self::weight(self.map.time[n as usize], exponent);
            let s = &mut sums[n as usize];
            s[0] += w;
            (0..3).for_each(|a| s[1 + a] += w * f64::from(u[a]));
        }
    }
}

/// Displacement of every node that a front reaches, mm; `None` elsewhere. Bones move exactly with their transform.
///
/// Bones are added in their order whatever the number of threads, so the sums are the same bits.
pub fn superpose(
    lattice: &Lattice,
    transforms: &[Rigid],
    centroids: &[Point3<f64>],
    rules: &FrontRules,
    options: &ChainmailOptions,
) -> Vec<Option<[f32; 3]>> {
    let n = lattice.node.len();
    let first = (options.prune_ratio > 1.0).then(|| time_map(lattice, Source::AnyBone, rules, None).time);
    let bound = first.as_deref().map(|times| (times, options.prune_ratio));
    let mut sums = vec![[0f64; 4]; n];
    let present: Vec<u16> = (0..transforms.len() as u16).collect();
    let plane = lattice.grid.size()[0] * lattice.grid.size()[1];
    for group in present.chunks(rayon::current_num_threads().max(1)) {
        let waves: Vec<Wave> = group
            .par_iter()
            .map(|&b| Wave::new(lattice, b, transforms, centroids, rules, bound, options.carry))
            .collect();
        for wave in &waves {
            match &wave.displacement {
                None => wave.add_rigid(lattice, options.exponent, &mut sums),
                Some(u) => wave.add(u, options.exponent, &mut sums),
            }
        }
    }
    let mut out = vec![None; n];
    out.par_chunks_mut(plane).enumerate().for_each(|(k, out)| {
        for (at, o) in out.iter_mut().enumerate() {
            let node = k * plane + at;
            *o = match lattice.node[node] {
                Node::Outside => None,
                Node::Bone(b) => {
                    let x = lattice.rest(node);
                    let u = transforms[usize::from(b)] * x - x;
                    Some([u.x as f32, u.y as f32, u.z as f32])
                }
                Node::Soft => {
                    let s = sums[node];
                    (s[0] > 0.0).then(|| [(s[1] / s[0]) as f32, (s[2] / s[0]) as f32, (s[3] / s[0]) as f32])
                }
            };
        }
    });
    out
}
