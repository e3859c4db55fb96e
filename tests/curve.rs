//! Error against run time: `aventail curve` measures what it says, and `--speed` chooses points on the curve.

use crate::support::{Register, aventail, files_below, folder, near, small_phantom};
use std::fs;
use std::path::PathBuf;

const PLAN: &str = r#"
[[table]]
title = "images"
source = "refine.weight"
stage = [
    { id = "bones", name = "none", settings = { refine = { weight = 0.0 }, consistency = { rounds = 0 } } },
    { id = "default", name = "both", settings = {} },
]
"#;

fn write(name: &str, text: &str) -> PathBuf {
    let path = folder().join(name);
    fs::write(&path, text).expect("the test's folder can be written to");
    path
}

fn curve(out: &str, plan: &str) -> (assert_cmd::Command, PathBuf) {
    let plan = write(&format!("{out}.toml"), plan);
    let out = folder().join(out);
    let p = small_phantom();
    let mut run = aventail();
    run.arg("curve").arg("-q").arg("--plan").arg(plan).arg("--out").arg(&out);
    run.arg("--planning").arg(&p.planning).arg("--bones").arg(&p.bones).arg("--fraction").arg(&p.fraction);
    (run, out)
}

#[test]
fn every_setting_of_the_plan_is_a_point_beside_the_peers() {
    let peers = write("peers.csv", "name,seconds,error_mm\nother tool,90.5,2.25\n");
    let (mut run, out) = curve("curve", PLAN);
    run.arg("--landmarks")
        .arg(&small_phantom().landmarks)
        .arg("--peers")
        .arg(peers)
        .arg("--threads")
        .arg("2")
        .assert()
        .success();
    assert_eq!(files_below(&out), ["curve.csv", "curve.json", "curve.md", "curve.png"]);
    let table = fs::read_to_string(out.join("curve.csv")).expect("it was written");
    let rows: Vec<Vec<&str>> = table.lines().skip(1).map(|l| l.split(',').collect()).collect();
    assert_eq!(rows.iter().map(|r| r[1]).collect::<Vec<_>>(), ["none", "both", "1", "2", "other tool"], "{table}");
    let number = |row: usize, column: usize| rows[row][column].parse::<f64>().expect("a number");
    // With both images the error is smaller.
    assert!(number(1, 5) < number(0, 5) && number(0, 3) > 0.0 && number(0, 4) > 0.0, "{table}");
    assert!(number(4, 3) > 90.4 && number(4, 5) > 2.2 && rows[1][2] == "true", "{table}");
    // Threads change the time alone.
    assert_eq!(rows[2][5..], rows[1][5..], "{table}");
    assert_eq!(rows[3], [&["threads", "2"], &rows[1][2..]].concat(), "{table}");
}

#[test]
fn a_third_scan_of_the_patient_tells_the_error_where_no_points_are_known() {
    // The planning scan itself as the third: what goes there and on must come back.
    let default =
        "[[table]]\ntitle = \"one\"\nsource = \"\"\nstage = [{ id = \"default\", name = \"both\", settings = {} }]\n";
    let (mut run, out) = curve("around", default);
    run.arg("--threads").arg("1");
    run.arg("--around").arg(&small_phantom().planning).assert().success();
    let table = fs::read_to_string(out.join("curve.csv")).expect("it was written");
    let errors: Vec<f64> = table
        .lines()
        .skip(1)
        .map(|row| row.split(',').nth(5).and_then(|n| n.parse().ok()).expect("a number"))
        .collect();
    println!("{errors:?} mm");
    // One field compared with itself would leave nothing.
    assert!(errors.len() == 1 && errors[0] > 0.1 && errors[0] < 2.0, "1.67 when measured: {table}");
    let text = fs::read_to_string(out.join("curve.json")).expect("it was written");
    assert!(text.contains("\"around\""), "{text}");
    // Points that are known leave nothing to ask of a third scan.
    let (mut run, _) = curve("both", PLAN);
    run.arg("--around")
        .arg(&small_phantom().planning)
        .arg("--landmarks")
        .arg(&small_phantom().landmarks)
        .assert()
        .code(2);
}

#[test]
fn without_a_case_the_phantom_is_measured() {
    // It once was drawn at 4 mm without partial volumes, where the fit refuses it.
    let out = folder().join("phantom");
    let plan = r#"
        [[table]]
        title = "images"
        source = "refine.weight"
        stage = [{ id = "bones", name = "none", settings = { soft_tissue = "nearest-bone", consistency = { rounds = 0 } } }]
    "#;
    let mut run = aventail();
    run.arg("curve").arg("-q").arg("--plan").arg(write("one.toml", plan)).arg("--out").arg(&out).assert().success();
    let table = fs::read_to_string(out.join("curve.csv")).expect("it was written");
    let mean: f64 =
        table.lines().nth(1).and_then(|row| row.split(',').nth(5)).and_then(|n| n.parse().ok()).expect("a number");
    println!("nearest bone: {mean:.4} mm");
    assert!(mean > 0.1 && mean < 3.0, "{table}");
}

#[test]
fn what_cannot_be_measured_is_refused() {
    let (mut run, out) = curve("refused", PLAN);
    let bad = write("bad.csv", "name,seconds\nother,1\n");
    let code = run.arg("--landmarks").arg(&small_phantom().landmarks).arg("--peers").arg(bad).assert().code(3);
    let message = String::from_utf8_lossy(&code.get_output().stderr).into_owned();
    assert!(message.contains("bad.csv") && message.contains("error_mm"), "{message}");
    assert!(!out.exists());
    // A case without known points has no error.
    let message = String::from_utf8_lossy(&curve("blind", PLAN).0.assert().code(2).get_output().stderr).into_owned();
    assert!(message.contains("--landmarks") && message.contains("--around"), "{message}");
    // A region has grids of its own, of which the way on knows nothing.
    let plan = "[[table]]\ntitle = \"one\"\nsource = \"\"\n\
                stage = [{ id = \"box\", name = \"box\", settings = { region = { box_mm = [-50, -50, -50, 50, 50, 50] } } }]\n";
    let code = curve("region", plan).0.arg("--around").arg(&small_phantom().planning).assert().code(2);
    let message = String::from_utf8_lossy(&code.get_output().stderr).into_owned();
    assert!(message.contains("region of interest"), "{message}");
}

#[test]
fn speed_chooses_the_settings_that_are_recorded() {
    let fast = Register::of(small_phantom(), folder().join("fast")).with("--start", near());
    let fast = fast.with("--speed", "fast").flag("-q");
    fast.command().assert().success();
    let settings = fs::read_to_string(fast.out.join("settings.toml")).expect("it was written");
    assert!(settings.contains("preset = \"fast\"") && settings.contains("spacing_mm = 5.0"), "{settings}");
    assert!(!fast.out.join("uncertainty.nii.gz").exists());
    let both = Register::phantom("both").with("--speed", "fast").with("--preset", "thesis");
    both.command().assert().code(2);
}
