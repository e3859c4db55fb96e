//! Volumes as numpy arrays with their geometry, and as files.
//!
//! A raster in Python is `(array, spacing, origin, direction)`: the array C-contiguous in the order (z, y, x), components last;
//! spacing and origin in the order x, y, z, mm; the direction row by row, one column per axis; LPS. The library keeps `i`, which
//! is x, fastest in memory, so that no value changes its place.

use crate::errors::{Raised, raise};
use aventail::field::FieldFormat;
use aventail::geometry::{Grid, Rigid, rigid_from_matrix};
use aventail::io::{self, Stored, WriteOptions};
use aventail::volume::contour::Contours;
use aventail::volume::{LabelMap, Volume};
use aventail::{Error, Result};
use nalgebra::{Matrix3, Matrix4, Point3};
use numpy::{Element, PyArray1, PyArrayDyn, PyArrayMethods, PyReadonlyArrayDyn, PyUntypedArrayMethods};
use pyo3::prelude::*;
use std::path::{Path, PathBuf};

/// Names of labels.
pub(crate) use aventail::session::Names;
/// A raster on its way to Python.
pub(crate) type Raster<'py, T> = (Bound<'py, PyArrayDyn<T>>, [f64; 3], [f64; 3], [f64; 9]);
/// A raster of labels with their names.
pub(crate) type LabelRaster<'py> = (Raster<'py, u16>, Names);

/// The frames that a field joins, where its header tells.
type Frames = Option<(String, String)>;
/// Size, spacing, origin and direction of a grid.
type Geometry = ([usize; 3], [f64; 3], [f64; 3], [f64; 9]);

/// Something that was given as a file or in memory.
pub(crate) use aventail::session::Source as Given;

/// The grid of an array's shape (z, y, x, ...) and geometry.
fn grid_of(shape: &[usize], spacing: [f64; 3], origin: [f64; 3], direction: [f64; 9]) -> Result<Grid> {
    let [z, y, x, ..] = *shape else {
        let problem = format!("its shape is {shape:?}");
        return Err(Error::input("array", problem, "give an array of three axes, (z, y, x)"));
    };
    Grid::new([x, y, z], spacing, Point3::from(origin), Matrix3::from_row_slice(&direction))
}

