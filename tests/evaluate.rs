//! `aventail evaluate` and `aventail dose` as their users meet them: on the phantom with its true field, and refused.

#![expect(clippy::unwrap_used, reason = "a test that cannot read what it wrote fails")]

use crate::support::{aventail, done, files, files_below, folder, phantom};
use assert_cmd::Command;
use aventail::field::FieldFormat;
use aventail::geometry::Grid;
use aventail::io::{WriteOptions, read_field, read_image, read_labels, write_field};
use aventail::volume::{LabelMap, Volume};
use nalgebra::Vector3;
use serde_json::Value;
use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

fn truth() -> PathBuf {
    phantom().planning.with_file_name("true_planning_to_fraction.nii.gz")
}

/// `evaluate` on the phantom's CTs into a folder.
fn evaluate(out: &str) -> Command {
    let f = phantom();
    let mut command = aventail();
    command.arg("evaluate").arg("--quiet").arg("--out").arg(folder().join(out));
    command.arg("--planning").arg(&f.planning).arg("--fraction").arg(&f.fraction).arg("--bones").arg(&f.bones);
    command.arg("--landmarks").arg(&f.landmarks);
    command
}

fn json(path: &Path) -> Value {
    serde_json::from_slice(&fs::read(path).unwrap()).unwrap()
}

/// A zero field on a grid, as a file.
fn still(name: &str, grid: &Grid) -> PathBuf {
    let path = folder().join(name);
    write_field(&path, &Volume::filled(grid.clone(), [0.0; 3]), FieldFormat::MetaImage, &WriteOptions::default())
        .unwrap();
    path
}

/// Runs a command line that must be refused.
fn refused(command: &mut Command, code: i32, names: &[&str]) {
    let run = command.assert().code(code);
    let message = String::from_utf8(run.get_output().stderr.clone()).unwrap();
    assert!(run.get_output().stdout.is_empty(), "{message}");
    for name in names {
        assert!(message.contains(name), "`{name}` is not in\n{message}");
    }
    assert!(!message.contains("panicked"), "{message}");
}

/// The mean motion of the centres of the bones of the spine that lie near the middle of what both scans show, by their voxels.
fn couch_shift() -> Vector3<f64> {
    let (field, labels) = (read_field(truth()).unwrap().value, read_labels(&phantom().bones, None).unwrap().value);
    let grid = labels.volume.grid();
    let mut sums: BTreeMap<u16, (f64, f64, Vector3<f64>)> = BTreeMap::new();
    for (l, (u, label)) in field.data().iter().zip(labels.volume.data()).enumerate().filter(|(_, (_, l))| **l > 0) {
        let sum = sums.entry(*label).or_default();
        *sum = (sum.0 + 1.0, sum.1 + grid.centre(grid.voxel(l)).z, sum.2 + Vector3::from(u.map(f64::from)));
    }
    // Height of the centre, and its motion.
    let bones: BTreeMap<u16, (f64, Vector3<f64>)> = sums.iter().map(|(l, (n, z, u))| (*l, (z / n, u / *n))).collect();
    let common = bones.values().map(|(_, u)| u.z).sum::<f64>() / bones.len() as f64;
    let range = |image: &Path, back: f64| {
        let z = read_image(image).unwrap().value.grid().corners().map(|c| c.z - back);
        [z.iter().copied().fold(f64::MAX, f64::min), z.iter().copied().fold(f64::MIN, f64::max)]
    };
    let ([a, b], [c, d]) = (range(&phantom().planning, 0.0), range(&phantom().fraction, common));
    let middle = (a.max(c) + b.min(d)) / 2.0;
    let spine = |l: &u16| labels.names[l].starts_with("vertebrae") || labels.names[l] == "skull";
    let near: Vec<Vector3<f64>> =
        bones.iter().filter(|(l, (z, _))| spine(l) && (z - middle).abs() <= 60.0).map(|(_, (_, u))| *u).collect();
    assert!(near.len() >= 3, "{} bones", near.len());
    near.iter().sum::<Vector3<f64>>() / near.len() as f64
}

