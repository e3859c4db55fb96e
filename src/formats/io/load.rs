//! Files of any image format, told by their first bytes, to rasters.

use super::Loaded;
use super::bytes::{read_bytes_of, sha256};
use super::raster::Raster;
use super::{dicom, metaimage, nifti, nrrd};
use crate::error::Result;
use std::path::Path;

/// Reads and parses a file, or a DICOM series, then gives its raster to `take`; the checksum is computed meanwhile.
pub(super) fn load<T: Send>(path: &Path, take: impl FnOnce(&mut Raster<'_>) -> Result<T> + Send) -> Result<Loaded<T>> {
    if dicom::is_place(path) {
        return dicom::load(path, take);
    }
    let raw = read_bytes_of(path, &|head| promised(path, head))?;
    let (sha256, taken) = rayon::join(
        || sha256(&raw),
        || {
            let mut raster = parse(path, &raw)?;
            let value = take(&mut raster)?;
            Ok((value, raster.notes, raster.warnings))
        },
    );
    let (value, header, warnings) = taken?;
    Ok(Loaded { value, path: path.into(), sha256, header, warnings })
}

/// As [`load`], but of DICOM also an MR series, whose values are no labels.
pub(super) fn load_scan<T: Send>(
    path: &Path,
    take: impl FnOnce(&mut Raster<'_>) -> Result<T> + Send,
) -> Result<Loaded<T>> {
    if dicom::is_place(path) { dicom::load_scan(path, take) } else { load(path, take) }
}

/// The most bytes that a file can have by what its header, in these first bytes, promises.
fn promised(path: &Path, head: &[u8]) -> Result<u64> {
    if nrrd::is_nrrd(head) {
        nrrd::promised(path, head)
    } else if metaimage::is_metaimage(head) {
        metaimage::promised(path, head)
    } else {
        nifti::promised(path, head)
    }
}

/// Tells the format by the first bytes.
pub(super) fn parse<'a>(path: &Path, raw: &'a [u8]) -> Result<Raster<'a>> {
    if nrrd::is_nrrd(raw) {
        nrrd::parse(path, raw)
    } else if metaimage::is_metaimage(raw) {
        metaimage::parse(path, raw)
    } else {
        nifti::parse(path, raw)
    }
}
