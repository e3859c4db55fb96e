//! From bone transforms to the push field on the planning grid.

use super::blend::superpose;
use super::carry::Carry;
use super::extend::{extend, fill};
use super::front::{Front, FrontRules, LinkTime};
use super::lattice::{Lattice, Node, Tissue};
use super::material::Material;
use super::relax::Relaxation;
use crate::error::Result;
use crate::field::PushField;
use crate::geometry::Rigid;
use crate::progress::Progress;
use crate::volume::{Volume, trilinear_vector};
use nalgebra::{Matrix3, Point3, Vector3};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// How bone motion is carried to soft tissue.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ChainmailOptions {
    /// Material transfer function.
    pub material: Material,
    /// Time along a link.
    pub link_time: LinkTime,
    /// Links that a front runs along.
    pub front: Front,
    /// What a bone hands to the tissue around it.
    pub carry: Carry,
    /// Exponent n of the superposition's weights t^-n.
    pub exponent: f64,
    /// Times beyond this have no influence, mm of link at relative shear 1 (thesis 5.4.2: 800 links of 0.98 mm).
    pub cutoff: f64,
    /// A bone's front stops where it arrives this many times later than the first one: its weight there is below this
    /// ratio to the power -n. 0 for none (exact).
    pub prune_ratio: f64,
    /// Spacing of the elements, mm; 0 for the planning grid itself.
    pub spacing_mm: f64,
    /// Spacings of the relaxation, coarse to fine, mm, and rounds at each; empty for none.
    pub relaxation: Vec<(f64, usize)>,
    /// Voxels below this take no part, HU.
    pub least_hu: f32,
}

impl Default for ChainmailOptions {
    fn default() -> Self {
        Self {
            material: Material::default(),
            link_time: LinkTime::SlowInStiff,
            front: Front::Round,
            carry: Carry::Rigid,
            exponent: 4.0,
            cutoff: 800.0 * 0.98,
            prune_ratio: 4.0,
            spacing_mm: 3.0,
            relaxation: vec![(12.0, 40), (6.0, 30), (3.0, 20)],
            least_hu: -500.0,
        }
    }
}

impl ChainmailOptions {
    /// The thesis's final model (6.1.7): timestamps, linear decay, superposition t^-4, stiff, every voxel an element.
    pub fn thesis() -> Self {
        Self {
            link_time: LinkTime::Literal,
            front: Front::Rhombus,
            carry: Carry::LinearDecay,
            cutoff: 800.0,
            prune_ratio: 0.0,
            spacing_mm: 0.0,
            relaxation: Vec::new(),
            ..Self::default()
        }
    }
}

/// The bones' motion: one transform and one centroid (LPS mm, the thesis's rotation point) per bone of the skeleton.
pub struct Initiators<'a> {
    /// Planning to fraction.
    pub transforms: &'a [Rigid],
    /// Centroids in planning.
    pub centroids: &'a [Point3<f64>],
}

/// The propagation's result: the field, and the lattice with its displacements for the links' report.
pub struct Propagation {
    /// Planning to fraction.
    pub push: PushField,
    /// The elements.
    pub lattice: Lattice,
    /// Displacement of each element, mm.
    pub displacement: Vec<[f32; 3]>,
}