#[test]
fn the_true_field_of_the_phantom_passes() {
    let out = folder().join("truth");
    let mut command = evaluate("truth");
    command.arg("--planning-to-fraction").arg(truth());
    command.arg("--labels-planning").arg(&phantom().bones).arg("--labels-fraction").arg(&phantom().bones);
    let run = command.assert().success();
    let table = String::from_utf8(run.get_output().stdout.clone()).unwrap();
    assert!(table.lines().all(|line| line.trim_end() == line), "{table:?}");
    assert!(table.contains("a physicist decides") && !table.contains("approved"), "{table}");
    let names = files_below(&out);
    for name in ["evaluation.csv", "evaluation.html", "evaluation.json", "evaluation.md", "landmarks.csv"] {
        assert!(names.contains(&name.to_owned()), "{names:?}");
    }
    let drawn: Vec<&str> = names.iter().filter_map(|n| n.strip_prefix("pictures/1_")?.strip_suffix(".png")).collect();
    assert_eq!(drawn, ["before", "contours", "fusion", "jacobian", "jacobian_volume", "residuals", "shift"]);
    let a = &json(&out.join("evaluation.json"))["fields"][0]["assessment"];
    let at = |path: &str| a.pointer(path).and_then(Value::as_f64).unwrap_or_else(|| panic!("{path}"));
    assert!(at("/landmarks/after/mean") < 0.3 && at("/landmarks/ratio_of_means") < 0.1);
    // One shift of the whole: the couch shift, on the spine within 60 mm of the middle of what both scans show.
    assert_eq!(a["shift"]["alone"], "couch");
    let expected = couch_shift();
    for c in 0..3 {
        assert!((at(&format!("/shift/mm/{c}")) - expected[c]).abs() < 1e-3, "{} {expected}", a["shift"]);
    }
    assert!(at("/landmarks/shifted/mean") < at("/landmarks/before/mean"));
    let bones = a["rigidity"].as_array().unwrap();
    assert!(bones.len() > 30 && bones.iter().all(|b| b["rms_mm"].as_f64().unwrap() < 1e-3));
    // Two linear interpolations of a field stored every 5 mm.
    assert!(at("/inverse_consistency/0/distance_mm/median") < 0.2);
    assert!(at("/similarity/after/rms_hu") < at("/similarity/before/rms_hu"));
    assert!(at("/similarity/after/ncc") > at("/similarity/before/ncc"));
    let page = fs::read_to_string(out.join("evaluation.html")).unwrap();
    for outside in ["http:", "https:", "<script", "<link"] {
        assert!(!page.contains(outside), "{outside}");
    }
    assert!(!page.to_lowercase().contains("approved") && page.contains("eq. 4.2"));
}

#[test]
fn results_do_not_depend_on_threads_and_fields_stand_side_by_side() {
    let still = still("still.mha", read_image(&phantom().planning).unwrap().value.grid());
    let table = |threads: &str| {
        let out = format!("compare_{threads}");
        let mut command = evaluate(&out);
        command.args(["--threads", threads, "--compare"]).arg(truth()).arg(&still).assert().success();
        let out = folder().join(out);
        (fs::read(out.join("evaluation.csv")).unwrap(), fs::read_to_string(out.join("evaluation.md")).unwrap())
    };
    let (one, two) = (table("1"), table("2"));
    assert!(one.0 == two.0, "the numbers depend on the number of threads");
    assert!(one.1.contains("| true_planning_to_fraction.nii.gz | still.mha |"), "{}", one.1);
}

#[test]
fn the_limits_of_the_settings_judge_the_field() {
    let settings = folder().join("strict.toml");
    fs::write(&settings, "[verdict]\nlandmark_mean_mm = [0.0001, 0.0002]\nrigidity_mm = [0.0, 1e-9]\n").unwrap();
    let out = folder().join("strict");
    let mut command = evaluate("strict");
    command.arg("--planning-to-fraction").arg(truth()).arg("--config").arg(&settings).assert().success();
    let report = json(&out.join("evaluation.json"));
    let field = &report["fields"][0];
    let of = |name: &str| {
        let all = field["assessment"]["verdicts"].as_array().unwrap();
        all.iter().find(|v| v["name"].as_str().unwrap().starts_with(name)).unwrap()["verdict"].clone()
    };
    assert_eq!(
        (field["verdict"].as_str(), of("landmarks, mean"), of("departure")),
        (Some("fail"), "review".into(), "fail".into())
    );
    let page = fs::read_to_string(out.join("evaluation.html")).unwrap();
    assert!(page.contains("class=\"verdict fail\"") && page.find("section").unwrap() < page.find("<table").unwrap());
    let wrong = folder().join("wrong.toml");
    fs::write(&wrong, "[verdict]\ndice = [0.8, 0.9]\n").unwrap();
    let mut command = evaluate("wrong");
    refused(command.arg("--planning-to-fraction").arg(truth()).arg("--config").arg(&wrong), 2, &["verdict.dice"]);
}

