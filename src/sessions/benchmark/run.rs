//! Each task as it is run, and the bytes that it must move at least.

use super::{Scene, Task};
use crate::chainmail::{ChainmailOptions, Combination, ImagePull, Lattice, Organs, Variant, propagate, spread};
use crate::error::{Error, Result};
use crate::evaluate::jacobian as characteristics;
use crate::field::{FieldFormat, InvertOptions, invert, jacobian, warp_image, warp_labels};
use crate::io::{self, WriteOptions};
use crate::progress::Silent;
use std::hint::black_box;

/// Bytes of a displacement.
const VECTOR: usize = 12;

impl Task {
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
            let variant = Variant { combination, prune_ratio: 0.0, ..Variant::default() };
            black_box(spread(lattice, &bones, &variant));
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
                black_box(spread(&lattice, &bones, &options.variant));
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
