//! What samples of soft tissue are drawn from: how far the map says each place may be off, and how it follows the bones.

use super::beside::limits;
use super::options::Correlation;
use super::posterior::{PosePosterior, PosedBone};
use super::strain::Strain;
use crate::error::Result;
use crate::geometry::{Grid, Rigid};
use crate::volume::distance::squared_distance;
use crate::volume::{LabelMap, Mask, Spans, Volume, gaussian, trilinear_vector};
use nalgebra::{Point3, Vector3};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;
use rayon::prelude::*;

/// Spacing of what is drawn, mm.
const SPACING_MM: f64 = 5.0;
/// What moves with the patient around him, mm: a dose beside the skin is read there.
const AROUND_MM: f64 = 12.0;
/// The map is averaged over this, mm (sigma): what is drawn must not shear where the map jumps.
const AVERAGE_MM: f64 = 6.0;
/// Bones that a place follows.
const FOLLOWED: usize = 4;
/// A bone is not nearer than this, mm: half a node.
const NEAREST_MM: f32 = 2.5;
/// Draws of the bones that tell how much of the map they account for.
const TRIED: u64 = 64;
/// Of the map's variance at least this share is tissue's own, wherever the bones account for all of it.
const OWN: f32 = 0.25;

/// A patient whose registration is known, and how well.
#[derive(Debug, Clone, Copy)]
pub struct SampledPatient<'a> {
    /// What the fit leaves open of his bones.
    pub posterior: &'a PosePosterior,
    /// Labels on the planning grid.
    pub bones: &'a LabelMap,
    /// Inside of the skin, on the planning grid.
    pub body: &'a Mask,
    /// The map of uncertainty, mm, on the planning grid; below 0 where nothing is known.
    pub uncertainty: &'a Spans<f32>,
    /// The most that counts of it, and what counts where nothing is known, mm.
    pub most_mm: f64,
    /// Planning to fraction on the planning grid, LPS mm.
    pub push: &'a Volume<[f32; 3]>,
    /// Over what lengths its errors are alike.
    pub correlation: Correlation,
    /// How much it deforms soft tissue.
    pub strain: Strain,
}

/// A node in or by the patient.
#[derive(Debug, Clone)]
pub(super) struct Node {
    /// Its position on the grid.
    pub(super) at: usize,
    /// Where the registration takes it, LPS mm.
    pub(super) moved: Point3<f64>,
    /// The bones that it follows, by their place in the posterior, with their shares, which add up to 1; none where there is no
    /// bone.
    pub(super) follows: [(u16, f32); FOLLOWED],
    /// Deviation of each component of what is its own, mm.
    pub(super) own_mm: f32,
    /// The bone that it lies beside, by its place in the posterior, and how far from its motion it may be taken, mm.
    pub(super) beside: Option<(u16, f32)>,
}

/// Ready to draw samples of a registration.
#[derive(Debug)]
pub struct TissueModel<'a> {
    pub(super) patient: SampledPatient<'a>,
    pub(super) grid: Grid,
    pub(super) nodes: Vec<Node>,
    /// What the registration displaces each node of the grid by, LPS mm.
    pub(super) found: Vec<Vector3<f64>>,
}

impl<'a> TissueModel<'a> {
    /// Of a patient; `scale`: deviation of each component over the map.
    ///
    /// # Errors
    /// Only for internal inconsistency of grids.
    pub fn new(patient: SampledPatient<'a>, scale: f64) -> Result<Self> {
        let fine = patient.bones.volume.grid();
        let grid = fine.coarsened(SPACING_MM);
        let cells = NodeCells::of(&patient, &grid);
        let near = squared_distance(&Volume::new(grid.clone(), cells.tissue.iter().map(|t| *t > 0.0).collect())?, true);
        let reach = (AROUND_MM * AROUND_MM) as f32;
        let listed: Vec<usize> = (0..grid.len()).filter(|n| near.data()[*n] <= reach).collect();
        let map = smoothed(&grid, &cells)?;
        let follows = followed(&patient, &grid, &cells, &listed)?;
        let displaced = |at: usize| {
            let x = grid.centre(grid.voxel(at));
            trilinear_vector(patient.push, &patient.push.grid().index_within(&x)).unwrap_or_default()
        };
        let found: Vec<Vector3<f64>> = (0..grid.len()).into_par_iter().map(displaced).collect();
        let beside = limits(&patient.bones.volume, &patient.posterior.labels(), &grid, &listed);
        let mut nodes: Vec<Node> = Vec::with_capacity(listed.len());
        for ((at, follows), beside) in listed.into_iter().zip(follows).zip(beside) {
            let moved = grid.centre(grid.voxel(at)) + found[at];
            nodes.push(Node { at, moved, follows, own_mm: 0.0, beside });
        }
        let by_bones = variance_by_bones(&patient, &nodes);
        for (node, bones) in nodes.iter_mut().zip(by_bones) {
            let all = (scale as f32 * map[node.at]).powi(2);
            node.own_mm = (all - bones).max(OWN * all).sqrt();
        }
        Ok(Self { patient, grid, nodes, found })
    }
}

/// The planning scan in the cells around the nodes.
struct NodeCells {
    /// Voxels of the patient over all voxels.
    tissue: Vec<f32>,
    /// Mean of the map over the patient's voxels, mm.
    map: Vec<f32>,
    /// The bones that have a voxel there, by their place in the posterior.
    bones: Vec<Vec<u16>>,
}

