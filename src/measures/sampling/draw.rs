//! Drawing samples: bones from what the fit leaves open, tissue behind them and by itself.

use super::beside::{held, touches};
use super::model::{TissueModel, brought};
use super::noise::Noise;
use super::options::{Correlation, SamplingOptions};
use super::unfold::unfold;
use crate::error::Result;
use crate::geometry::Rigid;
use crate::volume::Volume;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;
use rayon::prelude::*;

/// A random field has at most this share of its length as deviation: over less it would fold tissue, so the next length takes
/// the rest.
const STEEPEST: f32 = 0.11;
/// Steps in which displacements are kept, per mm: smaller ones would be noise in the file.
const STEPS: f32 = 128.0;

/// A sample of a registration: what is added to the field that was found.
#[derive(Debug, Clone)]
pub struct Drawn {
    /// What moves each bone on from its fitted pose, in the fraction's frame; in the order of the posterior.
    pub bones: Vec<Rigid>,
    /// What moves tissue on, at nodes over the planning scan, LPS mm; 0 away from the patient.
    pub tissue: Volume<[f32; 3]>,
}

/// Random numbers of one kind for one sample: the same for the same keys, whatever else is drawn.
fn numbers(seed: u64, key: u64, sample: usize) -> ChaCha8Rng {
    let mut rng = ChaCha8Rng::seed_from_u64(seed ^ key);
    rng.set_stream(sample as u64);
    rng
}

impl TissueModel<'_> {
    /// Draws samples, the same bits for the same seed.
    ///
    /// # Errors
    /// Only for internal inconsistency of grids.
    pub fn draw(&self, options: &SamplingOptions) -> Result<Vec<Drawn>> {
        let draws = self.patient.posterior.draws(self.patient.strain.factor);
        let Correlation { lengths_mm, first_share, common_tissue, common_bones } = self.patient.correlation;
        let noise = lengths_mm.map(|length| Noise::new(&self.grid, length));
        let (own, common) = (self.own_key(), self.common_key());
        let numbers = |key: u64, sample| [own, common].map(|k| numbers(options.seed, k.wrapping_add(key), sample));
        let shares = [(1.0 - common_tissue).sqrt() as f32, common_tissue.sqrt() as f32];
        let mut between = vec![false; self.grid.len()];
        self.nodes.iter().for_each(|node| between[node.at] = !touches(node.beside));
        let one = |sample: usize| {
            let bones = draws.draw(&mut numbers(1, sample), common_bones);
            let mut rngs = numbers(0, sample);
            let mut fields = || {
                noise.each_ref().map(|noise| {
                    let [own, common] = rngs.each_mut().map(|rng| noise.draw(rng));
                    let both = own.into_iter().zip(common).map(|(o, c)| shares[0] * o + shares[1] * c);
                    both.collect::<Vec<f32>>()
                })
            };
            let components = [fields(), fields(), fields()];
            let mut tissue = vec![[0f32; 3]; self.grid.len()];
            for node in &self.nodes {
                let by_bones = brought(node, &self.patient.posterior.bones, &bones);
                let deviations = split(node.own_mm, first_share as f32, lengths_mm);
                let component = |a: usize| {
                    let own: f32 = components[a].iter().zip(deviations).map(|(field, mm)| mm * field[node.at]).sum();
                    own + by_bones[a] as f32
                };
                tissue[node.at] = [component(0), component(1), component(2)];
            }
            let hold = |tissue: &mut [[f32; 3]]| {
                for node in &self.nodes {
                    tissue[node.at] = held(node.beside, &node.moved, &bones, tissue[node.at]);
                }
            };
            hold(&mut tissue);
            let mut tissue = unfold(&self.grid, &self.found, &between, tissue, hold);
            tissue.iter_mut().for_each(|v| *v = v.map(|mm| (mm * STEPS).round() / STEPS));
            Ok(Drawn { bones, tissue: Volume::new(self.grid.clone(), tissue)? })
        };
        (0..options.number).into_par_iter().map(one).collect()
    }

    /// What the registration's own numbers begin with: other for each fraction.
    fn own_key(&self) -> u64 {
        let bones = self.patient.posterior.bones.iter();
        let values = bones.flat_map(|b| [b.centre.x, b.centre.y, b.centre.z, b.position_sd_mm]);
        hash(values.map(f64::to_bits))
    }

    /// What the numbers begin with that fractions of one planning scan share.
    fn common_key(&self) -> u64 {
        let labels = self.patient.bones.volume.data().iter().enumerate().filter(|(_, l)| **l != 0);
        hash(labels.step_by(97).map(|(n, l)| (n as u64) << 16 | u64::from(*l)))
    }
}

