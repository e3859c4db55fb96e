//! The file formats that displacement fields come in; reading and writing them is `io`'s.

use crate::error::{Error, Result};
use serde::{Deserialize, Serialize};
use std::path::Path;

/// File formats that hold a displacement field (and scalar images too).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum FieldFormat {
    /// NIfTI-1, 5-D with intent 1007: read alike by every ITK-based tool, old and new.
    #[default]
    Nifti,
    /// MetaImage, not compressed.
    MetaImage,
    /// NRRD; Slicer's own.
    Nrrd,
}

impl FieldFormat {
    /// File extension without its leading dot.
    pub fn extension(self) -> &'static str {
        match self {
            Self::Nifti => "nii.gz",
            Self::MetaImage => "mha",
            Self::Nrrd => "nrrd",
        }
    }

    /// The format that a path's extension names.
    ///
    /// # Errors
    /// [`Error::Usage`] when it names none.
    pub fn of(path: &Path) -> Result<Self> {
        let name = path.file_name().unwrap_or_default().to_string_lossy().to_lowercase();
        let formats =
            [(".nii.gz", Self::Nifti), (".nii", Self::Nifti), (".mha", Self::MetaImage), (".nrrd", Self::Nrrd)];
        formats.iter().find(|(end, _)| name.ends_with(end)).map(|(_, format)| *format).ok_or_else(|| {
            Error::usage(
                format!("{}: the extension names no image format", path.display()),
                "use .nii.gz, .nii, .mha or .nrrd",
            )
        })
    }
}
