//! Registration of real CTs with known truth, when the environment variable `AVENTAIL_CASES` names their folder.
//!
//! The folder holds `planning_ct.nii.gz`, `bones.nii.gz`, `bones.json`, where known `body.nii.gz` and
//! `joints_reference.json`, and one folder per fraction with `fraction_ct.nii.gz`, `truth_bones.json`,
//! `truth_points.csv.gz` and `landmarks.csv`. These CTs are not distributed: without them these tests pass at once and say so.

#![expect(clippy::print_stdout, reason = "the numbers are shown with --nocapture")]

use crate::support::score::{dice, name, read_truth, score_case, surface_p95, trust};
use crate::support::skip::{cases, of_cases, skipped};
use aventail::body::{self, BodyOptions};
use aventail::config::Config;
use aventail::evaluate::landmark::Landmark;
use aventail::io::{read_image, read_labels, read_landmarks};
use aventail::phantom::{CbctOptions, degrade};
use aventail::pipeline::{Case, register};
use aventail::runtime::Runtime;
use aventail::skeleton;
use aventail::view::View;
use aventail::volume::{LabelMap, Volume, trilinear_vector};
use nalgebra::Point3;
use std::path::{Path, PathBuf};
use std::sync::OnceLock;

/// What a registration may not exceed: within 15 % of what was measured (docs/validation.md).
struct Bounds {
    /// Mean over visible bones, and the worst of them, mm.
    bones: (f64, f64),
    /// Mean error of soft tissue, mm.
    soft: f64,
    /// Planning to fraction and back away from bone contact, worst, mm.
    back: f64,
    /// Least rank correlation of the map of uncertainty with the true error.
    trust: f64,
    /// Share of errors below the map: one standard deviation, which twice or half of it is not.
    below: (f64, f64),
}

/// Bounds by fraction.
const BOUNDS: [(&str, Bounds); 4] = [
    ("small", Bounds { bones: (0.10, 0.39), soft: 0.25, back: 0.5, trust: 0.50, below: (0.70, 0.94) }),
    ("moderate", Bounds { bones: (0.054, 0.10), soft: 0.28, back: 0.5, trust: 0.44, below: (0.69, 0.93) }),
    ("change", Bounds { bones: (0.08, 0.32), soft: 0.26, back: 0.5, trust: 0.51, below: (0.73, 0.98) }),
    ("spline", Bounds { bones: (0.07, 0.355), soft: 0.36, back: 0.4, trust: 0.48, below: (0.56, 0.76) }),
];
/// Those of other fractions, of which nothing was measured.
const OTHERS: Bounds = Bounds { bones: (0.5, 1.2), soft: 1.7, back: 0.5, trust: 0.4, below: (0.55, 0.92) };
/// A bone's departure from a rigid motion, mm.
const RIGID_MM: f64 = 0.001;
/// Folded cells outside bone contact: moderate has them.
const FOLDED: usize = 4;
/// Planning to fraction and back away from bone contact, mean, mm.
const BACK_MM: f64 = 0.023;

/// The planning side of the cases, read once.
struct Planning {
    folder: PathBuf,
    ct: Volume<f32>,
    bones: LabelMap,
}

/// The cases, or `None` and a line that says why.
fn planning() -> Option<&'static Planning> {
    static ONE: OnceLock<Planning> = OnceLock::new();
    let folder = cases()?;
    let planning = ONE.get_or_init(|| {
        let ct = read_image(folder.join("planning_ct.nii.gz")).expect("AVENTAIL_CASES holds the planning CT").value;
        let bones = read_labels(folder.join("bones.nii.gz"), Some(&folder.join("bones.json")));
        Planning { folder, ct, bones: bones.expect("AVENTAIL_CASES holds the bones").value }
    });
    Some(planning)
}

/// Folders of the fractions with known truth, by name.
fn fractions(folder: &Path) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(folder).expect("AVENTAIL_CASES is a folder");
    let mut out: Vec<PathBuf> = entries
        .map(|e| e.expect("the folder can be listed").path())
        .filter(|p| p.join("fraction_ct.nii.gz").is_file() && p.join("truth_bones.json").is_file())
        .collect();
    out.sort();
    assert!(!out.is_empty(), "{} has no fraction with known truth", folder.display());
    out
}

