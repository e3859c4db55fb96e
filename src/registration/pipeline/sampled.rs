//! Plausible registrations beside the one that was found, and doses through them.

use super::{Outcome, PlanningScan};
use crate::dose::{displacement, dose_at};
use crate::error::{Error, Result};
use crate::evaluate::{Direction, FieldPair};
use crate::geometry::Grid;
use crate::sampling::{
    Correlation, Drawn, PosePosterior, SampleSet, SampledPatient, SamplingOptions, Strain, TissueModel,
};
use crate::stats::percentile;
use crate::volume::Volume;
use nalgebra::{Point3, Vector3};
use rayon::prelude::*;

/// Whether the fraction's grey values are not a CT's.
fn other(outcome: &Outcome) -> bool {
    outcome.kind.as_ref().is_some_and(|k| k.mr.is_some() || k.corrected)
}

/// Over what lengths a registration's errors are alike: longer ones where the fraction's grey values are not a CT's.
pub fn correlation(outcome: &Outcome) -> Correlation {
    if other(outcome) { Correlation::OTHER } else { Correlation::CT }
}

/// How much a registration deforms soft tissue of which something is known.
fn strain(planning: &PlanningScan, outcome: &Outcome) -> Strain {
    let (grid, bone) = (planning.bones.volume.grid(), planning.bones.volume.data());
    let known = |l: usize| outcome.uncertainty.as_ref().is_none_or(|(map, _)| map.at(grid.voxel(l)) >= 0.0);
    let usual = if other(outcome) { Strain::USUAL_OTHER } else { Strain::USUAL_CT };
    Strain::of(&outcome.jacobian.to_volume(), usual, |l| outcome.body.data()[l] && bone[l] == 0 && known(l))
}

/// Where the map tells more than this, mm, or that nothing is known, this counts: on cases with known truth nine of ten errors
/// there are below it.
const MOST_MM: f64 = 10.0;

/// Draws samples of a registration, with the strain that they were drawn by; the same bits for the same seed, at any number of
/// threads.
///
/// # Errors
/// [`Error::Usage`] for options out of range; [`Error::Input`] when the run has no map of uncertainty.
pub fn sample(planning: &PlanningScan, outcome: &Outcome, options: &SamplingOptions) -> Result<(Vec<Drawn>, Strain)> {
    if let Some(problem) = options.problem() {
        return Err(Error::usage(problem, "give 20 to 100 samples"));
    }
    let (Some(posterior), Some((uncertainty, _))) = (&outcome.posterior, &outcome.uncertainty) else {
        let problem =
            "it has no uncertainty to sample: the map of uncertainty or the posterior of the bones is missing";
        return Err(Error::input("the registration", problem, "register with uncertainty = true in [output]"));
    };
    let strain = strain(planning, outcome);
    let patient = SampledPatient {
        posterior,
        bones: &planning.bones,
        body: &outcome.body,
        uncertainty,
        most_mm: MOST_MM,
        push: &outcome.push.displacement,
        correlation: correlation(outcome),
        strain,
    };
    Ok((TissueModel::new(patient, options.scale)?.draw(options)?, strain))
}

/// Draws samples of a registration, ready to be read.
///
/// # Errors
/// As [`sample`].
pub fn sample_set(planning: &PlanningScan, outcome: &Outcome, options: &SamplingOptions) -> Result<SampleSet> {
    let (drawn, _) = sample(planning, outcome, options)?;
    let bones: Vec<u16> = outcome.posterior.as_ref().map(PosePosterior::labels).unwrap_or_default();
    SampleSet::new(&planning.bones.volume, &bones, &drawn)
}

/// The whole field of one sample: planning to fraction on the planning grid, LPS mm.
pub fn sampled_field(push: &Volume<[f32; 3]>, samples: &SampleSet, sample: usize) -> Volume<[f32; 3]> {
    let grid = push.grid();
    let at = |l: usize| {
        let (x, u) = (grid.centre(grid.voxel(l)), Vector3::from(push.data()[l].map(f64::from)));
        (u + samples.one(sample, &x, &(x + u))).map(|c| c as f32).into()
    };
    Volume::from_fn(grid.clone(), at)
}

/// Rounds that look for the place in planning which a sample brings to a place of the fraction: what a sample adds changes little
/// over what it adds.
const ROUNDS: usize = 3;

/// Doses through samples, added up, on one grid.
#[derive(Debug, Clone)]
pub struct DoseSamples {
    grid: Grid,
    number: usize,
    /// At each voxel the doses of all samples, Gy.
    values: Vec<f32>,
    /// At each voxel the sum of the variances of what was added one by one, Gy^2.
    apart: Vec<f32>,
    /// Sum of the weights of what was added, and of their squares.
    weights: [f64; 2],
}

/// Mean, deviation and percentiles of a dose over samples, Gy, on its grid.
#[derive(Debug, Clone)]
pub struct DoseSpread {
    /// Mean.
    pub mean: Volume<f32>,
    /// Standard deviation.
    pub sd: Volume<f32>,
    /// 5th percentile.
    pub p05: Volume<f32>,
    /// 95th percentile.
    pub p95: Volume<f32>,
    /// Where several doses were added: the variance due to what their registrations have in common, Gy^2, from how the doses vary
    /// together; of a single voxel with the noise of so few samples, below 0 too.
    pub common: Option<Volume<f32>>,
}

