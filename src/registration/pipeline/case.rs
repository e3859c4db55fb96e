//! The loaded inputs of a registration.

use crate::config::InputRole;
use crate::error::Result;
use crate::evaluate::landmark::Landmark;
use crate::fit::BoneLandmark;
use crate::geometry::Rigid;
use crate::io::checksum::sha256_file;
use crate::io::dicom::About;
use crate::phantom::Phantom;
use crate::skeleton::Skeleton;
use crate::volume::{LabelMap, Volume};
use crate::warning::Warning;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// One input file with its checksum.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct InputFile {
    /// What it is to the run.
    pub role: InputRole,
    /// Path as given; in a report as seen from its folder.
    #[serde(serialize_with = "crate::io::path_as_text")]
    pub path: PathBuf,
    /// SHA-256 of its bytes, hexadecimal.
    pub sha256: String,
    /// What was given behind `#`: which of its entries it is, or its space, where the file alone does not tell.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub entry: Option<String>,
    /// What it says of itself, where it is a series of a clinic.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub about: Option<About>,
}

impl InputFile {
    /// Of a role, a path and the checksum of what was read there.
    pub fn new(role: InputRole, path: PathBuf, sha256: String) -> Self {
        Self { role, path, sha256, entry: None, about: None }
    }

    /// A file whose bytes are read for their checksum.
    ///
    /// # Errors
    /// [`crate::error::Error::Read`] when it cannot be read.
    pub fn read(role: InputRole, path: &Path) -> Result<Self> {
        Ok(Self::new(role, path.to_owned(), sha256_file(path)?))
    }

    /// Leaves the patient's identity out, which reports repeat otherwise.
    pub fn forget_patient(&mut self) {
        self.about = self.about.take().map(About::anonymous);
    }
}

/// The planning side of a patient, loaded and converted to LPS mm: what all his fractions share, and all that a posture is made
/// from.
#[derive(Debug, Clone)]
pub struct PlanningScan {
    /// Planning CT, HU.
    pub ct: Volume<f32>,
    /// Labels of bones and organs on its grid.
    pub bones: LabelMap,
    /// Skeleton given by the user instead of the built one.
    pub skeleton: Option<Skeleton>,
    /// What reading the files found.
    pub warnings: Vec<Warning>,
    /// The files behind it.
    pub inputs: Vec<InputFile>,
}

impl PlanningScan {
    /// Of a CT and its labels alone.
    pub fn new(ct: Volume<f32>, bones: LabelMap) -> Self {
        Self { ct, bones, skeleton: None, warnings: Vec::new(), inputs: Vec::new() }
    }
}

/// A fraction of the patient, with what is known of planning and this fraction; LPS mm.
#[derive(Debug, Clone)]
pub struct FractionScan {
    /// Fraction CT, HU; of a posture that was made, the artificial one.
    pub ct: Volume<f32>,
    /// Evaluation landmarks; they never enter the fit.
    pub landmarks: Vec<Landmark>,
    /// Landmarks on bones, which place the skeleton; see [`crate::fit::LandmarkUse`].
    pub bone_landmarks: Vec<BoneLandmark>,
    /// Motion of all bones together, planning to fraction, near which the fit begins; bone landmarks come before it.
    pub start: Option<Rigid>,
    /// What reading the files found.
    pub warnings: Vec<Warning>,
    /// The files behind it; none of a posture that was made.
    pub inputs: Vec<InputFile>,
}

impl FractionScan {
    /// Of a CT alone.
    pub fn new(ct: Volume<f32>) -> Self {
        Self {
            ct,
            landmarks: Vec::new(),
            bone_landmarks: Vec::new(),
            start: None,
            warnings: Vec::new(),
            inputs: Vec::new(),
        }
    }
}

/// Everything that a registration needs: a patient's planning side and one fraction.
#[derive(Debug, Clone)]
pub struct Case {
    /// The planning side.
    pub planning: PlanningScan,
    /// The fraction.
    pub fraction: FractionScan,
}

impl Case {
    /// Of images and labels alone: planning CT and fraction CT in HU, bone labels on the planning grid.
    pub fn new(planning: Volume<f32>, bones: LabelMap, fraction: Volume<f32>) -> Self {
        Self { planning: PlanningScan::new(planning, bones), fraction: FractionScan::new(fraction) }
    }

    /// The files behind it, those of planning first.
    pub fn inputs(&self) -> impl Iterator<Item = &InputFile> {
        self.planning.inputs.iter().chain(&self.fraction.inputs)
    }

    /// What reading the files found.
    pub fn warnings(&self) -> Vec<Warning> {
        [self.planning.warnings.as_slice(), &self.fraction.warnings].concat()
    }
}

/// The phantom as its files would be read: its skeleton is left to be built.
impl From<Phantom> for Case {
    fn from(phantom: Phantom) -> Self {
        let mut case = Self::new(phantom.planning, phantom.bones, phantom.fraction);
        case.fraction.landmarks = phantom.landmarks;
        case
    }
}
