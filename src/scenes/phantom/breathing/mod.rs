//! A chest that breathes: two lungs, and what lies below them, slide along a resting chest wall.
//!
//! The truth is discontinuous at the pleura, and tangential to it there; within each part it is
//! smooth, with an exact inverse ([`BreathingMotion`]). Bones move with the patient's setup alone,
//! so they are exactly rigid.

mod motion;
mod options;
mod scene;

pub use motion::{BreathingMotion, Part};
pub use options::BreathingOptions;

use super::shape::V3;
use super::texture::{stored, voxel_noise};
use super::voxel::Voxel;
use crate::error::Result;
use crate::evaluate::landmark::Landmark;
use crate::field::PushField;
use crate::geometry::Rigid;
use crate::volume::{LabelMap, Mask, Volume};
use motion::{Inner, TUBES};
use nalgebra::Point3;
use rayon::prelude::*;
use scene::ChestScene;

/// Places in the disc where points of known motion lie.
const PLACES: [[f64; 2]; 6] = [[0.0, 0.0], [0.6, 0.0], [-0.5, 0.3], [0.2, -0.6], [-0.2, 0.7], [0.5, 0.5]];
/// Directions in the disc, degrees, in which a pair of points lies on both sides of the pleura.
const AROUND: [f64; 6] = [-150.0, -90.0, -35.0, 20.0, 75.0, 130.0];
/// Heights of the points, mm.
const HEIGHTS: [f64; 5] = [-60.0, -100.0, -140.0, -175.0, -205.0];
/// How far the points of a pair lie from the pleura, mm.
const ASIDE: f64 = 3.5;

/// A planning CT and a fraction CT of a breathing chest with everything that is true about them.
#[derive(Debug, Clone)]
pub struct Breathing {
    /// Planning CT, HU.
    pub planning: Volume<f32>,
    /// Bones on the planning grid with TotalSegmentator v2 names.
    pub bones: LabelMap,
    /// `lung_left`, `lung_right`, `stomach` and `liver` on the planning grid.
    pub organs: LabelMap,
    /// Patient on the planning grid, lungs filled.
    pub body: Mask,
    /// Fraction CT, HU, on its own grid.
    pub fraction: Volume<f32>,
    /// Points in both images: `lung_..`, `liver_..` and `stomach_..` move, `wall_..` rest but for
    /// the setup. Points of one number that end in `inner` and `outer` face each other across the
    /// pleura.
    pub landmarks: Vec<Landmark>,
    /// The true push map, at any point.
    pub motion: BreathingMotion,
}

impl Breathing {
    /// Makes the phantom, in the current rayon thread pool.
    ///
    /// # Errors
    /// When the options are no image or no breath.
    pub fn new(options: &BreathingOptions) -> Result<Self> {
        options.check()?;
        let (grid, fraction_grid) = (options.planning_grid()?, options.fraction_grid()?);
        let (scene, motion) = (ChestScene::new(options.edge_mm), BreathingMotion::new(options));
        let voxel = Voxel::new(options.spacing_mm, options.edge_mm);
        let at_rest = |p: &V3| scene.sample(p, |_| (*p, 1.0));
        let samples: Vec<(f32, u16, bool)> = (0..grid.len())
            .into_par_iter()
            .map(|n| {
                let x = grid.centre(grid.voxel(n)).coords;
                let s = at_rest(&x);
                let hu = scene.over(&voxel, &x, |offset| at_rest(&(x + offset)).hu).unwrap_or(s.hu);
                let noise = options.planning_noise_hu * voxel_noise(options.seed, n);
                (stored(hu + noise), s.label, s.cover >= 0.5)
            })
            .collect();
        let names = scene.bones().iter().map(|b| b.name.clone());
        let bones = LabelMap {
            volume: Volume::new(grid.clone(), samples.iter().map(|s| s.1).collect())?,
            names: (1u16..).zip(names).collect(),
        };
        let body = Volume::new(grid.clone(), samples.iter().map(|s| s.2).collect())?;
        let planning = Volume::new(grid.clone(), samples.iter().map(|s| s.0).collect())?;
        let back = motion.setup().inverse();
        let fraction = Volume::from_fn(fraction_grid.clone(), |n| {
            let middle = fraction_grid.centre(fraction_grid.voxel(n));
            let at = |offset: &V3| {
                let y = middle + offset;
                let before = |part: Part| {
                    let was = motion.pull_as(part, &y);
                    (was.coords, if options.keep_mass { motion.jacobian_as(part, &was) } else { 1.0 })
                };
                scene.sample(&(back * y).coords, before).hu
            };
            let noise = options.fraction_noise_hu * voxel_noise(options.seed.wrapping_add(1), n);
            let hu = scene.over(&voxel, &(back * middle).coords, at).unwrap_or_else(|| at(&V3::zeros()));
            stored(hu + noise)
        });
        let landmarks = landmarks(&scene, &motion);
        let organs = organs(&body, &motion);
        Ok(Self { planning, bones, organs, body, fraction, landmarks, motion })
    }

