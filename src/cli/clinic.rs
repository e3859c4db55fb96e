//! Options of `register --dicom`; what is written is [`crate::report::Clinic`]'s.

<<<<<<< HEAD
use crate::report::ClinicFiles;
=======
use crate::error::Result;
use crate::pipeline::{Case, InputFile};
use crate::report::{Clinic, ClinicFiles, one_frame};
use crate::runtime::Runtime;
>>>>>>> h60
use clap::Args;
use std::path::PathBuf;

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
    /// Planning and fraction truly lie in one frame of reference: what is written of the fraction stays in it
    #[arg(long)]
    pub same_frame: bool,
}

impl ClinicArgs {
    /// What is to go back beside the images.
    pub(super) fn files(&self) -> ClinicFiles {
        ClinicFiles {
            structures: self.structures.clone(),
            dose: self.dose.clone(),
            anonymous: self.anonymous,
            same_frame: self.same_frame,
        }
    }
<<<<<<< HEAD
=======

    /// What the objects are made of; `None` where nobody asks for DICOM.
    ///
    /// # Errors
    /// As [`Clinic::read`].
    pub(super) fn read(&self, planning: &Path, fractions: &[&Path]) -> Result<Option<Clinic>> {
        self.dicom.then(|| Clinic::read(&self.files(), planning, fractions)).transpose()
    }

    /// [`ClinicArgs::read`], with what is to be known at once.
    pub(super) fn told(&self, planning: &Path, fractions: &[&Path], runtime: &Runtime) -> Result<Option<Clinic>> {
        let clinic = runtime.stage("read for DICOM", || self.read(planning, fractions))?;
        clinic.iter().flat_map(Clinic::warnings).for_each(|w| runtime.progress().note(&w.message));
        Ok(clinic)
    }

    /// Tells of scans that claim one frame of reference, where no DICOM is written that would.
    pub(super) fn judge(&self, case: &mut Case, runtime: &Runtime) {
        let odd = if self.dicom || self.same_frame { None } else { one_frame(case) };
        odd.iter().for_each(|w| runtime.progress().note(&w.message));
        case.fraction.warnings.extend(odd);
    }

    /// Leaves the patient's identity with the files of a clinic, or takes it out of them.
    pub(super) fn name_patient(&self, inputs: &mut [InputFile]) {
        inputs.iter_mut().filter(|_| self.anonymous).for_each(InputFile::forget_patient);
    }

    /// Names of what is written, as far as they do not depend on the images.
    pub(super) fn names(&self) -> Vec<String> {
        if self.dicom { Clinic::planned() } else { Vec::new() }
    }
>>>>>>> h60
}
