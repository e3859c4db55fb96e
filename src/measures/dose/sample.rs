//! Where a structure has its dose: samples of label maps and of contours, with the weight of each.

use super::interpolate::snapped;
use crate::geometry::Grid;
use crate::volume::contour::{Contours, Structure};
use crate::volume::{LabelMap, Surrounding, Volume, cubic};
use nalgebra::Vector3;
use rayon::prelude::*;
use std::collections::BTreeMap;

/// Samples in the box around a structure at least, if its contours are finer than the dose's voxels.
const FINE: f64 = 100_000.0;
/// Samples in the box around a structure at most.
const MOST: f64 = 8e6;
/// Width of the edge at which samples count in part, mm.
const SOFT_MM: f64 = 0.5;

/// Dose at one place, and the volume that it stands for in units of the structure's samples.
pub(super) struct DoseSample {
    pub gy: f32,
    pub weight: f32,
}

/// A structure's samples.
pub(super) struct Sampled {
    pub name: String,
    pub samples: Vec<DoseSample>,
    /// Volume of a sample of weight 1, ml.
    pub unit_ml: f64,
    /// Volume of the structure itself, ml.
    pub own_ml: f64,
    /// Weight of samples outside the dose's grid; their dose is 0.
    pub outside: f64,
}

/// The dose at a continuous index by cubic convolution, within what the voxels around it hold; a dose's voxels reach half a step beyond
/// their centres. Linear interpolation cuts peaks off, by 11 % in one of 6 mm on voxels of 4 mm.
fn at(dose: &Volume<f32>, index: &Vector3<f64>) -> Option<f32> {
    let (value, _) = cubic(dose, index)?;
    let around = Surrounding::of(dose.grid(), index)?.voxels.map(|l| dose.data()[l]);
    let [low, high] = around.iter().fold([f32::MAX, f32::MIN], |[low, high], d| [low.min(*d), high.max(*d)]);
    Some((value as f32).clamp(low, high))
}

/// A place of a structure: where it lies in the dose's continuous index, and the volume that it stands for.
struct SamplePlace {
    index: Vector3<f64>,
    weight: f32,
}

/// Where a structure is sampled on a dose's grid; doses on that grid are read there one after the other.
pub(super) struct Places {
    name: String,
    places: Vec<SamplePlace>,
    unit_ml: f64,
    own_ml: f64,
}

impl Places {
    /// The samples of a dose.
    pub(super) fn read(&self, dose: &Volume<f32>) -> Sampled {
        let mut outside = 0.0;
        let sample = |place: &SamplePlace| {
            let gy = at(dose, &place.index);
            outside += if gy.is_none() { f64::from(place.weight) } else { 0.0 };
            DoseSample { gy: gy.unwrap_or_default(), weight: place.weight }
        };
        let samples = self.places.iter().map(sample).collect();
        Sampled { name: self.name.clone(), samples, unit_ml: self.unit_ml, own_ml: self.own_ml, outside }
    }
}

/// What `made` makes of the places of every label that occurs, sorted by label, for doses on `dose`: places are many, and none is
/// kept that need not be.
pub(super) fn labels<T: Send>(dose: &Grid, structures: &LabelMap, made: impl Fn(Places) -> T + Sync) -> Vec<T> {
    let grid = structures.volume.grid();
    let mut voxels: BTreeMap<u16, Vec<usize>> = BTreeMap::new();
    for (l, label) in structures.volume.data().iter().enumerate().filter(|(_, l)| **l > 0) {
        voxels.entry(*label).or_default().push(l);
    }
    // Parts of a voxel along each axis, no larger than the dose's voxels; a thousandth is rounding of a header.
    let dose_spacing = dose.spacing();
    let parts: [usize; 3] =
        std::array::from_fn(|a| ((grid.spacing()[a] / dose_spacing[a] - 1e-3).ceil() as usize).clamp(1, 8));
    let unit_ml = grid.voxel_volume() / 1000.0 / parts.iter().product::<usize>() as f64;
    let middles: Vec<Vector3<f64>> = (0..parts.iter().product::<usize>())
        .map(|n| {
            let part = [n % parts[0], n / parts[0] % parts[1], n / (parts[0] * parts[1])];
            Vector3::from_fn(|a, _| (part[a] as f64 + 0.5) / parts[a] as f64 - 0.5)
        })
        .collect();
    let list: Vec<(u16, Vec<usize>)> = voxels.into_iter().collect();
    list.par_iter()
        .map(|(label, voxels)| {
            let name = structures.names.get(label).cloned().unwrap_or_else(|| label.to_string());
            let own_ml = voxels.len() as f64 * grid.voxel_volume() / 1000.0;
            let place = |l: &usize| {
                let voxel = Vector3::from(grid.voxel(*l).map(|c| c as f64));
                let at = move |m: &Vector3<f64>| snapped(dose, &grid.world(&(voxel + m)));
                middles.iter().map(move |m| SamplePlace { index: at(m), weight: 1.0 })
            };
            made(Places { name, places: voxels.iter().flat_map(place).collect(), unit_ml, own_ml })
        })
        .collect()
}

