//! MIND-SSC (Heinrich et al. 2013): how alike the neighbours of a place are to each other, in twelve channels. It does not ask
//! which grey values tissues have, so that images of two modalities can be compared.

use super::super::coarse::{Coarse, block, of_blocks};
use super::super::tissue::Tissue;
use crate::geometry::Grid;
use crate::volume::{Volume, blocks};
use nalgebra::{Matrix3, Point3, UnitQuaternion, Vector3};
use rayon::prelude::*;

/// Channels of a descriptor.
pub const CHANNELS: usize = 12;
/// Exponentials of dissimilarity, 0 to 1, of the pairs of neighbours.
pub type Descriptor = [f32; CHANNELS];

/// Neighbours lie this many steps of the fraction's coarse grid away: next to each other they share most of their voxels.
const APART: f64 = 2.0;
/// Voxels of a patch.
const PATCH: usize = 27;
/// A pair of patches of which less than this share is tissue says nothing.
const LEAST_PAIRS: f32 = 0.3;
/// Within which factors of the image's mean a place's own variance counts: noise in a flat region must not count as structure.
const VARIANCE: [f32; 2] = [1e-3, 1e3];
/// HU beyond which planning's values count as these.
const RANGE_HU: [f32; 2] = [-150.0, 900.0];
/// Width of planning's blocks, mm: interpolated, they blur as the fraction's blocks do.
const PLANNING_MM: f64 = 2.0;
/// Places that the mean variance is taken from: every so many.
const EVERY: usize = 7;

/// The six neighbours, along the axes.
const NEIGHBOURS: [[i32; 3]; 6] = [[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]];
/// Pairs of neighbours that do not face each other.
const PAIRS: [[usize; 2]; CHANNELS] =
    [[2, 0], [2, 1], [3, 0], [3, 1], [4, 0], [4, 1], [4, 2], [4, 3], [5, 0], [5, 1], [5, 2], [5, 3]];

/// Dissimilarities of the pairs, less the least, with their mean; `at` gives the value at an offset in steps, not a number where
/// there is no tissue.
#[inline(always)]
fn dissimilarities(at: impl Fn(Vector3<f64>) -> f32) -> Option<(Descriptor, f32)> {
    let mut patches = [[0f32; PATCH]; 6];
    for (patch, neighbour) in patches.iter_mut().zip(NEIGHBOURS) {
        let middle = Vector3::from(neighbour.map(f64::from)) * APART;
        for (n, value) in patch.iter_mut().enumerate() {
            let within = Vector3::new((n % 3) as f64, (n / 3 % 3) as f64, (n / 9) as f64).add_scalar(-1.0);
            *value = at(middle + within);
        }
    }
    let mut out = [0f32; CHANNELS];
    for (channel, [a, b]) in out.iter_mut().zip(PAIRS) {
        let (mut sum, mut n) = (0f32, 0f32);
        for (a, b) in patches[a].iter().zip(&patches[b]) {
            let square = (a - b) * (a - b);
            if !square.is_nan() {
                (sum, n) = (sum + square, n + 1.0);
            }
        }
        if n < LEAST_PAIRS * PATCH as f32 {
            return None;
        }
        *channel = sum / n;
    }
    let least = out.iter().copied().fold(f32::INFINITY, f32::min);
    out.iter_mut().for_each(|d| *d -= least);
    Some((out, out.iter().sum::<f32>() / CHANNELS as f32))
}

fn finished((dissimilarities, own): (Descriptor, f32), mean: f32) -> Descriptor {
    let variance = own.clamp(VARIANCE[0] * mean, VARIANCE[1] * mean).max(f32::MIN_POSITIVE);
    dissimilarities.map(|d| (-d / variance).exp())
}

fn mean_of(found: impl Iterator<Item = f32>) -> f32 {
    let (sum, n) = found.fold((0f64, 0usize), |(s, n), v| (s + f64::from(v), n + 1));
    (sum / n.max(1) as f64) as f32
}

/// The fraction's descriptors, on the search's coarse grid.
pub struct Described {
    pub(super) grid: Grid,
    /// Zero where there is none.
    pub each: Vec<Descriptor>,
    /// Whether there is one.
    pub is: Vec<bool>,
}

