//! What every object that is written holds: whose it is, what made it, and when.

use super::super::series::{Patient, Series, Study};
use super::element::{empty, integer, item, reference, sequence, text};
use super::uid::uid_of;
use crate::error::{Error, Result};
use crate::io::atomic::write_file;
use dicom_core::{Tag, VR};
use dicom_dictionary_std::{tags, uids};
use dicom_object::mem::InMemElement;
use dicom_object::meta::FileMetaTableBuilder;
use dicom_object::{FileDicomObject, InMemDicomObject};
use std::path::Path;

/// The program, as Manufacturer and Model Name.
const PROGRAM: &str = "aventail";
/// Its version.
const VERSION: &str = env!("CARGO_PKG_VERSION");

/// Said of everything that is written.
pub const CAUTION: &str = "Made by aventail. For research, not for treatment.";

/// When an object's content was made.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct When {
    /// `YYYYMMDD`.
    pub date: String,
    /// `HHMMSS`.
    pub time: String,
}

/// Where new objects come from: the patient and the study that they belong to, and what decides about their UIDs.
///
/// Objects made of the same origin have the same UIDs, so that a set written twice is one set to whoever imports it. They
/// also have the same dates, because no clock is asked.
#[derive(Debug, Clone)]
pub struct Origin {
    /// The patient, repeated as the source has it; [`Patient::default`] leaves the identity out.
    pub patient: Patient,
    /// The study that the objects join.
    pub study: Study,
    /// When they were made.
    pub when: When,
    /// UIDs or checksums of the inputs, and the settings: all that decides about the content.
    pub parts: Vec<String>,
}

impl Origin {
    /// Objects that join the study of `series`; without `when` they are dated as the series is, and nothing is invented:
    /// where the series has no date, neither have they.
    pub fn beside(series: &Series, when: Option<When>, parts: Vec<String>) -> Self {
        let first = |texts: [&String; 2]| texts.into_iter().find(|t| !t.is_empty()).cloned().unwrap_or_default();
        let when = when.unwrap_or_else(|| When {
            date: first([&series.date, &series.study.date]),
            // The series' own time is not known: the study's holds where they are of one day.
            time: if series.date.is_empty() || series.date == series.study.date {
                series.study.time.clone()
            } else {
                String::new()
            },
        });
        Self { patient: series.patient.clone(), study: series.study.clone(), when, parts }
    }

    /// The UID of what plays the part `role` (a series, an object, a frame of reference), for example `"ct", "series"`.
    ///
    /// It depends on the program's version too: another version may give another content. The patient counts as well: a study
    /// without a UID tells nobody apart.
    pub fn uid(&self, role: &[&str]) -> String {
        let Patient { name, id, birth_date, sex } = &self.patient;
        let own = [PROGRAM, VERSION, &self.study.uid, name, id, birth_date, sex];
        let parts: Vec<&str> =
            own.into_iter().chain(self.parts.iter().map(String::as_str)).chain(role.iter().copied()).collect();
        uid_of(&parts)
    }

    /// Study Instance UID: the source's, or one of its own where the source has none.
    pub fn study_uid(&self) -> String {
        if self.study.uid.is_empty() { self.uid(&["study"]) } else { self.study.uid.clone() }
    }

    /// Date and time, for objects that must have them.
    pub(in crate::io::dicom) fn dated(&self, path: &Path) -> Result<(&str, &str)> {
        if self.when.date.is_empty() {
            let problem = "the object needs a content date, and neither the series nor its study has a date";
            return Err(Error::write(path, problem, "give a date"));
        }
        let time = if self.when.time.is_empty() { "000000" } else { &self.when.time };
        Ok((&self.when.date, time))
    }
}

/// A series that is new, with one kind of object in it.
#[derive(Debug, Clone)]
pub(in crate::io::dicom) struct NewSeries<'a> {
    /// Series Instance UID.
    pub uid: &'a str,
    /// SOP Class UID of its objects.
    pub class: &'a str,
    /// Modality.
    pub modality: &'a str,
    /// Series Number.
    pub number: i32,
    /// Series Description.
    pub description: &'a str,
    /// Frame of Reference UID; empty where the objects have none.
    pub frame_of_reference: &'a str,
}

