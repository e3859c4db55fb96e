//! Doses that may count too often.

use crate::findings;
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
