//! DICOM where an image is asked for: a CT series in HU, an MR series where one may be, or a dose in Gy.

use super::super::Loaded;
use super::super::bytes::sha256_of;
use super::super::raster::Raster;
use super::super::series_path::Place;
use super::super::voxels::{Element, Layout};
use super::counts::lost_of;
use super::find::Object;
use super::place::{Chosen, choose, is_segmentation, objects};
use super::scan::{Scan, no_hu};
use super::segmentation::{self, Segment};
use super::{Dose, Series, ct, dose};
use crate::error::{Error, Result};
use crate::findings;
use crate::geometry::Grid;
use crate::volume::Volume;
use crate::warning::Warning;
use rayon::prelude::*;
use std::borrow::Cow;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Reads a CT series, or a dose.
///
/// # Errors
/// As [`super::read_series`] and [`super::read_doses`]; [`Error::Input`] of an MR series, which has no HU.
pub(in super::super) fn read_image(path: &Path) -> Result<Loaded<Volume<f32>>> {
    match choose(path)? {
        (Chosen::Scan(objects, _), _) if Scan::of(&objects) == Some(Scan::Mr) => Err(no_hu(path)),
        chosen => read_chosen(path, chosen),
    }
}

/// Reads a CT or MR series, or a dose.
///
/// # Errors
/// As [`super::read_series`] and [`super::read_doses`].
pub(in super::super) fn read_scan(path: &Path) -> Result<Loaded<Volume<f32>>> {
    read_chosen(path, choose(path)?)
}

fn read_chosen(path: &Path, chosen: (Chosen, PathBuf)) -> Result<Loaded<Volume<f32>>> {
    match chosen {
        (Chosen::Scan(objects, beside), same) => {
            let Loaded { value, path, sha256, header, warnings } = ct::read(&same, objects, beside)?;
            Ok(Loaded { value: value.0, path, sha256, header, warnings })
        }
        (Chosen::Dose(objects, beside), same) => {
            let Loaded { value, sha256, header, warnings, .. } = dose::read(&same, &objects, beside)?;
            let path = match objects.as_slice() {
                [one] => one.path.clone(),
                _ => same,
            };
            Ok(Loaded { value: value.volume, path, sha256, header, warnings })
        }
        (Chosen::Labels(_), _) => Err(no_image(path)),
    }
}

/// The refusal of labels where an image is asked for.
fn no_image(path: &Path) -> Error {
    let (what, problem) = (path.display().to_string(), "it is a segmentation, no image (modality \"SEG\")");
    Error::refused(findings::DICOM_NO_CT, what, problem, "give it where labels or bones are asked for")
}

/// Reads a dose where a dose is meant: of a folder that also holds a CT the dose.
///
/// # Errors
/// As [`super::read_doses`].
pub(in super::super) fn read_dose(path: &Path) -> Result<Loaded<Volume<f32>>> {
    let Loaded { value, path, sha256, header, warnings } = dose_at(path)?;
    Ok(Loaded { value: value.volume, path, sha256, header, warnings })
}

/// The same with what the object says of itself: of an object, a folder with one, or `FOLDER#NUMBER`.
///
/// # Errors
/// As [`super::read_doses`].
pub fn dose_at(path: &Path) -> Result<Loaded<Dose>> {
    let place = Place::of(path);
    if place.choice.is_none() {
        dose::read_dose(path)
    } else if let (Chosen::Dose(objects, beside), same) = choose(path)? {
        dose::read(&same, &objects, beside)
    } else {
        let problem = "this series is no RT Dose";
        Err(Error::refused(findings::DICOM_NO_DOSE, path.display().to_string(), problem, "choose the RTDOSE series"))
    }
}

/// The grid of a CT or MR series, without its pixels, or of a dose.
///
/// # Errors
/// As [`read_scan`], but for the pixels.
pub(in super::super) fn read_grid(path: &Path) -> Result<(Grid, Vec<Warning>)> {
    match choose(path)? {
        (Chosen::Scan(objects, beside), same) => {
            let planned = ct::plan(&same, objects, beside)?;
            Ok((planned.stack.grid, planned.warnings))
        }
        (Chosen::Dose(objects, beside), same) => {
            let read = dose::read(&same, &objects, beside)?;
            Ok((read.value.volume.grid().clone(), read.warnings))
        }
        (Chosen::Labels(object), _) => segmentation::read_grid(&object.path),
    }
}

/// What a CT or MR series says of itself, and its grid, without its pixels.
///
/// # Errors
/// As [`super::read_series`], but for the pixels.
pub fn describe_series(path: &Path) -> Result<(Series, Grid)> {
    match choose(path)? {
        (Chosen::Scan(objects, beside), same) => {
            let planned = ct::plan(&same, objects, beside)?;
            Ok((planned.series, planned.stack.grid))
        }
        (Chosen::Dose(..), _) => Err(ct::no_ct(path)),
        (Chosen::Labels(_), _) => Err(no_image(path)),
    }
}

