//! Results as DICOM beside a scan: `--dicom-like SERIES`. The series tells patient, study and frame of reference.

use crate::error::{Error, Result};
use crate::geometry::Grid;
use crate::io::checksum::sha256_file;
use crate::io::dicom::registration::{DerivedRegistration, reference_of, write_deformable};
use crate::io::dicom::write::{
    CAUTION, DerivedCt, DerivedDose, DerivedStructures, Origin, no_plan, write_ct, write_dose, write_structures,
};
use crate::io::dicom::{Dose, Patient, Roi, Series, describe_series, dose_at, is_dicom_path};
use crate::volume::Volume;
use crate::volume::contour::Contours;
use crate::warning::Warning;
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

/// Whether a path is that of a DICOM file to be written.
pub(super) fn is_dcm(path: &Path) -> bool {
    path.extension().is_some_and(|e| e.eq_ignore_ascii_case("dcm"))
}

/// Refuses an output in DICOM without a scan that it refers to, and the other way round, before anything is read.
///
/// # Errors
/// [`Error::Usage`].
pub(super) fn check(out: &Path, like: Option<&Path>, folder: bool) -> Result<()> {
    let file = out.display();
    match like {
        None if is_dcm(out) => Err(Error::usage(
            format!("{file}: DICOM needs a patient, a study and a frame of reference, and nothing tells them"),
            "add --dicom-like SERIES, the folder of the DICOM series of the scan that the result lies in",
        )),
        None => Ok(()),
        Some(like) if !is_dicom_path(like) => Err(Error::usage(
            format!("--dicom-like {}: it is no DICOM series", like.display()),
            "give the folder of the DICOM series of the scan that the result lies in",
        )),
        Some(_) if folder && (is_dcm(out) || out.extension().is_some() && !out.is_dir()) => Err(Error::usage(
            format!("{file}: an image is written as a DICOM series, a file for each slice"),
            "give a folder as --out, or leave --dicom-like out",
        )),
        Some(_) if folder && out.read_dir().is_ok_and(|mut files| files.next().is_some()) => Err(Error::usage(
            format!("{file}: it holds files already, and a series must be alone in its folder"),
            "give an empty or a new folder as --out",
        )),
        Some(_) if !folder && !is_dcm(out) => Err(Error::usage(
            format!("{file}: with --dicom-like the result is written as DICOM"),
            "name it *.dcm, or leave --dicom-like out",
        )),
        Some(_) => Ok(()),
    }
}

/// The scan that results refer to.
pub(super) struct Like {
    path: PathBuf,
    series: Series,
    /// Its grid.
    pub(super) grid: Grid,
}

/// What a result was made of.
pub(super) struct Made<'a> {
    /// Files that it depends on.
    pub files: Vec<&'a Path>,
    /// Registrations among them, or other fields.
    pub fields: Vec<&'a Path>,
    /// Settings that it depends on.
    pub settings: String,
}

impl Like {
    /// # Errors
    /// [`Error::Input`] when it names no frame of reference; else as for reading a series.
    pub(super) fn read(path: &Path) -> Result<Self> {
        let (series, grid) = describe_series(path)?;
        if series.frame_of_reference.is_empty() {
            let problem = "its images name no frame of reference, so that nothing can be said to lie in it";
            return Err(Error::input(path.display().to_string(), problem, "export the series again with it"));
        }
        Ok(Self { path: path.to_owned(), series, grid })
    }

    /// Refuses a thing of another patient.
    ///
    /// # Errors
    /// [`Error::Input`] with both.
    pub(super) fn same_patient(&self, what: &Path, patient: &Patient) -> Result<()> {
        let [a, b] = [&patient.id, &self.series.patient.id];
        if a == b {
            return Ok(());
        }
        let problem = format!("it is of another patient ({a:?}) than {} ({b:?})", self.path.display());
        Err(Error::input(what.display().to_string(), problem, "give a series of the same patient as --dicom-like"))
    }

    /// UIDs follow from all that the result depends on.
    fn origin(&self, made: &Made<'_>) -> Result<Origin> {
        let mut parts = vec![self.series.uid.clone(), made.settings.clone()];
        for path in made.files.iter().chain(&made.fields) {
            parts.push(sha256_file(path)?);
        }
        Ok(Origin::beside(&self.series, None, parts))
    }

    /// Writes contours in the frame of the scan on its slices.
    ///
    /// # Errors
    /// [`Error::Write`].
    pub(super) fn structures(&self, out: &Path, contours: &Contours, rois: &[Roi], made: &Made<'_>) -> Result<()> {
        let about = DerivedStructures {
            role: "structures",
            description: "Contours carried by registration (aventail)",
            derivation: &format!("Contours carried to this scan by registration. {CAUTION}"),
            number: 902,
            drawn_on: &self.series,
        };
        write_structures(out, contours, rois, &about, &self.origin(made)?)
    }

