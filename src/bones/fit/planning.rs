//! The planning side of the fit: what each bone looks like at every resolution. It does not depend on the fraction, so that
//! all fractions of a patient share it.

use super::samples::{SHELL_MM, Samples, candidates, draw};
use super::search::Anatomy;
use super::similarity::Measure;
use super::tissue::Tissue;
use super::{FitOptions, Resolution};
use crate::skeleton::Skeleton;
use crate::volume::ranges::{RANGES, memberships};
use crate::volume::{LabelMap, Volume, trilinear};
use nalgebra::Point3;

/// Samples of all bones together that the search of the couch shift looks at.
pub(super) const START_SAMPLES: usize = 1500;

/// Width of what belongs to a bone's samples in an image of another modality, mm: cortical bone and what lies on it are dark
/// alike there, and what is around tells.
const SURROUNDINGS_MM: f64 = 4.0;
/// Grey value of a whole membership in an image of memberships, so that it counts as tissue.
const WHOLE: f32 = 1000.0;

/// Membership of planning's tissue in each range of HU, blurred.
fn ranges(planning: &Volume<f32>, sigma: f64) -> Vec<Volume<f32>> {
    let of = |k: usize| {
        let share = planning.map(|hu| if Tissue::is_air(*hu) { *hu } else { WHOLE * memberships(*hu)[k] });
        Tissue::blurred(&share, sigma).value
    };
    (0..RANGES).map(of).collect()
}

/// What they are at a place.
fn shares(ranges: &[Volume<f32>], place: &Point3<f64>) -> [f32; RANGES] {
    std::array::from_fn(|k| {
        let index = ranges[k].grid().index_within(place);
        trilinear(&ranges[k], &index).map_or(0.0, |v| v as f32 / WHOLE)
    })
}

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
        let by_ranges = options.measure == Measure::CorrelationRatio;
        let lists = candidates(skeleton, labels, if by_ranges { SURROUNDINGS_MM } else { SHELL_MM });
        let mut all: Vec<u32> = lists.iter().flatten().copied().collect();
        all.sort_unstable();
        let mut levels: Vec<Drawn> = Vec::new();
        for resolution in std::iter::once(Self::START).chain(options.outward.iter().chain(&options.levels).copied()) {
            if levels.iter().any(|l| l.resolution == resolution) {
                continue;
            }
            let Resolution { blur_mm: sigma, samples: most } = resolution;
            let blurred = Tissue::blurred(planning, sigma);
            let ranges = if by_ranges { ranges(planning, sigma) } else { Vec::new() };
            let draw = |list: &[u32], most| {
                let mut samples = draw(list, planning.grid(), &blurred, most);
                if by_ranges {
                    samples.memberships = samples.points.iter().map(|p| shares(&ranges, p)).collect();
                }
                samples
            };
            let bones = lists.iter().map(|l| draw(l, most)).collect();
            levels.push(Drawn { resolution, bones, all: draw(&all, START_SAMPLES) });
        }
        Self { levels, anatomy: Anatomy::new(planning, labels, by_ranges) }
    }

    /// Resolution of the search for the couch shift; another blur was never measured.
    pub(super) const START: Resolution = Resolution { blur_mm: 6.0, samples: START_SAMPLES };

    /// The samples at a resolution; `None` for one that the options did not name.
    pub(super) fn at(&self, resolution: Resolution) -> Option<&Drawn> {
        self.levels.iter().find(|l| l.resolution == resolution)
    }
}
