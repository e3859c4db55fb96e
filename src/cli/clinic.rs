//! Options of `register --dicom`; what is written is [`crate::report::Clinic`]'s.

use crate::report::ClinicFiles;
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
    /// Planning and fraction really share one frame of reference: keep it in what is written
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
}
