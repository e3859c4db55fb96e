//! What a registration carries from one frame to the other.

use crate::arrays::{Given, contour_text};
use crate::errors::raise;
use aventail::dose::{interpolate, judge};
use aventail::field::{Chain, Interpolation, displacement, resample, resample_contours, resample_labels};
use aventail::geometry::Grid;
use aventail::volume::contour::Contours;
use aventail::volume::{LabelMap, Volume};
use aventail::{Error, Result, io};
use nalgebra::{Matrix3, Point3};
use numpy::{PyArray1, PyArrayDyn, PyArrayMethods, PyReadonlyArrayDyn, PyUntypedArrayMethods};
use pyo3::prelude::*;

/// Size (x, y, z), spacing, origin and direction of a grid to compute on.
#[derive(FromPyObject)]
pub(crate) struct Target([usize; 3], [f64; 3], [f64; 3], [f64; 9]);

impl Target {
    /// The grid.
    pub(crate) fn grid(self) -> Result<Grid> {
        Grid::new(self.0, self.1, Point3::from(self.2), Matrix3::from_row_slice(&self.3))
    }
}

/// What an image is, and how it is sampled.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub(crate) struct Kind {
    pub(crate) cubic: bool,
    pub(crate) outside: f32,
    pub(crate) dose: bool,
}

/// Carried points, and which of them the field covers.
pub(crate) type Points<'py> = (Bound<'py, PyArrayDyn<f64>>, Bound<'py, PyArray1<bool>>);

/// An array of points through `carry`.
pub(crate) fn points<'py>(
    py: Python<'py>,
    points: &PyReadonlyArrayDyn<'py, f64>,
    carry: impl FnOnce(Vec<Point3<f64>>) -> Vec<(Point3<f64>, bool)>,
) -> PyResult<Points<'py>> {
    let [n, 3] = *points.shape() else {
        let problem = format!("their shape is {:?}", points.shape());
        return Err(raise(py, &Error::input("points", problem, "give an array of shape (n, 3), x y z, LPS mm")));
    };
    let values: Vec<f64> = points.as_array().iter().copied().collect();
    let given = values.as_chunks::<3>().0.iter().map(|p| Point3::from(*p)).collect();
    let carried = carry(given);
    let flat: Vec<f64> = carried.iter().flat_map(|(p, _)| [p.x, p.y, p.z]).collect();
    let covered = carried.iter().map(|(_, covered)| *covered).collect();
    Ok((PyArray1::from_vec(py, flat).reshape(vec![n, 3])?, PyArray1::from_vec(py, covered)))
}

/// Where a field takes points; beyond its grid it is the identity.
pub(crate) fn pushed(field: &Volume<[f32; 3]>, points: Vec<Point3<f64>>) -> Vec<(Point3<f64>, bool)> {
    let one = |p: Point3<f64>| displacement(field, &p).map_or((p, false), |u| (p + u, true));
    points.into_iter().map(one).collect()
}

/// A scalar image through the field that leads back to its frame, on that field's grid or another of the same frame.
pub(crate) fn image(
    back: &Volume<[f32; 3]>,
    given: Given<Volume<f32>>,
    target: Option<&Grid>,
    kind: Kind,
) -> Result<Volume<f32>> {
    let mut image = match given {
        Given::File(path) if kind.dose => io::read_dose(path)?.value,
        Given::File(path) => io::read_scan(path)?.value,
        Given::Memory(volume) => volume,
    };
    let target = target.unwrap_or(back.grid());
    if kind.dose {
        judge("dose", &mut image)?;
        return interpolate(&image, back, target);
    }
    let interpolation = if kind.cubic { Interpolation::Cubic } else { Interpolation::Linear };
    let chain = Chain::along(back);
    resample(&chain.displacement_on(target)?.0, &image, interpolation, kind.outside)
}

/// A label map through the field that leads back to its frame.
pub(crate) fn labels(back: &Volume<[f32; 3]>, map: &LabelMap, target: Option<&Grid>) -> Result<LabelMap> {
    let chain = Chain::along(back);
    resample_labels(&chain.displacement_on(target.unwrap_or(back.grid()))?.0, map)
}

/// Contours through the fields there and back, on the slices of the new frame.
pub(crate) fn contours(
    [there, back]: [&Volume<[f32; 3]>; 2],
    contours: Contours,
    target: Option<&Grid>,
    frame: &str,
) -> Result<String> {
    let (forward, backward) = (Chain::along(there), Chain::along(back));
    let (moved, _) = resample_contours(&contours, &forward, &backward, target.unwrap_or(back.grid()));
    contour_text(&moved, frame)
}
