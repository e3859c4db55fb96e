//! How the waves of several bones become one displacement: superposition or prioritisation (thesis 5.4).

use super::super::lattice::Lattice;
use super::super::lattice::Node;
use super::super::variants::{Carry, Combination, Order, Structures, Variant};
use super::average::{FirstWave, each_active, weight, weighted_mean};
use super::carry::{Carrier, Initiators};
use super::front::{FrontRules, NEVER, Source, TICKS};
use super::ordered::engine::{Scene, Wave, run};
use super::superpose;
use rayon::prelude::*;

impl<'a> Scene<'a> {
    /// The scene that the variant describes.
    pub fn new(lattice: &'a Lattice, bones: &Initiators<'a>, variant: &Variant) -> Self {
        Self {
            lattice,
            rules: FrontRules::of(variant),
            order: variant.order,
            structures: variant.structures,
            carrier: Carrier::new(lattice, bones, variant.carry),
        }
    }

    /// Displacement that a wave brings to a node it has reached, mm.
    fn displacement(&self, wave: &Wave, owner: u16, node: usize, voxel: [usize; 3]) -> nalgebra::Vector3<f64> {
        let parcel = wave.trace.parcel.get(node).copied().unwrap_or_default();
        self.carrier.displacement(&parcel, owner, &self.lattice.grid.centre(voxel))
    }
}

/// Runs the wave from all bones at once.
pub fn first_wave(lattice: &Lattice, bones: &Initiators<'_>, variant: &Variant) -> FirstWave {
    if only_times(variant) {
        return superpose::first_wave(lattice, variant);
    }
    first_in_order(lattice, bones, variant)
}

/// As [`first_wave`], one element at a time.
pub(in crate::chainmail) fn first_in_order(lattice: &Lattice, bones: &Initiators<'_>, variant: &Variant) -> FirstWave {
    let wave = run(&Scene::new(lattice, bones, variant), Source::AnyBone, None);
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
pub fn spread(lattice: &Lattice, bones: &Initiators<'_>, variant: &Variant) -> Vec<Option<[f32; 3]>> {
    if only_times(variant) {
        return superpose::spread(lattice, bones, variant).0;
    }
    in_order(lattice, bones, variant)
}

/// As [`spread`], one element at a time.
pub(in crate::chainmail) fn in_order(
    lattice: &Lattice,
    bones: &Initiators<'_>,
    variant: &Variant,
) -> Vec<Option<[f32; 3]>> {
    let scene = Scene::new(lattice, bones, variant);
    match variant.combination {
        Combination::Superposition => weigh(&scene, bones, variant),
        Combination::Prioritisation => {
            let wave = run(&scene, Source::AnyBone, None);
            let owner = &wave.trace.owner;
            each_active(lattice, bones, |node, voxel| {
                let u = (wave.time[node] != NEVER).then(|| scene.displacement(&wave, owner[node], node, voxel))?;
                Some([u.x as f32, u.y as f32, u.z as f32])
            })
        }
    }
}

/// Whether nothing but the least time along paths decides: the variant that [`superpose`] serves.
pub(in crate::chainmail) fn only_times(variant: &Variant) -> bool {
    variant.order == Order::Timestamps && variant.structures == Structures::None && variant.carry == Carry::Rigid
}

/// Eq. 5.7: as many waves at a time as there are threads, added plane by plane.
fn weigh(scene: &Scene<'_>, bones: &Initiators<'_>, variant: &Variant) -> Vec<Option<[f32; 3]>> {
    let lattice = scene.lattice;
    let [nx, ny, _] = lattice.grid.size();
    let latest = superpose::latest_at_nodes(lattice, variant);
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
                    let u = scene.displacement(wave, *b, node, [at % nx, at / nx, k]);
                    let w = weight(f64::from(wave.time[node].max(1)), variant.exponent);
                    s[0] += w;
                    (0..3).for_each(|a| s[1 + a] += w * u[a]);
                }
            }
        });
    }
    each_active(lattice, bones, |node, _| weighted_mean(sums[node]))
}