impl DoseSamples {
    /// No dose, on a grid.
    pub fn zero(grid: &Grid, number: usize) -> Self {
        let (values, apart) = (vec![0.0; number * grid.len()], vec![0.0; grid.len()]);
        Self { grid: grid.clone(), number, values, apart, weights: [0.0; 2] }
    }

    /// How many samples there are.
    pub fn number(&self) -> usize {
        self.number
    }

    /// Adds `weight` times a dose, carried through each sample of a registration: sample by sample, so that those of another
    /// fraction add up with these one by one. A dose beyond its grid is 0, as without samples.
    ///
    /// # Errors
    /// [`Error::Input`] when there are fewer samples than of what was added before.
    pub fn add(
        &mut self,
        weight: f64,
        dose: &Volume<f32>,
        pair: &FieldPair,
        direction: Direction,
        samples: &SampleSet,
    ) -> Result<()> {
        if samples.number() != self.number {
            let problem = format!("{} samples of one registration and {} of another", self.number, samples.number());
            return Err(Error::input("samples", problem, "draw as many of each"));
        }
        let (grid, stride) = (&self.grid, self.grid.strides()[2]);
        let way = Way { dose, pair, samples };
        let planes = self.values.par_chunks_mut(self.number * stride).zip(self.apart.par_chunks_mut(stride));
        planes.enumerate().for_each_init(
            || (vec![Vector3::zeros(); samples.number()], vec![0f32; samples.number()]),
            |(room, own), (k, (values, apart))| {
                for (l, (out, apart)) in values.chunks_mut(samples.number()).zip(apart).enumerate() {
                    let p = grid.centre(grid.voxel(k * stride + l));
                    match direction {
                        Direction::FractionToPlanning => way.to_planning(weight, &p, room, own),
                        Direction::PlanningToFraction => way.to_fraction(weight, &p, own),
                    }
                    out.iter_mut().zip(own.iter()).for_each(|(out, own)| *out += own);
                    *apart += variance(own.iter().map(|v| f64::from(*v))) as f32;
                }
            },
        );
        self.weights = [self.weights[0] + weight, self.weights[1] + weight * weight];
        Ok(())
    }

    /// The dose of one sample.
    ///
    /// # Errors
    /// Only for internal inconsistency of grids.
    pub fn sample(&self, n: usize) -> Result<Volume<f32>> {
        Volume::new(self.grid.clone(), self.values.iter().skip(n).step_by(self.number).copied().collect())
    }

    /// What varies over the samples.
    ///
    /// # Errors
    /// Only for internal inconsistency of grids.
    pub fn spread(&self) -> Result<DoseSpread> {
        let of = |values: &[f32]| {
            let mut sorted: Vec<f64> = values.iter().map(|v| f64::from(*v)).collect();
            let mean = sorted.iter().sum::<f64>() / sorted.len() as f64;
            let sd = variance(sorted.iter().copied()).sqrt();
            sorted.sort_unstable_by(f64::total_cmp);
            let [low, high] = [5.0, 95.0].map(|p| percentile(&sorted, p));
            [mean, sd, low, high].map(|v| v as f32)
        };
        let all: Vec<[f32; 4]> = self.values.par_chunks(self.number).map(of).collect();
        let map = |n: usize| Volume::new(self.grid.clone(), all.iter().map(|v| v[n]).collect());
        // Of doses c + e_k with weights w_k and a common c the products of unlike ones hold var(c) (S^2 - sum of w_k^2), S = sum of w_k.
        let [sum, squares] = self.weights;
        let unlike = sum * sum - squares;
        let common = |(all, apart): (&[f32; 4], &f32)| {
            ((f64::from(all[1]).powi(2) - f64::from(*apart)) * sum * sum / unlike) as f32
        };
        let common = || Volume::new(self.grid.clone(), all.iter().zip(&self.apart).map(common).collect());
        let common = (unlike > 1e-9 * sum * sum).then(common).transpose()?;
        Ok(DoseSpread { mean: map(0)?, sd: map(1)?, p05: map(2)?, p95: map(3)?, common })
    }
}

/// Variance of samples; 0 of a single one.
fn variance(values: impl ExactSizeIterator<Item = f64> + Clone) -> f64 {
    let n = values.len() as f64;
    let mean = values.clone().sum::<f64>() / n;
    values.map(|v| (v - mean).powi(2)).sum::<f64>() / (n - 1.0).max(1.0)
}

/// What a dose is carried by.
struct Way<'a> {
    dose: &'a Volume<f32>,
    pair: &'a FieldPair,
    samples: &'a SampleSet,
}

impl Way<'_> {
    /// The fraction's dose at a place `x` of planning.
    fn to_planning(&self, weight: f64, x: &Point3<f64>, room: &mut [Vector3<f64>], out: &mut [f32]) {
        let moved = x + displacement(&self.pair.push.displacement, x);
        self.samples.at(x, &moved, room);
        for (out, added) in out.iter_mut().zip(room) {
            *out = (weight * dose_at(self.dose, &(moved + *added))) as f32;
        }
    }

    /// Planning's dose at a place `y` of the fraction.
    fn to_fraction(&self, weight: f64, y: &Point3<f64>, out: &mut [f32]) {
        let back = |p: Point3<f64>| p + displacement(&self.pair.pull.displacement, &p);
        let first = back(*y);
        for (sample, out) in out.iter_mut().enumerate() {
            let (mut x, mut moved) = (first, *y);
            for _ in 0..ROUNDS {
                moved = y - self.samples.one(sample, &x, &moved);
                x = back(moved);
            }
            *out = (weight * dose_at(self.dose, &x)) as f32;
        }
    }
}
