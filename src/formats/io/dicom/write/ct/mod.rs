//! CT series: an image on a grid as slices that planning systems import (PS3.3 A.3, C.8.2.1).

use super::super::series::{Series, Slice};
use super::common::{NewSeries, Origin, frame, put, references, save};
use super::element::{code, decimals, integer, sequence, short, text, texts};
use super::plane::{orientation, plane_size};
use crate::error::{Error, Result};
use crate::geometry::Grid;
use crate::volume::Volume;
use dicom_core::value::PrimitiveValue;
use dicom_core::{DataElement, VR};
use dicom_dictionary_std::{tags, uids};
use dicom_object::InMemDicomObject;
use std::path::Path;

/// Rescale intercept of scanners: air is stored as a small positive number.
const USUAL_INTERCEPT: f64 = -1024.0;

/// What a new CT series says of itself.
#[derive(Debug, Clone, Copy)]
pub struct DerivedCt<'a> {
    /// What the series is among those of one [`Origin`], for its UIDs: `planning on fraction`.
    pub role: &'a str,
    /// Series Description, at most 64 characters.
    pub description: &'a str,
    /// How the image was made, in a sentence.
    pub derivation: &'a str,
    /// Series Number.
    pub number: i32,
    /// Frame of Reference UID of the grid.
    pub frame_of_reference: &'a str,
    /// `HFS`, `FFP`, ...; empty where it is not known.
    pub patient_position: &'a str,
    /// The images that it was made of.
    pub sources: &'a [&'a Series],
}

/// The series that [`write_ct`] will write for a grid: objects written before it can refer to it.
pub fn ct_series(grid: &Grid, about: &DerivedCt<'_>, origin: &Origin) -> Series {
    let uid = origin.uid(&[about.role, "series"]);
    let slice = |k: usize| Slice {
        uid: origin.uid(&[about.role, "slice", &k.to_string()]),
        frame: None,
        position: grid.centre([0, 0, k]),
    };
    let mut study = origin.study.clone();
    study.uid = origin.study_uid();
    Series {
        patient: origin.patient.clone(),
        study,
        uid,
        number: Some(about.number),
        date: origin.when.date.clone(),
        description: about.description.into(),
        modality: "CT".into(),
        frame_of_reference: about.frame_of_reference.into(),
        sop_class: uids::CT_IMAGE_STORAGE.into(),
        patient_position: about.patient_position.into(),
        slices: (0..grid.size()[2]).map(slice).collect(),
    }
}

/// Writes an image in HU as `CT.0001.dcm` and so on into a folder, in the order of the grid's third axis; returns the series.
///
/// Values are rounded to whole HU, as in the other formats. They are stored as signed 16-bit integers with the intercept
/// -1024 as scanners have it, or without one where that leaves too little room.
///
/// # Errors
/// [`Error::Write`] when a value is not finite or does not fit, the grid has too many rows or columns, or a file cannot be
/// written.
pub fn write_ct(folder: &Path, ct: &Volume<f32>, about: &DerivedCt<'_>, origin: &Origin) -> Result<Series> {
    let grid = ct.grid();
    let intercept = intercept(folder, ct)?;
    let [columns, rows] = plane_size(folder, grid)?;
    let series = ct_series(grid, about, origin);
    let new = NewSeries {
        uid: &series.uid,
        class: &series.sop_class,
        modality: &series.modality,
        number: about.number,
        description: about.description,
        frame_of_reference: about.frame_of_reference,
    };
    let plane = grid.strides()[2];
    for (k, (slice, values)) in series.slices.iter().zip(ct.data().chunks_exact(plane)).enumerate() {
        let mut object = frame(origin, &new, &slice.uid);
        put(&mut object, of_kind(about));
        put(&mut object, of_place(grid, k));
        let stored = values.iter().map(|v| (f64::from(*v).round_ties_even() - intercept) as i16).collect();
        put(
            &mut object,
            [
                short(tags::SAMPLES_PER_PIXEL, 1),
                text(tags::PHOTOMETRIC_INTERPRETATION, VR::CS, "MONOCHROME2"),
                short(tags::ROWS, rows),
                short(tags::COLUMNS, columns),
                short(tags::BITS_ALLOCATED, 16),
                short(tags::BITS_STORED, 16),
                short(tags::HIGH_BIT, 15),
                short(tags::PIXEL_REPRESENTATION, 1),
                decimals(tags::RESCALE_INTERCEPT, [intercept]),
                decimals(tags::RESCALE_SLOPE, [1.0]),
                text(tags::RESCALE_TYPE, VR::LO, "HU"),
                decimals(tags::WINDOW_CENTER, [40.0]),
                decimals(tags::WINDOW_WIDTH, [400.0]),
                DataElement::new(tags::PIXEL_DATA, VR::OW, PrimitiveValue::I16(stored)),
            ],
        );
        save(&folder.join(format!("CT.{:04}.dcm", k + 1)), object)?;
    }
    Ok(series)
}