/// The elements that all objects have: Patient, General Study, General (or RT) Series, Frame of Reference, General Equipment
/// and SOP Common (PS3.3 C.7.1.1, C.7.2.1, C.7.3.1, C.8.8.1, C.7.4.1, C.7.5.1, C.12.1).
pub(in crate::io::dicom) fn frame(origin: &Origin, series: &NewSeries<'_>, instance: &str) -> InMemDicomObject {
    let (patient, study, when) = (&origin.patient, &origin.study, &origin.when);
    let mut object = item([
        text(tags::SPECIFIC_CHARACTER_SET, VR::CS, "ISO_IR 192"),
        text(tags::SOP_CLASS_UID, VR::UI, series.class),
        text(tags::SOP_INSTANCE_UID, VR::UI, instance),
        text(tags::PATIENT_NAME, VR::PN, patient.name.as_str()),
        text(tags::PATIENT_ID, VR::LO, patient.id.as_str()),
        text(tags::PATIENT_BIRTH_DATE, VR::DA, patient.birth_date.as_str()),
        text(tags::PATIENT_SEX, VR::CS, patient.sex.as_str()),
        text(tags::STUDY_INSTANCE_UID, VR::UI, origin.study_uid()),
        text(tags::STUDY_DATE, VR::DA, study.date.as_str()),
        text(tags::STUDY_TIME, VR::TM, study.time.as_str()),
        text(tags::STUDY_ID, VR::SH, study.id.as_str()),
        text(tags::ACCESSION_NUMBER, VR::SH, study.accession.as_str()),
        text(tags::REFERRING_PHYSICIAN_NAME, VR::PN, study.physician.as_str()),
        text(tags::MODALITY, VR::CS, series.modality),
        text(tags::SERIES_INSTANCE_UID, VR::UI, series.uid),
        integer(tags::SERIES_NUMBER, series.number.into()),
        text(tags::SERIES_DESCRIPTION, VR::LO, series.description),
        text(tags::MANUFACTURER, VR::LO, PROGRAM),
        text(tags::MANUFACTURER_MODEL_NAME, VR::LO, PROGRAM),
        text(tags::SOFTWARE_VERSIONS, VR::LO, VERSION),
    ]);
    optional(&mut object, tags::STUDY_DESCRIPTION, VR::LO, &study.description);
    let dates = [
        (tags::INSTANCE_CREATION_DATE, tags::INSTANCE_CREATION_TIME),
        (tags::SERIES_DATE, tags::SERIES_TIME),
        (tags::CONTENT_DATE, tags::CONTENT_TIME),
    ];
    // A structure set has dates of its own (C.8.8.5).
    let content = if series.modality == "RTSTRUCT" { 2 } else { 3 };
    for (date, time) in dates.into_iter().take(content) {
        optional(&mut object, date, VR::DA, &when.date);
        optional(&mut object, time, VR::TM, &when.time);
    }
    if !series.modality.starts_with("RT") && series.modality != "SEG" {
        // Type 2C of General Series: nobody says whether the body part is one of a pair. Segments say it themselves.
        object.put(empty(tags::LATERALITY, VR::CS));
    }
    if !series.frame_of_reference.is_empty() {
        object.put(text(tags::FRAME_OF_REFERENCE_UID, VR::UI, series.frame_of_reference));
        object.put(empty(tags::POSITION_REFERENCE_INDICATOR, VR::LO));
    }
    object
}

/// Puts an element that is left out where it would be empty.
fn optional(object: &mut InMemDicomObject, tag: Tag, vr: VR, value: &str) {
    if !value.is_empty() {
        object.put(text(tag, vr, value));
    }
}

/// Puts several elements.
pub(in crate::io::dicom) fn put(object: &mut InMemDicomObject, elements: impl IntoIterator<Item = InMemElement>) {
    for element in elements {
        object.put(element);
    }
}

