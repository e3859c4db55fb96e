//! One resolution of the fit.

use super::mirror::as_they_are;
use super::planning::{BoneSamples, Drawn};
use super::similarity::Measure;
use super::tissue::Tissue;
use super::{FitOptions, Resolution};
use crate::error::{Error, Result};
use crate::geometry::Rigid;
use crate::volume::Volume;
use std::sync::{Arc, Mutex, OnceLock, PoisonError};

/// An optimisation of the last pass stops when no parameter moves by this much, mm: 0.02 gives the same in the same time.
const TOLERANCE_MM: f64 = 1e-3;
/// Coarser passes stop when nothing moves by this share of their blur: a finer one follows.
const PASSING: f64 = 0.01;

/// Both images at one resolution, with each bone's samples.
pub(super) struct Level<'a> {
    pub(super) drawn: &'a Drawn,
    pub(super) fraction: Arc<Tissue>,
    /// An optimisation stops when no parameter moves by this much, mm.
    pub(super) tolerance_mm: f64,
    /// Bones whose image takes no part: they follow their joints.
    pub(super) dropped: Vec<bool>,
}

type Kept = (Resolution, Arc<Tissue>);

/// Both images at every resolution, made when it is asked for.
pub(super) struct Levels<'a> {
    samples: &'a BoneSamples,
    fraction: &'a Volume<f32>,
    options: &'a FitOptions,
    /// Blurs of the fraction that are kept, where several fits need them.
    kept: OnceLock<Mutex<Vec<Kept>>>,
}

impl<'a> Levels<'a> {
    pub(super) fn new(samples: &'a BoneSamples, fraction: &'a Volume<f32>, options: &'a FitOptions) -> Self {
        Self { samples, fraction, options, kept: OnceLock::new() }
    }

    /// From now on each blur is made once: further fits follow. One fit alone needs one blur at a time.
    pub(super) fn keep(&self) {
        self.kept.get_or_init(Mutex::default);
    }

    pub(super) fn at(&self, resolution: Resolution) -> Result<Level<'a>> {
        let drawn =
            self.samples.at(resolution).ok_or_else(|| Error::Internal(format!("no samples at {resolution:?}")))?;
        let dropped = vec![false; drawn.bones.len()];
        let last = self.options.levels.last() == Some(&resolution);
        let passing = if last { 0.0 } else { PASSING * resolution.blur_mm };
        let tolerance_mm = TOLERANCE_MM.max(passing);
        Ok(Level { drawn, fraction: self.blurred(resolution), tolerance_mm, dropped })
    }

    fn blurred(&self, resolution: Resolution) -> Arc<Tissue> {
        let make = || Arc::new(Tissue::blurred(self.fraction, resolution.blur_mm));
        let Some(kept) = self.kept.get() else { return make() };
        // The lock is not held while a blur is made, which may run other fits' work on this thread.
        let lock = || kept.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some((_, found)) = lock().iter().find(|(of, _)| *of == resolution) {
            return found.clone();
        }
        let made = make();
        lock().push((resolution, made.clone()));
        made
    }
}

impl Level<'_> {
    /// Share of the bones' contrast that a motion of all of them explains.
    pub(super) fn explained(&self, motion: &Rigid, measure: Measure) -> f64 {
        as_they_are(&self.drawn.all, &self.fraction, motion, measure)
    }
}
