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
use rayon::prelude::*;

/// Samples of all bones together that the search of the couch shift looks at.
pub(super) const START_SAMPLES: usize = 1500;

/// Width of what belongs to a bone's samples in an image of another modality, mm: cortical bone and what lies on it are dark
/// alike there, and what is around tells.
const SURROUNDINGS_MM: f64 = 4.0;
/// Reach of a blur, in standard deviations.
const REACH: f64 = 3.0;

/// How much planning's tissue in each range of HU counts at a place, blurred: the [`shares`] are what counts.
fn ranges(planning: &Volume<f32>, sigma: f64) -> Vec<Volume<f32>> {
    let of = |hu: f32| if Tissue::is_air(hu) { [0.0; RANGES] } else { memberships(hu) };
    let pair = |k: usize| {
        Tissue::spread(planning, sigma, |hu| {
            let all = of(hu);
            [all[k], all[k + 1]]
        })
    };
    (0..RANGES).step_by(2).flat_map(pair).collect()
}

/// Shares of a whole.
fn normalised(of: [f64; RANGES]) -> [f32; RANGES] {
    let all = of.iter().sum::<f64>().max(f64::MIN_POSITIVE);
    of.map(|share| (share / all) as f32)
}

/// Membership of the tissue at a place in each range.
fn shares(ranges: &[Volume<f32>], place: &Point3<f64>) -> [f32; RANGES] {
    let of: [f64; RANGES] = std::array::from_fn(|k| {
        let index = ranges[k].grid().index_within(place);
        trilinear(&ranges[k], &index).unwrap_or(0.0)
    });
    normalised(of)
}

/// Membership of the tissue at a place in each range, of voxels as near to it as a fine blur reaches: cheaper there than a blur of
/// the whole scan.
fn shares_near(planning: &Volume<f32>, sigma: f64, place: &Point3<f64>) -> [f32; RANGES] {
    let grid = planning.grid();
    let index = grid.index_within(place);
    // As in a blur of all voxels, an axis that is coarser than it reaches is interpolated.
    let along = |a: usize| -> Vec<(usize, f64)> {
        let step = grid.spacing()[a] / sigma;
        let reach = if step > REACH { 1.0 } else { REACH / step };
        let first = (index[a] - reach).ceil().max(0.0) as usize;
        let last = (index[a] + reach).floor().min(grid.size()[a] as f64 - 1.0) as usize;
        let weight = |n: usize| {
            let off = n as f64 - index[a];
            if step > REACH { 1.0 - off.abs() } else { (-0.5 * (off * step).powi(2)).exp() }
        };
        (first..=last).map(|n| (n, weight(n))).collect()
    };
    let [columns, rows, slices] = [along(0), along(1), along(2)];
    let mut of = [0f64; RANGES];
    for (k, by_slice) in &slices {
        for (j, by_row) in &rows {
            for (i, by_column) in &columns {
                let hu = *planning.at([*i, *j, *k]);
                if !Tissue::is_air(hu) {
                    let weight = by_slice * by_row * by_column;
                    of.iter_mut().zip(memberships(hu)).for_each(|(sum, m)| *sum += weight * f64::from(m));
                }
            }
        }
    }
    normalised(of)
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
            let fine = Tissue::block(planning, sigma) == [1; 3];
            let ranges = if by_ranges && !fine { ranges(planning, sigma) } else { Vec::new() };
            let shares = |p: &Point3<f64>| if fine { shares_near(planning, sigma, p) } else { shares(&ranges, p) };
            let draw = |list: &[u32], most| {
                let mut samples = draw(list, planning.grid(), &blurred, most);
                if by_ranges {
                    samples.memberships = samples.points.par_iter().map(shares).collect();
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