/// What kind of image it is, and of what it was made (PS3.3 C.7.6.1.1.2, C.8.2.1.1.1, C.12.4).
fn of_kind(about: &DerivedCt<'_>) -> Vec<dicom_object::mem::InMemElement> {
    let mut elements = vec![
        texts(tags::IMAGE_TYPE, VR::CS, ["DERIVED", "SECONDARY", "AXIAL"]),
        text(tags::DERIVATION_DESCRIPTION, VR::ST, about.derivation),
        text(tags::PATIENT_POSITION, VR::CS, about.patient_position),
        text(tags::KVP, VR::DS, ""),
        text(tags::ACQUISITION_NUMBER, VR::IS, ""),
        text(tags::BURNED_IN_ANNOTATION, VR::CS, "NO"),
    ];
    let sources: Vec<InMemDicomObject> = about
        .sources
        .iter()
        .flat_map(|s| references(s))
        .map(|mut source| {
            // What is at a place here was elsewhere there.
            source.put(text(tags::SPATIAL_LOCATIONS_PRESERVED, VR::CS, "NO"));
            let purpose = code("121322", "DCM", "Source image for image processing operation");
            source.put(sequence(tags::PURPOSE_OF_REFERENCE_CODE_SEQUENCE, vec![purpose]));
            source
        })
        .collect();
    if !sources.is_empty() {
        elements.push(sequence(tags::SOURCE_IMAGE_SEQUENCE, sources));
    }
    elements
}

/// Where slice `k` lies (PS3.3 C.7.6.2).
fn of_place(grid: &Grid, k: usize) -> Vec<dicom_object::mem::InMemElement> {
    let [across, down, thick] = grid.spacing();
    let position = grid.centre([0, 0, k]);
    let along = grid.direction().column(2).dot(&position.coords);
    vec![
        integer(tags::INSTANCE_NUMBER, k as i64 + 1),
        decimals(tags::IMAGE_POSITION_PATIENT, position.coords.iter().copied()),
        decimals(tags::IMAGE_ORIENTATION_PATIENT, orientation(grid)),
        // Between rows first, then between columns (PS3.3 10.7.1.3).
        decimals(tags::PIXEL_SPACING, [down, across]),
        decimals(tags::SLICE_THICKNESS, [thick]),
        decimals(tags::SPACING_BETWEEN_SLICES, [thick]),
        decimals(tags::SLICE_LOCATION, [along]),
    ]
}

/// The intercept with which all values fit signed 16-bit integers.
fn intercept(path: &Path, ct: &Volume<f32>) -> Result<f64> {
    if let Some(n) = ct.data().iter().position(|v| !v.is_finite()) {
        let problem = format!("voxel {:?} has the value {}, which is no HU", ct.grid().voxel(n), ct.data()[n]);
        return Err(Error::write(path, problem, "give an image with a finite value in every voxel"));
    }
    let [low, high] = ct.extremes().map(f64::from);
    let fits = |intercept: &f64| {
        let room = f64::from(i16::MIN)..=f64::from(i16::MAX);
        room.contains(&(low.round_ties_even() - intercept)) && room.contains(&(high.round_ties_even() - intercept))
    };
    [USUAL_INTERCEPT, 0.0].into_iter().find(fits).ok_or_else(|| {
        let problem = format!("its values from {low} to {high} do not fit 16-bit HU, -32768 to 32767");
        Error::write(path, problem, "give an image in HU; clip what metal has driven beyond")
    })
}

#[cfg(test)]
mod tests;
