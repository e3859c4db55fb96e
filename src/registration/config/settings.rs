//! The complete settings of a run, and the names of what they may start from.

use crate::body::BodyOptions;
use crate::chainmail::{ChainmailOptions, VolumeChange};
use crate::error::{Error, Result};
use crate::evaluate::couch::CouchOptions;
use crate::evaluate::verdict::Limits;
use crate::field::{ConsistencyOptions, FieldFormat, InvertOptions, Resampling};
use crate::fit::{FitOptions, LEAST_EXPLAINED_OF_MR, Measure};
use crate::plausibility::CheckOptions;
use crate::refine::RefineOptions;
use crate::skeleton::SlidingOptions;
use crate::volume::region::RegionOptions;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use std::borrow::Cow;

/// Complete settings of a registration.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Config {
    /// What the settings started from.
    pub preset: Preset,
    /// What the checks of the inputs may do.
    pub checks: CheckOptions,
    /// What the planning scan is.
    #[serde(default)]
    pub planning: ScanOptions,
    /// What the fraction is.
    #[serde(default)]
    pub fraction: ScanOptions,
    /// Finding the patient.
    pub body: BodyOptions,
    /// Fitting the skeleton.
    pub fit: FitOptions,
    /// Where bones slide on each other.
    pub sliding: SlidingOptions,
    /// The model of soft tissue.
    pub soft_tissue: SoftTissue,
    /// Carrying bone motion to soft tissue by the chain mail.
    pub chainmail: ChainmailOptions,
    /// Refining soft tissue by the images.
    pub refine: RefineOptions,
    /// Which bones the couch shift is matched on.
    pub couch: CouchOptions,
    /// Where results are wanted.
    pub region: RegionOptions,
    /// Inverting the field.
    pub invert: InvertOptions,
    /// How well the field and its inverse have to agree between voxels.
    pub consistency: ConsistencyOptions,
    /// Bringing the planning CT onto the fraction grid.
    pub resampling: Resampling,
    /// What is written, and how.
    pub output: OutputOptions,
    /// By which limits the result is judged.
    pub verdict: Limits,
}

/// What a scan is.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ScanOptions {
    /// What made it.
    pub modality: Modality,
}

/// What made an image.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Modality {
    /// What the header says: an MR where it is a DICOM series of one, else a CT.
    #[default]
    Auto,
    /// A CT or cone-beam CT in HU.
    Ct,
    /// Magnetic resonance: grey values of any scale, and no HU.
    Mr,
}

/// What carries bone motion to soft tissue.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum SoftTissue {
    /// The chain mail.
    #[default]
    ChainMail,
    /// For comparison: thin-plate splines through 6 control points per bone (thesis 4.2.3).
    ThinPlateSplines,
    /// For comparison: each voxel moves rigidly with its nearest bone.
    NearestBone,
}

/// Named starting points.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Preset {
    /// What measures best (docs/validation.md).
    #[default]
    Default,
    /// Elements of 5 mm, fewer samples of the fit and comparisons of the images, no map of uncertainty, fields not made to agree
    /// between voxels.
    Fast,
    /// The final model of the thesis (6.1.7): timestamps, linear decay, superposition t^-4, stiff, every voxel; nothing
    /// beyond it changes the field.
    Thesis,
}

/// What is written, and how.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct OutputOptions {
    /// File format of the two displacement fields.
    pub field_format: FieldFormat,
    /// Gzip level of compressed files, 0 to 9.
    pub gzip_level: u32,
    /// Write the regions of influence as `regions.nii.gz`: which bone each voxel follows.
    pub regions: bool,
    /// Write `uncertainty.nii.gz`: how far the result may be trusted, mm.
    pub uncertainty: bool,
}

impl Default for OutputOptions {
    fn default() -> Self {
        Self { field_format: FieldFormat::Nifti, gzip_level: 1, regions: false, uncertainty: true }
    }
}

impl Config {
    /// Whether planning or fraction is an MR, so that equal tissue may have any grey values.
    pub fn across(&self) -> bool {
        self.planning.modality == Modality::Mr || self.fraction.modality == Modality::Mr
    }

    /// The fit's options, by the measure that the scans' modalities need.
    pub fn fit_options(&self) -> Cow<'_, FitOptions> {
        if !self.across() {
            return Cow::Borrowed(&self.fit);
        }
        let of_mr = (self.planning.modality == Modality::Mr).then_some(LEAST_EXPLAINED_OF_MR);
        let least_explained = of_mr.unwrap_or(self.fit.least_explained);
        Cow::Owned(FitOptions { measure: Measure::CorrelationRatio, least_explained, ..self.fit.clone() })
    }

    /// All settings as a value, as reports hold them.
    ///
    /// # Errors
    /// [`Error::Internal`] when one has no JSON.
    pub fn value(&self) -> Result<Value> {
        serde_json::to_value(self).map_err(|e| Error::Internal(e.to_string()))
    }

    /// All settings as a file for `--config`.
    ///
    /// # Errors
    /// [`Error::Internal`] when one has no TOML.
    pub fn toml(&self) -> Result<String> {
        toml::to_string_pretty(self).map_err(|e| Error::Internal(format!("settings as TOML: {e}")))
    }

    /// Lays changes of organs' volumes over those of the settings; what is impossible then, if there are any.
    pub fn change_volumes(&mut self, changes: &[VolumeChange]) -> Option<String> {
        for change in changes {
            self.chainmail.volume_change.retain(|c| c.organ != change.organ);
            self.chainmail.volume_change.push(change.clone());
        }
        self.problem().filter(|_| !changes.is_empty())
    }
}
