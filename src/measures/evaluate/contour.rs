//! How well two delineations of a structure agree: overlap, centre of mass, and distances between their surfaces.
//!
//! Distances are between triangulated surfaces ([`Surface`]), weighted by area, not between voxel centres; `docs/metrics.md`
//! compares the definitions with plastimatch's and ITK's.

use super::{Surface, weighted_percentile};
use crate::error::{Error, Result};
use crate::volume::LabelMap;
use crate::volume::region::part;
use nalgebra::Vector3;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::collections::btree_map::Entry;
use std::ops::Range;

/// Agreement of two delineations, `a` mapped and `b` reference.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ContourMetrics {
    /// Name of the structure.
    pub name: String,
    /// Volume of the mapped one, ml.
    pub mapped_ml: f64,
    /// Volume of the reference, ml.
    pub reference_ml: f64,
    /// Dice coefficient 2 |A and B| / (|A| + |B|) of voxels, 0 to 1.
    pub dice: f64,
    /// What needs both to exist; `None` when either has no voxel.
    pub distances: Option<ContourDistances>,
}

/// Distances between two surfaces, mm.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct ContourDistances {
    /// Distance between the centres of mass.
    pub centre_of_mass_mm: f64,
    /// Mean distance to agreement: half the sum of both directed area-weighted mean distances.
    pub mean_mm: f64,
    /// Greater of both directed area-weighted 95th percentiles.
    pub hausdorff_95_mm: f64,
    /// Greater of both directed maxima.
    pub hausdorff_mm: f64,
}

/// What is known of a label before its surface is looked at.
#[derive(Clone)]
struct Moments {
    voxels: usize,
    /// Sum of positions, LPS mm.
    sum: Vector3<f64>,
    /// Voxel box around it.
    around: [Range<usize>; 3],
}

impl Moments {
    fn centre(&self) -> Vector3<f64> {
        self.sum / self.voxels as f64
    }

    /// Its surface, from the box around it and the voxels next to that: most labels are small parts of the grid.
    fn surface(&self, map: &LabelMap, label: u16) -> Option<Surface> {
        let size = map.volume.grid().size();
        let range =
            std::array::from_fn(|a| self.around[a].start.saturating_sub(1)..(self.around[a].end + 1).min(size[a]));
        Surface::of(&part(&map.volume, &range).ok()?, |v| v == label)
    }
}

/// Agreement of each structure whose name occurs in both maps, which share a grid. Sorted by the reference's labels.
///
/// # Errors
/// [`Error::Input`] when the grids differ or no name is in both.
pub fn compare(mapped: &LabelMap, reference: &LabelMap) -> Result<Vec<ContourMetrics>> {
    if !mapped.volume.grid().matches(reference.volume.grid(), 1e-3) {
        return Err(Error::Internal("contours on different grids".into()));
    }
    let pairs: Vec<(u16, u16, &String)> = reference
        .names
        .iter()
        .filter_map(|(b, name)| mapped.names.iter().find(|(_, n)| *n == name).map(|(a, _)| (*a, *b, name)))
        .collect();
    if pairs.is_empty() {
        let names = |map: &LabelMap| map.names.values().take(4).cloned().collect::<Vec<_>>().join(", ");
        return Err(Error::input(
            "label maps of planning and fraction",
            format!("no structure is in both ({} ... and {} ...)", names(mapped), names(reference)),
            "give both the same names",
        ));
    }
    let (of_a, of_b) = (moments(mapped), moments(reference));
    let mut both = vec![0usize; usize::from(u16::MAX) + 1];
    let partner: Vec<u16> = {
        let mut table = vec![0; usize::from(u16::MAX) + 1];
        pairs.iter().for_each(|(a, b, _)| table[usize::from(*a)] = *b);
        table
    };
    for (a, b) in mapped.volume.data().iter().zip(reference.volume.data()) {
        if *a > 0 && partner[usize::from(*a)] == *b && *b > 0 {
            both[usize::from(*b)] += 1;
        }
    }
    let voxel_ml = reference.volume.grid().voxel_volume() / 1000.0;
    // A table may name far more structures than the maps hold: what is in neither is no structure to compare.
    let held = |(a, b, _): &&(u16, u16, &String)| of_a.contains_key(a) || of_b.contains_key(b);
    let pairs: Vec<(u16, u16, &String)> = pairs.iter().filter(held).copied().collect();
    let measure = |(a, b, name): &(u16, u16, &String)| {
        let (of_a, of_b) = (of_a.get(a), of_b.get(b));
        let count = |m: Option<&Moments>| m.map_or(0, |m| m.voxels);
        let (na, nb) = (count(of_a), count(of_b));
        let distances = of_a.zip(of_b).map(|(of_a, of_b)| {
            let centre_of_mass_mm = (of_a.centre() - of_b.centre()).norm();
            let surfaces = (of_a.surface(mapped, *a)?, of_b.surface(reference, *b)?);
            Some(ContourDistances { centre_of_mass_mm, ..distances(&surfaces.0, &surfaces.1) })
        });
        ContourMetrics {
            name: (*name).clone(),
            mapped_ml: na as f64 * voxel_ml,
            reference_ml: nb as f64 * voxel_ml,
            dice: 2.0 * both[usize::from(*b)] as f64 / ((na + nb).max(1)) as f64,
            distances: distances.flatten(),
        }
    };
    Ok(pairs.par_iter().map(measure).collect())
}

