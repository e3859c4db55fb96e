//! `aventail summary`: the run that is unlike the others is found among many, and nothing of them is touched.

#![expect(clippy::unwrap_used, reason = "a test that cannot read what it wrote fails")]

use crate::support::{Register, aventail, done, folder, small_phantom};
use serde_json::Value;
use std::fs;
use std::path::{Path, PathBuf};

/// Five patients with three fractions each, copies of a real report; landmarks of one are far off.
fn cohort() -> PathBuf {
    let out = folder().join("results");
    let report: Value = serde_json::from_slice(&fs::read(done().out.join("report.json")).unwrap()).unwrap();
    for patient in 1..=5 {
        for fraction in [1, 2, 10] {
            let mut own = report.clone();
            let mean = if (patient, fraction) == (4, 10) { 7.5 } else { 0.4 + 0.01 * f64::from(patient + fraction) };
            own["landmarks"]["after"]["mean"] = mean.into();
            let folder = out.join(format!("patient {patient}/fx{fraction}"));
            fs::create_dir_all(&folder).unwrap();
            fs::write(folder.join("report.json"), own.to_string()).unwrap();
        }
    }
    out
}

fn json(path: &Path) -> Value {
    serde_json::from_slice(&fs::read(path).unwrap()).unwrap()
}

#[test]
fn many_runs_become_one_table_and_one_page() {
    let (results, out) = (cohort(), folder().join("summary"));
    let run = aventail().arg("summary").arg(&results).arg("--out").arg(&out).assert().success();
    let said = String::from_utf8(run.get_output().stdout.clone()).unwrap();
    assert!(said.contains("15 runs of 5 patients") && said.contains("1 with figures that stand apart"), "{said}");
    assert!(said.contains("patient 4, fx10: landmarks, mean 7.50 mm"), "{said}");
    assert!(!said.contains(" ..."), "cut off: {said}");
    let summary = json(&out.join("summary.json"));
    let runs = summary["runs"].as_array().unwrap();
    let names: Vec<&str> = runs.iter().map(|r| r["fraction"].as_str().unwrap()).collect();
    assert_eq!(names[..6], ["fx1", "fx2", "fx10", "fx1", "fx2", "fx10"]);
    let odd: Vec<&Value> = runs.iter().filter(|r| !r["stand_apart"].as_array().unwrap().is_empty()).collect();
    assert_eq!((odd.len(), odd[0]["folder"].as_str().unwrap()), (1, "../results/patient 4/fx10"));
    // Every figure is the report's own.
    let report = json(&results.join("patient 4/fx10/report.json"));
    let figures = &odd[0]["figures"];
    assert_eq!(figures["landmarks_mean_mm"], report["landmarks"]["after"]["mean"]);
    assert_eq!(figures["folded_percent"], report["jacobian"]["body"]["folded_percent"]);
    assert_eq!(figures["uncertainty_p95_mm"], report["uncertainty"]["soft_tissue_mm"]["p95"]);
    let page = fs::read_to_string(out.join("summary.html")).unwrap();
    assert!(page.contains("href=\"../results/patient 4/fx10/report.html\""));
    let table = fs::read_to_string(out.join("summary.csv")).unwrap();
    assert_eq!(table.lines().count(), 16);
    let inspect = aventail().arg("inspect").arg(&out).assert().success();
    assert!(String::from_utf8_lossy(&inspect.get_output().stdout).contains("2 files are as its report says"));
    // Once more, over itself.
    aventail().arg("summary").arg(&results).arg("--out").arg(&out).assert().success();
}

#[test]
fn what_is_no_run_is_refused_and_runs_stay_untouched() {
    let at = |name: &str| folder().join(name);
    let refused = |path: &Path, out: &Path, code: i32, said: &str| {
        let run = aventail().arg("summary").arg(path).arg("--out").arg(out).assert().code(code);
        let message = String::from_utf8(run.get_output().stderr.clone()).unwrap();
        assert!(message.contains(said) && message.contains("remedy"), "{message}");
    };
    fs::create_dir_all(at("empty")).unwrap();
    refused(&at("empty"), &at("a"), 4, "report.json");
    refused(&at("nowhere"), &at("a"), 3, "nowhere");
    fs::create_dir_all(at("damaged")).unwrap();
    fs::write(at("damaged/report.json"), "{\"version\": 3}").unwrap();
    refused(&at("damaged"), &at("a"), 3, "damaged");
    assert!(!at("a").join("summary.json").exists());
    // Beside a run the run stays as it was.
    let own = at("own");
    fs::create_dir_all(&own).unwrap();
    fs::copy(done().out.join("report.json"), own.join("report.json")).unwrap();
    aventail().arg("summary").arg(&own).arg("--out").arg(&own).assert().success();
    let report = |folder: &Path| fs::read(folder.join("report.json")).unwrap();
    assert!(report(&own) == report(&done().out) && own.join("summary.html").exists());
}

#[test]
fn a_run_tells_what_it_will_need_and_writes_nothing() {
    let register = Register::quick("estimated").flag("--estimate").flag("--json").with("--threads", "2");
    let run = register.command().assert().success();
    let told: Value = serde_json::from_slice(&run.get_output().stdout).unwrap();
    assert_eq!(told["threads"], 2);
    let bytes = told["memory_bytes"].as_f64().unwrap();
    assert!((5e7..2e9).contains(&bytes), "{bytes}");
    assert!(!register.out.exists());
    // It needs no folder.
    let p = small_phantom();
    let estimate = |bones: &Path| {
        let mut run = aventail();
        run.args(["register", "--estimate", "--planning"]).arg(&p.planning).arg("--fraction").arg(&p.fraction);
        run.arg("--bones").arg(bones);
        run
    };
    let run = estimate(&p.bones).assert().success();
    assert!(String::from_utf8_lossy(&run.get_output().stdout).contains("GB of memory"));
    let run = estimate(Path::new("auto")).assert().code(2);
    assert!(String::from_utf8_lossy(&run.get_output().stderr).contains("add --out DIR"));
    // What the run would refuse before it begins, this refuses too.
    let marks = register.out.with_file_name("cut_landmarks.csv");
    fs::write(&marks, "name,planning_x,planning_y\nnose,1,2\n").unwrap();
    for option in ["--landmarks", "--bone-landmarks", "--start"] {
        let run = Register::searched("estimated").flag("--estimate").with(option, &marks).command().assert().failure();
        let told = String::from_utf8_lossy(&run.get_output().stderr).into_owned();
        assert!(told.contains("cut_landmarks.csv"), "{option}: {told}");
    }
}
