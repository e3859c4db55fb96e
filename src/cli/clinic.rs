//! Options of `register --dicom`; what is written is [`crate::report::Clinic`]'s.

use crate::report::ClinicFiles;
use clap::Args;
use std::path::PathBuf;

/// Options for planning systems.
#[derive(Debug, Args)]
pub struct ClinicArgs {
    /// Write DICOM for the planning system to OUT/dicom: the planning CT on the fraction, the
    /// registrations, and --structures and --dose mapped to the fraction. Planning and fraction
    /// must be DICOM
    #[arg(long, conflicts_with = "roi")]
    pub dicom: bool,
    /// Structure set of the planning CT, to be mapped to the fraction
    #[arg(long, value_name = "RTSTRUCT", requires = "dicom")]
    pub structures: Option<PathBuf>,
    /// Dose of the plan, to be mapped to the fraction
    #[arg(long, value_name = "RTDOSE", requires = "dicom")]
    pub dose: Option<PathBuf>,
    /// Leave the patient's identity out of the report and the DICOM files (study and series UIDs
    /// and file names stay)
    #[arg(long)]
    pub anonymous: bool,
    /// Planning and fraction truly share one frame of reference: use it for the DICOM files,
    /// instead of a new one
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