    /// The true push field on the planning grid. Voxels at the pleura hold the motion of the part
    /// that their centre lies in.
    ///
    /// # Errors
    /// Never in practice; the field has the planning grid's size.
    pub fn truth(&self) -> Result<PushField> {
        let grid = self.body.grid();
        let displacement = Volume::from_fn(grid.clone(), |n| {
            let x = grid.centre(grid.voxel(n));
            (self.motion.push(&x) - x).map(|c| c as f32).into()
        });
        Ok(PushField { displacement, computed: self.body.clone() })
    }

    /// True motion of each bone, planning to fraction, LPS mm: all of them rest in the patient.
    pub fn transforms(&self) -> impl Iterator<Item = (&str, &Rigid)> {
        self.bones.names.values().map(|name| (name.as_str(), self.motion.setup()))
    }
}

/// Lungs, and what lies below them down to the image's end.
fn organs(body: &Mask, motion: &BreathingMotion) -> LabelMap {
    let grid = body.grid();
    let volume = Volume::from_fn(grid.clone(), |n| {
        let x = grid.centre(grid.voxel(n));
        match (motion.part(&x), motion.in_lung(&x)) {
            (Part::Rest, _) => 0,
            (Part::Left, true) => 1,
            (Part::Right, true) => 2,
            (Part::Left, false) => 3,
            (Part::Right, false) => 4,
        }
    });
    let names = ["lung_left", "lung_right", "stomach", "liver"].map(str::to_owned);
    LabelMap { volume, names: (1u16..).zip(names).collect() }
}