    /// Writes an image in HU as a series into a folder. `source` is what it was made of, where that is DICOM.
    ///
    /// # Errors
    /// [`Error::Write`].
    pub(super) fn image(&self, out: &Path, ct: &Volume<f32>, source: Option<&Series>, made: &Made<'_>) -> Result<()> {
        let refuse = |e: std::io::Error| Error::write(out, e.to_string(), "choose a folder that you may write to");
        std::fs::create_dir_all(out).map_err(refuse)?;
        let sources: Vec<&Series> = source.into_iter().collect();
        let about = DerivedCt {
            role: "image",
            description: "CT carried by registration (aventail, research only)",
            derivation: &format!("CT deformed into the frame of this scan by registration. {CAUTION}"),
            number: 901,
            frame_of_reference: &self.series.frame_of_reference,
            patient_position: &self.series.patient_position,
            sources: &sources,
        };
        write_ct(out, ct, &about, &self.origin(made)?).map(|_| ())
    }

    /// Writes a dose that was made of the doses of these files; returns what is to be known.
    ///
    /// # Errors
    /// [`Error::Write`]; [`Error::Input`] when a source is of another patient, or physical and effective doses are mixed.
    pub(super) fn dose(
        &self,
        out: &Path,
        dose: &Volume<f32>,
        sources: &[&Path],
        made: &Made<'_>,
    ) -> Result<Vec<Warning>> {
        let mut read: Vec<Dose> = Vec::new();
        let mut warnings = Vec::new();
        for path in sources {
            let what = path.display().to_string();
            let one = if is_dicom_path(path) { Some(dose_at(path)?.value) } else { None };
            warnings.extend(no_plan(&what, one.as_ref().map_or(&BTreeSet::new(), |one| &one.plans)));
            let Some(one) = one else { continue };
            self.same_patient(path, &one.series.patient)?;
            if let Some(other) = read.iter().find(|other| other.kind != one.kind) {
                let problem = format!("its dose is {}, that of another is {}", one.kind, other.kind);
                return Err(Error::input(what, problem, "add up doses of one type"));
            }
            read.push(one);
        }
        let plans: BTreeSet<String> = read.iter().flat_map(|one| one.plans.iter().cloned()).collect();
        let summations: BTreeSet<&str> = read.iter().map(|one| one.summation.as_str()).collect();
        let summation = match (plans.len(), summations.len(), summations.first()) {
            (2.., ..) => "MULTI_PLAN",
            (_, 1, Some(own)) if !own.is_empty() => own,
            _ => "PLAN",
        };
        let registrations: Vec<[String; 2]> = made.fields.iter().filter_map(|path| reference_of(path)).collect();
        let registrations: Vec<[&str; 2]> = registrations.iter().map(|[a, b]| [a.as_str(), b.as_str()]).collect();
        let about = DerivedDose {
            role: "dose",
            description: "Dose carried by registration (aventail, research only)",
            comment: "Carried by registration, not recalculated; research only",
            number: 903,
            frame_of_reference: &self.series.frame_of_reference,
            kind: read.first().map_or("PHYSICAL", |one| one.kind.as_str()),
            summation,
            plans: &plans,
            carried_by: Some(&registrations),
        };
        write_dose(out, dose, &about, &self.origin(made)?)?;
        Ok(warnings)
    }
}

impl Like {
    /// Writes a field that lies in this scan and leads to another, as a Deformable Spatial Registration.
    ///
    /// # Errors
    /// [`Error::Write`]; [`Error::Input`] when the other scan is of another patient.
    pub(super) fn field(&self, out: &Path, field: &Volume<[f32; 3]>, to: &Self, made: &Made<'_>) -> Result<()> {
        self.same_patient(&to.path, &to.series.patient)?;
        let about = DerivedRegistration {
            role: "field",
            description: "Displacement field (aventail, research only)",
            number: 907,
            from: &self.series,
            to: &to.series,
        };
        let mut origin = self.origin(made)?;
        origin.parts.push(to.series.uid.clone());
        write_deformable(out, field, &about, &origin).map(|_| ())
    }
}

/// ROIs of contours that come from no structure set.
pub(super) fn rois_of(contours: &Contours) -> Vec<Roi> {
    let roi = |(n, s): (usize, &crate::volume::contour::Structure)| Roi {
        number: n as i64 + 1,
        name: s.name.clone(),
        interpreted_type: String::new(),
        colour: s.colour,
        generation_algorithm: String::new(),
        empty: s.polygons.is_empty(),
    };
    contours.structures.iter().enumerate().map(roi).collect()
}
