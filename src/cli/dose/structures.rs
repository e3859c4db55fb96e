//! The structures whose dose is counted.

use crate::config::InputRole;
use crate::dose::{Dvh, DvhPlaces, dvh, dvh_of_contours};
use crate::error::Result;
use crate::findings;
use crate::geometry::Grid;
use crate::io::dicom::{Framed, Role, check_frames, is_dicom_path, is_segmentation};
use crate::io::{self, ContourFile};
use crate::provenance::Provenance;
use crate::volume::contour::Contours;
use crate::volume::{LabelMap, Volume};
use crate::warning::Warning;
use nalgebra::Point3;
use std::path::Path;

/// Structures as labels, or as contours, which may overlap.
pub(super) enum Structures {
    Labels(Box<LabelMap>),
    Contours(Contours),
}

/// Width of a bin of a page's curves, Gy.
pub(super) const BIN: f64 = 0.1;

/// Structures that a warning names.
const NAMED: usize = 12;

impl Structures {
    /// Reads a label map (with a file of `names`, if any) or contours; `near` are files whose frame they must share.
    pub(super) fn read(
        provenance: &mut Provenance,
        path: &Path,
        names: Option<&Path>,
        near: &[Framed<'_>],
    ) -> Result<Self> {
        if !io::is_json(path) && (!is_dicom_path(path) || is_segmentation(path)) {
            near.iter().try_for_each(|other| check_frames(Role::Structures.at(path), *other))?;
            let map = Box::new(provenance.take(InputRole::Structures, io::read_structures(path, names)?));
            if names.is_some() {
                provenance.warnings.extend(missing(&map));
            }
            return Ok(Self::Labels(map));
        }
        near.iter().try_for_each(|other| check_frames(Role::Structures.at(path), *other))?;
        let ContourFile { mut contours, path, warnings, .. } = io::read_contour_file(path)?;
        provenance.note(InputRole::Structures, &path)?;
        provenance.warnings.extend(warnings);
        provenance.warnings.extend(contours.tidy());
        Ok(Self::Contours(contours))
    }

    /// Each structure's histogram: volumes above `at` Gy, curves in bins of `bin` Gy.
    pub(super) fn histograms(&self, dose: &Volume<f32>, at: &[f64], bin: f64) -> Vec<Dvh> {
        match self {
            Self::Labels(map) => dvh(dose, map, at, bin),
            Self::Contours(all) => dvh_of_contours(dose, all, at, bin),
        }
    }

    /// Their names.
    pub(super) fn names(&self) -> Vec<String> {
        match self {
            Self::Labels(map) => map.names.values().cloned().collect(),
            Self::Contours(all) => all.structures.iter().map(|s| s.name.clone()).collect(),
        }
    }

    /// For the histograms of many doses on a grid.
    pub(super) fn places(&self, grid: &Grid) -> DvhPlaces {
        match self {
            Self::Labels(map) => DvhPlaces::of_labels(grid, map),
            Self::Contours(all) => DvhPlaces::of_contours(grid, all),
        }
    }

    /// The box around them in the world, its least and greatest corner; none where there is no structure.
    pub(super) fn around(&self) -> Option<[Point3<f64>; 2]> {
        let widened = |points: &mut dyn Iterator<Item = Point3<f64>>| {
            let first = points.next()?;
            Some(points.fold([first; 2], |[low, high], p| [low.inf(&p), high.sup(&p)]))
        };
        match self {
            Self::Labels(map) => {
                let grid = map.volume.grid();
                let labelled = map.volume.data().iter().enumerate().filter(|(_, label)| **label != 0);
                widened(&mut labelled.map(|(l, _)| grid.centre(grid.voxel(l))))
            }
            Self::Contours(all) => {
                let polygons = all.structures.iter().flat_map(|s| &s.polygons);
                widened(&mut polygons.flat_map(|p| p.points.iter().map(|q| all.world(*q, p.height))))
            }
        }
    }

    /// The colours that contours were drawn in, in the order of the histograms; none of labels.
    pub(super) fn colours(&self) -> Vec<Option<[u8; 3]>> {
        match self {
            Self::Labels(_) => Vec::new(),
            Self::Contours(all) => all.structures.iter().map(|s| s.colour).collect(),
        }
    }
}

/// A word about names in the file of names whose label no voxel has: a small structure may have been lost in a mask.
fn missing(map: &LabelMap) -> Option<Warning> {
    let counts = map.counts();
    let gone: Vec<&str> =
        map.names.iter().filter(|(l, _)| !counts.contains_key(l)).map(|(_, name)| name.as_str()).collect();
    let shown = gone.iter().take(NAMED).copied().collect::<Vec<_>>().join(", ");
    let more = gone.len().checked_sub(NAMED + 1).map_or(String::new(), |n| format!(" and {} more", n + 1));
    (!gone.is_empty())
        .then(|| Warning::new(findings::STRUCTURE_EMPTY, format!("named, but no voxel has their label: {shown}{more}")))
}
