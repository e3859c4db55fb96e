//! Frames of a segmentation as slices of one grid. Slices without a frame are empty.

use super::super::elements::{Item, first, number};
use super::super::frames::Plane;
use super::super::pixels::believable;
use crate::error::{Error, Result};
use crate::findings;
use crate::geometry::Grid;
use dicom_dictionary_std::tags;
use nalgebra::{Matrix3, Vector3};
use std::path::Path;

/// Positions closer than this are one place, mm.
const SAME_PLACE_MM: f64 = 0.01;
/// Frames may lie this far from the line along the normal, mm.
const ASIDE_MM: f64 = 0.2;
/// Frames may lie so far from their place, mm, or this share of the distance between slices, whichever is more.
const JITTER_MM: f64 = 0.05;
const JITTER: f64 = 0.01;
/// Direction cosines of frames agree within this.
const SAME_AXES: f64 = 5e-4;
/// Bytes of a file beside its own for which empty slices between frames are believed (see [`believable`]).
const SPARSE: u64 = 1 << 20;

/// The grid of all frames, and the slice that each lies on.
pub(super) struct Lattice {
    pub(super) grid: Grid,
    pub(super) slices: Vec<usize>,
}

/// Distances between slices that a header tells.
pub(super) struct Told {
    between: Option<f64>,
    thickness: Option<f64>,
}

impl Told {
    /// What the groups that all frames share say, else the first frame's, else the object itself.
    pub(super) fn of(set: &Item, own: Option<&Item>, shared: Option<&Item>) -> Self {
        let measures = [shared, own].into_iter().flatten().filter_map(|g| first(g, tags::PIXEL_MEASURES_SEQUENCE));
        let places: Vec<&Item> = measures.chain([set]).collect();
        let of = |tag| places.iter().find_map(|p| number(p, tag)).map(f64::abs).filter(|d| *d > 0.0);
        Self { between: of(tags::SPACING_BETWEEN_SLICES), thickness: of(tags::SLICE_THICKNESS) }
    }
}

/// Puts frames on one grid. `around` adds an empty slice at both ends: what lies beyond the frames is empty. `length` is that
/// of the file.
///
/// # Errors
/// [`Error::Input`] where they do not lie on one grid.
pub(super) fn lattice(path: &Path, planes: &[Plane], told: &Told, around: bool, length: u64) -> Result<Lattice> {
    let what = path.display().to_string();
    let Some(one) = planes.first() else {
        return Err(Error::refused(findings::SEGMENTS_ODD, what, "it has no frame", "export the segmentation again"));
    };
    agree(&what, planes, one)?;
    let normal = one.axes[0].cross(&one.axes[1]);
    let heights: Vec<f64> = planes.iter().map(|p| (p.position - one.position).dot(&normal)).collect();
    let aside = |p: &Plane| {
        let d = p.position - one.position;
        (d - normal * d.dot(&normal)).norm()
    };
    if let Some(n) = (0..planes.len()).find(|&n| aside(&planes[n]) > ASIDE_MM) {
        let problem =
            format!("its frames are sheared: frame {} lies {:.1} mm aside of the first", n + 1, aside(&planes[n]));
        let remedy = "resample it to an upright grid, for example in Slicer, and give that label map";
        return Err(Error::refused(findings::DICOM_TILT, what, problem, remedy));
    }
    let mut places = heights.clone();
    places.sort_by(f64::total_cmp);
    places.dedup_by(|a, b| (*a - *b).abs() <= SAME_PLACE_MM);
    let (Some(&low), Some(&high)) = (places.first(), places.last()) else {
        return Err(Error::Internal("frames without a place".into()));
    };
    let step = step(&what, &places, told)?;
    let count = ((high - low) / step).round();
    let pad = if around { 1.0 } else { 0.0 };
    let slices = count + 1.0 + 2.0 * pad;
    let pixels = one.size[0] as u64 * one.size[1] as u64;
    let promised = if slices < 1e9 { pixels.saturating_mul(2).saturating_mul(slices as u64) } else { u64::MAX };
    believable(path, promised, length.saturating_add(SPARSE))?;
    let step = if count > 0.0 { (high - low) / count } else { step };
    let direction = Matrix3::from_columns(&[one.axes[0], one.axes[1], normal]);
    let origin = one.position + normal * (low - pad * step);
    let size = [one.size[0], one.size[1], slices as usize];
    let grid = Grid::new(size, [one.spacing[0], one.spacing[1], step], origin, direction)?;
    let slice = |h: &f64| ((h - low) / step + pad).round() as usize;
    Ok(Lattice { slices: heights.iter().map(slice).collect(), grid })
}

