//! How far the result may be trusted, in mm, at every place: one standard deviation, so that about two thirds of the errors are
//! smaller.
//!
//! Where both images show a place, two things tell an error (docs/decisions/0012-uncertainty.md has what was compared):
//! *disagreement*, the distance `d` between the field and the one of the bones alone, and *mismatch*, the remaining
//! difference of the images over their gradient, `q`, both averaged over 4 mm. Neither alone does, and the product does in
//! all cases: `0.5 ((d + 0.1) (q + 0.1)^2)^(1/3)`. Where images say nothing (outside the fraction's view, or when they take no
//! part), error grows with the distance to the nearest bone, beside that bone's own uncertainty.

use crate::error::Result;
use crate::field::PushField;
use crate::geometry::Grid;
use crate::stats::Summary;
use crate::volume::distance::{nearest_label, squared_distance};
use crate::volume::{LabelMap, Mask, Volume, gaussian, trilinear, trilinear_vector};
use nalgebra::{Point3, Vector3};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// What the map says in short.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct UncertaintyReport {
    /// Uncertainty over soft tissue (body above -500 HU, no bone), mm.
    pub soft_tissue_mm: Summary,
    /// Share of soft tissue where no image speaks, percent.
    pub without_images_percent: f64,
    /// Soft tissue with more than 2 mm, ml: beyond what AAPM TG-132 asks of a registration.
    pub above_2mm_ml: f64,
}

/// What the map is made from; all in the planning frame but `fraction`.
#[derive(Debug, Clone, Copy)]
pub struct Evidence<'a> {
    /// Planning CT, HU.
    pub planning: &'a Volume<f32>,
    /// Fraction CT, HU.
    pub fraction: &'a Volume<f32>,
    /// The patient in the planning CT.
    pub body: &'a Mask,
    /// Voxels that count as tissue, on the planning grid.
    pub tissue: &'a Mask,
    /// Bone labels.
    pub bones: &'a LabelMap,
    /// Standard deviation of each bone's position, mm, by its label.
    pub bone_mm: &'a BTreeMap<u16, f64>,
    /// The result.
    pub push: &'a PushField,
    /// Displacements of the bones alone on any grid; `None` when images took no part in soft tissue.
    pub bones_alone: Option<&'a Volume<[f32; 3]>>,
}

/// Spacing at which the map is computed, mm.
const SPACING_MM: f64 = 3.0;
/// Width (sigma) of the averages of difference and gradient, mm.
const AVERAGE_MM: f64 = 4.0;
/// HU between which the images are compared, as in the refinement by image.
const WINDOW_HU: [f32; 2] = [-250.0, 300.0];
/// Gradient that noise alone shows, HU/mm.
const NOISE_GRADIENT: f64 = 10.0;
/// Disagreement and mismatch that are always there, mm.
const FLOOR_MM: f64 = 0.1;
/// Scale of the product, so that two thirds of errors are smaller.
const SCALE: f64 = 0.5;
/// Error of the bones alone per mm of distance to a bone, and the distance at which a bone's surface counts as.
const PER_MM: f64 = 0.034;
const AT_BONE_MM: f64 = 5.0;
/// Share of the neighbourhood that both images must show to speak.
const LEAST_SEEN: f32 = 0.05;

/// The map on the planning grid, mm (0 outside the patient), and its summary.
///
/// # Errors
/// Only for internal inconsistency of grids.
pub fn map(e: &Evidence<'_>) -> Result<(Volume<f32>, UncertaintyReport)> {
    let grid = e.planning.grid().coarsened(SPACING_MM);
    let (owner, far) = bones(e, &grid)?;
    let seen = e.bones_alone.map(|alone| seen(e, alone, &grid)).transpose()?;
    let bone_mm = |label: u16| e.bone_mm.get(&label).copied().unwrap_or(0.0);
    let data: Vec<f32> = (0..grid.len())
        .into_par_iter()
        .map(|n| match seen.as_ref().and_then(|s| s[n]) {
            Some(mm) => mm,
            None => (PER_MM * (f64::from(far.data()[n]) + AT_BONE_MM)).hypot(bone_mm(owner.data()[n])) as f32,
        })
        .collect();
    let speaks: Vec<bool> = (0..grid.len()).map(|n| seen.as_ref().is_some_and(|s| s[n].is_some())).collect();
    let (coarse, speaks) = (Volume::new(grid.clone(), data)?, Volume::new(grid, speaks)?);
    let map = fine(e, &coarse, bone_mm)?;
    let report = report(e, &map, &speaks);
    Ok((map, report))
}