/// Grid and values of a raster of `axes` axes.
fn taken<T: Element + Copy>(raster: &Bound<'_, PyAny>, axes: usize) -> PyResult<(Grid, Vec<T>)> {
    let py = raster.py();
    let (array, spacing, origin, direction): (PyReadonlyArrayDyn<'_, T>, [f64; 3], [f64; 3], [f64; 9]) =
        raster.extract()?;
    let shape = array.shape();
    if shape.len() != axes || axes == 4 && shape.last() != Some(&3) {
        let remedy = if axes == 4 { "give (z, y, x, 3), components last" } else { "give (z, y, x)" };
        return Err(raise(py, &Error::input("array", format!("its shape is {shape:?}"), remedy)));
    }
    let grid = grid_of(shape, spacing, origin, direction).raised(py)?;
    let values = array.as_slice().ok().filter(|_| array.is_c_contiguous());
    let values = values.ok_or_else(|| raise(py, &Error::Internal("an array is not contiguous".into())))?;
    Ok((grid, values.to_vec()))
}

/// A path, or what `other` makes of anything else.
pub(crate) fn given<T>(
    any: &Bound<'_, PyAny>,
    other: impl FnOnce(&Bound<'_, PyAny>) -> PyResult<T>,
) -> PyResult<Given<T>> {
    match any.extract::<PathBuf>() {
        Ok(path) => Ok(Given::File(path)),
        Err(_) => other(any).map(Given::Memory),
    }
}

/// A scalar image: a path or a raster of float32.
pub(crate) fn image(any: &Bound<'_, PyAny>) -> PyResult<Given<Volume<f32>>> {
    given(any, |raster| {
        let (grid, values) = taken(raster, 3)?;
        Volume::new(grid, values).raised(raster.py())
    })
}

/// A displacement field: a path or a raster of float32 with three components.
pub(crate) fn field(any: &Bound<'_, PyAny>) -> PyResult<Given<Volume<[f32; 3]>>> {
    given(any, |raster| {
        let (grid, values) = taken::<f32>(raster, 4)?;
        let vectors = values.as_chunks::<3>().0.to_vec();
        Volume::new(grid, vectors).raised(raster.py())
    })
}

/// A label map: a path or a raster of uint16; the names come apart.
pub(crate) fn labels(any: &Bound<'_, PyAny>) -> PyResult<Given<Volume<u16>>> {
    given(any, |raster| {
        let (grid, values) = taken(raster, 3)?;
        Volume::new(grid, values).raised(raster.py())
    })
}

/// Names: a path or a table.
pub(crate) fn names(any: &Bound<'_, PyAny>) -> PyResult<Given<Names>> {
    given(any, |table| table.extract())
}

/// A rigid transform of the rows of its matrix.
pub(crate) fn rigid(what: &str, rows: &[[f64; 4]; 4]) -> Result<Rigid> {
    rigid_from_matrix(&Matrix4::from_fn(|r, c| rows[r][c])).ok_or_else(|| {
        let remedy = "give a 4x4 of a rotation and a shift in mm, planning to fraction, LPS";
        Error::input(what, format!("the matrix is not rigid: {rows:?}"), remedy)
    })
}

/// A rigid transform as the rows of its matrix.
pub(crate) fn rows(transform: &Rigid) -> [[f64; 4]; 4] {
    let matrix = transform.to_homogeneous();
    std::array::from_fn(|r| std::array::from_fn(|c| matrix[(r, c)]))
}

/// An array of values in storage order, without copying them, with the geometry of their grid.
pub(crate) fn raster<'py, T: Element>(py: Python<'py>, grid: &Grid, values: Vec<T>) -> PyResult<Raster<'py, T>> {
    let [x, y, z] = grid.size();
    let mut shape = vec![z, y, x];
    if values.len() > grid.len() {
        shape.push(values.len() / grid.len());
    }
    let direction = grid.direction().transpose();
    let direction = std::array::from_fn(|n| direction.as_slice()[n]);
    Ok((PyArray1::from_vec(py, values).reshape(shape)?, grid.spacing(), grid.origin().into(), direction))
}