/// Places of a structure on a lattice along the axes of doses on `grid`, around it.
pub(super) fn contours(grid: &Grid, all: &Contours, structure: &Structure) -> Places {
    let spacing = all.spacing_of(structure, grid.spacing()[2]);
    let own_ml = structure.volume(spacing) / 1000.0;
    let empty = Places { name: structure.name.clone(), places: Vec::new(), unit_ml: 0.0, own_ml };
    let Some([low, high]) = around(grid, all, structure, spacing) else { return empty };
    let step = steps(grid, &(high - low));
    // Lattice points lie in the middles of equal parts of voxels, where the lattice is finer than these.
    let first = low.zip_map(&step, |l, s| ((l + 0.5) / s).floor());
    let count: [usize; 3] = std::array::from_fn(|a| (((high[a] + 0.5) / step[a]).ceil() - first[a]) as usize);
    let mm = step.component_mul(&Vector3::from(grid.spacing()));
    let normal = all.axes.column(2).into_owned();
    let along = (0..3).map(|a| grid.direction().column(a).dot(&normal).abs() * mm[a]).sum::<f64>();
    let soft = SOFT_MM.min(mm.min());
    let solid = all.solid(structure, spacing);
    let place = |i: usize, j: usize, k: usize| {
        let part = Vector3::new(i as f64, j as f64, k as f64);
        (first + part).zip_map(&step, |m, s| (m + 0.5) * s - 0.5)
    };
    let planes: Vec<Vec<SamplePlace>> = (0..count[2])
        .into_par_iter()
        .map(|k| {
            let mut places = Vec::new();
            for j in 0..count[1] {
                for i in 0..count[0] {
                    let point = grid.world(&place(i, j, k));
                    let weight = solid.share(&point, soft, along);
                    if weight > 0.0 {
                        places.push(SamplePlace { index: snapped(grid, &point), weight: weight as f32 });
                    }
                }
            }
            places
        })
        .collect();
    Places { places: planes.into_iter().flatten().collect(), unit_ml: mm.product() / 1000.0, ..empty }
}

/// The box around a structure in the dose's continuous index; `None` without a polygon.
fn around(grid: &Grid, all: &Contours, structure: &Structure, spacing: f64) -> Option<[Vector3<f64>; 2]> {
    let points = || structure.polygons.iter().flat_map(|p| p.points.iter().map(|q| Vector3::new(q[0], q[1], p.height)));
    points().next()?;
    let start = [Vector3::repeat(f64::MAX), Vector3::repeat(f64::MIN)];
    let [mut low, mut high] = points().fold(start, |[low, high], p| [low.inf(&p), high.sup(&p)]);
    low.z -= 0.5 * spacing;
    high.z += 0.5 * spacing;
    let corner = |c: usize| {
        let p = Vector3::from_fn(|a, _| if c >> a & 1 == 1 { high[a] } else { low[a] });
        grid.index(&all.world([p.x, p.y], p.z))
    };
    Some((0..8).map(corner).fold(start, |[low, high], p| [low.inf(&p), high.sup(&p)]))
}

/// Steps of the lattice along the dose's axes, in voxels, for a box of `size` voxels: whole parts of voxels, so many that
/// the smallest structure has a shape; more than a voxel only for what is very large.
fn steps(grid: &Grid, size: &Vector3<f64>) -> Vector3<f64> {
    let spacing = Vector3::from(grid.spacing());
    let mm = size.component_mul(&spacing).map(|e| e.max(0.01));
    let fine = (mm.product() / FINE).cbrt();
    let step = spacing.map(|s| 1.0 / (s / fine).ceil().clamp(1.0, 4096.0));
    let points = mm.component_div(&spacing.component_mul(&step)).product();
    step * (points / MOST).cbrt().max(1.0)
}
