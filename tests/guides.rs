//! Structures that guide, on a phantom in whose fraction an organ-like ball grows or shrinks by a motion known in formulas.

#![expect(clippy::print_stdout, reason = "the numbers are shown with --nocapture")]

use crate::support::shared::{begun_near, neck};
use aventail::config::Config;
use aventail::field::PushField;
use aventail::geometry::Grid;
use aventail::phantom::Phantom;
use aventail::pipeline::{Case, Outcome, check_inputs, register};
use aventail::runtime::Runtime;
use aventail::volume::distance::squared_distance;
use aventail::volume::region::part;
use aventail::volume::{Mask, Outline, Volume, cubic};
use nalgebra::{Point3, Vector3};
use std::sync::OnceLock;

/// Radius of the ball in the fraction before it changes, mm.
const RADIUS: f64 = 12.0;

/// A ball whose volume changes, and tissue around it that gives way without losing volume, ever less up to `end`, mm.
#[derive(Clone, Copy)]
struct Swelling {
    centre: Point3<f64>,
    end: f64,
    factor: f64,
}

impl Swelling {
    /// Where a distance from the centre comes to lie.
    fn grown(&self, r: f64) -> f64 {
        if r < RADIUS {
            return self.factor.cbrt() * r;
        }
        let t = ((r - RADIUS - 3.0) / (self.end - RADIUS - 3.0)).clamp(0.0, 1.0);
        let left = 1.0 - t * t * (3.0 - 2.0 * t);
        (r.powi(3) + (self.factor - 1.0) * RADIUS.powi(3) * left).cbrt()
    }

    fn along(&self, from: &Point3<f64>, of: impl Fn(f64) -> f64) -> Point3<f64> {
        let way = from - self.centre;
        let r = way.norm();
        if r < 1e-9 || r >= self.end { *from } else { self.centre + way * (of(r) / r) }
    }

    fn push(&self, y: &Point3<f64>) -> Point3<f64> {
        self.along(y, |r| self.grown(r))
    }

    fn pull(&self, z: &Point3<f64>) -> Point3<f64> {
        self.along(z, |r| {
            let (mut low, mut high) = (0.0, self.end);
            for _ in 0..60 {
                let middle = 0.5 * (low + high);
                if self.grown(middle) < r { low = middle } else { high = middle }
            }
            0.5 * (low + high)
        })
    }
}

/// Where soft tissue is thickest, planning, and how far bone, air and skin are from there, mm.
fn thickest(phantom: &Phantom) -> (Point3<f64>, f64) {
    let grid = phantom.planning.grid();
    let soft = Volume::from_fn(grid.clone(), |n| {
        let edge = grid.voxel(n).iter().zip(grid.size()).any(|(&c, size)| c == 0 || c + 1 == size);
        !edge && phantom.body.data()[n] && phantom.bones.volume.data()[n] == 0 && phantom.planning.data()[n] > -300.0
    });
    let far = squared_distance(&soft, false);
    let (n, far) = far.data().iter().enumerate().max_by(|a, b| a.1.total_cmp(b.1)).expect("there is a voxel");
    (grid.centre(grid.voxel(n)), f64::from(far.sqrt()))
}

/// A case with a ball that changes in the fraction, outlined in both scans, and its truth.
struct Scene {
    case: Case,
    swelling: Swelling,
}

impl Scene {
    fn new(factor: f64) -> Self {
        let phantom = neck();
        let (middle, room) = thickest(phantom);
        assert!(room > RADIUS + 8.0, "{room}");
        let swelling = Swelling { centre: phantom.push(&middle), end: room, factor };
        let (there, here) = (phantom.planning.grid(), phantom.fraction.grid());
        let from = |n: usize| swelling.pull(&here.centre(here.voxel(n)));
        let hu = |n: usize| cubic(&phantom.fraction, &here.index(&from(n))).map_or(-1000.0, |(hu, _)| hu as f32);
        let inside = |y: &Point3<f64>| (y - swelling.centre).norm() < RADIUS;
        let near = |x: &Point3<f64>| (x - middle).norm() < 3.0 * RADIUS;
        let in_planning = |n: usize| {
            let x = there.centre(there.voxel(n));
            near(&x) && inside(&phantom.push(&x))
        };
        let outline = |grid: &Grid, of: &(dyn Fn(usize) -> bool + Sync)| {
            let mask: Mask = Volume::from_fn(grid.clone(), of);
            Outline::of("gland", &mask, |v| v).expect("the ball has voxels")
        };
        let mut case = begun_near(phantom.clone().into());
        case.fraction.ct = Volume::from_fn(here.clone(), hu);
        case.fraction.guides = vec![outline(here, &|n| inside(&from(n)))];
        case.planning_mut().guides = vec![outline(there, &in_planning)];
        Self { case, swelling }
    }

