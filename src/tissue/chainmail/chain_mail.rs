//! The chain mail of a patient at rest: the elements at every spacing that a propagation goes through, and when each bone's
//! wave comes to them. None of it depends on how the bones move, so that all fractions of a patient share it.

use super::lattice::islands::islands;
use super::lattice::material::Organs;
use super::lattice::{Lattice, Tissue};
use super::options::ChainmailOptions;
use super::relaxation::rest::RestingLinks;
use super::variants::{Combination, Variant};
use super::waves::blend::{only_times, spread};
use super::waves::carry::Initiators;
use super::waves::prolongation::Prolongation;
use super::waves::pruning::Pruning;
use super::waves::superpose::{self, Waves};
use crate::error::{Error, Result};
use crate::volume::Mask;
use std::sync::Arc;

/// The elements of a patient at rest.
pub struct ChainMail {
    pub(super) organs: Organs,
    /// The voxels that take part.
    pub(super) computed: Mask,
    levels: Vec<MailLevel>,
}

/// The elements at one spacing.
pub(super) struct MailLevel {
    /// mm.
    spacing: f64,
    pub(super) lattice: Arc<Lattice>,
    /// Each bone's wave, where they run through these elements and are few enough to be kept.
    waves: Option<Waves>,
    /// The links of its elements, and which of these images have no hold on; `None` where they are not relaxed.
    resting: Option<(RestingLinks, Mask)>,
}

impl ChainMail {
    /// Links the elements at all spacings of the options, and at `further` ones (mm), which take what the same waves bring.
    ///
    /// # Errors
    /// [`Error::Usage`] when the options name an organ that the labels lack.
    pub fn new(tissue: &Tissue<'_>, options: &ChainmailOptions, further: &[f64]) -> Result<Self> {
        let organs = organs(tissue, options)?;
        let coarser = options.relaxation.iter().map(|r| r.spacing_mm).filter(|s| *s > options.spacing_mm);
        let waves = options.spacing_of_waves();
        let finest = [waves, options.spacing_mm];
        let mut spacings: Vec<f64> = coarser.chain(finest).chain(further.iter().copied()).collect();
        spacings.sort_by(f64::total_cmp);
        spacings.dedup();
        let bones = tissue.bone_of_label.iter().flatten().max().map_or(0, |b| b + 1);
        let level = |spacing| {
            let lattice = Lattice::new(tissue, &options.material, &organs, spacing);
            let kept = usual(&options.variant) && (spacing - waves).abs() < f64::EPSILON;
            MailLevel {
                spacing,
                waves: if kept { Waves::new(&lattice, bones, &options.variant) } else { None },
                resting: options
                    .relaxes(spacing)
                    .then(|| (RestingLinks::new(&lattice, options.variant.elasticity), islands(&lattice))),
                lattice: Arc::new(lattice),
            }
        };
        let levels = spacings.into_iter().map(level).collect();
        Ok(Self { organs, computed: tissue.computed(), levels })
    }

    /// The elements at a spacing, mm.
    ///
    /// # Errors
    /// [`Error::Internal`] when it was not asked for.
    pub(super) fn at(&self, spacing: f64) -> Result<&MailLevel> {
        let found = self.levels.iter().find(|l| (l.spacing - spacing).abs() < f64::EPSILON);
        found.ok_or_else(|| Error::Internal(format!("no elements of {spacing} mm were made")))
    }

    /// What the waves bring to the elements that they run through.
    ///
    /// # Errors
    /// As [`ChainMail::at`].
    pub(super) fn run_waves(&self, bones: &Initiators<'_>, options: &ChainmailOptions) -> Result<Prolongation> {
        let level = self.at(options.spacing_of_waves())?;
        let lattice = level.lattice.clone();
        let variant = &options.variant;
        if !usual(variant) {
            return Ok(Prolongation { displacement: spread(&lattice, bones, variant), lattice, pruning: None });
        }
        let (displacement, pruned) = match &level.waves {
            Some(waves) => waves.blend(&lattice, bones, variant),
            None => superpose::spread(&lattice, bones, variant),
        };
        let pruning = Some(Pruning::new(pruned, &lattice, bones.transforms, variant));
        Ok(Prolongation { lattice, displacement, pruning })
    }
}

impl MailLevel {
    /// The links of its elements, and which of these images have no hold on.
    ///
    /// # Errors
    /// [`Error::Internal`] when these elements were not to be relaxed.
    pub(super) fn resting(&self) -> Result<&(RestingLinks, Mask)> {
        let of = || Error::Internal(format!("elements of {} mm were not to be relaxed", self.spacing));
        self.resting.as_ref().ok_or_else(of)
    }
}

/// Whether bones are superposed by nothing but the times of their waves.
fn usual(variant: &Variant) -> bool {
    only_times(variant) && variant.combination == Combination::Superposition
}

/// Finds the organs that have constraints of their own.
///
/// # Errors
/// [`crate::error::Error::Usage`] when a name is no label's, or a bone's.
pub fn organs(tissue: &Tissue<'_>, options: &ChainmailOptions) -> Result<Organs> {
    Organs::new(&options.organs, tissue.labels, |l| tissue.bone_of_label[usize::from(l)].is_some())
}
