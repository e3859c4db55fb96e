//! What a series of slices says of itself: what objects that are derived from it repeat, and refer to.

use nalgebra::Point3;
use serde::{Deserialize, Serialize};

/// The patient, as DICOM's Patient module names them (PS3.3 C.7.1.1); empty where the source says nothing.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Patient {
    /// Name, in DICOM's form `family^given`.
    pub name: String,
    /// The department's number of the patient.
    pub id: String,
    /// `YYYYMMDD`.
    pub birth_date: String,
    /// `M`, `F`, `O` or empty.
    pub sex: String,
}

/// The study (PS3.3 C.7.2.1); empty where the source says nothing.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize)]
pub struct Study {
    /// Study Instance UID.
    pub uid: String,
    /// `YYYYMMDD`.
    pub date: String,
    /// `HHMMSS`, fractions of a second allowed.
    pub time: String,
    /// Study ID.
    pub id: String,
    /// Accession Number.
    pub accession: String,
    /// Study Description.
    pub description: String,
    /// Referring Physician's Name.
    pub physician: String,
}

/// One slice of a series, or one frame of a multi-frame object.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Slice {
    /// SOP Instance UID of the object that holds it.
    pub uid: String,
    /// Number of the frame in it, from 1, where the object holds several.
    pub frame: Option<u32>,
    /// Centre of the first voxel, LPS mm.
    pub position: Point3<f64>,
}

/// A series of images.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Series {
    /// The patient.
    pub patient: Patient,
    /// The study.
    pub study: Study,
    /// Series Instance UID.
    pub uid: String,
    /// Series Number, if there is one.
    pub number: Option<i32>,
    /// `YYYYMMDD`.
    pub date: String,
    /// Series Description.
    pub description: String,
    /// `CT`, `RTDOSE`, ...
    pub modality: String,
    /// Frame of Reference UID: positions of two objects can be compared only where it is the same.
    pub frame_of_reference: String,
    /// SOP Class UID of its objects.
    pub sop_class: String,
    /// `HFS`, `FFP`, ...
    pub patient_position: String,
    /// The slices, in the order of the third axis of the grid that the series was read into.
    pub slices: Vec<Slice>,
}
