//! The whole fit on a neck of five blocks with a texture of their own, whose motions are known.

use crate::fit::level::Levels;
use crate::fit::schedule::Fitter;
use crate::fit::tried::{Guess, Start};
use crate::fit::{BoneSamples, DeterminedBy, FitOptions, FitResult, FitStart, GivenMotion, Measure, fit_pose};
use crate::geometry::{Grid, Rigid, about};
use crate::progress::Silent;
use crate::skeleton::{Skeleton, build};
use crate::volume::{LabelMap, Volume};
use nalgebra::{Point3, Vector3};
use std::sync::Arc;

const NECK: [&str; 5] = ["vertebrae_C7", "vertebrae_C6", "vertebrae_C5", "vertebrae_C4", "vertebrae_C3"];

/// Distance of the blocks' middles along z, mm.
const LEVEL: f64 = 20.0;

/// Which block holds a point of planning: body, two arches of unequal length, a process; 4 mm of disc between them.
fn block(p: &Point3<f64>) -> Option<usize> {
    let n = ((p.z + LEVEL / 2.0) / LEVEL).floor();
    let z = p.z - n * LEVEL;
    let (n, x) = ((0.0..5.0).contains(&n).then_some(n as usize)?, p.x - 0.6 * n);
    let body = x.abs() <= 12.0 && p.y.abs() <= 9.0 && z.abs() <= 8.0;
    let left = (6.0..11.0).contains(&x) && (0.0..28.0).contains(&p.y) && z.abs() <= 5.0;
    let right = (-12.0..-7.0).contains(&x) && (0.0..20.0).contains(&p.y) && (-6.0..4.0).contains(&z);
    let process = x.abs() <= 9.0 && (20.0..30.0 + n as f64).contains(&p.y) && z.abs() <= 4.0;
    (body || left || right || process).then_some(n)
}

/// HU of planning at a point: bone with a texture, soft tissue with a little, air around an oval neck.
fn hu(p: &Point3<f64>) -> f64 {
    let soft = 30.0 + 12.0 * (p.x / 9.0).sin() * (p.z / 11.0).cos() + 8.0 * (p.y / 7.0).cos();
    match block(p) {
        Some(n) => 500.0 + 160.0 * (p.x / 5.0 + n as f64).sin() + 120.0 * (p.y / 6.0 - 0.2 * p.z).cos(),
        None if (p.x / 48.0).powi(2) + ((p.y - 8.0) / 56.0).powi(2) < 1.0 => soft,
        None => -1000.0,
    }
}

/// The mean over a voxel, as a scanner has it: a bone's edge is no step between voxels.
fn mean(grid: &Grid, l: usize, hu: impl Fn(&Point3<f64>) -> f64) -> f64 {
    let at = Vector3::from(grid.voxel(l).map(|i| i as f64));
    let part = |n: usize| Vector3::new((n % 2) as f64, (n / 2 % 2) as f64, (n / 4) as f64).map(|i| i / 2.0 - 0.25);
    (0..8).map(|n| hu(&grid.world(&(at + part(n))))).sum::<f64>() / 8.0
}

struct Scene {
    planning: Volume<f32>,
    labels: LabelMap,
    skeleton: Skeleton,
    samples: BoneSamples,
}

impl Scene {
    fn new() -> Self {
        Self::on(Grid::axis_aligned([72, 88, 62], [1.5, 1.5, 2.0], [-54.0, -56.0, -20.0]).unwrap())
    }

    /// Planning on a grid.
    fn on(grid: Grid) -> Self {
        let planning = Volume::from_fn(grid.clone(), |l| mean(&grid, l, hu) as f32);
        let volume = Volume::from_fn(grid.clone(), |l| block(&grid.centre(grid.voxel(l))).map_or(0, |n| n as u16 + 1));
        let names = NECK.iter().enumerate().map(|(n, name)| (n as u16 + 1, (*name).to_owned())).collect();
        let labels = LabelMap { volume, names };
        let skeleton = build(&labels).unwrap().skeleton;
        let samples = BoneSamples::new(&skeleton, &planning, &labels, &FitOptions::default());
        Self { planning, labels, skeleton, samples }
    }

    fn fit(&self, fraction: &Volume<f32>, start: FitStart<'_>) -> crate::error::Result<FitResult> {
        fit_pose(&self.skeleton, &self.samples, fraction, start, &FitOptions::default(), &Silent)
    }