/// What an object refers to, by series, in the study `study` and in others: the Common Instance Reference module
/// (PS3.3 C.12.2).
pub(in crate::io::dicom) fn instances(study: &str, series: &[&Series]) -> Vec<InMemElement> {
    let of = |s: &Series| {
        item([
            text(tags::SERIES_INSTANCE_UID, VR::UI, s.uid.as_str()),
            sequence(tags::REFERENCED_INSTANCE_SEQUENCE, references(s)),
        ])
    };
    let mut unique: Vec<&Series> = Vec::new();
    for s in series.iter().filter(|s| !s.slices.is_empty()) {
        if !unique.iter().any(|u| u.uid == s.uid) {
            unique.push(s);
        }
    }
    let (own, others): (Vec<&Series>, Vec<&Series>) = unique.into_iter().partition(|s| s.study.uid == study);
    let mut elements = Vec::new();
    if !own.is_empty() {
        elements.push(sequence(tags::REFERENCED_SERIES_SEQUENCE, own.into_iter().map(of).collect()));
    }
    let mut studies: Vec<&str> = others.iter().map(|s| s.study.uid.as_str()).collect();
    studies.sort_unstable();
    studies.dedup();
    let items = studies.iter().map(|uid| {
        let series = others.iter().filter(|s| s.study.uid == *uid).copied().map(of).collect();
        item([text(tags::STUDY_INSTANCE_UID, VR::UI, *uid), sequence(tags::REFERENCED_SERIES_SEQUENCE, series)])
    });
    if !studies.is_empty() {
        elements.push(sequence(tags::STUDIES_CONTAINING_OTHER_REFERENCED_INSTANCES_SEQUENCE, items.collect()));
    }
    elements
}

/// The objects of a series, each once.
pub(in crate::io::dicom) fn references(series: &Series) -> Vec<InMemDicomObject> {
    let mut uids: Vec<&str> = series.slices.iter().map(|s| s.uid.as_str()).collect();
    uids.dedup();
    uids.into_iter().map(|uid| reference(&series.sop_class, uid)).collect()
}

/// Writes an object, Explicit VR Little Endian, whole or not at all.
///
/// # Errors
/// [`Error::Write`] when it cannot be written.
pub(in crate::io::dicom) fn save(path: &Path, object: InMemDicomObject) -> Result<()> {
    let meta = FileMetaTableBuilder::new()
        .transfer_syntax(uids::EXPLICIT_VR_LITTLE_ENDIAN)
        .implementation_class_uid(uid_of(&[PROGRAM, "implementation"]))
        .implementation_version_name(format!("{PROGRAM} {VERSION}").to_uppercase());
    let file: FileDicomObject<_> =
        object.with_meta(meta).map_err(|e| Error::Internal(format!("DICOM file meta information: {e}")))?;
    write_file(path, |out| file.write_all(out).map_err(std::io::Error::other))
}

#[cfg(test)]
mod tests {
    use super::super::super::fixture::origin;
    use super::*;

    #[test]
    fn uids_tell_study_and_patient_apart_whatever_else_is_the_same() {
        type Change = (&'static str, fn(&mut Origin));
        let changes: [Change; 7] = [
            ("study", |o| o.study.uid = "1.2.3.5".into()),
            ("no study", |o| o.study.uid.clear()),
            ("number", |o| o.patient.id = "HN 0002".into()),
            ("name", |o| o.patient.name = "Meier^Jürgen".into()),
            ("birth", |o| o.patient.birth_date.clear()),
            ("sex", |o| o.patient.sex.clear()),
            ("parts", |o| o.parts.swap(0, 1)),
        ];
        let mut seen = vec![origin().uid(&["ct", "series"]), origin().uid(&["ct", "slice"])];
        for (what, change) in changes {
            let mut other = origin();
            change(&mut other);
            let uid = other.uid(&["ct", "series"]);
            assert!(!seen.contains(&uid), "{what}");
            seen.push(uid);
        }
        // Two patients whose studies have no UID.
        let [mut a, mut b] = [origin(), origin()];
        a.study.uid.clear();
        b.study.uid.clear();
        b.patient.id = "HN 0002".into();
        assert!(a.study_uid() != b.study_uid() && a.study_uid() == a.clone().study_uid());
    }
}
