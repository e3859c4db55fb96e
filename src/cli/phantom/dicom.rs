//! The phantom as DICOM, as planning systems export it: two CT series of two frames of reference, structure set and dose, and
//! the truth as registrations.

use crate::error::{Error, Result};
use crate::field::PushField;
use crate::geometry::Rigid;
use crate::io::checksum::sha256;
use crate::io::dicom::registration::{DerivedRegistration, write_push, write_rigid};
use crate::io::dicom::write::{
    DerivedCt, DerivedDose, DerivedStructures, Origin, When, write_ct, write_dose, write_structures,
};
use crate::io::dicom::{Patient, Roi, Series, Study};
use crate::phantom::Plan;
use crate::volume::Volume;
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

/// Folder in the phantom's own.
const FOLDER: &str = "dicom";
/// Noon of days that no patient was scanned: the phantom is the same on every day.
const NOON: &str = "120000";
const PLANNING_DAY: &str = "20260101";
const DERIVATION: &str = "Synthetic: computed by aventail phantom from formulas, no patient was scanned.";

/// Names of what is written, as far as they do not depend on the phantom.
pub(super) fn names(plan: bool) -> Vec<String> {
    let own = if plan { vec!["planning/RS.dcm", "planning/RD.dcm"] } else { Vec::new() };
    own.into_iter().chain(["registration/fraction.dcm"]).map(|name| format!("{FOLDER}/{name}")).collect()
}

fn origin(parts: Vec<String>, day: &str, description: &str) -> Origin {
    let patient = Patient {
        name: "Phantom^Aventail".into(),
        id: "AVENTAIL-PHANTOM".into(),
        birth_date: String::new(),
        sex: "O".into(),
    };
    let when = When { date: day.into(), time: NOON.into() };
    let mut origin = Origin { patient, study: Study::default(), when, parts };
    origin.study = Study {
        uid: origin.study_uid(),
        date: day.into(),
        time: NOON.into(),
        id: "1".into(),
        description: description.into(),
        ..Study::default()
    };
    origin
}

fn sum(image: &Volume<f32>) -> String {
    sha256(&image.data().iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<u8>>())
}

fn folder(out: &Path, name: &str) -> Result<PathBuf> {
    let folder = out.join(FOLDER).join(name);
    let refuse = |e: std::io::Error| Error::write(&folder, e.to_string(), "choose a folder that you may write to");
    std::fs::create_dir_all(&folder).map_err(refuse)?;
    Ok(folder)
}

fn ct(image: &Volume<f32>, name: &str, origin: &Origin, out: &Path) -> Result<Series> {
    let about = DerivedCt {
        role: "ct",
        description: &format!("aventail phantom, {name}"),
        derivation: DERIVATION,
        number: 1,
        frame_of_reference: &origin.uid(&["frame of reference"]),
        patient_position: "HFS",
        sources: &[],
    };
    write_ct(&folder(out, name)?, image, &about, origin)
}

/// Writes the planning CT, and contours and dose where there is a plan; returns the CT series.
///
/// # Errors
/// [`Error::Write`] when a file cannot be written.
pub(super) fn write_planning(image: &Volume<f32>, plan: Option<&Plan>, out: &Path) -> Result<Series> {
    let origin = origin(vec![sum(image)], PLANNING_DAY, "aventail phantom, planning");
    let series = ct(image, "planning", &origin, out)?;
    let Some(plan) = plan else { return Ok(series) };
    let kind = |name: &str| match name {
        "body" => "EXTERNAL",
        "ctv" => "CTV",
        "ptv" => "PTV",
        _ => "ORGAN",
    };
    let numbered = (1..).zip(&plan.contours.structures);
    let rois: Vec<Roi> = numbered
        .map(|(number, s)| Roi {
            number,
            name: s.name.clone(),
            interpreted_type: kind(&s.name).into(),
            colour: s.colour,
            ..Roi::default()
        })
        .collect();
    let folder = folder(out, "planning")?;
    let about = DerivedStructures {
        role: "structures",
        description: "aventail phantom, contours",
        derivation: DERIVATION,
        number: 2,
        drawn_on: &series,
    };
    write_structures(&folder.join("RS.dcm"), &plan.contours, &rois, &about, &origin)?;
    let about = DerivedDose {
        role: "dose",
        description: "aventail phantom, planned dose",
        comment: "Synthetic: from formulas; its plan does not exist",
        number: 3,
        frame_of_reference: &series.frame_of_reference,
        kind: "PHYSICAL",
        summation: "PLAN",
        plans: &BTreeSet::from([origin.uid(&["plan"])]),
        carried_by: None,
    };
    write_dose(&folder.join("RD.dcm"), &plan.dose, &about, &origin)?;
    Ok(series)
}

/// A fraction, and what is true of it.
pub(super) struct Fraction<'a> {
    pub(super) name: &'a str,
    /// Days after the planning CT.
    pub(super) day: u32,
    pub(super) image: &'a Volume<f32>,
    pub(super) truth: &'a PushField,
    /// Name and motion of one bone.
    pub(super) bone: Option<(&'a str, &'a Rigid)>,
}

/// Writes a fraction of the patient whose planning series is given: its CT into the folder `name`, and as
/// `registration/NAME.dcm` the true push field and as `registration/NAME_BONE.dcm` the true motion of one bone.
///
/// # Errors
/// [`Error::Write`] when a file cannot be written.
pub(super) fn write_fraction(fraction: &Fraction<'_>, planning: &Series, out: &Path) -> Result<()> {
    let Fraction { name, day, image, truth, bone } = *fraction;
    let day = format!("202601{:02}", 1 + day);
    let origin = origin(vec![planning.uid.clone(), sum(image)], &day, &format!("aventail phantom, {name}"));
    let series = ct(image, name, &origin, out)?;
    let folder = folder(out, "registration")?;
    let about = DerivedRegistration {
        role: "truth",
        description: &format!("aventail phantom, truth, planning to {name}"),
        number: 2,
        from: planning,
        to: &series,
    };
    write_push(&folder.join(format!("{name}.dcm")), truth, &about, &origin)?;
    let Some((bone, rigid)) = bone else { return Ok(()) };
    let description = format!("aventail phantom, truth, {bone}");
    let about = DerivedRegistration { role: "bone", description: &description, number: 3, ..about };
    write_rigid(&folder.join(format!("{name}_{bone}.dcm")), rigid, &about, &origin)?;
    Ok(())
}
