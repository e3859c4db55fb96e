//! What made the series that a path means.

use super::place::{Chosen, choose, is_place};
use super::scan::{Scan, no_hu};
use crate::error::Result;
use std::path::Path;

/// What made the series that a path means; `None` where it is no DICOM, a dose or a segmentation.
///
/// # Errors
/// As for finding the series.
pub fn scan_of(path: &Path) -> Result<Option<Scan>> {
    if !is_place(path) {
        return Ok(None);
    }
    Ok(match choose(path)?.0 {
        Chosen::Scan(objects, _) => Scan::of(&objects),
        Chosen::Dose(..) | Chosen::Labels(_) => None,
    })
}

/// Refuses an MR series where HU are needed.
///
/// # Errors
/// [`crate::error::Error::Input`] then; else as [`scan_of`].
pub fn require_ct(path: &Path) -> Result<()> {
    if scan_of(path)? == Some(Scan::Mr) { Err(no_hu(path)) } else { Ok(()) }
}
