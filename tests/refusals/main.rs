//! Inputs that cannot be what they are said to be: each scene with the code by which it must be refused or warned of, or with
//! nothing to say. On the phantom, and on a real case where `AVENTAIL_CASES` names the folder.

#![expect(clippy::print_stdout, reason = "the table is shown with --nocapture")]

mod runs;
mod scenes;

use crate::support::shared::{bones_alone, coarse, neck};
use crate::support::skip::cases;
use crate::support::thinned;
use aventail::Error;
use aventail::config::Config;
use aventail::io::{read_image, read_labels};
use aventail::pipeline::{Case, Outcome, check_inputs, register};
use aventail::runtime::Runtime;
use nalgebra::Vector3;
use runs::RUNS;
use scenes::{Expected, FRACTION, INPUTS, NECK, Scene};
use std::sync::OnceLock;

fn phantom() -> &'static Case {
    static ONE: OnceLock<Case> = OnceLock::new();
    ONE.get_or_init(|| coarse().clone().into())
}

/// The real case, or `None` and a line that says why.
fn real() -> Option<&'static Case> {
    static ONE: OnceLock<Case> = OnceLock::new();
    let folder = cases()?;
    Some(ONE.get_or_init(|| {
        let image = |name: &str| read_image(folder.join(name)).expect("AVENTAIL_CASES holds the CTs").value;
        let bones = read_labels(folder.join("bones.nii.gz"), Some(&folder.join("bones.json")));
        let bones = bones.expect("AVENTAIL_CASES holds the bones").value;
        Case::new(image("planning_ct.nii.gz"), bones, image("moderate/fraction_ct.nii.gz"))
    }))
}

/// What judging the inputs alone gives.
fn judged(case: &Case) -> Result<Vec<String>, Error> {
    Ok(check_inputs(case, &Config::default())?.into_iter().map(|w| w.code).collect())
}

/// What a fit adds: soft tissue tells nothing of the inputs.
fn registered(case: &Case) -> Result<Vec<String>, Error> {
    let Outcome { warnings, .. } = register(case, &bones_alone(), &Runtime::silent()?)?;
    Ok(warnings.into_iter().map(|w| w.code).collect())
}

/// What is wrong with how a scene ended.
fn wrong(scene: &Scene, found: Result<Vec<String>, Error>) -> Option<String> {
    let (told, right) = match (&found, scene.expected) {
        (Err(e), Expected::Exit(code)) => (format!("refused: {e}"), e.exit_code() == code),
        (Err(e), Expected::Refused(codes)) => (format!("refused: {}", e.code()), codes.contains(&e.code())),
        (Ok(codes), Expected::Warned(code)) => (format!("warned: {codes:?}"), codes.iter().any(|c| c == code)),
        (Ok(codes), Expected::Silent) => {
            let odd = |c: &&String| scenes::OF_INPUTS.contains(&c.as_str());
            (format!("silent: {codes:?}"), !codes.iter().any(|c| odd(&c)))
        }
        (Err(e), _) => (format!("refused: {e}"), false),
        (Ok(codes), _) => (format!("passed: {codes:?}"), false),
    };
    println!("{:<44} {told}", scene.name);
    (!right).then(|| format!("{}: {told}, expected {:?}", scene.name, scene.expected))
}

fn check(case: &Case, scenes: &[Scene], run: impl Fn(&Case) -> Result<Vec<String>, Error>) {
    let ended = |scene: &Scene| {
        let mut changed = case.clone();
        (scene.change)(&mut changed);
        wrong(scene, run(&changed))
    };
    let wrong: Vec<String> = scenes.iter().filter_map(ended).collect();
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn inputs_of_the_phantom() {
    check(phantom(), &INPUTS, judged);
}

#[test]
fn fractions_of_the_phantom() {
    check(&Case::from(neck().clone()), &NECK, registered);
}

/// What a registration of a changed phantom is off, and how much of that its map of uncertainty owns up to.
#[derive(Debug)]
struct Measured {
    /// Points of the patient that the fraction shows.
    points: usize,
    /// Mean error, mm.
    mean: f64,
    /// Share of points that are off by more than 3 times the map and half a millimetre, percent; one of which the map says
    /// that it is not known is none of them.
    beyond: f64,
}

/// Measures a result against the phantom's truth, all of which is moved by `moved` mm.
fn measured(case: &Case, outcome: &Outcome, moved: [f64; 3]) -> Measured {
    let (truth, push) = (neck(), &outcome.push.displacement);
    let (grid, fraction) = (truth.body.grid(), case.fraction.ct.grid());
    let map = &outcome.uncertainty.as_ref().expect("it is asked for").0;
    let every = 7;
    let of = |n: usize| {
        let at = grid.centre(grid.voxel(n));
        let to = truth.push(&at) + Vector3::from(moved);
        let error = (at + Vector3::from(push.data()[n].map(f64::from)) - to).norm();
        fraction.contains(&fraction.index(&to)).then_some((error, f64::from(map.at(grid.voxel(n)))))
    };
    let inside = (0..grid.len()).step_by(every).filter(|&n| truth.body.data()[n]);
    let all: Vec<(f64, f64)> = inside.filter_map(of).collect();
    let beyond = all.iter().filter(|(error, said)| *said >= 0.0 && *error > 3.0 * said + 0.5).count();
    let points = all.len().max(1);
    Measured {
        points: all.len(),
        mean: all.iter().map(|p| p.0).sum::<f64>() / points as f64,
        beyond: 100.0 * beyond as f64 / points as f64,
    }
}

/// What is wrong with how a registration ended.
fn wrong_run(run: &runs::Run) -> Option<String> {
    let mut case = Case::from(neck().clone());
    (run.change)(&mut case);
    let (told, right) = match register(&case, &Config::default(), &Runtime::silent().expect("threads can be had")) {
        Err(e) => (format!("refused: {e}"), matches!(run.end, runs::End::Refused(codes) if codes.contains(&e.code()))),
        Ok(outcome) => {
            let m = measured(&case, &outcome, run.moved);
            let mut codes: Vec<&str> = outcome.warnings.iter().map(|w| w.code.as_str()).collect();
            codes.dedup();
            let right = match run.end {
                runs::End::Refused(_) => false,
                runs::End::Done { mean_mm, beyond_percent, warned } => {
                    m.points > 500
                        && m.mean <= mean_mm
                        && m.beyond <= beyond_percent
                        && (warned.is_empty() || codes.contains(&warned))
                }
            };
            (format!("{m:.2?} {codes:?}"), right)
        }
    };
    println!("{:<44} {told}", run.name);
    (!right).then(|| format!("{}: {told}, expected {:?}", run.name, run.end))
}

#[test]
fn runs_on_the_phantom() {
    let wrong: Vec<String> = RUNS.iter().filter_map(wrong_run).collect();
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn inputs_of_a_real_case() {
    if let Some(case) = real() {
        // A quarter of the pixels tells the same of them, in a quarter of the time.
        let mut case = case.clone();
        case.fraction.ct = thinned(&case.fraction.ct);
        let scan = case.planning_mut();
        scan.ct = thinned(&scan.ct);
        scan.bones.volume = thinned(&scan.bones.volume);
        check(&case, &INPUTS, judged);
    }
}

#[test]
fn fractions_of_a_real_case() {
    if let Some(case) = real() {
        check(case, &FRACTION, registered);
    }
}