/// A deviation as those of fields of three lengths, mm; their squares add up to its own.
fn split(mm: f32, first_share: f32, lengths_mm: [f64; 3]) -> [f32; 3] {
    let steepest = lengths_mm.map(|length| STEEPEST * length as f32);
    let first = (first_share.sqrt() * mm).min(steepest[0]);
    let rest = (mm * mm - first * first).max(0.0).sqrt();
    let second = rest.min(steepest[1]);
    [first, second, (rest * rest - second * second).max(0.0).sqrt()]
}

/// A number of 64 bits that changes with each of its parts (FNV-1a).
fn hash(parts: impl Iterator<Item = u64>) -> u64 {
    parts.fold(0xcbf2_9ce4_8422_2325, |h, part| (h ^ part).wrapping_mul(0x0100_0000_01b3).rotate_left(17))
}

#[cfg(test)]
#[expect(clippy::float_cmp, reason = "zeros that nothing was added to")]
mod tests {
    use super::super::{PosePosterior, PosedBone, SampledPatient, Strain};
    use super::*;
    use crate::geometry::Grid;
    use crate::volume::{LabelMap, Mask, Spans};
    use nalgebra::Point3;

    /// A ball of tissue around a ball of bone, of which the map says 1 mm everywhere, or nothing.
    struct Ball {
        bones: LabelMap,
        body: Mask,
        map: Spans<f32>,
        push: Volume<[f32; 3]>,
        posterior: PosePosterior,
        strain: Strain,
    }

    impl Ball {
        fn new(told: f32, bone_mm: f64) -> Self {
            let grid = Grid::axis_aligned([60, 60, 50], [2.0, 2.0, 2.5], [0.0; 3]).unwrap();
            let middle = Point3::new(60.0, 60.0, 60.0);
            let within = |mm: f64| Volume::from_fn(grid.clone(), |l| (grid.centre(grid.voxel(l)) - middle).norm() < mm);
            let bone = PosedBone {
                name: "bone".into(),
                label: 3,
                centre: middle + nalgebra::Vector3::new(4.0, 0.0, 0.0),
                // It hardly turns.
                radius_mm: 1e6,
                position_sd_mm: bone_mm,
            };
            let (body, core) = (within(50.0), within(10.0));
            Self {
                bones: LabelMap {
                    volume: core.map(|b| if *b { 3 } else { 0 }),
                    names: [(3, "bone".to_owned())].into(),
                },
                map: Spans::of_volume(&body.map(|b| if *b { told } else { -1.0 })),
                body,
                push: Volume::filled(grid, [4.0, 0.0, 0.0]),
                posterior: PosePosterior::new(vec![bone], None),
                strain: Strain::default(),
            }
        }

        fn drawn(&self, correlation: Correlation, options: &SamplingOptions) -> Vec<Drawn> {
            let patient = SampledPatient {
                posterior: &self.posterior,
                bones: &self.bones,
                body: &self.body,
                uncertainty: &self.map,
                most_mm: 10.0,
                push: &self.push,
                correlation,
                strain: self.strain,
            };
            TissueModel::new(patient, options.scale).unwrap().draw(options).unwrap()
        }
    }

    /// Of two sets of samples the mean product of their components over the nodes within the ball's tissue, mm^2.
    fn product(a: &[Drawn], b: &[Drawn]) -> f64 {
        let grid = a[0].tissue.grid();
        let inner = |l: &usize| {
            let far = (grid.centre(grid.voxel(*l)) - Point3::new(60.0, 60.0, 60.0)).norm();
            (25.0..40.0).contains(&far)
        };
        let nodes: Vec<usize> = (0..grid.len()).filter(inner).collect();
        let of = |(a, b): (&Drawn, &Drawn)| {
            let each = nodes.iter().flat_map(|l| [0, 1, 2].map(|c| a.tissue.data()[*l][c] * b.tissue.data()[*l][c]));
            each.map(f64::from).sum::<f64>()
        };
        a.iter().zip(b).map(of).sum::<f64>() / (3 * nodes.len() * a.len()) as f64
    }

