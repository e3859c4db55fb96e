//! What a registration gives back to a planning system as DICOM: `register --dicom`.

use super::fields::{WORTH_OF_LABELS, outside};
use super::giveback::{CAUTION, no_plan};
use crate::config::Config;
use crate::dose::{interpolate, judge};
use crate::error::{Error, Result};
use crate::field::{Chain, InvertOptions, Link, Motion, resample_contours};
use crate::geometry::{Grid, Rigid};
use crate::io::dicom::registration::{DerivedRegistration, Written, write_pull, write_push, write_rigid};
use crate::io::dicom::write::{
    DerivedCt, DerivedDose, DerivedStructures, Origin, write_ct, write_dose, write_structures,
};
use crate::io::dicom::{
    Dose, Patient, Role, Series, StructureSet, check_frames, describe_series, is_dicom_path, read_dose,
    read_structure_set,
};
use crate::pipeline::{InputFile, Outcome};
use crate::report::OutputFile;
use crate::volume::contour::Contours;
use crate::warning::Warning;
use clap::Args;
use nalgebra::Translation3;
use std::path::{Path, PathBuf};

/// Folder in that of the run.
const FOLDER: &str = "dicom";

/// Options for planning systems.
#[derive(Debug, Args)]
pub struct ClinicArgs {
    /// Write OUT/dicom for the planning system: the planning CT on the fraction, the registrations, and what --structures
    /// and --dose name, carried to the fraction. Planning and fraction must be DICOM
    #[arg(long, conflicts_with = "roi")]
    pub dicom: bool,
    /// Structure set of the planning CT
    #[arg(long, value_name = "RTSTRUCT", requires = "dicom")]
    pub structures: Option<PathBuf>,
    /// Dose of the plan
    #[arg(long, value_name = "RTDOSE", requires = "dicom")]
    pub dose: Option<PathBuf>,
    /// Leave the patient's identity out of the report and of DICOM (UIDs of study and series stay, and names of files)
    #[arg(long)]
    pub anonymous: bool,
}

/// What the objects are made of, read before anything long begins.
pub(super) struct Clinic {
    planning: Series,
    fractions: Vec<(Series, Grid)>,
    structures: Option<StructureSet>,
    dose: Option<Dose>,
    anonymous: bool,
    warnings: Vec<Warning>,
}

impl ClinicArgs {
    /// Files that are read besides the images.
    pub(super) fn files(&self) -> impl Iterator<Item = &Path> {
        [&self.structures, &self.dose].into_iter().flatten().map(PathBuf::as_path)
    }

    /// The same as inputs of the run, for its report.
    ///
    /// # Errors
    /// [`Error::Read`] when one cannot be read.
    pub(super) fn inputs(&self) -> Result<Vec<InputFile>> {
        let all = [("structures", &self.structures), ("dose", &self.dose)];
        all.iter().filter_map(|(role, path)| Some(InputFile::read(role, path.as_deref()?))).collect()
    }

    /// Names of what is written, as far as they do not depend on the images.
    pub(super) fn names(&self) -> Vec<String> {
        let names =
            ["RS.dcm", "RD.dcm", "REG_couch.dcm", "REG_fraction_to_planning.dcm", "REG_planning_to_fraction.dcm"];
        let names = names.iter().filter(|_| self.dicom);
        names.map(|name| format!("{FOLDER}/{name}")).collect()
    }
}