/// Label of the nearest bone and the distance to it, mm, on a coarse grid.
fn bones(e: &Evidence<'_>, grid: &Grid) -> Result<(Volume<u16>, Volume<f32>)> {
    let fine = e.bones.volume.grid();
    let mut labels = Volume::filled(grid.clone(), 0u16);
    for (l, label) in e.bones.volume.data().iter().enumerate().filter(|(_, l)| e.bone_mm.contains_key(l)) {
        if let Some(at) = voxel(grid, &fine.centre(fine.voxel(l))) {
            let at = grid.linear(at);
            labels.data_mut()[at] = *label;
        }
    }
    let far = squared_distance(&labels.map(|l| *l != 0), true).map(|d| d.sqrt().min(1e3));
    Ok((nearest_label(&labels), far))
}

/// The voxel that a point lies in.
fn voxel(grid: &Grid, p: &Point3<f64>) -> Option<[usize; 3]> {
    let at = grid.index(p).map(f64::round);
    (0..3).all(|a| at[a] >= 0.0 && at[a] < grid.size()[a] as f64).then(|| [0, 1, 2].map(|a| at[a] as usize))
}

/// Uncertainty where both images speak.
fn seen(e: &Evidence<'_>, alone: &Volume<[f32; 3]>, grid: &Grid) -> Result<Vec<Option<f32>>> {
    let points = compare(e, grid);
    let (gain, offset) = grey_values(&points);
    let square = |p: &Pairs| {
        let sum: f64 = p.0.iter().map(|[a, b]| (f64::from(*a) - gain * f64::from(*b) - offset).powi(2)).sum();
        (sum / p.0.len() as f64) as f32
    };
    let of = |f: &dyn Fn(&Node) -> f32| Volume::new(grid.clone(), points.iter().map(f).collect());
    let weight = gaussian(&of(&|n| f32::from(u8::from(n.pairs.is_some())))?, AVERAGE_MM);
    let difference = gaussian(&of(&|n| n.pairs.as_ref().map_or(0.0, square))?, AVERAGE_MM);
    let slope = gaussian(&squared_slope(&of(&|n| n.mean)?), AVERAGE_MM);
    let distance = |n: usize| {
        let x = grid.centre(grid.voxel(n));
        let at = |v: &Volume<[f32; 3]>| trilinear_vector(v, &v.grid().index(&x)).unwrap_or_else(Vector3::zeros);
        (at(&e.push.displacement) - at(alone)).norm()
    };
    let value = |n: usize| {
        let w = weight.data()[n];
        (w > LEAST_SEEN).then(|| {
            let mismatch =
                f64::from(difference.data()[n] / w).sqrt() / (f64::from(slope.data()[n]).sqrt() + NOISE_GRADIENT);
            (SCALE * ((distance(n) + FLOOR_MM) * (mismatch + FLOOR_MM).powi(2)).cbrt()) as f32
        })
    };
    Ok((0..grid.len()).into_par_iter().map(value).collect())
}

/// Windowed planning and fraction HU at the eight points of a coarse voxel.
#[derive(Clone)]
struct Pairs([[f32; 2]; 8]);

/// What the images show at a coarse voxel.
struct Node {
    /// Mean windowed planning HU; the window's lower end outside the patient.
    mean: f32,
    /// Both images' HU, in soft tissue that the fraction shows.
    pairs: Option<Pairs>,
}

/// Both images at eight points of each coarse voxel, the fraction where the field says.
fn compare(e: &Evidence<'_>, grid: &Grid) -> Vec<Node> {
    let [low, high] = WINDOW_HU;
    let (planning, fraction, u) = (e.planning, e.fraction, &e.push.displacement);
    let labels = e.bones.volume.data();
    let offsets = grid.eighths();
    let node = |n: usize| {
        let x = grid.centre(grid.voxel(n));
        let Some(own) = voxel(planning.grid(), &x).map(|v| planning.grid().linear(v)) else {
            return Node { mean: low, pairs: None };
        };
        if !e.body.data()[own] {
            return Node { mean: low, pairs: None };
        }
        let value = |image: &Volume<f32>, p: Point3<f64>| {
            trilinear(image, &image.grid().index(&p)).map(|v| (v as f32).clamp(low, high))
        };
        let shift = trilinear_vector(u, &u.grid().index(&x)).unwrap_or_else(Vector3::zeros);
        let (mut pairs, mut sum, mut complete) = ([[0.0; 2]; 8], 0.0, !e.bone_mm.contains_key(&labels[own]));
        for (pair, o) in pairs.iter_mut().zip(&offsets) {
            let a = value(planning, x + o).unwrap_or_else(|| planning.data()[own].clamp(low, high));
            sum += a;
            match value(fraction, x + o + shift).filter(|_| complete) {
                Some(b) => *pair = [a, b],
                None => complete = false,
            }
        }
        Node { mean: sum / 8.0, pairs: complete.then_some(Pairs(pairs)) }
    };
    (0..grid.len()).into_par_iter().map(node).collect()
}