    /// The greatest distance of a bone's voxels from where they should be, mm.
    fn error(&self, fit: &FitResult, name: &str, truth: &Rigid) -> f64 {
        let n = self.skeleton.bones.iter().position(|b| b.name == name).unwrap();
        let label = self.skeleton.bones[n].label;
        let grid = self.labels.volume.grid();
        let of = |l: usize| (self.labels.volume.data()[l] == label).then(|| grid.centre(grid.voxel(l)));
        (0..grid.len()).filter_map(of).map(|p| (fit.transforms[n] * p - truth * p).norm()).fold(0.0, f64::max)
    }
}

/// Motions from the lowest block up: the couch, and a turn about each disc.
fn motions(couch: Rigid, bend: Vector3<f64>) -> [Rigid; 5] {
    let mut all = [couch; 5];
    for n in 1..5 {
        let disc = Point3::new(0.0, 0.0, LEVEL * (n as f64 - 0.5));
        all[n] = all[n - 1] * about(&disc, bend, Vector3::zeros());
    }
    all
}

fn couch() -> Rigid {
    about(&Point3::new(0.0, 0.0, 40.0), Vector3::new(0.03, -0.02, 0.06), Vector3::new(23.0, -14.0, 9.0))
}

fn bend() -> Vector3<f64> {
    Vector3::new(0.07, 0.02, -0.03)
}

/// The moved neck on a grid of its own, with a gain, an offset and noise; `gone`: a block that is not there.
fn fraction(motions: &[Rigid; 5], grid: Grid, gone: Option<usize>) -> Volume<f32> {
    let back = motions.map(|t| t.inverse());
    Volume::from_fn(grid.clone(), |l| {
        let value = mean(&grid, l, |y| {
            let of = |n: usize| {
                let x = back[n] * y;
                (block(&x) == Some(n) && gone != Some(n)).then(|| hu(&x))
            };
            let around = back[2] * y;
            let tissue = || if block(&around).is_some() { 35.0 } else { hu(&around) };
            (0..5).find_map(of).unwrap_or_else(tissue)
        });
        let noise = f64::from((l as u32).wrapping_mul(2_654_435_761) >> 20) / 4096.0 - 0.5;
        (if value > -900.0 { 0.96 * value + 9.0 + 20.0 * noise } else { value }) as f32
    })
}

fn whole() -> Grid {
    let turned = *nalgebra::Rotation3::from_euler_angles(0.02, -0.03, 0.1).matrix();
    Grid::new([76, 90, 66], [1.5, 1.5, 2.0], Point3::new(-35.0, -78.0, -16.0), turned).unwrap()
}

#[test]
fn a_neck_that_bends_is_found_bone_by_bone() {
    let scene = Scene::new();
    let truth = motions(couch(), bend());
    let found = scene.fit(&fraction(&truth, whole(), None), FitStart::Search).unwrap();
    for (name, truth) in NECK.iter().zip(&truth) {
        let error = scene.error(&found, name, truth);
        assert!(error < 0.5, "{name}: {error}");
    }
    for bone in &found.bones {
        assert!(bone.determined_by == DeterminedBy::Image && !bone.hit_limit(), "{bone:?}");
        assert!(bone.visible > 0.95 && bone.similarity_after.unwrap() > 0.9, "{bone:?}");
        assert!(bone.similarity_after > bone.similarity_before, "{bone:?}");
        assert!(bone.position_sd_mm > 1e-4 && bone.position_sd_mm < 0.5, "{bone:?}");
    }
    assert!(found.common_share > 0.4, "{}", found.common_share);
    assert_eq!(found.warnings, []);
    // The same from near it, and from where the truth is; a start that leads nowhere is left, with a word.
    for (start, word) in [
        (
            FitStart::Near(
                about(&Point3::origin(), Vector3::new(0.0, 0.05, 0.0), Vector3::new(4.0, 3.0, -5.0)) * couch(),
            ),
            None,
        ),
        (FitStart::Near(Rigid::translation(300.0, 40.0, 0.0)), Some("start-left")),
    ] {
        let again = scene.fit(&fraction(&truth, whole(), None), start).unwrap();
        for (name, truth) in NECK.iter().zip(&truth) {
            assert!(scene.error(&again, name, truth) < 0.5, "{name}");
        }
        assert_eq!(again.warnings.iter().map(|w| w.code.as_str()).collect::<Vec<_>>(), word.as_slice());
    }
    let source = "landmarks".to_owned();
    let known: Vec<Option<GivenMotion>> = (scene.skeleton.bones.iter())
        .map(|b| NECK.iter().position(|n| *n == b.name))
        .map(|n| n.map(|n| GivenMotion { transform: truth[n], source: source.clone(), position_sd_mm: 0.1 }))
        .collect();
    let placed = scene.fit(&fraction(&truth, whole(), None), FitStart::Placed(&known)).unwrap();
    assert!(NECK.iter().zip(&truth).all(|(name, truth)| scene.error(&placed, name, truth) < 0.5));
}

