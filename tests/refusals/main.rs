//! Inputs that cannot be what they are said to be: each scene with the code by which it must be refused or warned of, or with
//! nothing to say. On the phantom, and on a real case where `AVENTAIL_CASES` names the folder.

#![expect(clippy::print_stdout, reason = "the table is shown with --nocapture")]

mod scenes;

use aventail::Error;
use aventail::config::Config;
use aventail::io::{read_image, read_labels};
use aventail::phantom::{Phantom, PhantomOptions};
use aventail::pipeline::{Case, Outcome, Planning, check_fraction, register};
use aventail::runtime::Runtime;
use scenes::{ALIKE, Expected, FRACTION, INPUTS, Scene};
use std::path::PathBuf;
use std::sync::OnceLock;

fn phantom() -> &'static Case {
    static ONE: OnceLock<Case> = OnceLock::new();
    ONE.get_or_init(|| Phantom::new(&PhantomOptions::coarse()).expect("the options are sensible").into())
}

/// The real case, or `None` and a line that says why.
fn real() -> Option<&'static Case> {
    static ONE: OnceLock<Option<Case>> = OnceLock::new();
    let case = ONE.get_or_init(|| {
        let folder = PathBuf::from(std::env::var_os("AVENTAIL_CASES")?);
        let image = |name: &str| read_image(folder.join(name)).expect("AVENTAIL_CASES holds the CTs").value;
        let bones = read_labels(folder.join("bones.nii.gz"), Some(&folder.join("bones.json")));
        Some(Case {
            planning: image("planning_ct.nii.gz"),
            fraction: image("moderate/fraction_ct.nii.gz"),
            bones: bones.expect("AVENTAIL_CASES holds the bones").value,
            ..phantom().clone()
        })
    });
    if case.is_none() {
        println!("AVENTAIL_CASES is not set: scenes of the real case are left out");
    }
    case.as_ref()
}

fn config() -> Config {
    // No map of trust: nothing here asks for it.
    let mut config = Config::default();
    config.output.uncertainty = false;
    config
}

/// What judging the inputs alone gives.
fn judged(case: &Case) -> Result<Vec<String>, Error> {
    let (config, runtime) = (config(), Runtime::silent()?);
    let mut codes: Vec<String> = check_fraction(&case.fraction, &config)?.into_iter().map(|w| w.code).collect();
    codes.extend(Planning::new(case, &config, &runtime)?.warnings().iter().map(|w| w.code.clone()));
    Ok(codes)
}

fn registered(case: &Case) -> Result<Vec<String>, Error> {
    let Outcome { warnings, .. } = register(case, &config(), &Runtime::silent()?)?;
    Ok(warnings.into_iter().map(|w| w.code).collect())
}

/// What is wrong with how a scene ended.
fn wrong(scene: &Scene, found: Result<Vec<String>, Error>) -> Option<String> {
    let (told, right) = match (&found, scene.expected) {
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
    check(phantom(), &ALIKE, registered);
}

#[test]
fn inputs_of_a_real_case() {
    if let Some(case) = real() {
        check(case, &INPUTS, judged);
    }
}

#[test]
fn fractions_of_a_real_case() {
    if let Some(case) = real() {
        check(case, &FRACTION, registered);
    }
}
