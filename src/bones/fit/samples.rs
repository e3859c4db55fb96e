//! Planning bone points with their HU: what the fit compares with the fraction CT.

use super::tissue::{EDGE_MM, Tissue};
use crate::geometry::Grid;
use crate::skeleton::Skeleton;
use crate::volume::LabelMap;
use crate::volume::ranges::RANGES;
use nalgebra::Point3;

/// Width in mm of the shell of soft tissue around a bone that belongs to its samples: edges carry the information. In
/// coarser images it is one voxel of the finest axis wide: without any shell a bone has no contrast.
pub(super) const SHELL_MM: f64 = 2.5;

/// Sample voxels of one bone at one resolution.
#[derive(Debug, Clone, Default)]
pub struct Samples {
    /// Positions in the planning CT, LPS mm.
    pub points: Vec<Point3<f64>>,
    /// Planning HU there (clamped and smoothed as the fraction is).
    pub values: Vec<f64>,
    /// Membership of each in the ranges of HU, where another modality is compared; else empty.
    pub memberships: Vec<[f32; RANGES]>,
    /// Volume in cubic mm of all candidate voxels, of which the samples are a part.
    pub volume_mm3: f64,
}

impl Samples {
    /// At most so many of them, evenly chosen.
    pub fn thinned(&self, most: usize) -> Self {
        let every = self.points.len().div_ceil(most).max(1);
        Self {
            points: self.points.iter().step_by(every).copied().collect(),
            values: self.values.iter().step_by(every).copied().collect(),
            memberships: self.memberships.iter().step_by(every).copied().collect(),
            volume_mm3: self.volume_mm3,
        }
    }
}

/// Storage positions of each bone's voxels and shell, in storage order; bones in the order of the skeleton.
///
/// Shell voxels belong to the first bone of the skeleton that reaches them; another bone's voxels are never taken.
/// Voxels at the image's ends are left out, as those of the fraction are (see [`Tissue::visibility`]): what lies beyond is unknown
/// to planning and blurs into the fraction's.
pub fn candidates(skeleton: &Skeleton, labels: &LabelMap, shell_mm: f64) -> Vec<Vec<u32>> {
    let grid = labels.volume.grid();
    let size = grid.size();
    let spacing = grid.spacing();
    // What bears another label (an organ, a muscle) is tissue like any other.
    let mut of_label = vec![usize::MAX; usize::from(u16::MAX) + 1];
    for (b, bone) in skeleton.bones.iter().enumerate() {
        of_label[usize::from(bone.label)] = b;
    }
    let shell = spacing.into_iter().fold(f64::INFINITY, f64::min).max(shell_mm);
    let reach: [i64; 3] = std::array::from_fn(|a| (shell / spacing[a]).floor() as i64);
    let mut ball = Vec::new();
    for k in -reach[2]..=reach[2] {
        for j in -reach[1]..=reach[1] {
            for i in -reach[0]..=reach[0] {
                let mm2: f64 = [i, j, k].iter().zip(spacing).map(|(&o, s)| (o as f64 * s).powi(2)).sum();
                if mm2 <= shell * shell {
                    ball.push([i, j, k]);
                }
            }
        }
    }
    let strides = grid.strides().map(|s| s as i64);
    let steps: Vec<i64> = ball.iter().map(|o| (0..3).map(|a| o[a] * strides[a]).sum()).collect();
    let data = labels.volume.data();
    let mut out = vec![Vec::new(); skeleton.bones.len()];
    let mut taken = vec![false; data.len()];
    for (l, &label) in data.iter().enumerate() {
        let b = of_label[usize::from(label)];
        if label == 0 || b == usize::MAX {
            continue;
        }
        out[b].push(l as u32);
        let at = grid.voxel(l);
        let surface = (0..3).any(|a| {
            let stride = grid.strides()[a];
            at[a] == 0 || at[a] + 1 == size[a] || data[l - stride] != label || data[l + stride] != label
        });
        if !surface {
            continue;
        }
        let whole = (0..3).all(|a| at[a] as i64 >= reach[a] && at[a] as i64 + reach[a] < size[a] as i64);
        for (o, step) in ball.iter().zip(&steps) {
            let inside = |a: usize| (0..size[a] as i64).contains(&(at[a] as i64 + o[a]));
            if !whole && !(0..3).all(inside) {
                continue;
            }
            let m = (l as i64 + step) as usize;
            if of_label[usize::from(data[m])] == usize::MAX && !taken[m] {
                taken[m] = true;
                out[b].push(m as u32);
            }
        }
    }
    let inner = |l: u32, margin: [usize; 3]| !outermost(grid.voxel(l as usize), size, margin);
    let margins = [([1; 3], 2), (spacing.map(|s| ((EDGE_MM / s).ceil() as usize).max(1)), 5)];
    for list in &mut out {
        // A sliver of which less than half would be left, or less than a fifth without all that is blurred, has nothing else.
        let all = list.len();
        for (margin, least) in margins {
            if least * list.iter().filter(|l| inner(**l, margin)).count() < all {
                break;
            }
            list.retain(|l| inner(*l, margin));
        }
        list.sort_unstable();
    }
    out
}

/// Whether a voxel is among the first or last along an axis that has more than two.
fn outermost(at: [usize; 3], size: [usize; 3], margin: [usize; 3]) -> bool {
    (0..3).any(|a| size[a] > 2 && (at[a] < margin[a] || at[a] + margin[a] >= size[a]))
}

/// At most about `most` of the candidates (storage positions on `grid`), those in tissue; chosen by a hash of their
/// position so that no lattice pattern remains.
pub fn draw(candidates: &[u32], grid: &Grid, image: &Tissue, most: usize) -> Samples {
    let n = candidates.len();
    let keep = |l: u32| n <= most || hash(l) % n as u64 <= most as u64;
    let chosen = candidates.iter().copied().filter(|&l| keep(l)).filter_map(|l| {
        let p = grid.centre(grid.voxel(l as usize));
        image.at(&p).map(|v| (p, v))
    });
    let (points, values) = chosen.unzip();
    Samples { points, values, memberships: Vec::new(), volume_mm3: n as f64 * grid.voxel_volume() }
}

/// SplitMix64's finaliser: a fixed, well-mixed hash.
fn hash(l: u32) -> u64 {
    let mut z = u64::from(l).wrapping_add(0x9E37_79B9_7F4A_7C15);
    z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    z ^ (z >> 31)
}
