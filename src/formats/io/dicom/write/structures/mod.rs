//! Structure sets: contours with the series that they are drawn on (PS3.3 A.19, C.8.8.5, C.8.8.6, C.8.8.8).

use super::super::keyhole::keyholes;
use super::super::series::{Series, Slice};
use super::super::structures::Roi;
use super::common::{NewSeries, Origin, frame, put, references, save};
use super::element::{decimal, empty, integer, item, reference, sequence, text};
use crate::error::{Error, Result};
use crate::volume::contour::{Contours, Polygon, Structure};
use dicom_core::value::PrimitiveValue;
use dicom_core::{DataElement, VR};
use dicom_dictionary_std::{tags, uids};
use dicom_object::InMemDicomObject;
use nalgebra::{Point3, Vector3};
use std::collections::BTreeSet;
use std::path::Path;

/// Structure Set Label: 16 characters at most, and what people see first.
const LABEL: &str = "RESEARCH ONLY";
/// Detached Study Management: retired, and still what planning systems write as class of a referenced study.
const STUDY_CLASS: &str = "1.2.840.10008.3.1.2.3.1";
/// Longest structure name.
const LONGEST_NAME: usize = 64;
/// Steps of coordinates, 1 / mm: a tenth of a micrometre.
const STEPS: f64 = 1e4;

/// What a new structure set says of itself.
#[derive(Debug, Clone, Copy)]
pub struct DerivedStructures<'a> {
    /// What the set is among the objects of one [`Origin`], for its UIDs: `planning contours on fraction`.
    pub role: &'a str,
    /// Series Description, and name of the set; at most 64 characters.
    pub description: &'a str,
    /// How the contours were made, in a sentence.
    pub derivation: &'a str,
    /// Series Number.
    pub number: i32,
    /// The images that the contours are drawn on.
    pub drawn_on: &'a Series,
}

/// Writes a structure set: structure `n` of `contours` is `rois[n]`, with its number, name, type and colour.
///
/// Holes are joined to what surrounds them (keyholes), since not every reader combines contours by exclusive or. Structures
/// without a contour stay in the set. Every contour names the image on whose plane it lies, within half the distance between
/// slices; a contour beyond the last slice names none.
///
/// # Errors
/// [`Error::Write`] when `rois` are not those of the contours, a name is longer than 64 characters or holds a backslash, a
/// number occurs twice, the series has no slices, or the file cannot be written.
pub fn write_structures(
    path: &Path,
    contours: &Contours,
    rois: &[Roi],
    about: &DerivedStructures<'_>,
    origin: &Origin,
) -> Result<()> {
    check(path, contours, rois, about.drawn_on)?;
    let series = about.drawn_on;
    let uid = origin.uid(&[about.role, "series"]);
    let new = NewSeries {
        uid: &uid,
        class: uids::RT_STRUCTURE_SET_STORAGE,
        modality: "RTSTRUCT",
        number: about.number,
        description: about.description,
        frame_of_reference: &series.frame_of_reference,
    };
    let mut object = frame(origin, &new, &origin.uid(&[about.role, "object"]));
    let planes = Planes::of(series, &contours.axes.column(2).into_owned());
    let all = || rois.iter().zip(&contours.structures);
    put(
        &mut object,
        [
            text(tags::OPERATORS_NAME, VR::PN, ""),
            text(tags::STRUCTURE_SET_LABEL, VR::SH, LABEL),
            text(tags::STRUCTURE_SET_NAME, VR::LO, about.description),
            text(tags::STRUCTURE_SET_DESCRIPTION, VR::ST, about.derivation),
            text(tags::STRUCTURE_SET_DATE, VR::DA, origin.when.date.as_str()),
            text(tags::STRUCTURE_SET_TIME, VR::TM, origin.when.time.as_str()),
            integer(tags::INSTANCE_NUMBER, 1),
            text(tags::APPROVAL_STATUS, VR::CS, "UNAPPROVED"),
            sequence(tags::REFERENCED_FRAME_OF_REFERENCE_SEQUENCE, vec![drawn_on(series)]),
            sequence(
                tags::STRUCTURE_SET_ROI_SEQUENCE,
                rois.iter().map(|r| named(r, &series.frame_of_reference)).collect(),
            ),
            sequence(tags::ROI_CONTOUR_SEQUENCE, all().map(|(r, s)| drawn(r, s, contours, &planes)).collect()),
            sequence(tags::RTROI_OBSERVATIONS_SEQUENCE, rois.iter().enumerate().map(|(n, r)| observed(n, r)).collect()),
        ],
    );
    save(path, object)
}

fn check(path: &Path, contours: &Contours, rois: &[Roi], series: &Series) -> Result<()> {
    if rois.len() != contours.structures.len() {
        return Err(Error::Internal(format!("{} ROIs for {} structures", rois.len(), contours.structures.len())));
    }
    if series.slices.is_empty() {
        let problem = "the series that its contours are drawn on has no slices";
        return Err(Error::write(path, problem, "give the CT series of the contours"));
    }
    if let Some(r) = rois.iter().find(|r| r.name.chars().count() > LONGEST_NAME || r.name.contains(['\\', '\n', '\r']))
    {
        let problem = format!("DICOM has no room for the structure name {:?}", r.name);
        return Err(Error::write(path, problem, "give it a name of at most 64 characters without a backslash"));
    }
    let mut numbers = BTreeSet::new();
    if let Some(r) = rois.iter().find(|r| !numbers.insert(r.number)) {
        let problem = format!("two structures have the number {}, one of them {:?}", r.number, r.name);
        return Err(Error::write(path, problem, "give each structure a number of its own"));
    }
    Ok(())
}