/// Carries the bones' motion to every voxel of the planning grid.
///
/// # Errors
/// None at present; the result type leaves room for limits on memory.
pub fn propagate(
    tissue: &Tissue<'_>,
    bones: &Initiators<'_>,
    options: &ChainmailOptions,
    progress: &dyn Progress,
) -> Result<Propagation> {
    let rules = FrontRules { time: options.link_time, front: options.front, cutoff: options.cutoff };
    let turns: Vec<Matrix3<f64>> =
        bones.transforms.iter().map(|t| t.rotation.to_rotation_matrix().into_inner()).collect();
    let steps = options.relaxation.len() + 2;
    // What relaxation changed at the last, coarser spacing; carried on as a correction, so that detail near bones stays.
    let mut change: Option<Volume<[f32; 3]>> = None;
    for (n, &(spacing, rounds)) in options.relaxation.iter().filter(|r| r.0 > options.spacing_mm).enumerate() {
        progress.step(n, steps, &format!("relax at {spacing} mm"));
        let lattice = Lattice::new(tissue, &options.material, spacing);
        let start = start(&lattice, bones, &rules, options, change.as_ref());
        let mut relaxation = Relaxation::new(&lattice, &start.0, &turns);
        relaxation.run(rounds);
        let relaxed = relaxation.displacements();
        let difference: Vec<Option<[f32; 3]>> = (0..relaxed.len())
            .map(|n| (lattice.node[n] != Node::Outside).then(|| std::array::from_fn(|a| relaxed[n][a] - start.1[n][a])))
            .collect();
        change = Some(Volume::new(lattice.grid.clone(), fill(&lattice, &difference, 2).0)?);
    }
    progress.step(steps - 2, steps, "propagate");
    let lattice = Lattice::new(tissue, &options.material, options.spacing_mm);
    let (mut displacement, _) = start(&lattice, bones, &rules, options, change.as_ref());
    if let Some(&(_, rounds)) = options.relaxation.iter().find(|r| r.0 <= options.spacing_mm) {
        let mut relaxation = Relaxation::new(&lattice, &displacement, &turns);
        relaxation.run(rounds);
        displacement = relaxation.displacements();
    }
    let known: Vec<Option<[f32; 3]>> =
        (0..displacement.len()).map(|n| (lattice.node[n] != Node::Outside).then(|| displacement[n])).collect();
    displacement = extend(&lattice, &known);
    progress.step(steps - 1, steps, "all voxels");
    let coarse = Volume::new(lattice.grid.clone(), displacement)?;
    let push = to_voxels(tissue, bones.transforms, &coarse)?;
    Ok(Propagation { push, lattice, displacement: coarse.into_data() })
}

/// Superposition plus the coarser correction on the whole lattice, and the superposition alone.
fn start(
    lattice: &Lattice,
    bones: &Initiators<'_>,
    rules: &FrontRules,
    options: &ChainmailOptions,
    change: Option<&Volume<[f32; 3]>>,
) -> (Vec<[f32; 3]>, Vec<[f32; 3]>) {
    let plain = reached_or_filled(lattice, &superpose(lattice, bones.transforms, bones.centroids, rules, options));
    let mut corrected = plain.clone();
    if let Some(change) = change {
        let plane = lattice.grid.size()[0] * lattice.grid.size()[1];
        corrected.par_chunks_mut(plane).enumerate().for_each(|(k, out)| {
            for (at, u) in out.iter_mut().enumerate() {
                let node = k * plane + at;
                if matches!(lattice.node[node], Node::Bone(_)) {
                    continue;
                }
                if let Some(d) = trilinear_vector(change, &change.grid().index(&lattice.rest(node))) {
                    for a in 0..3 {
                        u[a] += d[a] as f32;
                    }
                }
            }
        });
    }
    (corrected, plain)
}

/// Islands that no front reaches take the motion around them; outside the elements the field is zero for now.
fn reached_or_filled(lattice: &Lattice, reached: &[Option<[f32; 3]>]) -> Vec<[f32; 3]> {
    let island = |n: usize| lattice.node[n] == Node::Soft && reached[n].is_none();
    if lattice.active.iter().any(|&n| island(n as usize)) {
        return fill(lattice, reached, usize::MAX).0;
    }
    reached.iter().map(|u| u.unwrap_or_default()).collect()
}

/// The lattice's displacements on the planning grid; bone voxels move exactly with their bone.
fn to_voxels(tissue: &Tissue<'_>, transforms: &[Rigid], coarse: &Volume<[f32; 3]>) -> Result<PushField> {
    let grid = tissue.ct.grid().clone();
    let [nx, ny, _] = grid.size();
    let mut u = vec![[0f32; 3]; grid.len()];
    let base = coarse.grid().index(&grid.origin());
    let step = coarse.grid().inverse_step() * grid.step();
    u.par_chunks_mut(nx * ny).enumerate().for_each(|(k, out)| {
        for (at, o) in out.iter_mut().enumerate() {
            let (i, j) = (at % nx, at / nx);
            let voxel = k * nx * ny + at;
            let d = match tissue.bone(voxel) {
                Some(b) => {
                    let x = grid.centre([i, j, k]);
                    transforms[usize::from(b)] * x - x
                }
                None => trilinear_vector(coarse, &(base + step * Vector3::new(i as f64, j as f64, k as f64)))
                    .unwrap_or_default(),
            };
            *o = [d.x as f32, d.y as f32, d.z as f32];
        }
    });
    let computed = (0..grid.len()).map(|v| tissue.active(v)).collect();
    Ok(PushField { displacement: Volume::new(grid.clone(), u)?, computed: Volume::new(grid, computed)? })
}
