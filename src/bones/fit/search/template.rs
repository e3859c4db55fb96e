//! What a bone looks like with its surroundings, turned.

use super::super::coarse::{BLOCK_MM, Coarse, block, of_blocks};
use super::super::shape::{Descriptor, Shapes, Undescribed};
use crate::geometry::Grid;
use crate::skeleton::Skeleton;
use crate::volume::morphology::dilate;
use crate::volume::ranges::{RANGES, memberships};
use crate::volume::{LabelMap, Mask, Volume, blocks, trilinear};
use nalgebra::{Point3, UnitQuaternion, Vector3};
use rayon::prelude::*;

/// Ranges of HU that the search in an image of another modality tells apart: fat, soft tissue, marrow, cortical bone.
pub const GROUPS: usize = 4;

/// Width of the surroundings that belong to a bone, mm: they tell a vertebra from its neighbours.
const AROUND_MM: f64 = 8.0;
/// Smaller bones propose nothing, mm^3.
const LEAST_MM3: f64 = 3000.0;
/// Voxels that a turned bone is compared by, at most.
const VOXELS: usize = 500;
/// One in so many of them has a descriptor: neighbours' hold nearly the same.
pub const DESCRIBED: usize = 3;

/// The planning side of the search: CT and labels, coarse.
#[derive(Debug, Clone)]
pub struct Anatomy {
    planning: Coarse,
    labels: Volume<u16>,
    /// Membership in groups of ranges of HU, where another modality is compared; else empty.
    groups: Vec<Volume<f32>>,
    /// Its tissue, where descriptors are compared.
    pub undescribed: Option<Undescribed>,
}

/// A bone with its surroundings in planning.
pub struct Template<'a> {
    anatomy: &'a Anatomy,
    /// Its place in the skeleton.
    pub bone: usize,
    /// The middle of its label, LPS mm.
    pub centre: Point3<f64>,
    /// Blocks that belong to it.
    mask: Mask,
    /// Their middles, LPS mm.
    points: Vec<Point3<f64>>,
}

/// A turned bone: offsets from its middle in voxels of the fraction, with planning's HU there.
#[derive(Default)]
pub struct Turned {
    /// Whole steps along the fraction's axes.
    pub offsets: Vec<[i32; 3]>,
    /// HU.
    pub values: Vec<f32>,
    /// Membership in groups of ranges of HU, where another modality is compared; else empty.
    pub memberships: Vec<[f32; GROUPS]>,
    /// Descriptors, where these are compared; else empty.
    pub descriptors: Vec<Option<Descriptor>>,
}

impl Anatomy {
    /// Of the planning CT (HU) and its labels, which share a grid.
    pub fn new(planning: &Volume<f32>, labels: &LabelMap, by_ranges: bool) -> Self {
        let fine = labels.volume.grid();
        let block = block(fine, BLOCK_MM);
        let grid = blocks(fine, block);
        let most = |voxels: &[usize]| {
            let mut found: Vec<u16> = voxels.iter().map(|&v| labels.volume.data()[v]).filter(|l| *l > 0).collect();
            found.sort_unstable();
            let longest = found.chunk_by(|a, b| a == b).max_by_key(|c| c.len());
            longest.filter(|c| 3 * c.len() > voxels.len()).map_or(0, |c| c[0])
        };
        let values = of_blocks(fine, block, &grid, most);
        let labels = Volume::new(grid, values).expect("one label per block");
        let groups = if by_ranges { groups(planning) } else { Vec::new() };
        let coarse = Coarse::new(planning);
        let undescribed = by_ranges.then(|| Undescribed::new(planning, &coarse));
        Self { planning: coarse, labels, groups, undescribed }
    }

    /// The bones that are large enough.
    pub fn templates(&self, skeleton: &Skeleton) -> Vec<Template<'_>> {
        let large = (0..skeleton.bones.len()).into_par_iter().filter(|&b| skeleton.bones[b].volume_mm3 >= LEAST_MM3);
        let of = |b: usize| {
            let grid = self.labels.grid();
            let mask = dilate(&self.labels.map(|l| *l == skeleton.bones[b].label), AROUND_MM);
            let inside = mask.data().iter().enumerate().filter(|(_, m)| **m);
            let points = inside.map(|(l, _)| grid.centre(grid.voxel(l))).collect();
            Template { anatomy: self, bone: b, centre: skeleton.bones[b].centroid, mask, points }
        };
        large.map(of).filter(|t| !t.points.is_empty()).collect()
    }
}