/// Points of known motion in the lungs and the organs below, and pairs of points across the pleura.
fn landmarks(scene: &ChestScene, motion: &BreathingMotion) -> Vec<Landmark> {
    let mut out = Vec::new();
    let mut add = |name: String, x: V3| {
        let planning = Point3::from(x);
        out.push(Landmark { name, planning, fraction: motion.push(&planning) });
    };
    for tube in &TUBES {
        let (side, below) = if tube.part == Part::Left { ("left", "stomach") } else { ("right", "liver") };
        let mut number = 0;
        for z in HEIGHTS {
            for [x, y] in PLACES {
                let at = Inner { x, y, z };
                number += 1;
                let above = tube.above_diaphragm(&at);
                if above.abs() > 4.0 {
                    let organ = if above > 0.0 { format!("lung_{side}") } else { below.to_owned() };
                    add(format!("{organ}_{number:02}"), tube.outer(&at));
                }
            }
            for angle in AROUND {
                number += 1;
                let (y, x) = angle.to_radians().sin_cos();
                let (rim, inner) = (tube.outer(&Inner { x, y, z }), tube.outer(&Inner { x: 0.9 * x, y: 0.9 * y, z }));
                let outwards = (rim - inner).normalize();
                let pair = [rim - outwards * ASIDE, rim + outwards * ASIDE];
                if scene.bone(&pair[1]).is_none_or(|(_, d)| d > 1.0) {
                    add(format!("organs_{side}_{number:02}_inner"), pair[0]);
                    add(format!("wall_{side}_{number:02}_outer"), pair[1]);
                }
            }
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::OnceLock;

    /// One coarse phantom without noise.
    fn plain() -> &'static Breathing {
        static ONE: OnceLock<Breathing> = OnceLock::new();
        ONE.get_or_init(|| Breathing::new(&plain_options()).unwrap())
    }

    fn plain_options() -> BreathingOptions {
        BreathingOptions { planning_noise_hu: 0.0, fraction_noise_hu: 0.0, ..BreathingOptions::coarse() }
    }

    #[test]
    fn bones_lie_outside_of_the_pleura_and_move_rigidly() {
        let p = plain();
        let (grid, counts) = (p.bones.volume.grid(), p.bones.counts());
        assert_eq!((p.bones.names.len(), counts.len()), (33, 33));
        assert!(counts.values().all(|n| *n >= 15), "{counts:?}");
        let truth = p.truth().unwrap();
        for n in (0..grid.len()).filter(|&n| p.bones.volume.data()[n] > 0) {
            let x = grid.centre(grid.voxel(n));
            let label = &p.bones.names[&p.bones.volume.data()[n]];
            assert!(p.motion.pleura_distance(&x) > 0.5, "{label} at {x}: {} mm", p.motion.pleura_distance(&x));
            assert!(p.body.data()[n] && p.planning.data()[n] > 20.0, "{label} at {x}: {} HU", p.planning.data()[n]);
            let u = V3::from(truth.displacement.data()[n].map(f64::from));
            assert!((x + u - p.motion.setup() * x).norm() < 1e-4);
        }
        assert_eq!(p.transforms().count(), 33);
    }

    #[test]
    fn the_fraction_shows_the_planning_anatomy_through_the_inverse() {
        let p = Breathing::new(&BreathingOptions { keep_mass: false, ..plain_options() }).unwrap();
        let grid = p.fraction.grid();
        let scene = ChestScene::new(plain_options().edge_mm);
        let (mut seen, mut in_lung) = (0, 0);
        for n in (0..grid.len()).step_by(5) {
            let y = grid.centre(grid.voxel(n));
            let x = p.motion.pull(&y);
            // At the pleura a voxel shows both sides, which were not neighbours before.
            if p.motion.pleura_distance(&x).abs() > 3.0 {
                let expected = scene.sample(&x.coords, |_| (x.coords, 1.0)).hu;
                assert!((f64::from(p.fraction.data()[n]) - expected).abs() < 1.0, "{y} from {x}: {expected}");
                seen += 1;
                in_lung += usize::from(p.motion.in_lung(&x));
            }
        }
        assert!(seen > 20_000 && in_lung > 2_000, "{seen} {in_lung}");
    }

    #[test]
    fn lungs_show_vessels_and_air_comes_in() {
        let p = plain();
        let grid = p.planning.grid();
        let of = |label: u16| {
            let own = p.organs.volume.data().iter().enumerate().filter(move |(_, l)| **l == label);
            own.map(|(n, _)| f64::from(p.planning.data()[n])).collect::<Vec<_>>()
        };
        for (label, least_ml) in [(1, 800.0), (2, 900.0)] {
            let hu = of(label);
            let volume = hu.len() as f64 * grid.voxel_volume() / 1000.0;
            let vessels = hu.iter().filter(|v| **v > -600.0).count() as f64 / hu.len() as f64;
            assert!(volume > least_ml && (0.03..0.4).contains(&vessels), "{volume} ml, {vessels}");
        }
        let liver = of(4);
        let mean = liver.iter().sum::<f64>() / liver.len() as f64;
        assert!((40.0..80.0).contains(&mean), "{mean}");
        // Lung tissue, as its density tells, is as much in the fraction; the belly goes on beyond
        // the image.
        let fraction = p.fraction.grid();
        let mass = |image: &Volume<f32>, lung: &dyn Fn(&Point3<f64>) -> bool| {
            let g = image.grid();
            let own = (0..g.len()).filter(|&n| lung(&g.centre(g.voxel(n))));
            own.map(|n| f64::from(image.data()[n] + 1000.0)).sum::<f64>() * g.voxel_volume()
        };
        let before = mass(&p.planning, &|x| p.motion.in_lung(x) && p.motion.pleura_distance(x) < -4.0);
        let after = mass(&p.fraction, &|y| {
            let x = p.motion.pull(y);
            p.motion.in_lung(&x) && p.motion.pleura_distance(&x) < -4.0
        });
        // Vessels keep their density, so there is somewhat more.
        assert!(fraction.len() > 10_000 && (0.98..1.15).contains(&(after / before)), "{}", after / before);
    }

    #[test]
    fn points_follow_the_truth_and_pairs_face_each_other_across_the_pleura() {
        let p = plain();
        let named = |word: &str| p.landmarks.iter().filter(|l| l.name.starts_with(word)).collect::<Vec<_>>();
        assert!(named("lung_left").len() >= 15 && named("lung_right").len() >= 15, "{}", named("lung").len());
        assert!(named("wall_").len() >= 30 && !named("liver").is_empty() && !named("stomach").is_empty());
        for l in &p.landmarks {
            assert!((p.motion.push(&l.planning) - l.fraction).norm() < 1e-12, "{}", l.name);
            let part = p.motion.part(&l.planning);
            assert_eq!(part == Part::Rest, l.name.starts_with("wall"), "{}", l.name);
        }
        let mut slips = Vec::new();
        for outer in named("wall_") {
            let inner = outer.name.replace("wall", "organs").replace("outer", "inner");
            let inner = p.landmarks.iter().find(|l| l.name == inner).unwrap();
            assert!(((inner.planning - outer.planning).norm() - 2.0 * ASIDE).abs() < 1e-9);
            slips.push(((inner.fraction - inner.planning) - (outer.fraction - outer.planning)).norm());
        }
        assert!(slips.iter().filter(|s| **s > 5.0).count() * 2 > slips.len(), "{slips:?}");
    }

    #[test]
    fn same_bits_at_one_and_two_threads_and_nonsense_is_refused() {
        let make = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            let options = BreathingOptions { spacing_mm: [9.0, 9.0, 10.0], ..BreathingOptions::default() };
            pool.install(|| Breathing::new(&options).unwrap())
        };
        let (one, two) = (make(1), make(2));
        assert!(one.planning == two.planning && one.fraction == two.fraction && one.landmarks == two.landmarks);
        let refused = |options: BreathingOptions| Breathing::new(&options).unwrap_err().to_string();
        assert!(refused(BreathingOptions { amplitude_mm: 80.0, ..plain_options() }).contains("amplitude"));
        assert!(refused(BreathingOptions { spacing_mm: [0.0, 1.0, 1.0], ..plain_options() }).contains("spacing"));
        assert!(refused(BreathingOptions { setup_shift_mm: [f64::NAN; 3], ..plain_options() }).contains("shift"));
    }
}