/// HU inside this much of 0 enter the fit of gain and offset: not the window's ends.
const MIDDLE_HU: f32 = 200.0;

/// Gain and offset of the fraction's grey values that fit planning best, in soft tissue.
fn grey_values(nodes: &[Node]) -> (f64, f64) {
    let mut s = [0f64; 5];
    for [p, f] in nodes.iter().filter_map(|n| n.pairs.as_ref()).flat_map(|p| p.0) {
        if p.abs() < MIDDLE_HU && f.abs() < MIDDLE_HU {
            let (p, f) = (f64::from(p), f64::from(f));
            s = [s[0] + 1.0, s[1] + f, s[2] + p, s[3] + f * f, s[4] + f * p];
        }
    }
    let variance = s[3] - s[1] * s[1] / s[0].max(1.0);
    if variance < 1.0 {
        return (1.0, 0.0);
    }
    let gain = ((s[4] - s[1] * s[2] / s[0]) / variance).clamp(0.7, 1.4);
    (gain, (s[2] - gain * s[1]) / s[0])
}

/// Squared length of the gradient, per mm^2; central differences, one-sided at the edge.
fn squared_slope(image: &Volume<f32>) -> Volume<f32> {
    let grid = image.grid();
    let (size, strides, spacing) = (grid.size(), grid.strides(), grid.spacing());
    let data = image.data();
    let square = |n: usize| {
        let at = grid.voxel(n);
        (0..3)
            .map(|a| {
                let low = if at[a] > 0 { n - strides[a] } else { n };
                let high = if at[a] + 1 < size[a] { n + strides[a] } else { n };
                let steps = ((high - low) / strides[a]).max(1) as f64;
                (f64::from(data[high] - data[low]) / (steps * spacing[a])).powi(2)
            })
            .sum::<f64>() as f32
    };
    let values = (0..grid.len()).into_par_iter().map(square).collect();
    Volume::new(grid.clone(), values).expect("one value per voxel")
}

/// The coarse map on the planning grid: bones have their own uncertainty, and outside the patient it is 0.
fn fine(e: &Evidence<'_>, coarse: &Volume<f32>, bone_mm: impl Fn(u16) -> f64 + Sync) -> Result<Volume<f32>> {
    let grid = e.planning.grid();
    let [ni, nj, _] = grid.size();
    let labels = e.bones.volume.data();
    let ratio: [f64; 3] = std::array::from_fn(|a| grid.spacing()[a] / coarse.grid().spacing()[a]);
    let last = coarse.grid().size().map(|n| (n - 1) as f64);
    let mut out = vec![0f32; grid.len()];
    out.par_chunks_mut(ni * nj).enumerate().for_each(|(k, slice)| {
        for (n, value) in slice.iter_mut().enumerate() {
            let l = k * ni * nj + n;
            if e.bone_mm.contains_key(&labels[l]) {
                *value = bone_mm(labels[l]) as f32;
            } else if e.body.data()[l] {
                // Both grids share origin and axes.
                let at = [n % ni, n / ni, k];
                let index = Vector3::from_fn(|a, _| (at[a] as f64 * ratio[a]).min(last[a]));
                *value = trilinear(coarse, &index).unwrap_or(0.0) as f32;
            }
        }
    });
    Volume::new(grid.clone(), out)
}

