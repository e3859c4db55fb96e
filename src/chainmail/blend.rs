//! Superposition of the bones' motions with weights t^-n (thesis 5.4.2, eq. 5.7).

use super::front::{FrontRules, NEVER, time_map};
use super::lattice::{Lattice, Node};
use crate::geometry::Rigid;
use rayon::prelude::*;

/// Displacement of every node that a front reaches, mm; `None` elsewhere. Bones move exactly with their transform.
///
/// Bones are added in their order whatever the number of threads, so the sums are the same bits.
pub fn superpose(lattice: &Lattice, transforms: &[Rigid], rules: &FrontRules, exponent: f64) -> Vec<Option<[f32; 3]>> {
    let n = lattice.node.len();
    let mut sums = vec![[0f64; 4]; n];
    let present: Vec<u16> = (0..transforms.len() as u16).collect();
    let plane = lattice.grid.size()[0] * lattice.grid.size()[1];
    for group in present.chunks(rayon::current_num_threads().max(1)) {
        let maps: Vec<Vec<u32>> = group.par_iter().map(|&b| time_map(lattice, b, rules)).collect();
        for (&b, map) in group.iter().zip(&maps) {
            let t = &transforms[usize::from(b)];
            sums.par_chunks_mut(plane).enumerate().for_each(|(k, out)| {
                for (at, s) in out.iter_mut().enumerate() {
                    let node = k * plane + at;
                    let time = map[node];
                    if time == NEVER || lattice.node[node] != Node::Soft {
                        continue;
                    }
                    let w = f64::from(time.max(1)).powf(-exponent);
                    let x = lattice.rest(node);
                    let u = t * x - x;
                    s[0] += w;
                    for a in 0..3 {
                        s[1 + a] += w * u[a];
                    }
                }
            });
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
