//! What a registration gives back to a planning system as DICOM.

use super::OutputFile;
use super::identity::Decided;
use crate::config::{Config, InputRole};
use crate::dose::{dose_carried, interpolate, judge};
use crate::error::{Error, Result};
use crate::field::{Chain, WORTH_OF_LABELS, outside_field, resample_contours};
use crate::findings;
use crate::geometry::{Grid, Rigid};
use crate::io::dicom::registration::{DerivedRegistration, Written, write_pull, write_push, write_rigid};
use crate::io::dicom::write::{
    CAUTION, DerivedCt, DerivedDose, DerivedStructures, Origin, ct_series, no_plan, write_ct, write_dose,
    write_structures,
};
use crate::io::dicom::{
    Dose, Patient, Role, Series, StructureSet, check_frames, describe_series, is_dicom_path, read_dose,
    read_structure_set, require_ct, same_frame,
};
use crate::pipeline::Outcome;
use crate::provenance::{InputFile, Provenance};
use crate::volume::contour::Contours;
use crate::warning::Warning;
use nalgebra::{Translation3, UnitQuaternion};
use std::path::{Path, PathBuf};

/// Folder in that of the run.
const FOLDER: &str = "dicom";
/// Names in it, as far as they do not depend on the images.
const NAMES: [&str; 6] = [
    "RS.dcm",
    "RD.dcm",
    "REG_couch.dcm",
    "REG_couch_rotation.dcm",
    "REG_fraction_to_planning.dcm",
    "REG_planning_to_fraction.dcm",
];

/// What is to go back as DICOM beside the planning CT and the registrations.
#[derive(Debug, Clone, Default)]
pub struct ClinicFiles {
    /// Structure set of the planning CT.
    pub structures: Option<PathBuf>,
    /// Dose of the plan.
    pub dose: Option<PathBuf>,
    /// Leaves the patient's identity out of what is written.
    pub anonymous: bool,
    /// Planning and fraction lie in one frame of reference, where they claim one: what is written of the fraction stays in it.
    pub same_frame: bool,
}

/// What the objects of a run in DICOM are made of, read before anything long begins.
#[derive(Debug, Clone)]
pub struct Clinic {
    planning: Series,
    fractions: Vec<(Series, Grid)>,
    structures: Option<StructureSet>,
    dose: Option<Dose>,
    anonymous: bool,
    same_frame: bool,
    inputs: Vec<InputFile>,
    warnings: Vec<Warning>,
}

/// A word about a planning CT and a fraction that claim one frame of reference.
pub fn one_frame(provenance: &Provenance) -> Option<Warning> {
    let frame = |role: InputRole| {
        let about = provenance.inputs.iter().find(|input| input.role == role).and_then(|input| input.about.as_ref());
        about.map(|about| about.frame_of_reference.as_str())
    };
    claims_one(frame(InputRole::Planning)?, frame(InputRole::Fraction)?)
}

fn claims_one(planning: &str, fraction: &str) -> Option<Warning> {
    same_frame(planning, fraction).then(|| {
        let message = format!(
            "planning and fraction claim one frame of reference ({planning}), as if the patient had not been set up anew; what \
             is written of the fraction as DICOM gets a frame of its own and belongs to the CT that is written with it, not to \
             the fraction's own images; --same-frame keeps it in theirs"
        );
        Warning::new(findings::DICOM_ONE_FRAME, message)
    })
}

impl ClinicFiles {
    /// The files, none of which may be overwritten.
    pub fn paths(&self) -> impl Iterator<Item = &Path> {
        [&self.structures, &self.dose].into_iter().flatten().map(PathBuf::as_path)
    }
}

impl Clinic {
    /// Names of what is written into the folder of a run, as far as they do not depend on the images: what the folder must
    /// have room for.
    pub fn planned() -> Vec<String> {
        NAMES.iter().map(|name| format!("{FOLDER}/{name}")).collect()
    }

    /// Refuses settings that cut the scans: what is given back needs all of them.
    ///
    /// # Errors
    /// [`Error::Usage`] when the settings choose a region.
    pub fn check(config: &Config) -> Result<()> {
        if config.region.is_some() {
            return Err(Error::usage(
                "DICOM is written only for the whole scan, but the settings choose a region",
                "ask for no DICOM, or remove [region] from the settings",
            ));
        }
        Ok(())
    }

