//! How the waves of several bones become one displacement: superposition or prioritisation (thesis 5.4).

use super::carry::{Carrier, Carry, Initiators};
use super::engine::{Scene, Source, Wave, run};
use super::front::{FrontRules, NEVER, Order, Structures, TICKS};
use super::lattice::{Lattice, Node};
use super::options::{ChainmailOptions, Combination};
use super::superpose;
use rayon::prelude::*;

impl<'a> Scene<'a> {
    /// The scene that the options describe.
    pub fn new(lattice: &'a Lattice, bones: &Initiators<'a>, options: &ChainmailOptions) -> Self {
        Self {
            lattice,
            rules: FrontRules::of(options),
            order: options.order,
            structures: options.structures,
            carrier: Carrier::new(lattice, bones, options.carry),
        }
    }

    /// Displacement that a wave brings to a node it has reached, mm.
    fn brought(&self, wave: &Wave, owner: u16, node: usize, voxel: [usize; 3]) -> nalgebra::Vector3<f64> {
        let parcel = wave.trace.parcel.get(node).copied().unwrap_or_default();
        self.carrier.displacement(&parcel, owner, &self.lattice.grid.centre(voxel))
    }
}

/// One wave from all bones at once, in every detail: the regions of influence and the order of processing.
#[derive(Debug, Clone)]
pub struct FirstWave {
    /// Nodes of soft tissue in the order in which they were processed.
    pub order: Vec<u32>,
    /// Time of each node along its path, mm at relative shear 1; infinite where the wave does not come.
    pub time: Vec<f64>,
    /// Bone (position in the skeleton) that reaches each node first; `None` where no bone does.
    pub owner: Vec<Option<u16>>,
    /// Angle left of the bone's rotation at each node, radians; empty for [`super::Carry::Rigid`].
    pub angle: Vec<f32>,
}

/// Runs the wave from all bones at once.
pub fn first_wave(lattice: &Lattice, bones: &Initiators<'_>, options: &ChainmailOptions) -> FirstWave {
    if only_times(options) {
        return superpose::first_wave(lattice, options);
    }
    let wave = run(&Scene::new(lattice, bones, options), Source::AnyBone, None);
    let trace = wave.trace;
    let reached = |n: usize| wave.time[n] != NEVER;
    let mm = |n: usize| if reached(n) { f64::from(wave.time[n]) / TICKS } else { f64::INFINITY };
    FirstWave {
        order: trace.order,
        time: (0..wave.time.len()).map(mm).collect(),
        owner: (0..wave.time.len()).map(|n| reached(n).then(|| trace.owner[n])).collect(),
        angle: trace.parcel.iter().map(|p| p.angle).collect(),
    }
}

/// Displacement of each active node of the lattice, in their order, mm; `None` where no front comes. Bones move exactly with
/// their transform.
///
/// Bones are added in their order whatever the number of threads, so the sums are the same bits.
pub fn spread(lattice: &Lattice, bones: &Initiators<'_>, options: &ChainmailOptions) -> Vec<Option<[f32; 3]>> {
    if only_times(options) {
        return superpose::spread(lattice, bones, options).0;
    }
    let scene = Scene::new(lattice, bones, options);
    match options.combination {
        Combination::Superposition => weigh(&scene, bones, options),
        Combination::Prioritisation => {
            let wave = run(&scene, Source::AnyBone, None);
            let owner = &wave.trace.owner;
            each_active(lattice, bones, |node, voxel| {
                let u = (wave.time[node] != NEVER).then(|| scene.brought(&wave, owner[node], node, voxel))?;
                Some([u.x as f32, u.y as f32, u.z as f32])
            })
        }
    }
}

/// Whether nothing but the least time along paths decides: the variant that [`superpose`] serves.
pub(super) fn only_times(options: &ChainmailOptions) -> bool {
    options.order == Order::Timestamps && options.structures == Structures::None && options.carry == Carry::Rigid
}

/// Weight t^-n of a wave that took `time` ticks, of which there is at least one.
pub(super) fn weight(time: f64, exponent: f64) -> f64 {
    if is_usual(exponent) { usual_weight(time) } else { time.powf(-exponent) }
}

/// Whether weights are [`usual_weight`].
pub(super) fn is_usual(exponent: f64) -> bool {
    (exponent - 4.0).abs() < f64::EPSILON
}

/// Weight by the usual exponent of 4, without the cost of a general power.
#[inline(always)]
pub(super) fn usual_weight(time: f64) -> f64 {
    (time * time * time * time).recip()
}

/// Eq. 5.7: as many waves at a time as there are threads, added plane by plane.
fn weigh(scene: &Scene<'_>, bones: &Initiators<'_>, options: &ChainmailOptions) -> Vec<Option<[f32; 3]>> {
    let lattice = scene.lattice;
    let [nx, ny, _] = lattice.grid.size();
    let latest = superpose::latest_at_nodes(lattice, options);
    let mut sums = vec![[0f64; 4]; lattice.node.len()];
    let present: Vec<u16> = (0..bones.transforms.len() as u16).collect();
    for group in present.chunks(rayon::current_num_threads().max(1)) {
        let waves: Vec<(u16, Wave)> =
            group.par_iter().map(|&b| (b, run(scene, Source::Bone(b), latest.as_deref()))).collect();
        sums.par_chunks_mut(nx * ny).enumerate().for_each(|(k, sums)| {
            for (at, s) in sums.iter_mut().enumerate() {
                let node = k * nx * ny + at;
                if lattice.node[node] != Node::Soft {
                    continue;
                }
                for (b, wave) in waves.iter().filter(|(_, wave)| wave.time[node] != NEVER) {
                    let u = scene.brought(wave, *b, node, [at % nx, at / nx, k]);
                    let w = weight(f64::from(wave.time[node].max(1)), options.exponent);
                    s[0] += w;
                    (0..3).for_each(|a| s[1 + a] += w * u[a]);
                }
            }
        });
    }
    each_active(lattice, bones, |node, _| weighted_mean(sums[node]))
}

/// The mean displacement of a sum of weights and one of weighted displacements; `None` without weight.
pub(super) fn weighted_mean([weight, x, y, z]: [f64; 4]) -> Option<[f32; 3]> {
    (weight > 0.0).then(|| [x, y, z].map(|sum| (sum / weight) as f32))
}

/// Bones' own motion, and `soft(node, voxel)` of every node of soft tissue; in the order of the active nodes.
pub(super) fn each_active(
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
