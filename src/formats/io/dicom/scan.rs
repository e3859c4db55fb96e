//! What made the images of a series: CT or MR, by the class of its objects.

use super::find::Object;
use crate::error::Error;
use crate::findings;
use dicom_dictionary_std::uids;
use std::path::Path;

/// What made the images of a series that is read as a volume.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Scan {
    /// Computed tomography: HU.
    Ct,
    /// Magnetic resonance: grey values without a unit, comparable within one series only.
    Mr,
}

impl Scan {
    /// Its SOP classes (PS3.4 B.5): single images, enhanced, converted to enhanced.
    const fn classes(self) -> [&'static str; 3] {
        match self {
            Self::Ct => [
                uids::CT_IMAGE_STORAGE,
                uids::ENHANCED_CT_IMAGE_STORAGE,
                uids::LEGACY_CONVERTED_ENHANCED_CT_IMAGE_STORAGE,
            ],
            Self::Mr => [
                uids::MR_IMAGE_STORAGE,
                uids::ENHANCED_MR_IMAGE_STORAGE,
                uids::LEGACY_CONVERTED_ENHANCED_MR_IMAGE_STORAGE,
            ],
        }
    }

    /// By SOP Class UID.
    pub(super) fn of_class(class: &str) -> Option<Self> {
        [Self::Ct, Self::Mr].into_iter().find(|scan| scan.classes().contains(&class))
    }

    /// Of a series: a CT where one of its objects is one.
    pub(super) fn of<'a>(objects: impl IntoIterator<Item = &'a Object>) -> Option<Self> {
        let kinds: Vec<Self> = objects.into_iter().filter_map(|o| Self::of_class(&o.sop_class)).collect();
        kinds.iter().find(|scan| **scan == Self::Ct).or(kinds.first()).copied()
    }

    /// Its Modality (0008,0060).
    pub const fn name(self) -> &'static str {
        match self {
            Self::Ct => "CT",
            Self::Mr => "MR",
        }
    }
}

/// The refusal of an MR series where HU are needed.
pub(super) fn no_hu(path: &Path) -> Error {
    Error::refused(
        findings::DICOM_NO_CT,
        path.display().to_string(),
        "it is an MR series: its values are no HU (modality \"MR\")",
        "give a CT; bones and densities cannot be told from MR values",
    )
}