/// Air, HU.
const AIR_HU: f32 = -600.0;
/// The group of each range.
const GROUP: [usize; RANGES] = [0, 1, 1, 2, 3, 3];

/// Mean membership of each block's tissue in the groups.
fn groups(planning: &Volume<f32>) -> Vec<Volume<f32>> {
    let fine = planning.grid();
    let block = block(fine, BLOCK_MM);
    let grid = blocks(fine, block);
    let of = |voxels: &[usize]| {
        let mut sums = [0f32; GROUPS];
        let tissue = voxels.iter().map(|&v| planning.data()[v]).filter(|hu| *hu > AIR_HU);
        for hu in tissue {
            memberships(hu).iter().zip(GROUP).for_each(|(m, group)| sums[group] += m);
        }
        let all: f32 = sums.iter().sum();
        // A block of air counts as cortical bone: both are dark.
        if all > 0.0 { sums.map(|s| s / all) } else { [0.0, 0.0, 0.0, 1.0] }
    };
    let all = of_blocks(fine, block, &grid, of);
    (0..GROUPS).map(|a| Volume::from_fn(grid.clone(), |n| all[n][a])).collect()
}

impl Template<'_> {
    /// The bone turned about its middle, on a grid of the fraction.
    pub fn turned(&self, turn: &UnitQuaternion<f64>, fraction: &Grid, shapes: Option<&Shapes<'_>>) -> Turned {
        let Self { centre, points, .. } = self;
        let Coarse { value, seen } = &self.anatomy.planning;
        let grid = value.grid();
        let mut range = [[0i32; 2]; 3];
        for p in points {
            let at = fraction.inverse_step() * (turn * (p - centre));
            for (r, v) in range.iter_mut().zip(at.iter()) {
                *r = [r[0].min(v.floor() as i32), r[1].max(v.ceil() as i32)];
            }
        }
        let mut all = Turned::default();
        let groups = &self.anatomy.groups;
        let back = turn.inverse();
        for k in range[2][0]..=range[2][1] {
            for j in range[1][0]..=range[1][1] {
                for i in range[0][0]..=range[0][1] {
                    let offset = fraction.step() * Vector3::new(f64::from(i), f64::from(j), f64::from(k));
                    let index = grid.index(&(centre + back * offset));
                    let Some(voxel) = grid.voxel_near(&index).map(|v| grid.linear(v)) else { continue };
                    if !self.mask.data()[voxel] || !seen[voxel] {
                        continue;
                    }
                    if let Some(hu) = trilinear(value, &index) {
                        all.offsets.push([i, j, k]);
                        all.values.push(hu as f32);
                        if !groups.is_empty() {
                            let share = |a: usize| trilinear(&groups[a], &index).map_or(0.0, |v| v as f32);
                            all.memberships.push(std::array::from_fn(share));
                        }
                    }
                }
            }
        }
        let mut all = all.thinned(VOXELS);
        if let Some(shapes) = shapes {
            let place = |o: &[i32; 3]| centre + back * (fraction.step() * Vector3::from(o.map(f64::from)));
            let places: Vec<Point3<f64>> = all.offsets.iter().step_by(DESCRIBED).map(place).collect();
            all.descriptors = vec![None; all.offsets.len()];
            let described = all.descriptors.iter_mut().step_by(DESCRIBED);
            described.zip(shapes.planning(&places, turn)).for_each(|(own, found)| *own = found);
        }
        all
    }
}

impl Turned {
    /// At most about so many of its voxels, spread evenly: by multiples of the golden ratio.
    pub fn thinned(&self, most: usize) -> Self {
        let share = most as f64 / self.values.len().max(1) as f64;
        const GOLDEN: f64 = 0.618_033_988_749_895;
        let kept = |n: &usize| (*n as f64 * GOLDEN).fract() < share;
        let chosen: Vec<usize> = (0..self.values.len()).filter(kept).collect();
        Self {
            offsets: chosen.iter().map(|&n| self.offsets[n]).collect(),
            values: chosen.iter().map(|&n| self.values[n]).collect(),
            memberships: chosen.iter().filter_map(|&n| self.memberships.get(n).copied()).collect(),
            descriptors: chosen.iter().filter_map(|&n| self.descriptors.get(n).copied()).collect(),
        }
    }
}