/// A label map with its names.
pub(crate) fn label_raster(py: Python<'_>, map: LabelMap) -> PyResult<LabelRaster<'_>> {
    let grid = map.volume.grid().clone();
    Ok((raster(py, &grid, map.volume.into_data())?, map.names))
}

/// A field of displacements in storage order.
pub(crate) fn field_raster(py: Python<'_>, field: Volume<[f32; 3]>) -> PyResult<Raster<'_, f32>> {
    let grid = field.grid().clone();
    raster(py, &grid, field.into_data().into_flattened())
}

/// Contours of a JSON text or a file (JSON, DICOM structure set).
pub(crate) fn contours(json: Option<&str>, path: Option<&Path>) -> Result<Contours> {
    match (json, path) {
        (Some(text), _) => Ok(io::parse_contours(text, "contours")?.0),
        (None, Some(path)) => Ok(io::read_contour_file(path)?.contours),
        (None, None) => Err(Error::usage("no contours are given", "give contours or a file of them")),
    }
}

/// The JSON text of contours.
pub(crate) fn contour_text(contours: &Contours, frame: &str) -> Result<String> {
    let text = io::contour_json(contours, frame)?;
    String::from_utf8(text).map_err(|e| Error::Internal(e.to_string()))
}

/// Options of a file with a text in its header.
fn described(description: String) -> WriteOptions {
    WriteOptions { description, ..WriteOptions::default() }
}

/// Reads a scalar image, or a dose.
#[pyfunction]
pub(crate) fn read_image(py: Python<'_>, path: PathBuf, dose: bool) -> PyResult<Raster<'_, f32>> {
    let read = || if dose { io::read_dose(path) } else { io::read_scan(path) };
    let image = py.detach(read).raised(py)?.value;
    let grid = image.grid().clone();
    raster(py, &grid, image.into_data())
}

/// Reads a label map with the names in its header.
#[pyfunction]
pub(crate) fn read_labels(py: Python<'_>, path: PathBuf) -> PyResult<LabelRaster<'_>> {
    let map = py.detach(|| io::read_label_map(path, None)).raised(py)?.value;
    label_raster(py, map)
}

/// Reads a displacement field; also the frames that its header says it joins.
#[pyfunction]
pub(crate) fn read_field(py: Python<'_>, path: PathBuf) -> PyResult<(Raster<'_, f32>, Frames)> {
    let field = py.detach(|| io::read_field(path)).raised(py)?;
    let frames = io::frames_of(&field.header.description).map(|f| (f.from, f.to));
    Ok((field_raster(py, field.value)?, frames))
}

/// Reads the geometry of an image: size, spacing, origin, direction.
#[pyfunction]
pub(crate) fn read_grid(py: Python<'_>, path: PathBuf) -> PyResult<Geometry> {
    let grid = py.detach(|| io::read_grid(path)).raised(py)?.0;
    let direction = grid.direction().transpose();
    let direction = std::array::from_fn(|n| direction.as_slice()[n]);
    Ok((grid.size(), grid.spacing(), grid.origin().into(), direction))
}

/// Reads contours as the text of a contour JSON.
#[pyfunction]
pub(crate) fn read_contours(py: Python<'_>, path: PathBuf) -> PyResult<String> {
    let read = || {
        let file = io::read_contour_file(path)?;
        contour_text(&file.contours, file.frame.as_deref().unwrap_or_default())
    };
    py.detach(read).raised(py)
}

/// Writes a scalar image as float32, or as whole numbers.
#[pyfunction]
pub(crate) fn write_image(py: Python<'_>, path: PathBuf, raster: &Bound<'_, PyAny>, whole: bool) -> PyResult<()> {
    let Given::Memory(volume) = image(raster)? else { return Ok(()) };
    let stored = if whole { Stored::Int16 } else { Stored::Float32 };
    py.detach(|| io::write_image(path, &volume, stored, &WriteOptions::default())).raised(py)
}

/// Writes a label map with its names.
#[pyfunction]
pub(crate) fn write_labels(py: Python<'_>, path: PathBuf, raster: &Bound<'_, PyAny>, names: Names) -> PyResult<()> {
    let Given::Memory(volume) = labels(raster)? else { return Ok(()) };
    let map = LabelMap { volume, names };
    py.detach(|| io::write_labels(path, &map, &WriteOptions::default())).raised(py)
}

/// Writes a field that takes points of frame `start` to frame `end`, in a layout, or that of the file's extension.
#[pyfunction]
pub(crate) fn write_field(
    py: Python<'_>,
    path: PathBuf,
    raster: &Bound<'_, PyAny>,
    frames: (String, String),
    format: Option<&str>,
) -> PyResult<()> {
    let Given::Memory(volume) = field(raster)? else { return Ok(()) };
    let format = match format {
        None => FieldFormat::of(&path).raised(py)?,
        Some(name) => serde_json::from_value(name.into())
            .map_err(|e| Error::usage(format!("the layout is {name:?}: {e}"), "take one of those named"))
            .raised(py)?,
    };
    let options = described(io::direction(&frames.0, &frames.1, format));
    py.detach(|| io::write_field(path, &volume, format, &options)).raised(py)
}

/// Writes contours of a contour JSON's text that lie in a frame.
#[pyfunction]
pub(crate) fn write_contours(py: Python<'_>, path: PathBuf, json: &str, frame: &str) -> PyResult<()> {
    let all = contours(Some(json), None).raised(py)?;
    py.detach(|| io::write_contours(path, &all, frame)).raised(py)
}
