//! The file formats that displacement fields come in; reading and writing them is `io`'s.

use crate::error::{Error, Result};
use serde::{Deserialize, Serialize};
use std::path::Path;

/// File formats that hold a displacement field; the first three hold scalar images too.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum FieldFormat {
    /// NIfTI-1, 5-D with intent 1007: read alike by every ITK-based tool, old and new.
    #[default]
    Nifti,
    /// MetaImage, not compressed.
    #[serde(rename = "metaimage")]
    MetaImage,
    /// NRRD; Slicer's own.
    Nrrd,
    /// NIfTI-1, 5-D with intent 1006 and RAS vectors: read by ITK 5.4 and later, ANTs and greedy; older ITK misreads it.
    Dispvect,
    /// NiftyReg's displacement field: NIfTI-1, `NREG_TRANS`, RAS. ITK-based tools read its x and y reversed.
    NiftyregDisplacement,
    /// NiftyReg's deformation field: NIfTI-1, `NREG_TRANS`, RAS positions. No displacement for any other tool.
    NiftyregDeformation,
}

impl FieldFormat {
    /// File extension without its leading dot.
    pub fn extension(self) -> &'static str {
        match self.container() {
            Self::MetaImage => "mha",
            Self::Nrrd => "nrrd",
            _ => "nii.gz",
        }
    }

    /// The plain format of the same file type, which scalar images are written in.
    pub fn container(self) -> Self {
        match self {
            Self::Dispvect | Self::NiftyregDisplacement | Self::NiftyregDeformation => Self::Nifti,
            plain => plain,
        }
    }

    /// The frame and unit of the stored vectors, for people.
    pub fn vectors(self) -> &'static str {
        match self {
            Self::Nifti | Self::MetaImage | Self::Nrrd => "LPS mm",
            Self::Dispvect | Self::NiftyregDisplacement => "RAS mm",
            Self::NiftyregDeformation => "positions, RAS mm",
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
