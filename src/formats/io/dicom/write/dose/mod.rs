//! Doses: a dose grid in Gy that belongs to a plan and a frame of reference (PS3.3 A.18, C.8.8.3).
//!
//! Such a dose was carried to another anatomy by a registration: nobody computed it there, and no plan was changed. What the
//! standard has for that is Spatial Transform of Dose with a reference to the registration, and Dose Comment. Dose Type and
//! Dose Summation Type stay what the source said, with the source's plan (Referenced RT Plan Sequence is of
//! type 1C: every summation type needs one). Tissue Heterogeneity Correction is of type 3 and tells how a dose was computed:
//! it is left out.

use super::common::{NewSeries, Origin, frame, put, save};
use super::element::{decimal, decimals, integer, reference, sequence, short, text};
use super::plane::{Frames, orientation, plane_size};
use crate::error::{Error, Result};
use crate::findings;
use crate::volume::Volume;
use crate::warning::Warning;
use dicom_core::value::PrimitiveValue;
use dicom_core::{DataElement, VR};
use dicom_dictionary_std::{tags, uids};
use dicom_object::InMemDicomObject;
use std::collections::BTreeSet;
use std::path::Path;

/// Largest stored value: below 2^31, so that a reader that takes them as signed is right as well.
const LARGEST: f64 = 2e9;

/// What a dose that was carried says of itself.
#[derive(Debug, Clone, Copy)]
pub struct DerivedDose<'a> {
    /// What the dose is among the objects of one [`Origin`], for its UIDs: `planned dose on fraction`.
    pub role: &'a str,
    /// Series Description, at most 64 characters.
    pub description: &'a str,
    /// Dose Comment, at most 64 characters.
    pub comment: &'a str,
    /// Series Number.
    pub number: i32,
    /// Frame of Reference UID of the grid.
    pub frame_of_reference: &'a str,
    /// Dose Type of the source: `PHYSICAL` or `EFFECTIVE`.
    pub kind: &'a str,
    /// Dose Summation Type of the source: `PLAN`, `FRACTION`, ...
    pub summation: &'a str,
    /// SOP Instance UIDs of the plans that the source refers to. Without one the object lacks what the standard demands of
    /// all summation types, and systems may refuse it.
    pub plans: &'a BTreeSet<String>,
    /// The registrations that carried the dose, SOP Class UID and SOP Instance UID of each that is an object of DICOM. None for
    /// a dose that is where it was computed.
    pub carried_by: Option<&'a [[&'a str; 2]]>,
}

/// A word about a dose that names no plan.
pub fn no_plan(what: &str, plans: &BTreeSet<String>) -> Option<Warning> {
    plans.is_empty().then(|| {
        let message = format!(
            "{what}: it names no plan, so the dose that is written as DICOM names none either; every dose of a planning system has \
             one, and it may be refused without"
        );
        Warning::new(findings::DICOM_NO_PLAN, message)
    })
}

