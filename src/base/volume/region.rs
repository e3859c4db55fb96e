//! A part of a volume: where the user wants results, and what around it they depend on.

use super::{LabelMap, Volume};
use crate::error::{Error, Result};
use crate::geometry::Grid;
use nalgebra::{Point3, Vector3};
use serde::{Deserialize, Serialize};
use std::ops::Range;

/// A region of the planning frame. Everything farther from it than the margin is left out of the work.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RegionOptions {
    /// The box around a label of this name.
    pub label: Option<String>,
    /// A box: least then greatest x, y, z, LPS mm.
    pub box_mm: Option<[f64; 6]>,
    /// How far around the region bones and tissue are taken along, mm: those farther away no longer act on it.
    pub margin_mm: f64,
}

/// What is wrong with a box, least then greatest x, y, z, if anything; `key`: the setting that it is.
pub fn box_problem(key: &str, &[x0, y0, z0, x1, y1, z1]: &[f64; 6]) -> Option<String> {
    let ordered = x0 < x1 && y0 < y1 && z0 < z1 && [x0, y0, z0, x1, y1, z1].iter().all(|v| v.is_finite());
    (!ordered).then(|| format!("{key} is {x0}, {y0}, {z0}, {x1}, {y1}, {z1}: least x, y, z, then greatest"))
}

impl Default for RegionOptions {
    fn default() -> Self {
        Self { label: None, box_mm: None, margin_mm: 50.0 }
    }
}

impl RegionOptions {
    /// Whether a region is asked for.
    pub fn is_some(&self) -> bool {
        self.label.is_some() || self.box_mm.is_some()
    }

    /// What is wrong with these values, if anything.
    pub fn problem(&self) -> Option<String> {
        if self.label.is_some() && self.box_mm.is_some() {
            return Some("region.label and region.box_mm are both given: one of them is needed".into());
        }
        if let Some(problem) = self.box_mm.and_then(|b| box_problem("region.box_mm", &b)) {
            return Some(problem);
        }
        let bad = !(0.0..=1000.0).contains(&self.margin_mm);
        bad.then(|| format!("region.margin_mm is {}: it must lie in [0, 1000]", self.margin_mm))
    }

    /// The voxels of the planning grid in the region, margin included.
    ///
    /// # Errors
    /// [`Error::Usage`] when no label has the name, or the region lies outside the grid.
    pub fn voxels(&self, labels: &LabelMap) -> Result<[Range<usize>; 3]> {
        let grid = labels.volume.grid();
        let corners = match (&self.label, self.box_mm) {
            (Some(name), _) => box_of_label(labels, name)?,
            (None, Some([x0, y0, z0, x1, y1, z1])) => [Point3::new(x0, y0, z0), Point3::new(x1, y1, z1)],
            (None, None) => return Ok(grid.size().map(|n| 0..n)),
        };
        self.of_box(grid, corners)
    }

    /// Whether a box, if one is asked for, lies in the planning scan.
    ///
    /// # Errors
    /// [`Error::Usage`] when it lies outside the grid.
    pub fn check_box(&self, planning: &Grid) -> Result<()> {
        match self.box_mm {
            Some([x0, y0, z0, x1, y1, z1]) => {
                self.of_box(planning, [Point3::new(x0, y0, z0), Point3::new(x1, y1, z1)]).map(drop)
            }
            None => Ok(()),
        }
    }

    fn of_box(&self, grid: &Grid, corners: [Point3<f64>; 2]) -> Result<[Range<usize>; 3]> {
        voxels_of_box(grid, corners, self.margin_mm).ok_or_else(|| {
            Error::usage(
                format!("the region {:.0?} to {:.0?} mm lies outside the planning CT", corners[0], corners[1]),
                "give least and greatest x, y, z in LPS mm; `aventail inspect` shows where the planning CT lies",
            )
        })
    }
}

/// Opposite corners of the world box around a label.
fn box_of_label(labels: &LabelMap, name: &str) -> Result<[Point3<f64>; 2]> {
    let grid = labels.volume.grid();
    let found: Vec<u16> = labels.names.iter().filter(|(_, n)| *n == name).map(|(l, _)| *l).collect();
    let start = [Vector3::repeat(f64::MAX), Vector3::repeat(f64::MIN)];
    let data = labels.volume.data().iter().enumerate().filter(|(_, l)| found.contains(l));
    let [low, high] = data.fold(start, |[low, high], (n, _)| {
        let x = grid.centre(grid.voxel(n)).coords;
        [low.inf(&x), high.sup(&x)]
    });
    if low.x > high.x {
        let names: Vec<&str> = labels.names.values().map(String::as_str).collect();
        return Err(Error::usage(
            format!("region: no voxel has a label of the name {name}"),
            format!("the labels are {}", names.join(", ")),
        ));
    }
    Ok([low.into(), high.into()])
}