    /// Mean square of a component, mm^2.
    fn square(drawn: &[Drawn]) -> f64 {
        product(drawn, drawn)
    }

    #[test]
    fn tissue_deviates_as_the_map_says_and_not_at_all_where_it_says_nothing() {
        let options = SamplingOptions { number: 40, ..SamplingOptions::default() };
        // At nodes, which have more than what is read between them: the more, the shorter the length.
        for (correlation, more) in [(Correlation::CT, 1.115), (Correlation::OTHER, 1.023)] {
            let found = square(&Ball::new(1.0, 0.05).drawn(correlation, &options)).sqrt();
            assert!((found / (more * options.scale) - 1.0).abs() < 0.08, "{found} for {}", more * options.scale);
        }
        let still = Ball::new(0.0, 0.0).drawn(Correlation::CT, &options);
        assert!(square(&still) == 0.0 && still.iter().all(|d| d.tissue.data()[0] == [0.0; 3]));
        // What is not known inside the patient counts as the most.
        let unknown = square(&Ball::new(-1.0, 0.05).drawn(Correlation::CT, &options)).sqrt();
        assert!((unknown / 5.0 - 1.0).abs() < 0.25, "{unknown}");
    }

    #[test]
    fn a_strained_patient_deviates_more_within_bounds() {
        let options = SamplingOptions { number: 40, ..SamplingOptions::default() };
        let strain = Strain { median_log_volume: 0.06, factor: 2.0 };
        let ratio = |told: f32| {
            let usual = square(&Ball::new(told, 0.05).drawn(Correlation::OTHER, &options)).sqrt();
            let strained = Ball { strain, ..Ball::new(told, 0.05) };
            square(&strained.drawn(Correlation::OTHER, &options)).sqrt() / usual
        };
        // Where the map says the most that counts, only the bones' share grows.
        let (usual, most) = (ratio(0.4), ratio(10.0));
        assert!((usual - 2.0).abs() < 0.02 && (most - 1.0).abs() < 1e-3, "{usual} {most}");
    }

    #[test]
    fn what_the_bones_account_for_does_not_count_twice() {
        // Bones that may be off by all that the map says leave a quarter of its variance to tissue.
        let options = SamplingOptions { number: 60, scale: 1.0, ..SamplingOptions::default() };
        let found = square(&Ball::new(1.0, 1.0).drawn(Correlation::CT, &options));
        assert!((found - 1.25).abs() < 0.2, "{found}");
    }

    #[test]
    fn the_same_seed_draws_the_same_and_fractions_share_their_part() {
        let options = SamplingOptions { number: 30, ..SamplingOptions::default() };
        let (first, mut other) = (Ball::new(1.0, 0.05), Ball::new(1.0, 0.05));
        let drawn = first.drawn(Correlation::OTHER, &options);
        let fewer = first.drawn(Correlation::OTHER, &SamplingOptions { number: 3, ..options });
        for (a, b) in fewer.iter().zip(&drawn) {
            assert!(a.tissue == b.tissue && a.bones == b.bones);
        }
        let seeded = first.drawn(Correlation::OTHER, &SamplingOptions { seed: 1, number: 2, ..options });
        assert!(seeded[0].tissue != drawn[0].tissue);
        // The same planning side in another fraction: a quarter of the variance is the same.
        other.posterior.bones[0].centre.x += 1.5;
        let there = other.drawn(Correlation::OTHER, &options);
        let share = product(&drawn, &there) / square(&drawn);
        assert!((share - 0.25).abs() < 0.12, "{share}");
    }

    #[test]
    fn a_large_deviation_goes_with_a_longer_length() {
        let [near, far, wide] = split(0.4, 0.5, Correlation::CT.lengths_mm);
        assert!((near - far).abs() < 1e-6 && wide == 0.0);
        let [near, far, wide] = split(10.0, 0.5, Correlation::CT.lengths_mm);
        assert!(near < 0.9 && far < 2.0 && wide > 9.0);
        assert!((near * near + far * far + wide * wide - 100.0).abs() < 1e-3);
    }
}