#[test]
fn contours_under_the_identity_agree_with_themselves() {
    let f = phantom();
    let still = still("identity.mha", read_image(&f.planning).unwrap().value.grid());
    let out = folder().join("identity");
    let mut command = aventail();
    command.args(["evaluate", "--quiet", "--fraction-to-planning"]).arg(&still).arg("--out").arg(&out);
    command.arg("--labels-planning").arg(&f.bones).arg("--labels-fraction").arg(&f.bones);
    command.arg("--then").arg(&still).arg("--direct").arg(&still).assert().success();
    let a = &json(&out.join("evaluation.json"))["fields"][0]["assessment"];
    let contours = a["contours"].as_array().unwrap();
    assert!(contours.len() > 30);
    for c in contours.iter().filter(|c| !c["distances"].is_null()) {
        assert!(
            (c["dice"].as_f64().unwrap() - 1.0).abs() < 1e-12
                && c["distances"]["hausdorff_mm"].as_f64().unwrap() < 1e-9
        );
    }
    assert!(a["transitivity"]["distance_mm"]["max"].as_f64().unwrap() < 1e-6);
    assert!(a["verdicts"].as_array().unwrap().iter().all(|t| t["verdict"] == "pass"));
}

/// Without planning CT, mask and bones nothing tells tissue from air: nothing is said of tissue, nor of bone contact.
#[test]
fn a_field_alone_is_measured_everywhere_and_no_rule_fails() {
    let still = still("beside.mha", read_image(&phantom().planning).unwrap().value.grid());
    let out = folder().join("alone");
    let mut command = aventail();
    command.args(["evaluate", "--quiet", "--out"]).arg(&out).arg("--compare").arg(truth()).arg(&still);
    command.assert().success();
    for field in json(&out.join("evaluation.json"))["fields"].as_array().unwrap() {
        let a = &field["assessment"];
        assert_eq!((a["domain"].as_str(), a["bones_known"].as_bool()), (Some("grid"), Some(false)));
        for v in a["verdicts"].as_array().unwrap() {
            assert!(v["verdict"] != "fail" && v["name"].as_str().unwrap().contains("whole grid, air included"), "{v}");
            assert!(
                !v["name"].as_str().unwrap().contains("tissue") && !v["reason"].to_string().contains("tissue"),
                "{v}"
            );
        }
    }
    let text = fs::read_to_string(out.join("evaluation.md")).unwrap();
    assert!(text.contains("| folded cells of bone contact, cells | \u{2013} | \u{2013} |"), "{text}");
    assert!(!fs::read_to_string(out.join("evaluation.csv")).unwrap().contains("NaN"));
}

#[test]
fn what_cannot_be_measured_is_refused() {
    let f = phantom();
    let push = |c: &mut Command| {
        c.arg("--planning-to-fraction").arg(truth());
    };
    refused(&mut evaluate("no_field"), 2, &["no field is given", "--planning-to-fraction"]);
    let mut both = evaluate("both");
    push(&mut both);
    refused(both.arg("--compare").arg(truth()), 2, &["--compare"]);
    let mut missing = evaluate("missing");
    refused(missing.arg("--planning-to-fraction").arg(folder().join("nothing.mha")), 3, &["nothing.mha"]);
    let mut scalar = evaluate("scalar");
    refused(scalar.arg("--planning-to-fraction").arg(&f.planning), 4, &["planning_ct.nii.gz"]);
    let grid = Grid::axis_aligned([4, 4, 4], [1.0; 3], [0.0; 3]).unwrap();
    let empty = files::image(&folder().join("empty.nii.gz"), &Volume::filled(grid.clone(), 0.0));
    let mut mask = evaluate("mask");
    push(&mut mask);
    refused(mask.arg("--mask").arg(empty), 4, &["no voxel of the mask is set"]);
    let other = LabelMap { volume: Volume::filled(grid, 1), names: [(1, "liver".to_owned())].into() };
    let other = files::labels(&folder().join("other.nii.gz"), &other);
    let mut names = evaluate("names");
    push(&mut names);
    names.arg("--labels-planning").arg(&f.bones).arg("--labels-fraction").arg(other);
    refused(&mut names, 4, &["no structure is in both"]);
    let mut alone = evaluate("alone");
    push(&mut alone);
    refused(alone.arg("--then").arg(truth()), 2, &["--direct"]);
}