/// Writes a dose in Gy as unsigned 32-bit integers, frames ascending along the normal of the slices.
///
/// Every value is kept within half a step, which is the greatest dose / 2e9.
///
/// # Errors
/// [`Error::Write`] when a value is negative or not finite, the grid has too many rows, columns or voxels, or the file
/// cannot be written.
pub fn write_dose(path: &Path, dose: &Volume<f32>, about: &DerivedDose<'_>, origin: &Origin) -> Result<()> {
    let step = step(path, dose)?;
    let grid = dose.grid();
    let [columns, rows] = plane_size(path, grid)?;
    if grid.len() as u64 * 4 > u64::from(u32::MAX) - 1 {
        let problem = format!("{:?} voxels take more than 4 GB", grid.size());
        return Err(Error::write(path, problem, "choose a coarser grid"));
    }
    let uid = origin.uid(&[about.role, "series"]);
    let new = NewSeries {
        uid: &uid,
        class: uids::RT_DOSE_STORAGE,
        modality: "RTDOSE",
        number: about.number,
        description: about.description,
        frame_of_reference: about.frame_of_reference,
    };
    let mut object = frame(origin, &new, &origin.uid(&[about.role, "object"]));
    put(&mut object, of_dose(about));
    // Offsets go up along the normal, rows x columns (PS3.3 C.8.8.3.2).
    let frames = Frames::of(grid);
    let [across, down, thick] = grid.spacing();
    let stored =
        frames.order().flat_map(|k| frames.values(dose.data(), k)).map(|d| (f64::from(*d) / step).round() as u32);
    put(
        &mut object,
        [
            decimals(tags::IMAGE_POSITION_PATIENT, grid.centre([0, 0, frames.first()]).coords.iter().copied()),
            decimals(tags::IMAGE_ORIENTATION_PATIENT, orientation(grid)),
            decimals(tags::PIXEL_SPACING, [down, across]),
            decimals(tags::SLICE_THICKNESS, [thick]),
            integer(tags::NUMBER_OF_FRAMES, grid.size()[2] as i64),
            DataElement::new(
                tags::FRAME_INCREMENT_POINTER,
                VR::AT,
                PrimitiveValue::from(tags::GRID_FRAME_OFFSET_VECTOR),
            ),
            decimals(tags::GRID_FRAME_OFFSET_VECTOR, (0..grid.size()[2]).map(|k| k as f64 * thick)),
            short(tags::SAMPLES_PER_PIXEL, 1),
            text(tags::PHOTOMETRIC_INTERPRETATION, VR::CS, "MONOCHROME2"),
            short(tags::ROWS, rows),
            short(tags::COLUMNS, columns),
            short(tags::BITS_ALLOCATED, 32),
            short(tags::BITS_STORED, 32),
            short(tags::HIGH_BIT, 31),
            short(tags::PIXEL_REPRESENTATION, 0),
            decimals(tags::DOSE_GRID_SCALING, [step]),
            // 32-bit words, as 16-bit words in the order of the transfer syntax (PS3.5 8.1.1).
            DataElement::new(tags::PIXEL_DATA, VR::OW, PrimitiveValue::U32(stored.collect())),
        ],
    );
    save(path, object)
}

/// What kind of dose it is.
fn of_dose(about: &DerivedDose<'_>) -> Vec<dicom_object::mem::InMemElement> {
    let mut elements = vec![
        text(tags::OPERATORS_NAME, VR::PN, ""),
        integer(tags::INSTANCE_NUMBER, 1),
        text(tags::DOSE_UNITS, VR::CS, "GY"),
        text(tags::DOSE_TYPE, VR::CS, about.kind),
        text(tags::DOSE_COMMENT, VR::LO, about.comment),
        text(tags::DOSE_SUMMATION_TYPE, VR::CS, about.summation),
    ];
    let plans: Vec<InMemDicomObject> = about.plans.iter().map(|uid| reference(uids::RT_PLAN_STORAGE, uid)).collect();
    if !plans.is_empty() {
        elements.push(sequence(tags::REFERENCED_RT_PLAN_SEQUENCE, plans));
    }
    let carried = if about.carried_by.is_some() { "NON_RIGID" } else { "NONE" };
    elements.push(text(tags::SPATIAL_TRANSFORM_OF_DOSE, VR::CS, carried));
    if let Some(registrations) = about.carried_by {
        // Of type 2C: empty where the field is no object of DICOM.
        let items = registrations.iter().map(|[class, instance]| reference(class, instance)).collect();
        elements.push(sequence(tags::REFERENCED_SPATIAL_REGISTRATION_SEQUENCE, items));
    }
    elements
}

/// Dose of one step of the stored values, Gy: the value that the file's text stands for.
fn step(path: &Path, dose: &Volume<f32>) -> Result<f64> {
    if let Some(n) = dose.data().iter().position(|d| !(d.is_finite() && *d >= 0.0)) {
        let problem = format!("voxel {:?} has {} Gy, which is no dose", dose.grid().voxel(n), dose.data()[n]);
        return Err(Error::write(
            path,
            problem,
            "give a dose of 0 Gy or more in every voxel, not a difference of doses",
        ));
    }
    let greatest = f64::from(dose.extremes()[1]);
    let step = if greatest > 0.0 { greatest / LARGEST } else { 1.0 / LARGEST };
    decimal(step).parse().map_err(|e| Error::Internal(format!("dose step {step}: {e}")))
}

#[cfg(test)]
mod tests;