/// A word about images that the structure set or segmentation of a path was drawn on or made of and that are not in the series of
/// another; nothing where it lies beside the series, for reading that tells it then.
///
/// # Errors
/// As for finding both.
pub fn missing_images(of: &Path, series: &Path) -> Result<Option<Warning>> {
    let (series, objects) = match choose(series)? {
        (Chosen::Scan(objects, _), _) => (series, objects),
        _ => return Ok(None),
    };
    let beside = |file: &Path| objects_root(series).is_some_and(|folder| file.starts_with(folder));
    let there: Vec<&Object> = objects.iter().collect();
    let others: Vec<Object> = self::objects(&Place::of(of).root)?.objects;
    let others: Vec<&Object> = others.iter().filter(|o| !beside(&o.path)).collect();
    Ok(lost_of(&there, &others).into_iter().next())
}

/// The folder of a series.
fn objects_root(series: &Path) -> Option<PathBuf> {
    let root = Place::of(series).root;
    if root.is_dir() { Some(root) } else { root.parent().map(Path::to_owned) }
}

/// The same image, or a segmentation, as a parsed file, for what is read from rasters.
///
/// # Errors
/// As [`read_image`], or as [`segmentation::read_segmentation`].
pub(in super::super) fn load<T>(path: &Path, take: impl FnOnce(&mut Raster<'_>) -> Result<T>) -> Result<Loaded<T>> {
    if is_segmentation(path) {
        let named = |segment: &Segment| Some(segment.name.clone());
        let Loaded { value, path, sha256, header, warnings } = segmentation::read_segmentation(path, &named)?;
        let bytes: Vec<u8> = value.volume.data().iter().flat_map(|v| v.to_le_bytes()).collect();
        let stored = Stored { grid: value.volume.grid().clone(), element: Element::U16, bytes, names: value.names };
        return raster(Loaded { value: stored, path, sha256, header, warnings }, take);
    }
    raster_of(read_image(path)?, take)
}

/// The same of an image that may be an MR.
///
/// # Errors
/// As [`load`] and [`read_scan`].
pub(in super::super) fn load_scan<T>(
    path: &Path,
    take: impl FnOnce(&mut Raster<'_>) -> Result<T>,
) -> Result<Loaded<T>> {
    if is_segmentation(path) { load(path, take) } else { raster_of(read_scan(path)?, take) }
}

fn raster_of<T>(read: Loaded<Volume<f32>>, take: impl FnOnce(&mut Raster<'_>) -> Result<T>) -> Result<Loaded<T>> {
    let Loaded { value, path, sha256, header, warnings } = read;
    let bytes: Vec<u8> = value.data().par_iter().flat_map_iter(|v| v.to_le_bytes()).collect();
    let stored = Stored { grid: value.grid().clone(), element: Element::F32, bytes, names: BTreeMap::new() };
    raster(Loaded { value: stored, path, sha256, header, warnings }, take)
}

/// Decoded values, little endian.
struct Stored {
    grid: Grid,
    element: Element,
    bytes: Vec<u8>,
    names: BTreeMap<u16, String>,
}

fn raster<T>(stored: Loaded<Stored>, take: impl FnOnce(&mut Raster<'_>) -> Result<T>) -> Result<Loaded<T>> {
    let Loaded { value: stored, path, sha256, header, warnings } = stored;
    let mut notes = header;
    // The values are scaled already.
    let scaling = notes.scaling.take();
    notes.big_endian = false;
    let mut raster = Raster {
        grid: stored.grid,
        components: 1,
        layout: Layout::Planar,
        vectors: Err("a DICOM image is no displacement field".into()),
        element: stored.element,
        bytes: Cow::Owned(stored.bytes),
        offset: 0,
        notes,
        extensions: Vec::new(),
        names: stored.names,
        warnings,
    };
    let value = take(&mut raster)?;
    let Raster { mut notes, warnings, .. } = raster;
    notes.scaling = scaling;
    Ok(Loaded { value, path, sha256, header: notes, warnings })
}

/// SHA-256 of the image that a folder, or a choice in it, means: that of the sorted SHA-256 of its
/// files, one a line. Of a folder without an image the DICOM files are all counted.
///
/// # Errors
/// As for reading the image, but for its pixels.
pub(in super::super) fn checksum(path: &Path) -> Result<String> {
    let files: Vec<PathBuf> = match choose(path) {
        Ok((Chosen::Scan(objects, beside), same)) => {
            ct::used(&ct::plan(&same, objects, beside)?).into_iter().cloned().collect()
        }
        Ok((Chosen::Dose(objects, _), _)) => objects.into_iter().map(|o| o.path).collect(),
        Ok((Chosen::Labels(object), _)) => vec![object.path],
        Err(Error::Input { .. }) if Place::of(path).choice.is_none() => {
            objects(path)?.objects.into_iter().map(|o| o.path).collect()
        }
        Err(e) => return Err(e),
    };
    Ok(ct::sum(files.par_iter().map(|file| sha256_of(file)).collect::<Result<_>>()?))
}
