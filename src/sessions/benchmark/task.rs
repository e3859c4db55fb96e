//! What is timed: one hot path each.

use serde::{Deserialize, Serialize};

/// One hot path.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Task {
    /// Elements at every voxel from the CT.
    Elements,
    /// One wave from all bones over every voxel, and the displacements that it brings.
    Prioritised,
    /// One wave per bone over every voxel, round fronts, none pruned, weights t^-4.
    Superposition,
    /// The default waves: coarse elements, pruned where they hardly weigh.
    Waves,
    /// The default propagation without images.
    Propagation,
    /// The default propagation with both images.
    PropagationWithImages,
    /// The inverse to 1e-3 mm.
    Invert,
    /// The planning CT on the fraction grid.
    Resample,
    /// Bone labels on the fraction grid.
    Labels,
    /// The Jacobian map.
    Jacobian,
    /// What the cells of the planning grid hold: once per patient.
    Cells,
    /// Jacobian map and digital folds of a field, and their characteristics by tissue and bone.
    Characteristics,
    /// The planning CT from a compressed NIfTI file.
    Read,
    /// The field to a NIfTI file at the default compression.
    Write,
}

impl Task {
    /// All tasks.
    pub const ALL: [Self; 14] = [
        Self::Elements,
        Self::Prioritised,
        Self::Superposition,
        Self::Waves,
        Self::Propagation,
        Self::PropagationWithImages,
        Self::Invert,
        Self::Resample,
        Self::Labels,
        Self::Jacobian,
        Self::Cells,
        Self::Characteristics,
        Self::Read,
        Self::Write,
    ];

    /// Its name on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Elements => "elements",
            Self::Prioritised => "prioritised",
            Self::Superposition => "superposition",
            Self::Waves => "waves",
            Self::Propagation => "propagation",
            Self::PropagationWithImages => "propagation-with-images",
            Self::Invert => "invert",
            Self::Resample => "resample",
            Self::Labels => "labels",
            Self::Jacobian => "jacobian",
            Self::Cells => "cells",
            Self::Characteristics => "characteristics",
            Self::Read => "read",
            Self::Write => "write",
        }
    }

    /// What it does, in a line.
    pub fn what(self) -> &'static str {
        match self {
            Self::Elements => "elements of the chain mail at every voxel",
            Self::Prioritised => "one wave from all bones over every voxel, with displacements",
            Self::Superposition => "influence of each bone over every voxel, none pruned",
            Self::Waves => "the default: coarse elements, influence pruned where it hardly weighs",
            Self::Propagation => "the default propagation without images",
            Self::PropagationWithImages => "the default propagation with images",
            Self::Invert => "the inverse to 1e-3 mm",
            Self::Resample => "the planning CT on the fraction grid",
            Self::Labels => "the bone labels on the fraction grid",
            Self::Jacobian => "the Jacobian map",
            Self::Cells => "what cells hold, once per patient",
            Self::Characteristics => "Jacobian map and characteristics by tissue and bone",
            Self::Read => "the planning CT from int16 .nii.gz",
            Self::Write => "the field to .nii.gz, as a registration writes it",
        }
    }

    /// Time that it should take at most on two cores at full size, s.
    pub fn target(self) -> Option<f64> {
        match self {
            Self::Prioritised | Self::Invert => Some(1.0),
            Self::Superposition => Some(15.0),
            Self::Waves => Some(3.0),
            Self::Resample => Some(0.15),
            Self::Jacobian | Self::Characteristics => Some(0.1),
            _ => None,
        }
    }
}
