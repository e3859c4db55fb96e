//! Names of files beside a result.

use std::path::{Path, PathBuf};

/// Extensions of volumes.
const ENDS: [&str; 5] = [".nii.gz", ".nii", ".mha", ".nrrd", ".dcm"];

/// The name of a result without the extension that volumes have, and that extension, if any.
fn parts(out: &Path) -> (String, Option<&'static str>) {
    let name = out.file_name().unwrap_or_default().to_string_lossy();
    let end = ENDS.into_iter().find(|end| name.ends_with(end));
    (end.and_then(|end| name.strip_suffix(end)).unwrap_or(&name).to_owned(), end)
}

/// A result's path with another extension.
pub(super) fn with_extension(out: &Path, extension: &str) -> PathBuf {
    out.with_file_name(format!("{}.{extension}", parts(out).0))
}

/// A file beside a result: its name with a word behind it, in its format; NIfTI where the name tells none.
pub(super) fn named(out: &Path, word: &str) -> PathBuf {
    let (stem, end) = parts(out);
    out.with_file_name(format!("{stem}_{word}{}", end.unwrap_or(".nii.gz")))
}

/// A map beside a result: as [`named`], but beside DICOM a NIfTI.
pub(super) fn map_beside(out: &Path, word: &str) -> PathBuf {
    let dicom = parts(out).1 == Some(".dcm");
    if dicom { named(&with_extension(out, "nii.gz"), word) } else { named(out, word) }
}