    /// Reads what is needed of the planning CT and the series of each fraction, a CT or an MR.
    ///
    /// # Errors
    /// [`Error::Usage`] when planning or a fraction is no DICOM; [`Error::Input`] when one names no frame of reference, they
    /// are not of one patient, planning is an MR (what is written of it is a CT series), or structures or dose do not lie in
    /// planning's frame of reference; [`Error::Read`] when a file cannot be read.
    pub fn read(files: &ClinicFiles, planning: &Path, fractions: &[&Path]) -> Result<Self> {
        let (own, _) = series(planning)?;
        require_ct(planning)?;
        let fractions = fractions.iter().map(|path| {
            let found = series(path)?;
            same_patient(planning, &own, path, &found.0)?;
            Ok(found)
        });
        let fractions = fractions.collect::<Result<_>>()?;
        let (mut inputs, mut warnings) = (Vec::new(), Vec::new());
        let mut structures = None;
        if let Some(path) = &files.structures {
            check_frames(Role::Structures.at(path), Role::Image.at(planning))?;
            let mut set = read_structure_set(path)?;
            warnings.append(&mut set.warnings);
            warnings.extend(set.missing_images(&own, planning));
            warnings.extend(set.contours.tidy());
            inputs.push(InputFile::read(InputRole::Structures, path)?);
            structures = Some(set);
        }
        let mut dose = None;
        if let Some(path) = &files.dose {
            check_frames(Role::Dose.at(path), Role::Image.at(planning))?;
            let mut read = read_dose(path)?;
            warnings.append(&mut read.warnings);
            let what = path.display().to_string();
            warnings.extend(judge(&what, &mut read.value.volume)?);
            warnings.extend(no_plan(&what, &read.value.plans));
            warnings.extend(read.value.is_carried().then(|| dose_carried(&what)));
            inputs.push(InputFile::read(InputRole::Dose, path)?);
            dose = Some(read.value);
        }
        let ClinicFiles { anonymous, same_frame, .. } = *files;
        Ok(Self { planning: own, fractions, structures, dose, anonymous, same_frame, inputs, warnings })
    }

    /// What is to be known before anything long begins, of all fractions.
    pub fn warnings(&self) -> Vec<Warning> {
        let mut all = self.warnings.clone();
        all.extend(self.fractions.iter().find_map(|(fraction, _)| self.in_one_frame(fraction)));
        all
    }

    fn in_one_frame(&self, fraction: &Series) -> Option<Warning> {
        let own = || claims_one(&self.planning.frame_of_reference, &fraction.frame_of_reference);
        if self.same_frame { None } else { own() }
    }

    /// Structures and dose as inputs of the run, for its report.
    pub fn inputs(&self) -> &[InputFile] {
        &self.inputs
    }

    /// The structures of the planning CT.
    pub fn contours(&self) -> Option<&Contours> {
        self.structures.as_ref().map(|set| &set.contours)
    }

    /// Writes the objects of fraction `n`, as they were named to [`Clinic::read`], into the folder `dicom` of the run's folder
    /// `out`; returns the files, and what is to be known.
    ///
    /// # Errors
    /// [`Error::Write`] when a file cannot be written.
    pub fn write(
        &self,
        n: usize,
        decided: &Decided<'_>,
        outcome: &Outcome,
        out: &Path,
    ) -> Result<(Vec<OutputFile>, Vec<Warning>)> {
        let (fraction, grid) = self.fractions.get(n).ok_or_else(|| Error::Internal(format!("no series {n}")))?;
        if !grid.matches(outcome.pull.displacement.grid(), 1e-3) {
            return Err(Error::Internal("the fraction's series lies on another grid than its result".into()));
        }
        let folder = out.join(FOLDER);
        let refuse = |e: std::io::Error| Error::write(&folder, e.to_string(), "choose a folder that you may write to");
        std::fs::create_dir_all(folder.join("ct")).map_err(refuse)?;
        let origin = self.origin(fraction, decided)?;
        let mut warnings = self.warnings.clone();
        let odd = self.in_one_frame(fraction);
        // The objects refer to images in a frame of their own: those that are written here.
        let own = odd.is_some().then(|| {
            let frame = origin.uid(&["fraction", "frame of reference"]);
            let derivation = derivation();
            ct_series(grid, &DerivedCt { frame_of_reference: &frame, ..about_ct(fraction, &derivation, &[]) }, &origin)
        });
        let own = own.map(|own| Series { patient_position: fraction.patient_position.clone(), ..own });
        warnings.extend(odd);
        let fraction = own.as_ref().unwrap_or(fraction);
        let set = Set { clinic: self, fraction, origin, folder, files: Vec::new() };
        set.write(outcome, warnings)
    }

