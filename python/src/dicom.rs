//! Single results as DICOM beside a scan, as the program's `--dicom-like` writes them.

use crate::arrays::{self, Given, contours};
use crate::errors::Raised;
use aventail::dose::judge;
use aventail::io;
use aventail::io::dicom::like::{self, Like};
use aventail::io::dicom::{CarriedDose, is_structure_set, read_structure_set};
use aventail::{Error, Result};
use pyo3::prelude::*;
use std::path::{Path, PathBuf};

/// The scan that a result refers to, once the result can be written: into a new folder, or as a file.
fn beside(out: &Path, series: &Path, folder: bool, more: &[&Path]) -> Result<Like> {
    like::check(out, Some(series), folder)?;
    let inputs: Vec<&Path> = more.iter().copied().chain([series]).collect();
    io::check_files(&inputs, &[out.to_owned()])?;
    io::check_place(out)?;
    Like::read(series)
}

/// What is never there: these are given in memory.
fn on_disk() -> Error {
    Error::Internal("a result that is to be written is a file".into())
}

/// Writes an image as a series of slices into a folder.
#[pyfunction]
#[pyo3(signature = (path, raster, like, of))]
pub(crate) fn write_dicom_image(
    py: Python<'_>,
    path: PathBuf,
    raster: &Bound<'_, PyAny>,
    like: PathBuf,
    of: Option<PathBuf>,
) -> PyResult<()> {
    let Given::Memory(volume) = arrays::image(raster)? else { return Err(on_disk()).raised(py) };
    let of = of.as_deref();
    let write = || beside(&path, &like, true, of.as_slice())?.image(&path, &volume, of);
    py.detach(write).raised(py)
}

/// Writes a dose; returns code and message of each warning.
#[pyfunction]
pub(crate) fn write_dicom_dose(
    py: Python<'_>,
    path: PathBuf,
    raster: &Bound<'_, PyAny>,
    like: PathBuf,
    of: Vec<PathBuf>,
    fields: Vec<PathBuf>,
) -> PyResult<Vec<(String, String)>> {
    let Given::Memory(mut volume) = arrays::image(raster)? else { return Err(on_disk()).raised(py) };
    let [of, fields] = [&of, &fields].map(|paths| paths.iter().map(PathBuf::as_path).collect::<Vec<_>>());
    let write = || {
        let scan = beside(&path, &like, false, &[&of[..], &fields].concat())?;
        judge("dose", &mut volume)?;
        let warnings = scan.dose(&path, &volume, CarriedDose::Dose, [&of, &fields])?;
        Ok(warnings.into_iter().map(|w| (w.code, w.message)).collect())
    };
    py.detach(write).raised(py)
}

/// Writes contours as a structure set.
#[pyfunction]
#[pyo3(signature = (path, json, like, of))]
pub(crate) fn write_dicom_contours(
    py: Python<'_>,
    path: PathBuf,
    json: &str,
    like: PathBuf,
    of: Option<PathBuf>,
) -> PyResult<()> {
    let all = contours(Some(json), None).raised(py)?;
    let write = || {
        let scan = beside(&path, &like, false, of.as_deref().as_slice())?;
        let set = of.as_deref().filter(|of| is_structure_set(of)).map(read_structure_set).transpose()?;
        scan.structures(&path, &all, set.as_ref())
    };
    py.detach(write).raised(py)
}

/// Writes a field that lies in one series and leads to another.
#[pyfunction]
pub(crate) fn write_dicom_field(
    py: Python<'_>,
    path: PathBuf,
    raster: &Bound<'_, PyAny>,
    start: PathBuf,
    end: PathBuf,
) -> PyResult<()> {
    let Given::Memory(field) = arrays::field(raster)? else { return Err(on_disk()).raised(py) };
    let write = || {
        let [from, to] = [beside(&path, &start, false, &[&end])?, Like::read(&end)?];
        from.field(&path, &field, &to)
    };
    py.detach(write).raised(py)
}