fn report(e: &Evidence<'_>, map: &Volume<f32>, speaks: &Mask) -> UncertaintyReport {
    let labels = e.bones.volume.data();
    let grid = map.grid();
    let soft: Vec<usize> =
        (0..grid.len()).filter(|&l| e.tissue.data()[l] && !e.bone_mm.contains_key(&labels[l])).collect();
    let values: Vec<f32> = soft.iter().map(|&l| map.data()[l]).collect();
    let above = values.iter().filter(|v| **v > 2.0).count();
    let unheard = |l: &&usize| voxel(speaks.grid(), &grid.centre(grid.voxel(**l))).is_none_or(|v| !speaks.at(v));
    let silent = soft.par_iter().filter(unheard).count();
    UncertaintyReport {
        without_images_percent: 100.0 * silent as f64 / soft.len().max(1) as f64,
        above_2mm_ml: above as f64 * grid.voxel_volume() / 1000.0,
        soft_tissue_mm: crate::stats::Summary::of_singles(&[&values]),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A box of tissue with stripes in its left half and nothing in its right half; a bone in the middle. The fraction is the
    /// same, shifted by `error` beyond what the field says, and shows only z < 60.
    fn scene(error: f64, images: bool) -> (Volume<f32>, UncertaintyReport) {
        let grid = Grid::axis_aligned([40, 30, 40], [3.0, 3.0, 2.0], [0.0; 3]).unwrap();
        let seen = Grid::axis_aligned([50, 40, 31], [3.0, 3.0, 2.0], [-12.0, -12.0, 0.0]).unwrap();
        let inside = |p: &Point3<f64>| p.x > 6.0 && p.x < 110.0 && p.y > 6.0 && p.y < 80.0;
        let hu = |p: &Point3<f64>| match inside(p) {
            false => -1000.0,
            true if p.x < 55.0 => (60.0 * (p.x / 4.0).sin()) as f32,
            true => 20.0,
        };
        let planning = Volume::from_fn(grid.clone(), |l| hu(&grid.centre(grid.voxel(l))));
        let fraction =
            Volume::from_fn(seen.clone(), |l| hu(&(seen.centre(seen.voxel(l)) - Vector3::new(error, 0.0, 0.0))) + 15.0);
        let body = Volume::from_fn(grid.clone(), |l| inside(&grid.centre(grid.voxel(l))));
        let label = |l: usize| {
            let [i, j, _] = grid.voxel(l);
            u16::from((18..=20).contains(&i) && (14..=16).contains(&j)) * 5
        };
        let bones = LabelMap { volume: Volume::from_fn(grid.clone(), label), names: BTreeMap::new() };
        let displacement = Volume::filled(grid.clone(), [0.0f32; 3]);
        // The field of the bones alone disagrees by 1 mm.
        let alone = Volume::filled(grid.clone(), [0.0, 1.0, 0.0]);
        let push = PushField { displacement, computed: Volume::filled(grid, true) };
        let e = Evidence {
            planning: &planning,
            fraction: &fraction,
            body: &body,
            tissue: &body,
            bones: &bones,
            bone_mm: &BTreeMap::from([(5, 0.25)]),
            push: &push,
            bones_alone: images.then_some(&alone),
        };
        map(&e).unwrap()
    }

    #[test]
    fn mismatch_raises_it_and_views_and_bones_keep_their_own() {
        let ((good, report), (bad, _)) = (scene(0.0, true), scene(2.0, true));
        let at = |m: &Volume<f32>, v: [usize; 3]| *m.at(v);
        let stripes = [10, 20, 12];
        // A grey value offset alone is no mismatch: 0.5 (1.1 * 0.1^2)^(1/3), and a little for partial volume.
        assert!((0.11..0.25).contains(&at(&good, stripes)), "{}", at(&good, stripes));
        assert!(at(&bad, stripes) > 2.0 * at(&good, stripes), "{} {}", at(&bad, stripes), at(&good, stripes));
        assert!((at(&good, [19, 15, 12]) - 0.25).abs() < 1e-6);
        assert!(at(&good, [0, 0, 5]) == 0.0);
        // Outside the fraction's view the distance to the bone speaks.
        let far = at(&good, [33, 15, 38]);
        let want = (0.034f64 * (39.0 + 5.0)).hypot(0.25);
        assert!((f64::from(far) - want).abs() < 0.15, "{far} {want}");
        assert!((10.0..40.0).contains(&report.without_images_percent), "{report:?}");
    }

    #[test]
    fn without_images_distance_alone_decides() {
        let (map, report) = scene(2.0, false);
        assert!((report.without_images_percent - 100.0).abs() < 1e-9);
        assert!(map.at([30, 15, 12]) > map.at([24, 15, 12]));
        assert_eq!(map.at([10, 20, 12]).to_bits(), scene(0.0, false).0.at([10, 20, 12]).to_bits());
    }
}