/// The pages beside a mapped dose and a sum of it, a quarter and three quarters: what they show, and that they are known.
fn pages_of_carried_dose([there, sum]: [&Path; 2]) {
    let beside = |dose: &Path, extension: &str| {
        PathBuf::from(dose.display().to_string().replace(".nii.gz", &format!(".{extension}")))
    };
    let read = |dose: &Path| fs::read_to_string(beside(dose, "html")).unwrap();
    let (map, both) = (read(there), read(sum));
    // Before and after; the sum, two shares, histograms.
    for (page, pictures) in [(&map, 2), (&both, 4)] {
        assert_eq!(page.matches("data:image/png;base64,").count(), pictures);
        assert!(page.contains("Steep dose") && page.contains("class=\"sign\"") && !page.contains("<script"));
    }
    assert!(map.contains("Before, where it was computed") && map.contains("After, on the fraction"));
    assert!(both.contains("<td class=\"n\">25.0</td>") && both.contains("<td class=\"n\">75.0</td>"));
    assert!(both.contains(">mandible<"));
    for dose in [there, sum] {
        let outputs = json(&beside(dose, "json"))["outputs"].as_array().unwrap().clone();
        assert_eq!(outputs.len(), 2, "{outputs:?}");
        aventail().arg("inspect").arg(beside(dose, "json")).assert().success();
    }
}

/// A ball of dose on the phantom's planning grid.
fn dose() -> PathBuf {
    let path = folder().join("dose.nii.gz");
    let grid = read_image(&phantom().planning).unwrap().value.grid().clone();
    let middle = grid.middle();
    let gy = |l: usize| 70.0 * (-((grid.centre(grid.voxel(l)) - middle).norm() / 60.0).powi(4)).exp() as f32;
    files::image(&path, &Volume::from_fn(grid.clone(), gy))
}

fn run_dose(verb: &str, out: &Path) -> Command {
    let mut command = aventail();
    command.args(["dose", verb, "--out"]).arg(out);
    command
}

#[test]
fn dose_goes_there_and_back_and_adds_up() {
    let f = phantom();
    let dose = dose();
    let there = folder().join("dose_on_fraction.nii.gz");
    let mut map = run_dose("map", &there);
    let one_way = |command: &mut Command| {
        let out = command.assert().success().get_output().stdout.clone();
        String::from_utf8(out).unwrap()
    };
    map.arg("--dose").arg(&dose).args(["--to", "fraction", "--method", "energy-mass", "--json", "--grid"]);
    map.arg(&f.fraction).arg("--ct").arg(&f.planning).arg("--planning-to-fraction").arg(truth()).assert().success();
    let report = json(&folder().join("dose_on_fraction.json"));
    let balance = &report["parts"][0]["balance"];
    assert!(balance["relative_error"].as_f64().unwrap() <= 1e-6, "{balance}");
    assert!(balance["mapped_j"].as_f64().unwrap() > 0.9 * balance["source_j"].as_f64().unwrap(), "{balance}");
    let sum = folder().join("sum.nii.gz");
    let mut back = run_dose("accumulate", &sum);
    back.arg("--dose").arg(&there).arg(&there).arg("--fields").arg(truth()).arg(truth());
    back.args(["--weights", "0.25", "0.75", "--grid"]).arg(&dose);
    back.arg("--page-ct").arg(&f.planning).arg("--structures").arg(&f.bones).assert().success();
    pages_of_carried_dose([&there, &sum]);
    // Without a page none is left of the run before.
    let mut bare = run_dose("map", &there);
    bare.arg("--dose").arg(&dose).args(["--to", "fraction", "--no-page", "--grid"]).arg(&f.fraction);
    let told = one_way(bare.arg("--planning-to-fraction").arg(truth()));
    assert!(told.contains("the dose went through the inverse of the given field"), "{told}");
    assert!(!folder().join("dose_on_fraction.html").exists());
    assert_eq!(json(&folder().join("dose_on_fraction.json"))["outputs"].as_array().unwrap().len(), 1);
    // There and back is the planned dose, but for resampling at 5 mm.
    let out = folder().join("dose_compare");
    run_dose("compare", &out).arg("--dose").arg(&sum).arg("--reference").arg(&dose).assert().success();
    let mean = json(&out.join("compare.json"))["difference_gy"]["magnitude"]["mean"].as_f64().unwrap();
    println!("there and back: {mean:.4} Gy on the mean");
    assert!(mean < 1.5, "{mean}");
    let drawn = folder().join("dose_compare_on_ct");
    let mut compare = run_dose("compare", &drawn);
    compare.arg("--dose").arg(&sum).arg("--reference").arg(&dose).arg("--ct").arg(&f.planning).assert().success();
    for (page, pictures) in [(&out, 3), (&drawn, 3)].map(|(run, n)| (run.join("compare.html"), n)) {
        let text = fs::read_to_string(&page).unwrap();
        assert_eq!(text.matches("data:image/png;base64,").count(), pictures, "{}", page.display());
        assert!(
            text.contains("steep dose") && !text.contains("<script") && !text.contains("https:"),
            "{}",
            page.display()
        );
    }
    let curves = folder().join("dvh");
    let mut dvh = run_dose("dvh", &curves);
    dvh.arg("--dose").arg(&dose).arg(&sum).arg("--structures").arg(&f.bones).args(["--at", "20", "50"]);
    dvh.assert().success();
    assert_eq!(files_below(&curves), ["dvh.csv", "dvh.html", "dvh.json", "dvh.png", "dvh_figures.csv", "dvh_run.json"]);
    let figures = fs::read_to_string(curves.join("dvh_figures.csv")).unwrap();
    assert!(figures.contains("v50gy_percent") && figures.contains("mandible"), "{figures}");
}