/// Refuses frames that differ in what those of one grid have in common.
fn agree(what: &str, planes: &[Plane], one: &Plane) -> Result<()> {
    let near = |a: f64, b: f64| (a - b).abs() <= 1e-4 * b;
    for (n, p) in planes.iter().enumerate() {
        let turned = (0..2).map(|a| (p.axes[a] - one.axes[a]).amax()).fold(0.0, f64::max);
        let differs = if turned > SAME_AXES {
            "orientations"
        } else if p.size != one.size {
            "sizes"
        } else if !near(p.spacing[0], one.spacing[0]) || !near(p.spacing[1], one.spacing[1]) {
            "pixel spacings"
        } else {
            continue;
        };
        let problem = format!("its frames do not belong to one volume: {differs} of frames 1 and {} differ", n + 1);
        let remedy = "export the segments of each image as a segmentation of their own";
        return Err(Error::refused(findings::DICOM_IMAGES_DIFFER, what, problem, remedy));
    }
    Ok(())
}

/// The distance between slices with which all places lie on slices: as told, else the least distance between two.
fn step(what: &str, places: &[f64], told: &Told) -> Result<f64> {
    let least = places.windows(2).map(|w| w[1] - w[0]).fold(f64::INFINITY, f64::min);
    let (low, high) = (places[0], places[places.len() - 1]);
    let fits = |step: &f64| {
        let count = ((high - low) / step).round();
        let step = if count > 0.0 { (high - low) / count } else { *step };
        let allowed = (JITTER * step).max(JITTER_MM);
        let off = |h: &f64| ((h - low) - ((h - low) / step).round() * step).abs();
        // Two places are two slices.
        (least.is_infinite() || least > 0.5 * step) && places.iter().all(|h| off(h) <= allowed)
    };
    let thickness = told.thickness.filter(|_| told.between.is_none());
    let candidates = [told.between, Some(least).filter(|l| l.is_finite()), thickness];
    if let Some(step) = candidates.into_iter().flatten().find(fits) {
        return Ok(step);
    }
    if places.len() < 2 {
        let problem = "it has frames at one place only, and tells neither Spacing Between Slices nor Slice Thickness";
        return Err(Error::refused(
            findings::DICOM_INCOMPLETE,
            what,
            problem,
            "export the segmentation with one of them",
        ));
    }
    let problem = format!("its frames do not lie on evenly spaced slices: the nearest two are {least:.3} mm apart");
    let remedy = "export the segmentation of a series with evenly spaced slices, or resample it";
    Err(Error::refused(findings::DICOM_GAP, what, problem, remedy))
}

/// How the voxels of a grid lie among those of another: the voxel there of each axis' step and of the first voxel.
pub(super) struct Among {
    first: Vector3<f64>,
    steps: [Vector3<f64>; 3],
}

impl Among {
    /// `None` where they are not the same voxels.
    pub(super) fn of(grid: &Grid, other: &Grid) -> Option<Self> {
        let at = |index: [f64; 3]| other.index(&grid.world(&Vector3::from(index)));
        let first = at([0.0; 3]);
        let unit = |a: usize| {
            let mut index = [0.0; 3];
            index[a] = 1.0;
            at(index) - first
        };
        let among =
            Self { first: first.map(f64::round), steps: [unit(0), unit(1), unit(2)].map(|s| s.map(f64::round)) };
        let whole = |s: &Vector3<f64>| (s.abs().sum() - 1.0).abs() < 1e-9;
        if !among.steps.iter().all(whole) {
            return None;
        }
        // The corners tell how far voxels drift apart.
        let [i, j, k] = grid.size().map(|n| n.saturating_sub(1) as f64);
        let near = |index: [f64; 3]| (among.map(index) - at(index)).amax() < 0.1;
        let corners = (0..8).map(|c| [(c & 1, i), (c >> 1 & 1, j), (c >> 2, k)].map(|(on, n)| f64::from(on) * n));
        corners.into_iter().all(near).then_some(among)
    }

    fn map(&self, [i, j, k]: [f64; 3]) -> Vector3<f64> {
        self.first + self.steps[0] * i + self.steps[1] * j + self.steps[2] * k
    }

    /// The voxel of a grid of this size at which a voxel lies; `None` outside.
    pub(super) fn voxel(&self, voxel: [usize; 3], size: [usize; 3]) -> Option<[usize; 3]> {
        let at = self.map(voxel.map(|n| n as f64));
        let within = |a: usize| at[a] >= 0.0 && at[a] < size[a] as f64;
        (within(0) && within(1) && within(2)).then(|| [at[0] as usize, at[1] as usize, at[2] as usize])
    }
}
