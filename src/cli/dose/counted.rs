//! Doses that may count too often.

use crate::config::InputRole;
use crate::dose::judge;
use crate::error::Result;
use crate::findings;
use crate::io;
use crate::io::dicom::{dose_at, is_dicom_path};
use crate::provenance::Provenance;
use crate::volume::Volume;
use crate::warning::Warning;
use std::path::Path;

/// A word about the dose of a whole plan, as its header says, that counts as one of several fractions.
pub(super) fn whole_plan(path: &Path, fractions: f64) -> Warning {
    let message = format!(
        "{}: its header says that it is the dose of a whole plan, and it counts {fractions} times; is it that of one fraction?",
        path.display()
    );
    Warning::new(findings::DOSE_COUNTED, message)
}

/// Reads a dose and refuses what is none in Gy; also whether it says that it is the dose of a whole plan.
pub(super) fn read_told(provenance: &mut Provenance, path: &Path) -> Result<(Volume<f32>, bool)> {
    let (mut dose, of_whole_plan) = if is_dicom_path(path) {
        let dose = provenance.take(InputRole::Dose, dose_at(path)?);
        let of_whole_plan = dose.is_of_whole_plan();
        (dose.volume, of_whole_plan)
    } else {
        (provenance.take(InputRole::Dose, io::read_dose(path)?), false)
    };
    provenance.warnings.extend(judge(&path.display().to_string(), &mut dose)?);
    Ok((dose, of_whole_plan))
}