#[test]
fn dose_that_makes_no_sense_is_refused() {
    let f = phantom();
    let dose = dose();
    let out = folder().join("refused.nii.gz");
    let map = || {
        let mut c = run_dose("map", &out);
        c.args(["--to", "fraction", "--grid"]).arg(&f.fraction).arg("--planning-to-fraction").arg(truth());
        c
    };
    refused(map().arg("--dose").arg(&dose).args(["--method", "energy-mass"]), 2, &["no CT", "--ct"]);
    refused(map().arg("--dose").arg(&f.planning), 4, &["Gy at voxel"]);
    let mut parts = map();
    parts.arg("--dose").arg(&dose).args(["--method", "energy-mass", "--parts", "0", "--ct"]).arg(&f.planning);
    refused(&mut parts, 4, &["parts = 0"]);
    let mut sum = run_dose("accumulate", &out);
    sum.arg("--dose").arg(&dose).arg(&dose).arg("--fields").arg(truth()).arg("--grid").arg(&dose);
    refused(&mut sum, 2, &["2 doses but 1 values of --fields"]);
    let mut format = run_dose("map", &folder().join("dose.txt"));
    format.args(["--to", "fraction", "--grid"]).arg(&f.fraction).arg("--planning-to-fraction").arg(truth());
    refused(format.arg("--dose").arg(&dose), 2, &["dose.txt"]);
    assert!(!out.exists() && !folder().join("refused.json").exists());
}

#[test]
fn help_teaches_with_examples() {
    for words in [&["evaluate"][..], &["dose", "map"], &["dose", "accumulate"], &["dose", "dvh"], &["dose", "compare"]]
    {
        let run = aventail().args(words).arg("--help").assert().success();
        let help = String::from_utf8(run.get_output().stdout.clone()).unwrap();
        assert!(help.contains("Example") && help.contains("--out"), "{help}");
    }
}

#[test]
fn a_field_that_its_own_run_doubts_does_not_pass_when_it_is_measured_again() {
    // The run's own files, with a warning that puts its result in doubt.
    let run = folder().join("doubted");
    fs::create_dir_all(&run).unwrap();
    let name = "planning_to_fraction.nii.gz";
    fs::copy(done().out.join(name), run.join(name)).unwrap();
    let mut report = json(&done().out.join("report.json"));
    let warnings =
        serde_json::json!([{ "code": "joint-limit", "message": "skull: its joint is 9 deg beyond its soft range" }]);
    report["warnings"] = warnings;
    fs::write(run.join("report.json"), report.to_string()).unwrap();
    let doubts = |field: &Path, out: &str| {
        evaluate(out).arg("--planning-to-fraction").arg(field).assert().success();
        let all = json(&folder().join(out).join("evaluation.json"))["fields"][0]["assessment"]["verdicts"].clone();
        let told = |v: &serde_json::Value| (v["name"] == "warning: joint-limit").then(|| v["reason"].to_string());
        all.as_array().unwrap().iter().filter_map(told).collect::<Vec<_>>()
    };
    let told = doubts(&run.join(name), "of_its_run");
    assert!(told.len() == 1 && told[0].contains("told by the run that wrote it: skull"), "{told:?}");
    // Another field beside that report is not its own.
    fs::copy(truth(), run.join(name)).unwrap();
    assert_eq!(doubts(&run.join(name), "of_another"), Vec::<String>::new());
}
