//! The loaded inputs of a registration.

use crate::evaluate::landmark::Landmark;
use crate::fit::BoneLandmark;
use crate::geometry::Rigid;
use crate::io::dicom::About;
use crate::phantom::Phantom;
use crate::skeleton::Skeleton;
use crate::volume::{LabelMap, Volume};
use crate::warning::Warning;
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// One input file with its checksum.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct InputFile {
    /// What it is, for example `planning`.
    pub role: String,
    /// Path as given; in a report as seen from its folder.
    #[serde(serialize_with = "crate::io::path_as_text")]
    pub path: PathBuf,
    /// SHA-256 of its bytes, hexadecimal.
    pub sha256: String,
    /// What it says of itself, where it is a series of a clinic.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub about: Option<About>,
}

/// Everything a registration needs, loaded and converted to LPS mm.
#[derive(Debug, Clone)]
pub struct Case {
    /// Planning CT, HU.
    pub planning: Volume<f32>,
    /// Bone labels on the planning grid.
    pub bones: LabelMap,
    /// Fraction CT, HU.
    pub fraction: Volume<f32>,
    /// Evaluation landmarks; they never enter the fit.
    pub landmarks: Vec<Landmark>,
    /// Landmarks on bones, which place the skeleton; see [`crate::fit::LandmarkUse`].
    pub bone_landmarks: Vec<BoneLandmark>,
    /// Motion of all bones together, planning to fraction, near which the fit begins; bone landmarks come before it.
    pub start: Option<Rigid>,
    /// Skeleton given by the user instead of the built one.
    pub skeleton: Option<Skeleton>,
    /// What reading the files found.
    pub warnings: Vec<Warning>,
    /// The files behind it.
    pub inputs: Vec<InputFile>,
}

impl Case {
    /// Of images and labels alone.
    pub fn new(planning: Volume<f32>, bones: LabelMap, fraction: Volume<f32>) -> Self {
        Self {
            planning,
            bones,
            fraction,
            landmarks: Vec::new(),
            bone_landmarks: Vec::new(),
            start: None,
            skeleton: None,
            warnings: Vec::new(),
            inputs: Vec::new(),
        }
    }
}

/// The phantom as its files would be read: its skeleton is left to be built.
impl From<Phantom> for Case {
    fn from(phantom: Phantom) -> Self {
        Self { landmarks: phantom.landmarks, ..Self::new(phantom.planning, phantom.bones, phantom.fraction) }
    }
}