    /// Mean error of tissue in the ball and 8 mm around it, and from 10 to 40 mm away, mm.
    fn errors(&self, push: &PushField) -> [f64; 2] {
        let phantom = neck();
        let grid = phantom.planning.grid();
        let mut sums = [[0.0f64; 2]; 2];
        for n in 0..grid.len() {
            let soft =
                phantom.body.data()[n] && phantom.bones.volume.data()[n] == 0 && phantom.planning.data()[n] > -300.0;
            let x = grid.centre(grid.voxel(n));
            if !soft {
                continue;
            }
            let y = phantom.push(&x);
            let away = (y - self.swelling.centre).norm() - RADIUS;
            let part = match away {
                a if a < 8.0 => 0,
                a if (10.0..40.0).contains(&a) => 1,
                _ => continue,
            };
            let found = x + Vector3::from(push.displacement.data()[n].map(f64::from));
            sums[part][0] += (found - self.swelling.push(&y)).norm();
            sums[part][1] += 1.0;
        }
        sums.map(|[sum, n]| sum / n)
    }
}

/// A case without its guides.
fn unguided(case: &Case) -> Case {
    let mut case = case.clone();
    case.fraction.guides.clear();
    case.planning_mut().guides.clear();
    case
}

fn run(case: &Case, config: &Config, threads: usize) -> Outcome {
    let runtime = Runtime::new(threads, Box::new(aventail::progress::Silent)).expect("threads can be had");
    register(case, config, &runtime).expect("the scans show one patient")
}

fn config() -> Config {
    // Bones are found by fewer samples: what tissue does between them is looked at.
    let mut config = Config::default();
    config.output.uncertainty = false;
    config.fit.outward = vec![(4.0, 1000).into()];
    config.fit.levels = vec![(2.0, 2000).into()];
    config
}

fn codes(outcome: &Outcome) -> Vec<&str> {
    outcome.warnings.iter().map(|w| w.code.as_str()).collect()
}

/// A ball that grows, without guides and with them.
fn grown() -> &'static (Scene, Outcome, Outcome) {
    static ONE: OnceLock<(Scene, Outcome, Outcome)> = OnceLock::new();
    ONE.get_or_init(|| {
        let scene = Scene::new(1.6);
        let plain = run(&unguided(&scene.case), &config(), 0);
        let guided = run(&scene.case, &config(), 0);
        (scene, plain, guided)
    })
}

fn halves_the_error(scene: &Scene, plain: &Outcome, guided: &Outcome) {
    let [before, after] = [plain, guided].map(|outcome| scene.errors(&outcome.push));
    let reached = &guided.guides[0];
    println!("error {before:.3?} -> {after:.3?} mm; {reached:?}");
    // 0.51 and 0.42 measured, of which 0.5 mm and more is the posture's own error in voxels of 3 mm.
    assert!(after[0] <= 0.55 * before[0], "in and around it: {} mm, without guide {}", after[0], before[0]);
    assert!(after[1] <= 1.02 * before[1], "farther: {} mm, without guide {}", after[1], before[1]);
    assert!(guided.jacobian_report.body.folded <= plain.jacobian_report.body.folded);
    let back = |outcome: &Outcome| outcome.consistency.there_and_back_mm.p95;
    assert!(back(guided) <= back(plain) + 0.02, "{} {}", back(guided), back(plain));
    let (before, after) = (reached.before.expect("it is seen"), reached.after.expect("it is seen"));
    assert!(after.mean_mm < 0.5 * before.mean_mm && after.p95_mm < before.p95_mm && after.dice > before.dice);
    assert!((reached.fraction_ml / reached.planning_ml / scene.swelling.factor - 1.0).abs() < 0.1, "{reached:?}");
    assert!(!codes(guided).iter().any(|c| c.starts_with("guide")), "{:?}", codes(guided));
}