/// What an MR shows of the neck, on the scale that its patient is brought to: bright fat and marrow, dark cortical bone, darker
/// towards one side.
fn mr(ct: &Volume<f32>) -> Volume<f32> {
    let grid = ct.grid();
    let middle = grid.world(&Vector3::from(grid.size().map(|n| 0.5 * n as f64)));
    Volume::from_fn(grid.clone(), |l| {
        let hu = f64::from(ct.data()[l]);
        let grey = match hu {
            hu if hu < -500.0 => return -1000.0,
            hu if hu < 60.0 => 0.3 * hu + 140.0,
            hu if hu < 400.0 => 160.0 + 0.5 * (hu - 60.0),
            hu => 330.0 - 0.6 * (hu - 400.0),
        };
        let coil = 1.0 + (grid.centre(grid.voxel(l)) - middle).x / 300.0;
        (-150.0 + coil * grey) as f32
    })
}

#[test]
fn a_neck_is_found_in_an_mr() {
    let scene = Scene::new();
    let options = FitOptions { measure: Measure::CorrelationRatio, ..FitOptions::default() };
    let samples = BoneSamples::new(&scene.skeleton, &scene.planning, &scene.labels, &options);
    let fit = |image: &Volume<f32>| fit_pose(&scene.skeleton, &samples, image, FitStart::Search, &options, &Silent);
    let truth = motions(couch(), bend());
    let ct = fraction(&truth, whole(), None);
    let found = fit(&mr(&ct)).unwrap();
    for (name, truth) in NECK.iter().zip(&truth) {
        let error = scene.error(&found, name, truth);
        assert!(error < 1.0, "{name}: {error}");
    }
    assert!(found.bones.iter().all(|b| b.determined_by == DeterminedBy::Image), "{:?}", found.bones);
}

#[test]
fn a_bone_that_is_cut_off_or_gone_follows_its_joint() {
    let scene = Scene::new();
    let truth = motions(couch(), bend());
    // C3 lies above the image, C4 partly; then soft tissue is where it was.
    let grid = Grid::axis_aligned([80, 96, 40], [1.5, 1.5, 2.0], [-37.0, -80.0, -8.0]).unwrap();
    let (lost, kept) = (4, [0, 1, 2]);
    for (grid, gone) in [(grid, None), (whole(), Some(lost))] {
        let fraction = fraction(&truth, grid, gone);
        let found = scene.fit(&fraction, FitStart::Search).unwrap();
        let of = |n: usize| found.bones.iter().position(|b| b.name == NECK[n]).unwrap();
        let bone = &found.bones[of(lost)];
        assert_eq!(bone.determined_by, DeterminedBy::Joint, "{bone:?}");
        // Of a bone that is gone it is told how much of it should be seen.
        assert_eq!(bone.visible > 0.9, gone.is_some(), "{bone:?}");
        // A block that an edge cuts, or that a gap ends, does not move for more of it to come into view (0.57 mm).
        let cut = scene.error(&found, NECK[3], &truth[3]);
        assert!(cut < 0.5, "{cut}");
        for n in kept {
            assert_eq!(found.bones[of(n)].determined_by, DeterminedBy::Image);
            assert!(scene.error(&found, NECK[n], &truth[n]) < 0.6, "{}", NECK[n]);
        }
        // Where nothing but the joint speaks, it moves with its neighbours to within what a joint gives.
        assert!(scene.error(&found, NECK[lost], &truth[lost]) < 6.0);
        assert!(bone.position_sd_mm > 0.5, "{bone:?}");
    }
}

