//! What made a scan.

use super::source::Source;
use crate::config::Modality;
use crate::error::{Error, Result};
use crate::io::dicom::{Scan, scan_of};
use crate::volume::Volume;

/// What made a scan: what a DICOM series says of itself, else what is `told` by an option, else a CT.
///
/// # Errors
/// [`Error::Usage`] when a series is of another modality than is told; else as finding a series.
pub(super) fn of_scan(scan: &Source<Volume<f32>>, told: Modality, option: &str) -> Result<Modality> {
    let own = match scan.path().map_or(Ok(None), scan_of)? {
        Some(Scan::Ct) => Modality::Ct,
        Some(Scan::Mr) => Modality::Mr,
        None if told == Modality::Auto => Modality::Ct,
        None => told,
    };
    if told != Modality::Auto && own != told {
        let [is, said] = if own == Modality::Mr { ["an MR", "a CT"] } else { ["a CT", "an MR"] };
        let name = scan.path().map_or_else(String::new, |p| p.display().to_string());
        return Err(Error::usage(
            format!("{name}: it is {is} series, and the settings say {said} ({option})"),
            format!("leave {option} out: a DICOM series states its modality; choose one of several by FOLDER#NUMBER"),
        ));
    }
    Ok(own)
}
