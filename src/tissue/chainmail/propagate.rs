//! From bone transforms to the push field on the planning grid.

use super::chain_mail::{ChainMail, MailLevel};
use super::extend::{extend, fill};
use super::lattice::Node;
use super::lattice::{Lattice, Tissue};
use super::mend::mend;
use super::options::{ChainmailOptions, RelaxationLevel};
use super::relaxation::growth::Growth;
use super::relaxation::pull::ImagePull;
use super::relaxation::relax::Relaxation;
use super::relaxation::settle::settle;
use super::sides::take_sides;
use super::variants::Variant;
use super::waves::blend::first_wave;
use super::waves::carry::Initiators;
use super::waves::pruning::Pruning;
use crate::error::{Error, Result};
use crate::field::{PushField, in_steps};
use crate::geometry::{Rigid, rotation_matrices};
use crate::progress::Progress;
use crate::volume::{Mask, Volume, axis_pairs, trilinear_vector};
use nalgebra::Vector3;
use rayon::prelude::*;
use std::sync::Arc;

/// The propagation's result: the field, and the lattice with its displacements for the links' report.
pub struct Propagation {
    /// Planning to fraction.
    pub push: PushField,
    /// The elements.
    pub lattice: Arc<Lattice>,
    /// Displacement of each element, mm.
    pub displacement: Vec<[f32; 3]>,
    /// Waves that were pruned, and the most that this can change; where a bound is known.
    pub pruning: Option<Pruning>,
}

/// The elements, moved.
pub struct Elements {
    /// Where they are at rest.
    pub lattice: Arc<Lattice>,
    /// Displacement of each of its nodes, mm, continued beyond the patient.
    pub displacement: Volume<[f32; 3]>,
    /// As in [`Propagation`].
    pub pruning: Option<Pruning>,
}

/// Carries the bones' motion to every voxel of the planning grid.
///
/// # Errors
/// [`crate::error::Error::Usage`] when the options name an organ that the labels lack.
pub fn propagate(
    tissue: &Tissue<'_>,
    bones: &Initiators<'_>,
    options: &ChainmailOptions,
    image: Option<&dyn ImagePull>,
    progress: &dyn Progress,
) -> Result<Propagation> {
    ChainMail::new(tissue, options, &[])?.propagate(tissue, bones, options, image, progress)
}

impl ChainMail {
    /// As [`propagate`], with the chain mail of this very tissue and these options.
    ///
    /// # Errors
    /// [`crate::error::Error::Internal`] when the chain mail was made for other options.
    pub fn propagate(
        &self,
        tissue: &Tissue<'_>,
        bones: &Initiators<'_>,
        options: &ChainmailOptions,
        image: Option<&dyn ImagePull>,
        progress: &dyn Progress,
    ) -> Result<Propagation> {
        let Elements { lattice, displacement: coarse, pruning } =
            self.elements(tissue, bones, options, image, progress)?;
        let steps = options.relaxation.len() + 2;
        progress.step(steps - 1, steps, "all voxels");
        let mut push = to_voxels(tissue, &self.computed, bones.transforms, &coarse)?;
        if let Some(slip) = lattice.slip.as_ref().filter(|slip| slip.jumps) {
            take_sides(tissue, slip, &coarse, &mut push);
        }
        mend(tissue, &rotation_matrices(bones.transforms), options, &self.organs, &mut push);
        Ok(Propagation { push, lattice, displacement: coarse.into_data(), pruning })
    }

    /// Carries the bones' motion to the elements alone.
    ///
    /// # Errors
    /// As [`ChainMail::propagate`].
    pub fn elements(
        &self,
        tissue: &Tissue<'_>,
        bones: &Initiators<'_>,
        options: &ChainmailOptions,
        image: Option<&dyn ImagePull>,
        progress: &dyn Progress,
    ) -> Result<Elements> {
        let turns = rotation_matrices(bones.transforms);
        let mut growth = Growth::new(&options.volume_change, tissue)?;
        let mut relaxed = |level: &MailLevel, from: &[[f32; 3]], rounds| {
            let lattice = &*level.lattice;
            growth.enter(lattice, tissue);
            let (rest, loose) = level.resting()?;
            let relaxation = Relaxation::new(lattice, rest, from, &turns, options.poisson);
            Ok::<_, Error>(settle(relaxation, lattice, loose, rounds, &mut growth, image))
        };
        let steps = options.relaxation.len() + 2;
        progress.step(0, steps, "propagate");
        let waves = self.run_waves(bones, options)?;
        // What relaxation changed at the last, coarser spacing; carried on as a correction, so that detail near bones stays.
        let mut change: Option<Volume<[f32; 3]>> = None;
        let coarser = options.relaxation.iter().filter(|r| r.spacing_mm > options.spacing_mm);
        for (n, &RelaxationLevel { spacing_mm: spacing, rounds }) in coarser.enumerate() {
            progress.step(n + 1, steps, &format!("relax at {spacing} mm"));
            let level = self.at(spacing)?;
            let lattice = &level.lattice;
            let start = start(lattice, &waves.on(lattice, bones), change.as_ref());
            let relaxed = relaxed(level, &start.0, rounds)?;
            let difference: Vec<Option<[f32; 3]>> = (0..relaxed.len())
                .map(|n| {
                    (lattice.node[n] != Node::Outside).then(|| std::array::from_fn(|a| relaxed[n][a] - start.1[n][a]))
                })
                .collect();
            change = Some(Volume::new(
                lattice.grid.clone(),
                fill(lattice, &difference, |_| false, |layer, _, _| layer < 2).0,
            )?);
        }
        let level = self.at(options.spacing_mm)?;
        let lattice = &level.lattice;
        let (mut displacement, _) = start(lattice, &waves.on(lattice, bones), change.as_ref());
        if let Some(&RelaxationLevel { rounds, .. }) =
            options.relaxation.iter().find(|r| r.spacing_mm <= options.spacing_mm)
        {
            progress.step(steps - 2, steps, &format!("relax at {} mm", options.spacing_mm));
            displacement = relaxed(level, &displacement, rounds)?;
        }
        let known: Vec<Option<[f32; 3]>> =
            (0..displacement.len()).map(|n| (lattice.node[n] != Node::Outside).then(|| displacement[n])).collect();
        displacement = extend(lattice, &known, |node| tissue.holds(&lattice.rest(node)));
        let displacement = Volume::new(lattice.grid.clone(), displacement)?;
        Ok(Elements { lattice: lattice.clone(), displacement, pruning: waves.pruning })
    }
}

