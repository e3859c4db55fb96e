//! Doses that may count too often.

use crate::config::InputRole;
use crate::dose::{dose_carried, judge};
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

/// What headers of carried doses say.
pub(super) const CARRIED: &str = "aventail: dose, Gy";

/// A dose and what its header says of it.
pub(super) struct ToldDose {
    pub(super) dose: Volume<f32>,
    pub(super) of_whole_plan: bool,
    pub(super) carried: bool,
}

/// Reads a dose and refuses what is none in Gy.
pub(super) fn read_told(provenance: &mut Provenance, path: &Path) -> Result<ToldDose> {
    let mut told = if is_dicom_path(path) {
        let dose = provenance.take(InputRole::Dose, dose_at(path)?);
        let (of_whole_plan, carried) = (dose.is_of_whole_plan(), dose.is_carried());
        ToldDose { dose: dose.volume, of_whole_plan, carried }
    } else {
        let read = io::read_dose(path)?;
        let carried = [CARRIED, "aventail warp "].iter().any(|own| read.header.description.starts_with(own));
        ToldDose { dose: provenance.take(InputRole::Dose, read), of_whole_plan: false, carried }
    };
    provenance.warnings.extend(judge(&path.display().to_string(), &mut told.dose)?);
    Ok(told)
}

/// Reads a dose that is to be carried; warns of one that was carried before.
pub(super) fn read_to_carry(provenance: &mut Provenance, path: &Path) -> Result<ToldDose> {
    let told = read_told(provenance, path)?;
    provenance.warnings.extend(told.carried.then(|| dose_carried(&path.display().to_string())));
    Ok(told)
}