impl Described {
    /// Of blocks of the fraction, air being no tissue.
    pub fn new(Coarse { value: fraction, seen }: &Coarse) -> Self {
        let grid = fraction.grid().clone();
        let [ni, nj, nk] = grid.size().map(|n| n as i32);
        let value = |v: [i32; 3]| {
            if v.iter().zip([ni, nj, nk]).any(|(v, n)| *v < 0 || *v >= n) {
                return f32::NAN;
            }
            let l = grid.linear(v.map(|v| v as usize));
            if seen[l] && !Tissue::is_air(fraction.data()[l]) { fraction.data()[l] } else { f32::NAN }
        };
        let of = |l: usize| {
            let at = grid.voxel(l).map(|v| v as i32);
            let own = value(at);
            let offset = |o: Vector3<f64>| value([at[0] + o.x as i32, at[1] + o.y as i32, at[2] + o.z as i32]);
            (!own.is_nan()).then(|| dissimilarities(offset)).flatten()
        };
        let all: Vec<Option<(Descriptor, f32)>> = (0..grid.len()).into_par_iter().map(of).collect();
        let mean = mean_of(all.iter().flatten().map(|(_, own)| *own));
        let each = all.par_iter().map(|d| d.map_or([0.0; CHANNELS], |d| finished(d, mean))).collect();
        let is = all.iter().map(Option::is_some).collect();
        Self { grid, each, is }
    }

    /// Mean descriptor.
    pub fn mean(&self) -> Descriptor {
        let n = self.is.iter().filter(|is| **is).count().max(1) as f64;
        let sum = self.each.iter().fold([0f64; CHANNELS], |sum, d| std::array::from_fn(|c| sum[c] + f64::from(d[c])));
        sum.map(|s| (s / n) as f32)
    }
}

/// Planning's tissue, of which descriptors are made as a bone is turned.
#[derive(Debug, Clone)]
pub struct Undescribed {
    /// HU cut to a range; not a number in air and where nothing was measured.
    value: Volume<f32>,
    /// Blocks of the coarse grid of the planning CT, whose descriptors' mean variance counts.
    coarse: Vec<Point3<f64>>,
}

impl Undescribed {
    /// Of a planning image, HU.
    pub fn new(planning: &Volume<f32>, coarse: &Coarse) -> Self {
        let fine = planning.grid();
        let block = block(fine, PLANNING_MM);
        let grid = blocks(fine, block);
        let [least, _] = planning.extremes();
        let of = |voxels: &[usize]| {
            let tissue = voxels.iter().map(|&v| planning.data()[v]).filter(|v| *v > least && !Tissue::is_air(*v));
            let (sum, n) = tissue.fold((0.0, 0), |(s, n), v| (s + v.clamp(RANGE_HU[0], RANGE_HU[1]), n + 1));
            if 2 * n > voxels.len() { sum / n as f32 } else { f32::NAN }
        };
        let values = of_blocks(fine, block, &grid, of);
        let value = Volume::new(grid, values).expect("one value per block");
        let grid = coarse.value.grid();
        let coarse = (0..grid.len()).filter(|&l| coarse.seen[l]).step_by(EVERY);
        Self { value, coarse: coarse.map(|l| grid.centre(grid.voxel(l))).collect() }
    }

    /// Dissimilarities at a place, as seen after a turn along the steps of another grid.
    fn at(&self, place: &Point3<f64>, turned_steps: &Matrix3<f64>) -> Option<(Descriptor, f32)> {
        let grid = self.value.grid();
        let (start, steps) = (grid.index(place), grid.inverse_step() * turned_steps);
        let (size, strides, data) = (grid.size(), grid.strides(), self.value.data());
        let value = |offset: Vector3<f64>| {
            let index = start + steps * offset;
            let mut low = [0usize; 3];
            let mut share = [0f32; 3];
            for a in 0..3 {
                if !(index[a] >= 0.0 && index[a] < (size[a].max(1) - 1) as f64) {
                    return f32::NAN;
                }
                low[a] = index[a] as usize;
                share[a] = (index[a] - low[a] as f64) as f32;
            }
            let base = grid.linear(low);
            let along = |l: usize, stride: usize, s: f32| data[l] + s * (data[l + stride] - data[l]);
            let plane = |l: usize| {
                let (a, b) = (along(l, strides[0], share[0]), along(l + strides[1], strides[0], share[0]));
                a + share[1] * (b - a)
            };
            let (a, b) = (plane(base), plane(base + strides[2]));
            a + share[2] * (b - a)
        };
        dissimilarities(value)
    }

    /// Mean variance of the descriptors on a grid of such steps.
    pub fn variance(&self, steps: &Matrix3<f64>) -> f32 {
        let found: Vec<Option<(Descriptor, f32)>> = self.coarse.par_iter().map(|p| self.at(p, steps)).collect();
        mean_of(found.iter().flatten().map(|(_, own)| *own))
    }

    /// Descriptors of places of planning after a turn, as a grid of such steps (of this mean variance) sees them.
    pub fn described(
        &self,
        places: &[Point3<f64>],
        turn: &UnitQuaternion<f64>,
        steps: &Matrix3<f64>,
        variance: f32,
    ) -> Vec<Option<Descriptor>> {
        let turned = turn.inverse().to_rotation_matrix().matrix() * steps;
        places.iter().map(|p| self.at(p, &turned).map(|d| finished(d, variance))).collect()
    }
}
