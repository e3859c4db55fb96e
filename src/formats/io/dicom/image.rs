//! DICOM where an image is asked for: a CT series in HU, or a dose in Gy.

use super::super::Loaded;
use super::super::bytes::sha256_of;
use super::super::raster::Raster;
use super::super::series_path::Place;
use super::super::voxels::{Element, Layout};
use super::place::{Chosen, choose, objects};
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
/// As [`super::read_series`] and [`super::read_doses`].
pub(in super::super) fn read_image(path: &Path) -> Result<Loaded<Volume<f32>>> {
    match choose(path)? {
        (Chosen::Ct(objects, beside), same) => {
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
    }
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

/// The grid of a CT series, without its pixels, or of a dose.
///
/// # Errors
/// As [`read_image`], but for the pixels.
pub(in super::super) fn read_grid(path: &Path) -> Result<(Grid, Vec<Warning>)> {
    match choose(path)? {
        (Chosen::Ct(objects, beside), same) => {
            let planned = ct::plan(&same, objects, beside)?;
            Ok((planned.stack.grid, planned.warnings))
        }
        (Chosen::Dose(objects, beside), same) => {
            let read = dose::read(&same, &objects, beside)?;
            Ok((read.value.volume.grid().clone(), read.warnings))
        }
    }
}

/// What a CT series says of itself, and its grid, without its pixels.
///
/// # Errors
/// As [`super::read_series`], but for the pixels.
pub fn describe_series(path: &Path) -> Result<(Series, Grid)> {
    match choose(path)? {
        (Chosen::Ct(objects, beside), same) => {
            let planned = ct::plan(&same, objects, beside)?;
            Ok((planned.series, planned.stack.grid))
        }
        (Chosen::Dose(..), _) => Err(ct::no_ct(path)),
    }
}

/// The same image as a parsed file, for what is read from rasters.
///
/// # Errors
/// As [`read_image`].
pub(in super::super) fn load<T>(path: &Path, take: impl FnOnce(&mut Raster<'_>) -> Result<T>) -> Result<Loaded<T>> {
    let Loaded { value, path, sha256, header, warnings } = read_image(path)?;
    let bytes: Vec<u8> = value.data().par_iter().flat_map_iter(|v| v.to_le_bytes()).collect();
    let mut notes = header;
    // The values are scaled already.
    let scaling = notes.scaling.take();
    notes.big_endian = false;
    let mut raster = Raster {
        grid: value.grid().clone(),
        components: 1,
        layout: Layout::Planar,
        vectors: Err("a DICOM image is no displacement field".into()),
        element: Element::F32,
        bytes: Cow::Owned(bytes),
        offset: 0,
        notes,
        extensions: Vec::new(),
        names: BTreeMap::new(),
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
        Ok((Chosen::Ct(objects, beside), same)) => {
            ct::used(&ct::plan(&same, objects, beside)?).into_iter().cloned().collect()
        }
        Ok((Chosen::Dose(objects, _), _)) => objects.into_iter().map(|o| o.path).collect(),
        Err(Error::Input { .. }) if Place::of(path).choice.is_none() => {
            objects(path)?.objects.into_iter().map(|o| o.path).collect()
        }
        Err(e) => return Err(e),
    };
    Ok(ct::sum(files.par_iter().map(|file| sha256_of(file)).collect::<Result<_>>()?))
}