/// Distances between two surfaces; the centres of mass are left at 0.
pub fn distances(a: &Surface, b: &Surface) -> ContourDistances {
    let directed = |from: &Surface, to: &Surface| {
        let mut all: Vec<(f64, f64)> =
            to.distances(&from.vertices).into_iter().zip(from.areas.iter().copied()).collect();
        let mean = all.iter().map(|(d, w)| d * w).sum::<f64>() / from.area().max(f64::MIN_POSITIVE);
        all.sort_by(|x, y| x.0.total_cmp(&y.0));
        [mean, weighted_percentile(&all, 95.0), all.last().map_or(0.0, |d| d.0)]
    };
    let (ab, ba) = rayon::join(|| directed(a, b), || directed(b, a));
    ContourDistances {
        centre_of_mass_mm: 0.0,
        mean_mm: (ab[0] + ba[0]) / 2.0,
        hausdorff_95_mm: ab[1].max(ba[1]),
        hausdorff_mm: ab[2].max(ba[2]),
    }
}

/// Of every label that occurs; planes are looked at in parallel and added in their order.
fn moments(map: &LabelMap) -> BTreeMap<u16, Moments> {
    let grid = map.volume.grid();
    let [nx, ny, _] = grid.size();
    let planes: Vec<BTreeMap<u16, Moments>> = map
        .volume
        .data()
        .par_chunks(nx * ny)
        .enumerate()
        .map(|(k, labels)| {
            let mut found: BTreeMap<u16, Moments> = BTreeMap::new();
            for (n, label) in labels.iter().enumerate().filter(|(_, l)| **l > 0) {
                let at = [n % nx, n / nx, k];
                let empty = Moments { voxels: 0, sum: Vector3::zeros(), around: at.map(|c| c..c + 1) };
                let m = found.entry(*label).or_insert(empty);
                m.voxels += 1;
                m.sum += grid.centre(at).coords;
                m.around = std::array::from_fn(|a| m.around[a].start.min(at[a])..m.around[a].end.max(at[a] + 1));
            }
            found
        })
        .collect();
    let mut all: BTreeMap<u16, Moments> = BTreeMap::new();
    for (label, part) in planes.into_iter().flatten() {
        match all.entry(label) {
            Entry::Vacant(entry) => {
                entry.insert(part);
            }
            Entry::Occupied(mut entry) => {
                let m = entry.get_mut();
                m.voxels += part.voxels;
                m.sum += part.sum;
                m.around = std::array::from_fn(|a| {
                    m.around[a].start.min(part.around[a].start)..m.around[a].end.max(part.around[a].end)
                });
            }
        }
    }
    all
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Grid;
    use crate::volume::Volume;
    use nalgebra::Point3;

    fn map(grid: &Grid, inside: impl Fn(Point3<f64>) -> bool + Sync) -> LabelMap {
        let volume = Volume::from_fn(grid.clone(), |l| u16::from(inside(grid.centre(grid.voxel(l)))));
        LabelMap { volume, names: [(1, "solid".to_owned())].into() }
    }

    /// Within 1 % of what geometry says.
    fn near(measured: f64, exact: f64, what: &str) {
        assert!((measured / exact - 1.0).abs() < 0.01, "{what}: {measured} instead of {exact}");
    }

    #[test]
    fn balls_and_boxes_to_one_percent() {
        let grid = Grid::axis_aligned([120, 100, 100], [0.8, 1.0, 1.0], [-48.0, -50.0, -50.0]).unwrap();
        // Two balls of radius 25 whose middles are 20 mm apart: the lens of their intersection gives Dice.
        let (r, d) = (25.0f64, 20.0f64);
        let ball = |x: f64, r: f64| map(&grid, move |p| (p - Point3::new(x, 0.3, 0.1)).norm() <= r);
        let m = compare(&ball(-10.0, r), &ball(10.0, r)).unwrap().remove(0);
        let lens = std::f64::consts::PI * (4.0 * r + d) * (2.0 * r - d).powi(2) / 12.0;
        let volume = 4.0 / 3.0 * std::f64::consts::PI * r.powi(3);
        near(m.dice, lens / volume, "dice");
        near(m.mapped_ml, volume / 1000.0, "volume");
        let found = m.distances.unwrap();
        near(found.centre_of_mass_mm, d, "centre of mass");
        near(found.hausdorff_mm, d, "hausdorff of balls");
        // Distance of the point at angle t on one ball to the other: | |p - q| - r |, averaged over the sphere.
        let steps = 100_000;
        let mut at: Vec<f64> = (0..steps)
            .map(|n| {
                let c = -1.0 + 2.0 * (f64::from(n) + 0.5) / f64::from(steps);
                ((r * r + d * d + 2.0 * r * d * c).sqrt() - r).abs()
            })
            .collect();
        near(found.mean_mm, at.iter().sum::<f64>() / f64::from(steps), "mean distance to agreement");
        at.sort_by(f64::total_cmp);
        near(found.hausdorff_95_mm, at[95_000], "95th percentile");
        // Concentric balls: one distance everywhere.
        let even = Grid::axis_aligned([77, 77, 77], [1.0; 3], [-38.0; 3]).unwrap();
        let ball = |r: f64| map(&even, move |p| p.coords.norm() <= r);
        let c = compare(&ball(20.5), &ball(35.5)).unwrap().remove(0).distances.unwrap();
        near(c.mean_mm, 15.0, "concentric mean");
        // The maximum is a single place: it resolves to the voxels that describe the solids, 1 mm here.
        assert!((c.hausdorff_mm - 15.0).abs() < 1.0 && (c.hausdorff_95_mm - 15.0).abs() < 0.5, "{c:?}");
        // Boxes of 40 x 30 x 30 mm, one grown by 12 mm at one end: its face is 12 mm away, the others touch.
        let solid = |x: f64| map(&grid, move |p| p.x > -20.4 && p.x < x && p.y.abs() < 15.0 && p.z.abs() < 15.0);
        let b = compare(&solid(19.6), &solid(31.6)).unwrap().remove(0);
        near(b.dice, 2.0 * 40.0 / 92.0, "dice of boxes");
        let found = b.distances.unwrap();
        near(found.hausdorff_mm, 12.0, "hausdorff of boxes");
        near(found.centre_of_mass_mm, 6.0, "centre of mass of boxes");
    }

    #[test]
    fn equal_contours_agree_and_missing_ones_have_no_distance() {
        let grid = Grid::axis_aligned([20, 20, 20], [1.0, 1.0, 3.0], [0.0; 3]).unwrap();
        let a = map(&grid, |p| (p - Point3::new(10.0, 10.0, 30.0)).norm() < 7.0);
        let m = compare(&a, &a).unwrap().remove(0);
        let d = m.distances.unwrap();
        assert!((m.dice - 1.0).abs() < 1e-12 && d.hausdorff_mm < 1e-9 && d.centre_of_mass_mm < 1e-9);
        let empty = compare(&a, &map(&grid, |_| false)).unwrap().remove(0);
        assert!(empty.distances.is_none() && empty.dice.abs() < 1e-12);
        let mut more = a.clone();
        more.names.insert(9, "nowhere".to_owned());
        assert_eq!(compare(&more, &more).unwrap().len(), 1, "what is in neither is no row");
        let other = LabelMap { names: [(1, "else".to_owned())].into(), ..a.clone() };
        assert!(compare(&a, &other).unwrap_err().to_string().contains("no structure is in both"));
    }
}
