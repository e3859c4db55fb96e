//! The planning side of the fit: what each bone looks like at every resolution. It does not depend on the fraction, so that
//! all fractions of a patient share it.

use super::samples::{Samples, candidates, draw};
use super::search::Anatomy;
use super::tissue::Tissue;
use super::{FitOptions, Resolution};
use crate::skeleton::Skeleton;
use crate::volume::{LabelMap, Volume};

/// Samples of all bones together that the search of the couch shift looks at.
pub(super) const START_SAMPLES: usize = 1500;

/// Samples of each bone at every resolution of the fit.
#[derive(Debug, Clone)]
pub struct BoneSamples {
    levels: Vec<Drawn>,
    /// What the search of an unclear start looks at.
    pub(super) anatomy: Anatomy,
}

/// Samples at one resolution.
#[derive(Debug, Clone)]
pub(super) struct Drawn {
    pub(super) resolution: Resolution,
    /// Each bone's, in the order of the skeleton.
    pub(super) bones: Vec<Samples>,
    /// A small sample of all bones as one.
    pub(super) all: Samples,
}

impl BoneSamples {
    /// Draws the samples from the planning CT (HU) and its labels, which share a grid.
    pub fn new(skeleton: &Skeleton, planning: &Volume<f32>, labels: &LabelMap, options: &FitOptions) -> Self {
        let lists = candidates(skeleton, labels);
        let mut all: Vec<u32> = lists.iter().flatten().copied().collect();
        all.sort_unstable();
        let mut levels: Vec<Drawn> = Vec::new();
        for resolution in std::iter::once(Self::START).chain(options.outward.iter().chain(&options.levels).copied()) {
            if levels.iter().any(|l| l.resolution == resolution) {
                continue;
            }
            let Resolution { blur_mm: sigma, samples: most } = resolution;
            let blurred = Tissue::blurred(planning, sigma);
            let draw = |list: &[u32], most| draw(list, planning.grid(), &blurred, most);
            let bones = lists.iter().map(|l| draw(l, most)).collect();
            levels.push(Drawn { resolution, bones, all: draw(&all, START_SAMPLES) });
        }
        Self { levels, anatomy: Anatomy::new(planning, labels) }
    }

    /// Resolution of the search for the couch shift; another blur was never measured.
    pub(super) const START: Resolution = Resolution { blur_mm: 6.0, samples: START_SAMPLES };

    /// The samples at a resolution; `None` for one that the options did not name.
    pub(super) fn at(&self, resolution: Resolution) -> Option<&Drawn> {
        self.levels.iter().find(|l| l.resolution == resolution)
    }
}