/// The voxels whose centres lie in a world box grown by `margin` mm; `None` when there are none. Oblique grids take the
/// voxel box around it.
pub fn voxels_of_box(grid: &Grid, [a, b]: [Point3<f64>; 2], margin: f64) -> Option<[Range<usize>; 3]> {
    let (low, high) = (a.coords.inf(&b.coords).add_scalar(-margin), a.coords.sup(&b.coords).add_scalar(margin));
    let (mut first, mut last) = ([f64::MAX; 3], [f64::MIN; 3]);
    for c in 0..8 {
        let corner = Vector3::from_fn(|a, _| if c >> a & 1 == 1 { high[a] } else { low[a] });
        let at = grid.index(&corner.into());
        for a in 0..3 {
            (first[a], last[a]) = (first[a].min(at[a]), last[a].max(at[a]));
        }
    }
    let range = |a: usize| {
        let from = (first[a] - 1e-9).ceil().max(0.0) as usize;
        let to = (last[a] + 1e-9).floor().min(grid.size()[a] as f64 - 1.0);
        (to >= from as f64).then(|| from..to as usize + 1)
    };
    Some([range(0)?, range(1)?, range(2)?])
}

/// The part of a grid that a range of its voxels is.
///
/// # Errors
/// Only for a range that is empty.
pub fn part_of_grid(grid: &Grid, ranges: &[Range<usize>; 3]) -> Result<Grid> {
    let [size, first] = [ranges.each_ref().map(ExactSizeIterator::len), ranges.each_ref().map(|r| r.start)];
    Grid::new(size, grid.spacing(), grid.centre(first), *grid.direction())
}

/// The values in a range of voxels, on their part of the grid.
///
/// # Errors
/// Only for a range that is empty or leaves the grid.
pub fn part<T: Copy>(volume: &Volume<T>, ranges: &[Range<usize>; 3]) -> Result<Volume<T>> {
    let (grid, [i, j, k]) = (volume.grid(), ranges);
    let part = part_of_grid(grid, ranges)?;
    let mut data = Vec::with_capacity(part.len());
    for k in k.clone() {
        for j in j.clone() {
            let row = grid.linear([0, j, k]);
            data.extend_from_slice(&volume.data()[row + i.start..row + i.end]);
        }
    }
    Volume::new(part, data)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn labels() -> LabelMap {
        let turn = nalgebra::Rotation3::from_axis_angle(&Vector3::z_axis(), 0.3).into_inner();
        let grid = Grid::new([30, 20, 10], [1.0, 2.0, 3.0], Point3::new(-20.0, 5.0, 40.0), turn).unwrap();
        let volume = Volume::from_fn(grid.clone(), |n| u16::from(grid.voxel(n) == [12, 9, 4]) * 7);
        LabelMap { volume, names: [(7, "tongue".to_owned())].into() }
    }

    #[test]
    fn a_part_keeps_values_where_they_are() {
        let all = labels();
        let range = RegionOptions { label: Some("tongue".into()), margin_mm: 4.0, ..RegionOptions::default() };
        let range = range.voxels(&all).unwrap();
        assert!(range[2] == (3..6) && range[0].contains(&12) && range[0].len() < 15, "{range:?}");
        let cut = part(&all.volume, &range).unwrap();
        assert_eq!(cut.data().iter().filter(|l| **l == 7).count(), 1);
        for n in 0..cut.data().len() {
            let x = cut.grid().centre(cut.grid().voxel(n));
            let from = all.volume.grid().index(&x).map(f64::round);
            assert_eq!(cut.data()[n], *all.volume.at([0, 1, 2].map(|a| from[a] as usize)));
        }
    }

    #[test]
    fn regions_that_cannot_be_are_refused_by_name() {
        let options = |label: Option<&str>, box_mm| RegionOptions {
            label: label.map(str::to_owned),
            box_mm,
            ..RegionOptions::default()
        };
        let error = options(Some("tounge"), None).voxels(&labels()).unwrap_err();
        assert!(error.to_string().contains("tounge") && error.to_string().contains("tongue"), "{error}");
        let far = Some([900.0, 0.0, 0.0, 950.0, 1.0, 1.0]);
        assert!(options(None, far).voxels(&labels()).unwrap_err().to_string().contains("outside"));
        assert!(options(None, Some([0.0, 0.0, 5.0, 1.0, 1.0, 4.0])).problem().is_some());
        assert!(options(Some("a"), far).problem().is_some());
        assert_eq!(options(None, None).problem(), None);
    }
}