/// Regions of influence on the planning grid: 0 where no bone's motion comes, else the position in the skeleton plus 1
/// of the bone that reaches the voxel first. With prioritisation it is the bone whose motion the voxel takes, with
/// superposition the one with the greatest weight.
///
/// # Errors
/// [`crate::error::Error::Internal`] when the grids disagree.
pub fn regions(
    tissue: &Tissue<'_>,
    lattice: &Lattice,
    bones: &Initiators<'_>,
    variant: &Variant,
) -> Result<Volume<u16>> {
    let owner = first_wave(lattice, bones, variant).owner;
    let grid = tissue.ct.grid().clone();
    let size = lattice.grid.size();
    let base = lattice.grid.index(&grid.origin());
    let step = lattice.grid.inverse_step() * grid.step();
    let plane = grid.size()[0] * grid.size()[1];
    let mut out = vec![0u16; grid.len()];
    out.par_chunks_mut(plane).enumerate().for_each(|(k, out)| {
        for (at, o) in out.iter_mut().enumerate() {
            let voxel = k * plane + at;
            let [i, j, k] = grid.voxel(voxel).map(|v| v as f64);
            let near = base + step * Vector3::new(i, j, k);
            let node = [0, 1, 2].map(|a| (near[a].round().max(0.0) as usize).min(size[a] - 1));
            *o = match tissue.bone(voxel) {
                Some(b) => b + 1,
                None if tissue.active(voxel) => owner[lattice.grid.linear(node)].map_or(0, |b| b + 1),
                None => 0,
            };
        }
    });
    Volume::new(grid, out)
}

/// What the waves bring plus the coarser correction on the whole lattice, and the former alone.
fn start(
    lattice: &Lattice,
    by_waves: &[Option<[f32; 3]>],
    change: Option<&Volume<[f32; 3]>>,
) -> (Vec<[f32; 3]>, Vec<[f32; 3]>) {
    let plain = reached_or_filled(lattice, by_waves);
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

/// The displacements of active nodes on the whole lattice: islands that no front reaches take the motion around them; outside
/// the elements the field is zero for now.
fn reached_or_filled(lattice: &Lattice, reached: &[Option<[f32; 3]>]) -> Vec<[f32; 3]> {
    if reached.iter().any(Option::is_none) {
        return fill(lattice, &lattice.on_all_nodes(reached.iter().copied(), None), |_| false, |_, _, _| true).0;
    }
    lattice.on_all_nodes(reached.iter().map(|u| u.unwrap_or_default()), [0.0; 3])
}

/// The lattice's displacements on the planning grid, whose axes it shares; bone voxels move exactly with their bone.
///
/// Trilinear: between rows of elements first, so that a voxel costs one step along its row.
fn to_voxels(
    tissue: &Tissue<'_>,
    computed: &Mask,
    transforms: &[Rigid],
    coarse: &Volume<[f32; 3]>,
) -> Result<PushField> {
    let grid = tissue.ct.grid().clone();
    let [nx, ny, _] = grid.size();
    let axes = axis_pairs(coarse.grid(), &grid);
    let elements = coarse.grid().size()[0];
    let row = |j: usize, k: usize| -> &[[f32; 3]] { &coarse.data()[coarse.grid().linear([0, j, k])..][..elements] };
    let mut u = vec![[0f32; 3]; grid.len()];
    u.par_chunks_mut(nx).enumerate().for_each_init(Vec::new, |between: &mut Vec<Vector3<f64>>, (line, out)| {
        let (j, k) = (line % ny, line / ny);
        between.clear();
        let ((j0, j1, tj), (k0, k1, tk)) = (axes[1][j], axes[2][k]);
        let corners = [row(j0, k0), row(j1, k0), row(j0, k1), row(j1, k1)];
        // Far from the patient nothing moves.
        if corners.iter().any(|c| c.as_flattened().iter().any(|u| u.abs() > 0.0)) {
            between.extend((0..elements).map(|e| {
                let [a, b, c, d] = corners.map(|c| Vector3::from(c[e].map(f64::from)));
                (a * (1.0 - tj) + b * tj) * (1.0 - tk) + (c * (1.0 - tj) + d * tj) * tk
            }));
        }
        for (i, o) in out.iter_mut().enumerate() {
            let d = match (tissue.bone(line * nx + i), axes[0][i]) {
                (Some(b), _) => {
                    let x = grid.centre([i, j, k]);
                    transforms[usize::from(b)] * x - x
                }
                (None, (low, high, t)) if !between.is_empty() => between[low] * (1.0 - t) + between[high] * t,
                _ => continue,
            };
            let d = [d.x as f32, d.y as f32, d.z as f32];
            *o = if computed.data()[line * nx + i] { d } else { in_steps(d) };
        }
    });
    Ok(PushField { displacement: Volume::new(grid, u)?, computed: computed.clone() })
}