#[test]
fn registrations_meet_their_bounds() {
    let Some(planning) = planning() else { return };
    let mut wrong = Vec::new();
    for folder in fractions(&planning.folder) {
        let case = folder.file_name().expect("a folder has a name").to_string_lossy().into_owned();
        wrong.extend(check_fraction(planning, &folder, &case).into_iter().map(|w| format!("{case}: {w}")));
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

impl Planning {
    /// With a fraction.
    fn case(&self, fraction: Volume<f32>, landmarks: Vec<Landmark>) -> Case {
        let mut case = Case::new(self.ct.clone(), self.bones.clone(), fraction);
        case.fraction.landmarks = landmarks;
        case
    }
}

/// Registers one fraction, prints what it measured and returns what misses a bound.
fn check_fraction(planning: &Planning, folder: &Path, case: &str) -> Vec<String> {
    let image = read_image(folder.join("fraction_ct.nii.gz")).expect("it was found").value;
    let landmarks = read_landmarks(folder.join("landmarks.csv")).unwrap_or_default();
    let input = planning.case(image, landmarks);
    let runtime = Runtime::silent().expect("threads start");
    let outcome = register(&input, &Config::default(), &runtime).expect("the case registers");
    let truth = read_truth(&folder.join("truth_points.csv.gz"));
    let score = score_case(&outcome.push, &truth);
    let (map, _) = outcome.uncertainty.as_ref().expect("it is made by default");
    let (ranked, below) = trust(map, &outcome.push, &truth);
    let rigid = outcome.rigidity.iter().map(|b| b.rms_mm).fold(0.0, f64::max);
    let folded = outcome.jacobian_report.body.folded;
    let back = &outcome.consistency.there_and_back_mm;
    let bone = name(&planning.bones, score.worst.0);
    let seconds: f64 = runtime.times().iter().map(|s| s.seconds).sum();
    let landmarks = outcome.landmarks.as_ref().map_or(f64::NAN, |l| l.after.mean);
    println!(
        "{case}: bones {:.3} mm, worst {bone} {:.3} mm, soft {:.3} mm, rigid {rigid:.5} mm, folded {folded}, landmarks {landmarks:.2} mm, {seconds:.1} s",
        score.bones, score.worst.1, score.soft
    );
    println!("{case}: there and back {:.3} mm mean, {:.3} mm worst of {}", back.mean, back.max, back.n);
    println!("{case}: uncertainty against true error: Spearman {ranked:.3}, {:.0} % of errors below it", 100.0 * below);
    let most = BOUNDS.iter().find(|b| b.0 == case).map_or(&OTHERS, |b| &b.1);
    let bounds = [
        ("mean of bones, mm", score.bones, most.bones.0),
        ("worst bone, mm", score.worst.1, most.bones.1),
        ("soft tissue, mm", score.soft, most.soft),
        ("departure from rigid, mm", rigid, RIGID_MM),
        ("folded cells", folded as f64, FOLDED as f64),
        ("there and back, mean, mm", back.mean, BACK_MM),
        ("there and back, worst, mm", back.max, most.back),
        ("uncertainty, 1 - rank correlation", 1.0 - ranked, 1.0 - most.trust),
        ("errors above the uncertainty", 1.0 - below, 1.0 - most.below.0),
        ("errors below the uncertainty", below, most.below.1),
    ];
    let beyond = bounds.into_iter().filter(|(_, value, bound)| value.is_nan() || value > bound);
    beyond.map(|(what, value, bound)| format!("{what}: {value:.4} is above {bound}")).collect()
}

/// Mean error of soft tissue inside and outside a cone-beam CT's circle, and in a shaded CT, mm.
const CBCT_MM: (f64, f64) = (0.6, 4.1);
const SHADED_MM: f64 = 0.335;
/// Points in view that err by more than three times the map and half a millimetre, percent.
const UNCOVERED_PERCENT: f64 = 3.0;

/// Errors at soft tissue points that end up in view and out of it, and the share of those in view that the map does not cover.
fn cone_beam(planning: &Planning, folder: &Path, fraction: Volume<f32>) -> (Vec<f64>, Vec<f64>, f64) {
    let view = View::of(&fraction);
    let input = planning.case(fraction, Vec::new());
    let runtime = Runtime::silent().expect("threads start");
    let outcome = register(&input, &Config::default(), &runtime).expect("the case registers");
    assert!(outcome.warnings.iter().any(|w| w.is(aventail::findings::SHADED_FRACTION)), "{:?}", outcome.warnings);
    let (map, _) = outcome.uncertainty.as_ref().expect("it is made by default");
    let (mut inside, mut outside, mut uncovered) = (Vec::new(), Vec::new(), 0);
    for point in read_truth(&folder.join("truth_points.csv.gz")).iter().filter(|p| p.bone == 0) {
        let index = outcome.push.displacement.grid().index(&point.at);
        let u = trilinear_vector(&outcome.push.displacement, &index).expect("truth lies on the planning grid");
        let error = (u - point.motion).norm();
        let there = input.fraction.ct.grid().voxel_at(&(point.at + point.motion));
        if !there.is_some_and(|voxel| view.measured().is_none_or(|m| *m.at(voxel))) {
            outside.push(error);
            continue;
        }
        let said = map.grid().voxel_at(&point.at).map_or(0.0, |voxel| f64::from(map.at(voxel)));
        uncovered += usize::from(said >= 0.0 && error > 3.0 * said + 0.5);
        inside.push(error);
    }
    let percent = 100.0 * uncovered as f64 / inside.len().max(1) as f64;
    (inside, outside, percent)
}

fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len().max(1) as f64
}

#[test]
fn cone_beam_fractions_meet_their_bounds() {
    let Some(planning) = planning() else { return };
    let all = fractions(&planning.folder).into_iter().map(|folder| folder.join("cbct.nii.gz"));
    let taken: Vec<PathBuf> = all.filter(|file| file.is_file()).collect();
    if taken.is_empty() {
        skipped("no fraction of the real cases has a cbct.nii.gz");
    }
    for file in taken {
        let (folder, cbct) = (file.with_file_name(""), read_image(&file).expect("it was found"));
        let (inside, outside, uncovered) = cone_beam(planning, &folder, cbct.value);
        let far = outside.iter().copied().fold(0.0, f64::max);
        println!(
            "cone beam: inside {:.3} mm, outside {:.3}, {uncovered:.2} % uncovered",
            mean(&inside),
            mean(&outside)
        );
        assert!(mean(&inside) <= CBCT_MM.0 && mean(&outside) <= CBCT_MM.1, "{} {}", mean(&inside), mean(&outside));
        assert!(far < 10.0, "{far}");
        assert!(uncovered <= UNCOVERED_PERCENT, "{uncovered}");
        let ct = read_image(folder.join("fraction_ct.nii.gz")).expect("it was found").value;
        let shade =
            CbctOptions { gain: 0.8, cupping_hu: -180.0, shading_hu: 60.0, noise_hu: 60.0, ..CbctOptions::off() };
        let shaded = degrade(&ct, &shade, 1).expect("the options are legal");
        let (inside, _, uncovered) = cone_beam(planning, &folder, shaded);
        println!("shaded: {:.3} mm, {uncovered:.2} % uncovered", mean(&inside));
        assert!(mean(&inside) <= SHADED_MM && uncovered <= UNCOVERED_PERCENT, "{} {uncovered}", mean(&inside));
    }
}

#[test]
fn the_patient_is_found() {
    let Some(planning) = planning() else { return };
    let Some(reference) = of_cases(planning.folder.join("body.nii.gz")) else { return };
    let reference = read_image(reference).expect("it was found").value.map(|&v| v > 0.5);
    for labels in [Some(&planning.bones), None] {
        let found = body::find(&planning.ct, labels, &BodyOptions::default()).unwrap();
        let dice = dice(&found, &reference);
        let (there, back) = (surface_p95(&found, &reference), surface_p95(&reference, &found));
        let with = if labels.is_some() { "with" } else { "without" };
        println!("body {with} labels: Dice {dice:.4}, 95th percentile of surface distance {there:.2} and {back:.2} mm");
        assert!(dice >= 0.996, "{dice}");
        assert!(there <= 1.15 && back <= 1.15, "{there} and {back} mm");
    }
}

/// A joint centre placed by hand.
#[derive(serde::Deserialize)]
struct ReferenceJoint {
    name: String,
    parent: String,
    child: String,
    centre: Point3<f64>,
}

#[derive(serde::Deserialize)]
struct ReferenceJoints {
    joints: Vec<ReferenceJoint>,
}

#[test]
fn joint_centres_lie_where_an_expert_puts_them() {
    let Some(planning) = planning() else { return };
    let Some(reference) = of_cases(planning.folder.join("joints_reference.json")) else { return };
    let reference: ReferenceJoints = serde_json::from_slice(&std::fs::read(reference).unwrap()).unwrap();
    let built = skeleton::build(&planning.bones).unwrap().skeleton;
    let mut neck = Vec::new();
    for joint in &reference.joints {
        let child = built.bones.iter().find(|b| b.name == joint.child);
        let same = child.filter(|c| c.parent.is_some_and(|p| built.bones[p].name == joint.parent));
        let Some(bone) = same else {
            println!("{}: {} does not hang on {} here", joint.name, joint.child, joint.parent);
            continue;
        };
        let distance = (bone.joint.centre - joint.centre).norm();
        println!("{} ({}): {distance:.1} mm", joint.name, bone.joint.name);
        let (parent, child) = (&joint.parent, &joint.child);
        let cervical = |b: &String| b.starts_with("vertebrae_C") || b == "skull";
        if cervical(parent) && cervical(child) {
            neck.push(distance);
        }
    }
    assert_eq!(neck.len(), 7, "C7-C6 up to atlanto-occipital");
    let mean = neck.iter().sum::<f64>() / neck.len() as f64;
    println!("neck: mean {mean:.2} mm");
    assert!(mean <= 5.0, "{mean} mm");
}