    fn origin(&self, fraction: &Series, decided: &Decided<'_>) -> Result<Origin> {
        let mut parts = vec![self.planning.uid.clone(), fraction.uid.clone()];
        let given = [("anonymous", self.anonymous), ("same frame", self.same_frame)];
        parts.extend(decided.parts(&given)?);
        let mut origin = Origin::beside(fraction, None, parts);
        if self.anonymous {
            origin.patient = Patient::default();
            let study = &mut origin.study;
            for text in [&mut study.id, &mut study.accession, &mut study.description, &mut study.physician] {
                text.clear();
            }
        }
        Ok(origin)
    }
}

/// What the planning CT on the fraction says of itself.
fn about_ct<'a>(fraction: &'a Series, derivation: &'a str, sources: &'a [&'a Series]) -> DerivedCt<'a> {
    DerivedCt {
        role: "planning on fraction",
        description: "Planning CT on fraction (aventail, research only)",
        derivation,
        number: 901,
        frame_of_reference: &fraction.frame_of_reference,
        patient_position: &fraction.patient_position,
        sources,
    }
}

fn derivation() -> String {
    format!("Planning CT deformed onto the grid of the fraction. {CAUTION}")
}

/// A series of a planning system, with its grid.
fn series(path: &Path) -> Result<(Series, Grid)> {
    if !is_dicom_path(path) {
        let problem = format!("{}: DICOM results need DICOM input, and this is not DICOM", path.display());
        return Err(Error::usage(problem, "give the folders of the CT series, or ask for no DICOM"));
    }
    let (series, grid) = describe_series(path)?;
    if series.frame_of_reference.is_empty() {
        let problem = "its images name no frame of reference, which DICOM results must refer to";
        return Err(Error::input(path.display().to_string(), problem, "export the series again with it"));
    }
    Ok((series, grid))
}

/// Refuses a fraction of another patient.
fn same_patient(planning: &Path, own: &Series, path: &Path, fraction: &Series) -> Result<()> {
    let [a, b] = [&own.patient.id, &fraction.patient.id];
    if a == b {
        return Ok(());
    }
    let problem = format!("it is of another patient ({b:?}) than {} ({a:?})", planning.display());
    Err(Error::input(path.display().to_string(), problem, "give two series of one patient, or ask for no DICOM"))
}

/// The objects of one fraction while they are written.
struct Set<'a> {
    clinic: &'a Clinic,
    fraction: &'a Series,
    origin: Origin,
    folder: PathBuf,
    /// Names in the folder, and what they hold.
    files: Vec<(String, &'static str)>,
}

impl Set<'_> {
    fn write(mut self, outcome: &Outcome, mut warnings: Vec<Warning>) -> Result<(Vec<OutputFile>, Vec<Warning>)> {
        self.ct(outcome)?;
        let carried_by = self.registrations(outcome)?;
        if let Some(set) = &self.clinic.structures {
            warnings.extend(self.structures(set, outcome)?);
        }
        if let Some(dose) = &self.clinic.dose {
            self.dose(dose, outcome, &carried_by)?;
        }
        let out = self.folder.parent().unwrap_or(&self.folder);
        let listed = |(name, what): &(String, &str)| OutputFile::written(out, &format!("{FOLDER}/{name}"), what);
        Ok((self.files.iter().map(listed).collect::<Result<_>>()?, warnings))
    }

    fn path(&mut self, name: &str, what: &'static str) -> PathBuf {
        self.files.push((name.into(), what));
        self.folder.join(name)
    }

    fn ct(&mut self, outcome: &Outcome) -> Result<()> {
        let derivation = derivation();
        let sources = [&self.clinic.planning];
        let about = about_ct(self.fraction, &derivation, &sources);
        let series = write_ct(&self.folder.join("ct"), &outcome.planning_on_fraction, &about, &self.origin)?;
        let slices = 1..=series.slices.len();
        self.files.extend(slices.map(|k| (format!("ct/CT.{k:04}.dcm"), "planning CT on the fraction, DICOM")));
        Ok(())
    }

    /// Couch shift and both fields; returns the object that carries images, contours and dose to the fraction.
    fn registrations(&mut self, outcome: &Outcome) -> Result<Written> {
        let there = DerivedRegistration {
            role: "couch",
            description: "Couch shift (aventail, research only)",
            number: 904,
            from: &self.clinic.planning,
            to: self.fraction,
        };
        let back = DerivedRegistration { from: there.to, to: there.from, ..there };
        let rigid = Rigid::from_parts(Translation3::from(outcome.couch.shift()), UnitQuaternion::identity());
        let path = self.path("REG_couch.dcm", "couch shift, planning to fraction, DICOM Spatial Registration");
        write_rigid(&path, &rigid, &there, &self.origin)?;
        let what = "couch shift with its rotation, planning to fraction, DICOM Spatial Registration";
        let path = self.path("REG_couch_rotation.dcm", what);
        let description = "Couch shift and rotation (aventail, research only)";
        let turned = DerivedRegistration { role: "couch-rotation", description, number: 907, ..there };
        write_rigid(&path, &outcome.couch.rigid(), &turned, &self.origin)?;
        let what = "push field, DICOM Deformable Spatial Registration on the planning grid";
        let path = self.path("REG_planning_to_fraction.dcm", what);
        let description = "Planning to fraction (aventail, research only)";
        let about = DerivedRegistration { role: "push", description, number: 905, ..there };
        write_push(&path, &outcome.push, &about, &self.origin)?;
        let what = "pull field, DICOM Deformable Spatial Registration on the fraction grid";
        let path = self.path("REG_fraction_to_planning.dcm", what);
        let description = "Fraction to planning (aventail, research only)";
        write_pull(
            &path,
            &outcome.pull,
            &DerivedRegistration { role: "pull", description, number: 906, ..back },
            &self.origin,
        )
    }

    fn structures(&mut self, set: &StructureSet, outcome: &Outcome) -> Result<Option<Warning>> {
        let [forward, back] = [&outcome.push.displacement, &outcome.pull.displacement].map(Chain::along);
        let grid = outcome.pull.displacement.grid();
        let (moved, mapped) = resample_contours(&set.contours, &forward, &back, grid);
        let about = DerivedStructures {
            role: "structures",
            description: "Planning contours on fraction (aventail)",
            derivation: &format!("Contours of the planning CT carried to the fraction by registration. {CAUTION}"),
            number: 902,
            drawn_on: self.fraction,
        };
        let path = self.path("RS.dcm", "contours of planning on the fraction's slices, DICOM RTSTRUCT");
        write_structures(&path, &moved, &set.rois, &about, &self.origin)?;
        let share = 100.0 * mapped.outside as f64 / mapped.points.max(1) as f64;
        Ok(outside_field("the contours", "a field", share, WORTH_OF_LABELS))
    }

    fn dose(&mut self, dose: &Dose, outcome: &Outcome, [class, instance]: &Written) -> Result<()> {
        let pull = &outcome.pull.displacement;
        // On the fraction's grid, as coarse as the dose is.
        let spacing = dose.volume.grid().spacing().into_iter().fold(f64::INFINITY, f64::min);
        let mapped = interpolate(&dose.volume, pull, &pull.grid().coarsened(spacing))?;
        let about = DerivedDose {
            role: "dose",
            description: "Planned dose on fraction (aventail, research only)",
            comment: "Carried by registration, not recalculated; research only",
            number: 903,
            frame_of_reference: &self.fraction.frame_of_reference,
            kind: &dose.kind,
            summation: &dose.summation,
            plans: &dose.plans,
            carried_by: Some(&[[class, instance]]),
        };
        let path = self.path("RD.dcm", "dose of the plan carried to the fraction, Gy, DICOM RTDOSE");
        write_dose(&path, &mapped, &about, &self.origin)
    }
}