/// Referenced Frame of Reference: study, series and all images (PS3.3 C.8.8.5).
fn drawn_on(series: &Series) -> InMemDicomObject {
    let images = item([
        text(tags::SERIES_INSTANCE_UID, VR::UI, series.uid.as_str()),
        sequence(tags::CONTOUR_IMAGE_SEQUENCE, references(series)),
    ]);
    let mut study = reference(STUDY_CLASS, &series.study.uid);
    study.put(sequence(tags::RT_REFERENCED_SERIES_SEQUENCE, vec![images]));
    item([
        text(tags::FRAME_OF_REFERENCE_UID, VR::UI, series.frame_of_reference.as_str()),
        sequence(tags::RT_REFERENCED_STUDY_SEQUENCE, vec![study]),
    ])
}

fn named(roi: &Roi, frame_of_reference: &str) -> InMemDicomObject {
    item([
        integer(tags::ROI_NUMBER, roi.number),
        text(tags::REFERENCED_FRAME_OF_REFERENCE_UID, VR::UI, frame_of_reference),
        text(tags::ROI_NAME, VR::LO, roi.name.as_str()),
        text(tags::ROI_GENERATION_ALGORITHM, VR::CS, "AUTOMATIC"),
    ])
}

fn observed(n: usize, roi: &Roi) -> InMemDicomObject {
    item([
        integer(tags::OBSERVATION_NUMBER, n as i64 + 1),
        integer(tags::REFERENCED_ROI_NUMBER, roi.number),
        text(tags::RTROI_INTERPRETED_TYPE, VR::CS, roi.interpreted_type.as_str()),
        empty(tags::ROI_INTERPRETER, VR::PN),
    ])
}

/// A structure's contours (PS3.3 C.8.8.6).
fn drawn(roi: &Roi, structure: &Structure, contours: &Contours, planes: &Planes<'_>) -> InMemDicomObject {
    let mut object = item([integer(tags::REFERENCED_ROI_NUMBER, roi.number)]);
    if let Some(colour) = roi.colour.or(structure.colour) {
        let colour = colour.iter().map(|c| c.to_string()).collect();
        object.put(DataElement::new(tags::ROI_DISPLAY_COLOR, VR::IS, PrimitiveValue::Strs(colour)));
    }
    let polygons = keyholes(&structure.polygons);
    let items: Vec<InMemDicomObject> =
        polygons.iter().enumerate().map(|(n, polygon)| contour(n, polygon, contours, planes)).collect();
    if !items.is_empty() {
        object.put(sequence(tags::CONTOUR_SEQUENCE, items));
    }
    object
}

fn contour(n: usize, polygon: &Polygon, contours: &Contours, planes: &Planes<'_>) -> InMemDicomObject {
    let short = |v: &f64| decimal((v * STEPS).round() / STEPS);
    let points: Vec<Point3<f64>> = polygon.points.iter().map(|p| contours.world(*p, polygon.height)).collect();
    let mut object = item([
        integer(tags::CONTOUR_NUMBER, n as i64 + 1),
        text(tags::CONTOUR_GEOMETRIC_TYPE, VR::CS, "CLOSED_PLANAR"),
        integer(tags::NUMBER_OF_CONTOUR_POINTS, points.len() as i64),
        DataElement::new(
            tags::CONTOUR_DATA,
            VR::DS,
            PrimitiveValue::Strs(points.iter().flat_map(|p| p.iter().map(short).collect::<Vec<_>>()).collect()),
        ),
    ]);
    if let Some(image) = planes.image_at(polygon.height) {
        let image = reference(planes.class, image);
        object.put(sequence(tags::CONTOUR_IMAGE_SEQUENCE, vec![image]));
    }
    object
}

/// Positions of a series' slices along the contours' normal.
struct Planes<'a> {
    class: &'a str,
    /// Height, mm, and UID, ascending.
    slices: Vec<(f64, &'a str)>,
}

impl<'a> Planes<'a> {
    fn of(series: &'a Series, normal: &Vector3<f64>) -> Self {
        let place = |s: &'a Slice| (normal.dot(&s.position.coords), s.uid.as_str());
        let mut slices: Vec<_> = series.slices.iter().map(place).collect();
        slices.sort_by(|a, b| a.0.total_cmp(&b.0));
        Self { class: &series.sop_class, slices }
    }

    /// The image nearest to a height, within half of what lies between it and its neighbour.
    fn image_at(&self, height: f64) -> Option<&'a str> {
        let off = |s: &(f64, &str)| (s.0 - height).abs();
        let (n, nearest) = self.slices.iter().enumerate().min_by(|a, b| off(a.1).total_cmp(&off(b.1)))?;
        let before = n.checked_sub(1).map(|b| nearest.0 - self.slices[b].0);
        let after = self.slices.get(n + 1).map(|s| s.0 - nearest.0);
        let half = 0.5 * before.into_iter().chain(after).fold(f64::INFINITY, f64::min);
        // One slice alone tells no distance: a hair is allowed for rounding.
        let reach = if half.is_finite() { half } else { 0.01 };
        (off(nearest) <= reach + 1e-6).then_some(nearest.1)
    }
}

#[cfg(test)]
mod tests;