impl NodeCells {
    fn of(patient: &SampledPatient<'_>, grid: &Grid) -> Self {
        let fine = patient.bones.volume.grid();
        let ranges = [0, 1, 2].map(|a| fine.voxels_by_nearest(grid, a));
        let mut place = vec![u16::MAX; usize::from(u16::MAX) + 1];
        for (n, bone) in patient.posterior.bones.iter().enumerate() {
            place[usize::from(bone.label)] = n as u16;
        }
        let cell = |n: usize| {
            let [i, j, k] = grid.voxel(n);
            let (mut all, mut inside, mut sum, mut bones) = (0u32, 0u32, 0f64, Vec::new());
            for z in ranges[2][k].clone() {
                for y in ranges[1][j].clone() {
                    let row = fine.linear([0, y, z]);
                    for x in ranges[0][i].clone() {
                        let l = row + x;
                        all += 1;
                        let bone = place[usize::from(patient.bones.volume.data()[l])];
                        if bone != u16::MAX && !bones.contains(&bone) {
                            bones.push(bone);
                        }
                        if patient.body.data()[l] {
                            inside += 1;
                            let told = f64::from(patient.uncertainty.at([x, y, z]));
                            let told = if told < 0.0 { patient.most_mm } else { told * patient.strain.factor };
                            sum += told.min(patient.most_mm);
                        }
                    }
                }
            }
            let mean = if inside > 0 { sum / f64::from(inside) } else { 0.0 };
            (inside as f32 / all.max(1) as f32, (mean as f32, bones))
        };
        let (tissue, (map, bones)) = (0..grid.len()).into_par_iter().map(cell).unzip();
        Self { tissue, map, bones }
    }
}

/// The map over the patient, averaged, and continued around him.
fn smoothed(grid: &Grid, cells: &NodeCells) -> Result<Vec<f32>> {
    let weighted: Vec<f32> = cells.map.iter().zip(&cells.tissue).map(|(m, t)| m * t).collect();
    let sums = gaussian(&Volume::new(grid.clone(), weighted)?, AVERAGE_MM);
    let shares = gaussian(&Volume::new(grid.clone(), cells.tissue.clone())?, AVERAGE_MM);
    let ratio = |(s, n): (&f32, &f32)| if *n > 1e-4 { s / n } else { 0.0 };
    Ok(sums.data().iter().zip(shares.data()).map(ratio).collect())
}

/// The bones that each listed node follows: those nearest, by the inverse fourth power of their distance, as the chain mail
/// weighs what reaches it.
fn followed(
    patient: &SampledPatient<'_>,
    grid: &Grid,
    cells: &NodeCells,
    listed: &[usize],
) -> Result<Vec<[(u16, f32); FOLLOWED]>> {
    let mut nearest = vec![[(0u16, f32::INFINITY); FOLLOWED]; listed.len()];
    for bone in 0..patient.posterior.bones.len() as u16 {
        let mask = Volume::new(grid.clone(), cells.bones.iter().map(|b| b.contains(&bone)).collect())?;
        let far = squared_distance(&mask, true);
        for (own, at) in nearest.iter_mut().zip(listed) {
            let mut next = (bone, far.data()[*at]);
            for held in own.iter_mut() {
                if next.1 < held.1 {
                    std::mem::swap(held, &mut next);
                }
            }
        }
    }
    let shares = |list: [(u16, f32); FOLLOWED]| {
        let weights = list.map(|(bone, square)| (bone, square.max(NEAREST_MM * NEAREST_MM).powi(-2)));
        let sum: f32 = weights.iter().map(|(_, w)| w).sum();
        weights.map(|(bone, w)| (bone, if sum > 0.0 { w / sum } else { 0.0 }))
    };
    Ok(nearest.into_iter().map(shares).collect())
}

/// Variance of a component of what the bones bring to each node, mm^2: over draws that are always the same.
fn variance_by_bones(patient: &SampledPatient<'_>, nodes: &[Node]) -> Vec<f32> {
    let posterior = patient.posterior;
    let draws = posterior.draws(patient.strain.factor);
    let mut rngs = [TRIED, TRIED + 1].map(ChaCha8Rng::seed_from_u64);
    let tried: Vec<Vec<Rigid>> = (0..TRIED).map(|_| draws.draw(&mut rngs, 0.0)).collect();
    let of = |node: &Node| {
        let squares = tried.iter().map(|bones| brought(node, &posterior.bones, bones).norm_squared());
        (squares.sum::<f64>() / (3 * TRIED) as f64) as f32
    };
    nodes.par_iter().map(of).collect()
}

/// A bone's turn brings tissue no farther than at so many of its radii from its centre: what lies farther away does not swing with
/// a rib.
/// Through all tissue intervals are wider by half, and hold no more.
const REACH: f64 = 2.0;

/// What moved bones bring to a node, mm.
pub(super) fn brought(node: &Node, bones: &[PosedBone], motions: &[Rigid]) -> Vector3<f64> {
    let follows = node.follows.iter().filter(|(_, share)| *share > 0.0);
    let by = |(bone, share): &(u16, f32)| {
        let (Some(own), Some(motion)) = (bones.get(usize::from(*bone)), motions.get(usize::from(*bone))) else {
            return Vector3::zeros();
        };
        let arm = node.moved - own.centre;
        let reach = (REACH * own.radius_mm / arm.norm().max(1e-9)).min(1.0);
        let at = own.centre + arm * reach;
        (motion * at - at) * f64::from(*share)
    };
    follows.map(by).sum()
}