#[test]
fn a_ball_that_grows_is_followed_and_bones_keep_their_bits() {
    let (scene, plain, guided) = grown();
    halves_the_error(scene, plain, guided);
    let bone = scene.case.planning.bones.volume.data().iter();
    let bits = |outcome: &Outcome, n: usize| outcome.push.displacement.data()[n].map(f32::to_bits);
    let bones: Vec<usize> = bone.enumerate().filter(|(_, label)| **label > 0).map(|(n, _)| n).collect();
    assert!(bones.len() > 1000 && bones.iter().all(|&n| bits(plain, n) == bits(guided, n)));
}

#[test]
fn a_ball_that_shrinks_is_followed() {
    let scene = Scene::new(0.5);
    let (plain, guided) = (run(&unguided(&scene.case), &config(), 0), run(&scene.case, &config(), 0));
    halves_the_error(&scene, &plain, &guided);
}

#[test]
fn threads_change_no_bit_and_guides_of_no_weight_only_measure() {
    let (scene, plain, guided) = grown();
    let bits = |outcome: &Outcome| {
        outcome.push.displacement.data().iter().flat_map(|u| u.map(f32::to_bits)).collect::<Vec<u32>>()
    };
    assert!(bits(&run(&scene.case, &config(), 1)) == bits(guided), "one thread gives other bits");
    let mut measured = config();
    measured.refine.guide.weight = 0.0;
    let measured = run(&scene.case, &measured, 0);
    assert!(bits(&measured) == bits(plain), "outlines without weight move tissue");
    let reached = &measured.guides[0];
    let (before, after) = (reached.before.expect("it is seen"), reached.after.expect("it is seen"));
    assert!((before.mean_mm - after.mean_mm).abs() < 0.05, "{reached:?}");
}

#[test]
fn outlines_of_another_place_are_named() {
    let (scene, ..) = grown();
    let mut elsewhere = scene.case.clone();
    let shifted = |o: &Outline| o.clone().shifted(&Vector3::new(20.0, 0.0, 0.0));
    elsewhere.fraction.guides = elsewhere.fraction.guides.iter().map(shifted).collect();
    let outcome = run(&elsewhere, &config(), 0);
    // Firm tissue keeps it from being reached, where the images would tell that it is wrong.
    let named = codes(&outcome).iter().any(|code| ["guide-contradicts", "guide-missed"].contains(code));
    assert!(named, "{:?} {:?}", codes(&outcome), outcome.guides);
}

#[test]
fn outlines_that_are_exchanged_are_named_and_fold_nothing() {
    let (scene, plain, _) = grown();
    let mut exchanged = scene.case.clone();
    // Two halves of the ball, each under the name of the other in the fraction.
    let halves = |of: &Outline, middle: f64, names: [&str; 2]| {
        let grid = of.inside.grid();
        let half = |name: &str, left: bool| {
            let side = |n: usize| of.inside.data()[n] && (grid.centre(grid.voxel(n)).x < middle) == left;
            Outline::of(name, &Volume::from_fn(grid.clone(), side), |v| v).expect("half a ball has voxels")
        };
        vec![half(names[0], true), half(names[1], false)]
    };
    let middle = |of: &Outline| {
        let grid = of.inside.grid();
        let own = (0..grid.len()).filter(|&n| of.inside.data()[n]).map(|n| grid.centre(grid.voxel(n)).x);
        own.sum::<f64>() / of.inside.count() as f64
    };
    let (there, here) = (&scene.case.planning.guides[0], &scene.case.fraction.guides[0]);
    exchanged.planning_mut().guides = halves(there, middle(there), ["left", "right"]);
    exchanged.fraction.guides = halves(here, middle(here), ["right", "left"]);
    let outcome = run(&exchanged, &config(), 0);
    println!("{:?} {:?}", codes(&outcome), outcome.guides);
    for name in ["left", "right"] {
        let named = |w: &&aventail::warning::Warning| w.code.starts_with("guide-") && w.message.contains(name);
        assert!(outcome.warnings.iter().any(|w| named(&w)), "{name}: {:?}", codes(&outcome));
    }
    assert_eq!(outcome.jacobian_report.body.folded, plain.jacobian_report.body.folded);
}

