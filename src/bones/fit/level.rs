//! One resolution of the fit.

use super::mirror::as_they_are;
use super::planning::{BoneSamples, Drawn};
use super::similarity::Measure;
use super::tissue::Tissue;
use super::{FitOptions, Resolution};
use crate::error::{Error, Result};
use crate::geometry::Rigid;
use crate::volume::Volume;

/// An optimisation of the last pass stops when no parameter moves by this much, mm: 0.02 gives the same in the same time.
const TOLERANCE_MM: f64 = 1e-3;
/// Coarser passes stop when nothing moves by this share of their blur: a finer one follows.
const PASSING: f64 = 0.01;

/// Both images at one resolution, with each bone's samples.
pub(super) struct Level<'a> {
    pub(super) drawn: &'a Drawn,
    pub(super) fraction: Tissue,
    /// An optimisation stops when no parameter moves by this much, mm.
    pub(super) tolerance_mm: f64,
    /// Bones whose image takes no part: they follow their joints.
    pub(super) dropped: Vec<bool>,
}

impl<'a> Level<'a> {
    pub(super) fn new(
        samples: &'a BoneSamples,
        fraction: &Volume<f32>,
        resolution: Resolution,
        options: &FitOptions,
    ) -> Result<Self> {
        let drawn = samples.at(resolution).ok_or_else(|| Error::Internal(format!("no samples at {resolution:?}")))?;
        let dropped = vec![false; drawn.bones.len()];
        let last = options.levels.last() == Some(&resolution);
        let passing = if last { 0.0 } else { PASSING * resolution.blur_mm };
        let tolerance_mm = TOLERANCE_MM.max(passing);
        Ok(Self { drawn, fraction: Tissue::blurred(fraction, resolution.blur_mm), tolerance_mm, dropped })
    }
}

impl Level<'_> {
    /// Share of the bones' contrast that a motion of all of them explains.
    pub(super) fn explained(&self, motion: &Rigid, measure: Measure) -> f64 {
        as_they_are(&self.drawn.all, &self.fraction, motion, measure)
    }
}
