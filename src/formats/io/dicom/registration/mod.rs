//! Registrations: Spatial Registration (rigid) and Deformable Spatial Registration objects, written and read.
//!
//! The two point opposite ways (PS3.17 O.1). A Spatial Registration's matrix takes points of the *source* frame to the
//! *registered* frame, the frame of reference of the object itself. A Deformable Spatial Registration's grid lies in the
//! registered frame and takes its points to the source frame, where data are sampled: a pull field of the source's images.

mod deformable;
mod element;
mod rigid;

pub(super) use deformable::describe_deformable;
pub(in super::super) use deformable::read_field;
pub use deformable::{Deformable, read_deformable, write_deformable, write_pull, write_push};
pub use rigid::{RigidRegistration, read_rigid, write_rigid};

use super::open::{Opened, is_dicom, open};
use super::series::Series;
use super::write::{NewSeries, Origin, frame, instances, put};
use crate::error::Result;
use dicom_core::VR;
use dicom_dictionary_std::{tags, uids};
use dicom_object::InMemDicomObject;
use element::{empty, integer, text};
use std::path::Path;

/// Kinds of registrations.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// Spatial Registration: matrices.
    Rigid,
    /// Deformable Spatial Registration: a field.
    Deformable,
}

/// What kind of registration a file holds; `None` where it holds none.
pub fn kind_of(path: &Path) -> Option<Kind> {
    if !is_dicom(path) {
        return None;
    }
    let Opened::Object(object, _) = open(path, tags::STUDY_DATE) else { return None };
    match super::elements::text(&object, tags::SOP_CLASS_UID).as_str() {
        uids::SPATIAL_REGISTRATION_STORAGE => Some(Kind::Rigid),
        uids::DEFORMABLE_SPATIAL_REGISTRATION_STORAGE => Some(Kind::Deformable),
        _ => None,
    }
}

/// SOP Class UID and SOP Instance UID of a registration; `None` where a file holds none.
pub fn reference_of(path: &Path) -> Option<Written> {
    kind_of(path)?;
    let Opened::Object(object, _) = open(path, tags::STUDY_DATE) else { return None };
    Some([tags::SOP_CLASS_UID, tags::SOP_INSTANCE_UID].map(|tag| super::elements::text(&object, tag)))
}

/// The frames of reference that a registration joins to its own; none of objects of other kinds.
pub(super) fn registered_frames(set: &InMemDicomObject) -> Vec<String> {
    let of = |sequence, frame| {
        super::elements::items(set, sequence).iter().map(move |item| super::elements::text(item, frame))
    };
    let rigid = of(tags::REGISTRATION_SEQUENCE, tags::FRAME_OF_REFERENCE_UID);
    rigid.chain(of(tags::DEFORMABLE_REGISTRATION_SEQUENCE, tags::SOURCE_FRAME_OF_REFERENCE_UID)).collect()
}

/// What a new registration says of itself.
#[derive(Debug, Clone, Copy)]
pub struct DerivedRegistration<'a> {
    /// What it is among the objects of one [`Origin`], for its UIDs: `couch shift`.
    pub role: &'a str,
    /// Series Description, and Content Description; at most 64 characters.
    pub description: &'a str,
    /// Series Number.
    pub number: i32,
    /// The images of the frame where it starts: for points, the frame whose points it takes.
    pub from: &'a Series,
    /// The images of the frame where it ends.
    pub to: &'a Series,
}

/// SOP Class UID and SOP Instance UID of an object, for those that refer to it.
pub type Written = [String; 2];

/// The elements that both kinds have (PS3.3 C.20.1, C.12.2, Table 10-12). `registered` are the images of the registered frame.
fn begun(
    path: &Path,
    class: &str,
    about: &DerivedRegistration<'_>,
    registered: &Series,
    origin: &Origin,
) -> Result<(InMemDicomObject, Written)> {
    let uid = origin.uid(&[about.role, "series"]);
    let instance = origin.uid(&[about.role, "object"]);
    let new = NewSeries {
        uid: &uid,
        class,
        modality: "REG",
        number: about.number,
        description: about.description,
        frame_of_reference: &registered.frame_of_reference,
    };
    let mut object = frame(origin, &new, &instance);
    let (date, time) = origin.dated(path)?;
    put(
        &mut object,
        [
            text(tags::CONTENT_DATE, VR::DA, date),
            text(tags::CONTENT_TIME, VR::TM, time),
            integer(tags::INSTANCE_NUMBER, 1),
            text(tags::CONTENT_LABEL, VR::CS, "REGISTRATION"),
            text(tags::CONTENT_DESCRIPTION, VR::LO, about.description),
            empty(tags::CONTENT_CREATOR_NAME, VR::PN),
            // Enhanced General Equipment wants a serial number; a program has none.
            text(tags::DEVICE_SERIAL_NUMBER, VR::LO, "none"),
        ],
    );
    put(&mut object, instances(&origin.study_uid(), &[about.from, about.to]));
    Ok((object, [class.to_owned(), instance]))
}
