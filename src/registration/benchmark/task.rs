//! What is timed: one hot path each, with the bytes that it must move at least.

use super::Scene;
use crate::chainmail::{ChainmailOptions, Combination, ImagePull, Lattice, Organs, propagate, spread};
use crate::error::{Error, Result};
use crate::evaluate::jacobian as characteristics;
use crate::field::{FieldFormat, InvertOptions, invert, jacobian, warp_image, warp_labels};
use crate::io::{self, WriteOptions};
use crate::progress::Silent;
use serde::{Deserialize, Serialize};
use std::hint::black_box;

/// Bytes of a displacement.
const VECTOR: usize = 12;

/// One hot path.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Task {
    /// Elements at every voxel from the CT.
    Elements,
    /// One wave from all bones over every voxel, and the displacements that it brings.
    Prioritised,
    /// One wave per bone over every voxel, round fronts, none let go, weights t^-4.
    Superposition,
    /// The default waves: coarse elements, let go where they hardly weigh.
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

    /// Voxels that it works on, and bytes that it must read and write at least.
    pub fn work(self, scene: &Scene) -> (usize, u64) {
        let planning = scene.phantom.planning.grid().len();
        let fraction = scene.phantom.fraction.grid().len();
        let bones = scene.phantom.skeleton.bones.len();
        let (hu, label, flag) = (4, 2, 1);
        let (voxels, bytes) = match self {
            Self::Elements => (planning, planning * (hu + label + flag) + scene.active * VECTOR),
            // Material in, displacement out.
            Self::Prioritised => (scene.active, scene.active * (4 + VECTOR)),
            // A time per bone and voxel is written and read once.
            Self::Superposition => (scene.active, scene.active * (bones * 8 + VECTOR)),
            Self::Waves | Self::Propagation | Self::PropagationWithImages => {
                (scene.active, planning * (hu + label + flag + VECTOR))
            }
            Self::Invert => (fraction, planning * VECTOR + fraction * (VECTOR + flag)),
            Self::Resample => (fraction, planning * hu + fraction * (VECTOR + hu)),
            Self::Labels => (fraction, planning * label + fraction * (VECTOR + label)),
            Self::Jacobian => (planning, planning * (VECTOR + flag + hu)),
            Self::Cells => (planning, planning * (hu + label + flag)),
            Self::Characteristics => (planning, planning * (VECTOR + 2 * flag + hu)),
            // The file's int16 in, single precision out.
            Self::Read => (planning, planning * (2 + hu)),
            Self::Write => (planning, planning * VECTOR),
        };
        (voxels, bytes as u64)
    }

    /// Runs it once.
    pub(super) fn run(self, scene: &Scene) -> Result<()> {
        let options = ChainmailOptions::default();
        let (tissue, bones) = scene.chainmail(&options);
        let voxelwise = |combination| {
            let lattice = scene.lattice.as_ref().ok_or_else(|| Error::Internal("no elements at every voxel".into()))?;
            let options = ChainmailOptions { combination, prune_ratio: 0.0, ..ChainmailOptions::default() };
            black_box(spread(lattice, &bones, &options));
            Ok::<_, Error>(())
        };
        let fraction = scene.phantom.fraction.grid();
        match self {
            Self::Elements => {
                black_box(Lattice::new(&tissue, &options.material, &Organs::default(), 0.0));
            }
            Self::Prioritised => voxelwise(Combination::Prioritisation)?,
            Self::Superposition => voxelwise(Combination::Superposition)?,
            Self::Waves => {
                let lattice = Lattice::new(&tissue, &options.material, &Organs::default(), options.spacing_of_waves());
                black_box(spread(&lattice, &bones, &options));
            }
            Self::Propagation => {
                black_box(propagate(&tissue, &bones, &options, None, &Silent)?);
            }
            Self::PropagationWithImages => {
                let images = scene.images();
                let pull = images.as_ref().map(|i| i as &dyn ImagePull);
                black_box(propagate(&tissue, &bones, &options, pull, &Silent)?);
            }
            Self::Invert => {
                black_box(invert(&scene.push, fraction, None, &InvertOptions::default())?);
            }
            Self::Resample => {
                black_box(warp_image(&scene.pull, &scene.phantom.planning, -1000.0)?);
            }
            Self::Labels => {
                black_box(warp_labels(&scene.pull, &scene.phantom.bones)?);
            }
            Self::Jacobian => {
                black_box(jacobian(&scene.push));
            }
            Self::Cells => {
                black_box(scene.find_cells());
            }
            Self::Characteristics => {
                let cells = scene.cells.as_ref().ok_or_else(|| Error::Internal("no kinds of cells".into()))?;
                black_box(characteristics::evaluate(&scene.push, cells));
            }
            Self::Read => {
                black_box(io::read_image(&scene.planning_file)?);
            }
            Self::Write => {
                let level = WriteOptions::default().gzip_level;
                io::write_push(&scene.field_file, &scene.push, FieldFormat::Nifti, level)?;
            }
        }
        Ok(())
    }
}