#[test]
fn images_of_something_else_are_refused() {
    let scene = Scene::new();
    let options = FitOptions::default();
    let all = [&options.outward[..], &options.levels].concat();
    assert!(all.iter().all(|level| scene.samples.at(*level).is_some()));
    assert!(scene.samples.at(BoneSamples::START).is_some_and(|drawn| drawn.all.points.len() > 1000));
    let soft = scene.planning.map(|v| if *v > 200.0 { 35.0 } else { *v });
    let refused = scene.fit(&soft, FitStart::Search).unwrap_err();
    assert!(matches!(refused, crate::error::Error::Registration { .. }), "{refused:?}");
}

#[test]
fn a_fraction_with_left_and_right_exchanged_is_refused() {
    let scene = Scene::new();
    let right = fraction(&motions(couch(), bend()), whole(), None);
    let grid = right.grid();
    // The same voxels, whose header says that left is right.
    let first = grid.origin();
    let mirrored = Grid::new(grid.size(), grid.spacing(), Point3::new(-first.x, first.y, first.z), {
        let mut direction = *grid.direction();
        direction.row_mut(0).neg_mut();
        direction
    });
    let wrong = Volume::new(mirrored.unwrap(), right.data().to_vec()).unwrap();
    let refused = scene.fit(&wrong, FitStart::Search).unwrap_err();
    assert_eq!(refused.code(), "fraction-mirrored", "{refused}");
}

#[test]
fn a_fit_that_comes_to_a_known_place_is_told_before_its_last_pass() {
    let scene = Scene::new();
    let truth = motions(couch(), bend());
    let image = fraction(&truth, whole(), None);
    let options = FitOptions::default();
    let levels = Levels::new(&scene.samples, &image, &options);
    let level = levels.at(BoneSamples::START).unwrap();
    assert!(!Arc::ptr_eq(&level.fraction, &levels.at(BoneSamples::START).unwrap().fraction));
    levels.keep();
    let [one, two] = [0; 2].map(|_| levels.at(BoneSamples::START).unwrap().fraction);
    assert!(Arc::ptr_eq(&one, &two) && one.value.data() == level.fraction.value.data());
    let fitter = Fitter::new(&scene.skeleton, &options, &level, None);
    let of = |name: &str| truth[NECK.iter().position(|n| *n == name).unwrap()];
    let begin = |moved: Rigid| {
        let transforms = scene.skeleton.bones.iter().map(|b| moved * of(&b.name)).collect();
        fitter.begin(Start { common: moved, share: 1.0, transforms, guess: Guess::Each }, &levels, &Silent).unwrap()
    };
    let known = fitter.finish(begin(Rigid::identity()), &levels, &Silent).unwrap();
    assert!(known.found > 0.95, "{}", known.found);
    let beside = begin(Rigid::translation(2.0, -1.5, 1.0));
    assert!(fitter.same(&beside, &known));
    let ended = fitter.finish(beside, &levels, &Silent).unwrap();
    assert!(fitter.apart(&ended.fit.transforms, &known.fit.transforms) < 0.02);
    // One level up the blocks have another texture.
    let other = begin(Rigid::translation(0.0, 0.0, LEVEL));
    assert!(!fitter.same(&other, &known));
    let [there, here] = [other.cost(), known.passed.as_ref().map(|p| p.cost)].map(Option::unwrap);
    assert!(there > 0.5 * here && here < 0.0, "{there} {here}");
}

#[test]
fn what_the_end_of_thin_slices_blurs_is_no_sample_unless_there_is_hardly_anything_else() {
    // The lowest block and its shell reach up to 10 mm or so: most of it is shown, or one slice and its shell.
    for (end, left_out) in [(-1.0, 2.4), (8.0, 1.0)] {
        let cut = Grid::axis_aligned([72, 88, 90], [1.5, 1.5, 1.0], [-54.0, -56.0, end]).unwrap();
        let samples = Scene::on(cut).samples;
        for level in FitOptions::default().levels {
            let points = &samples.at(level).unwrap().bones[0].points;
            let lowest = points.iter().map(|p| p.z).fold(f64::INFINITY, f64::min);
            assert!((end + left_out - 1e-9..end + left_out + 1.0).contains(&lowest), "{end}: {lowest}");
        }
    }
}