impl Clinic {
    /// Reads what is needed; `None` where nobody asks for DICOM.
    ///
    /// # Errors
    /// When planning or fraction is no DICOM, names no frame of reference, or they are not of one patient; when structures or
    /// dose do not lie in planning's frame of reference; when a file cannot be read.
    pub(super) fn read(args: &ClinicArgs, planning: &Path, fractions: &[&Path]) -> Result<Option<Self>> {
        if !args.dicom {
            return Ok(None);
        }
        let series = |path: &Path| -> Result<(Series, Grid)> {
            if !is_dicom_path(path) {
                let problem = format!("{}: --dicom needs DICOM, and this is none", path.display());
                return Err(Error::usage(problem, "give the folders of the CT series, or leave --dicom out"));
            }
            let (series, grid) = describe_series(path)?;
            if series.frame_of_reference.is_empty() {
                let problem = "its images name no frame of reference, so that nothing can be said to lie in it";
                return Err(Error::input(path.display().to_string(), problem, "export the series again with it"));
            }
            Ok((series, grid))
        };
        let (own, _) = series(planning)?;
        let fractions = fractions.iter().map(|path| {
            let found = series(path)?;
            let [a, b] = [&own.patient.id, &found.0.patient.id];
            if a == b {
                return Ok(found);
            }
            let problem = format!("it is of another patient ({b:?}) than {} ({a:?})", planning.display());
            Err(Error::input(
                path.display().to_string(),
                problem,
                "give two series of one patient, or leave --dicom out",
            ))
        });
        let fractions = fractions.collect::<Result<_>>()?;
        let mut warnings = Vec::new();
        let mut structures = None;
        if let Some(path) = &args.structures {
            check_frames((path, Role::Structures), (planning, Role::Image))?;
            let mut set = read_structure_set(path)?;
            warnings.append(&mut set.warnings);
            warnings.extend(set.contours.tidy());
            structures = Some(set);
        }
        let mut dose = None;
        if let Some(path) = &args.dose {
            check_frames((path, Role::Dose), (planning, Role::Image))?;
            let mut read = read_dose(path)?;
            warnings.append(&mut read.warnings);
            let what = path.display().to_string();
            warnings.extend(judge(&what, &mut read.value.volume)?);
            warnings.extend(no_plan(&what, &read.value.plans));
            dose = Some(read.value);
        }
        Ok(Some(Self { planning: own, fractions, structures, dose, anonymous: args.anonymous, warnings }))
    }

    /// The structures of the planning CT.
    pub(super) fn contours(&self) -> Option<&Contours> {
        self.structures.as_ref().map(|set| &set.contours)
    }

    /// Writes the objects of fraction `n` into the run's folder; returns the files, and what is to be known.
    ///
    /// # Errors
    /// [`Error::Write`] when a file cannot be written.
    pub(super) fn write(
        &self,
        n: usize,
        outcome: &Outcome,
        config: &Config,
        out: &Path,
    ) -> Result<(Vec<OutputFile>, Vec<Warning>)> {
        let (fraction, grid) = self.fractions.get(n).ok_or_else(|| Error::Internal(format!("no series {n}")))?;
        if !grid.matches(outcome.pull.displacement.grid(), 1e-3) {
            return Err(Error::Internal("the fraction's series lies on another grid than its result".into()));
        }
        let folder = out.join(FOLDER);
        let refuse = |e: std::io::Error| Error::write(&folder, e.to_string(), "choose a folder that you may write to");
        std::fs::create_dir_all(folder.join("ct")).map_err(refuse)?;
        let set = Set { clinic: self, fraction, origin: self.origin(fraction, config)?, folder, files: Vec::new() };
        set.write(outcome, self.warnings.clone())
    }

    fn origin(&self, fraction: &Series, config: &Config) -> Result<Origin> {
        let of = |uid: Option<&String>| uid.cloned().unwrap_or_default();
        let parts = vec![
            self.planning.uid.clone(),
            fraction.uid.clone(),
            of(self.structures.as_ref().map(|s| &s.uid)),
            of(self.dose.as_ref().map(|d| &d.uid)),
            config.toml()?,
        ];
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
        let about = DerivedCt {
            role: "planning on fraction",
            description: "Planning CT on fraction (aventail, research only)",
            derivation: &format!("Planning CT deformed onto the grid of the fraction. {CAUTION}"),
            number: 901,
            frame_of_reference: &self.fraction.frame_of_reference,
            patient_position: &self.fraction.patient_position,
            sources: &[&self.clinic.planning],
        };
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
        let rigid = Rigid::from_parts(Translation3::from(outcome.couch_shift), nalgebra::UnitQuaternion::identity());
        let path = self.path("REG_couch.dcm", "couch shift, planning to fraction, DICOM Spatial Registration");
        write_rigid(&path, &rigid, &there, &self.origin)?;
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
        let link = |from: &str, to: &str, field: &crate::volume::Volume<[f32; 3]>| {
            let motion = Motion::Field(Box::new(field.clone()));
            [Link { name: "the field".into(), from: from.into(), to: to.into(), motion }]
        };
        let push = link("planning", "fraction", &outcome.push.displacement);
        let pull = link("fraction", "planning", &outcome.pull.displacement);
        let options = InvertOptions::default();
        let forward = Chain::between(&push, "planning", "fraction", &options)?;
        let back = Chain::between(&pull, "fraction", "planning", &options)?;
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
        Ok(outside("the contours", "a field", share, WORTH_OF_LABELS))
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
