//! Doses that may count too often.

use crate::findings;
use crate::io::dicom::is_dicom_path;
use crate::provenance::Provenance;
use crate::warning::Warning;
use std::path::Path;

/// A word about a dose of the whole plan, as its header says, that counts as one of several fractions. A dose of anything else
/// was warned of when it was read.
pub(super) fn whole_plan(path: &Path, provenance: &Provenance, fractions: f64) -> Option<Warning> {
    let name = path.display().to_string();
    let part = provenance.warnings.iter().any(|w| w.is(findings::DOSE_PART) && w.message.contains(&name));
    let whole = is_dicom_path(path) && !part;
    let message = || {
        format!(
            "{name}: its header says that it is the dose of a whole plan, and it counts {fractions} times; is it that of one fraction?"
        )
    };
    whole.then(|| Warning::new(findings::DOSE_COUNTED, message()))
}