#[test]
fn a_guide_that_the_scans_edge_cuts_is_named_and_its_cut_surface_draws_nothing() {
    let (scene, ..) = grown();
    let here = scene.case.fraction.ct.grid().clone();
    let [ni, nj, _] = here.size();
    let high = here.index(&scene.swelling.centre).z.round() as usize;
    let cut = |volume: &Volume<f32>| part(volume, &[0..ni, 0..nj, 0..high]).expect("slices of the scan");
    let mut case = scene.case.clone();
    case.fraction.ct = cut(&case.fraction.ct);
    let grid = case.fraction.ct.grid().clone();
    let inside = |n: usize| (scene.swelling.pull(&grid.centre(grid.voxel(n))) - scene.swelling.centre).norm() < RADIUS;
    let lower: Mask = Volume::from_fn(grid.clone(), inside);
    case.fraction.guides = vec![Outline::of("gland", &lower, |v| v).expect("half a ball has voxels")];
    let (plain, guided) = (run(&unguided(&case), &config(), 0), run(&case, &config(), 0));
    let [before, after] = [&plain, &guided].map(|outcome| scene.errors(&outcome.push));
    println!("error {before:.3?} -> {after:.3?} mm; {:?}", guided.guides);
    let word = guided.warnings.iter().find(|w| w.code == "guide-cut").expect("it is named");
    assert!(word.message.contains("gland"), "{}", word.message);
    assert!(after[0] < before[0] && after[1] <= 1.02 * before[1], "{before:?} {after:?}");
    let (_, _, whole) = grown();
    assert!(!codes(whole).contains(&"guide-cut"));
}

#[test]
fn equal_outlines_of_one_scan_move_hardly_anything() {
    let (scene, ..) = grown();
    let mut same = scene.case.clone();
    same.fraction.ct = same.planning.ct.clone();
    same.fraction.guides = same.planning.guides.clone();
    let outcome = run(&same, &config(), 0);
    let most =
        outcome.push.displacement.data().iter().map(|u| Vector3::from(u.map(f64::from)).norm()).fold(0.0, f64::max);
    let reached = outcome.guides[0].after.expect("it is seen");
    assert!(most < 0.3 && reached.dice > 0.995 && reached.mean_mm < 0.05, "{most} {reached:?}");
}

#[test]
fn structures_that_cannot_guide_are_named_or_refused() {
    let (scene, ..) = grown();
    let judged = |change: &dyn Fn(&mut Case, &mut Config)| {
        let (mut case, mut config) = (scene.case.clone(), config());
        change(&mut case, &mut config);
        check_inputs(&case, &config)
    };
    let told = |found: aventail::Result<Vec<aventail::warning::Warning>>| {
        found.map(|all| all.iter().any(|w| w.code == "guide-left-out" && w.message.contains("tumour")))
    };
    let one_more = |case: &mut Case| {
        let tumour = Outline { name: "tumour".into(), ..case.planning.guides[0].clone() };
        case.planning_mut().guides.push(tumour);
    };
    assert!(!told(judged(&|_, _| {})).expect("both scans outline it"));
    assert!(told(judged(&|case, _| one_more(case))).expect("the others guide"));
    let refused = |change: &dyn Fn(&mut Case, &mut Config), word: &str| {
        let error = judged(change).expect_err("it cannot guide");
        assert!(error.to_string().contains(word), "{error}");
        error.code().to_owned()
    };
    let named = |case: &mut Case, config: &mut Config| {
        one_more(case);
        config.refine.guide.names = vec!["tumour".into()];
    };
    assert_eq!(refused(&named, "in planning alone"), "guide-left-out");
    assert_eq!(refused(&|case, _| case.fraction.guides[0].name = "other".into(), "in both scans"), "guide-left-out");
    let bone = |case: &mut Case, config: &mut Config| {
        config.refine.guide.names = vec!["mandible".into()];
        case.fraction.guides[0].name = "mandible".into();
    };
    assert_eq!(refused(&bone, "is a bone"), "guide-left-out");
    refused(&|_, config| config.chainmail.relaxation.clear(), "relaxation");
}
