//! Samples of a registration, and doses through them.

#![expect(clippy::unwrap_used, reason = "a test that cannot read what it wrote fails")]

use crate::support::{
    Register, aventail, copy, done, files, files_below, folder, near, phantom, quick_settings, small_phantom,
};
use aventail::field::{PushField, folded_cells};
use aventail::io::samples::{self, SAMPLES};
use aventail::io::{read_field, read_image, read_labels};
use aventail::volume::Volume;
use nalgebra::{Point3, Vector3};
use serde_json::Value;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::OnceLock;

const NUMBER: usize = 8;

/// Samples of the run that all tests look at, drawn once.
fn drawn() -> &'static Path {
    static FOLDER: OnceLock<PathBuf> = OnceLock::new();
    FOLDER.get_or_init(|| {
        let out = folder().join("drawn");
        draw(&done().out, &out, &["--number", &NUMBER.to_string()]);
        out
    })
}

fn draw(run: &Path, out: &Path, more: &[&str]) {
    aventail().arg("samples").arg(run).args(more).args(["-q", "--out"]).arg(out).assert().success();
}

fn read_json(path: &Path) -> Value {
    serde_json::from_slice(&fs::read(path).unwrap()).unwrap()
}

/// The planned dose and contours of the phantom.
fn patient(name: &str) -> PathBuf {
    phantom().planning.with_file_name(name)
}

/// Runs `dose accumulate` of one dose through the run's field and samples; exit code and what it prints.
fn accumulate(dose: &Path, out: &Path, more: &[&str]) -> (i32, String) {
    let field = done().out.join("planning_to_fraction.nii.gz");
    let mut command = aventail();
    command.args(["dose", "accumulate", "-q", "--dose"]).arg(dose).arg("--fields").arg(field);
    command.arg("--grid").arg(&phantom().planning).arg("--out").arg(out).args(more);
    let output = command.output().unwrap();
    (output.status.code().unwrap(), String::from_utf8([output.stdout, output.stderr].concat()).unwrap())
}

#[test]
fn they_are_the_same_bits_again_and_with_the_registration_itself() {
    let first = drawn();
    let about = read_json(&first.join(SAMPLES));
    let report = read_json(&done().out.join("report.json"));
    let outputs = report["outputs"].as_array().unwrap();
    let listed = |name: &Value| outputs.iter().find(|o| o["name"] == *name).unwrap()["sha256"].clone();
    for field in about["fields"].as_array().unwrap() {
        assert_eq!(field["sha256"], listed(&field["name"]));
    }
    assert_eq!(about["options"]["number"], NUMBER);
    assert_eq!(about["motions"].as_array().unwrap().len(), NUMBER);
    // One thread, and fewer of them: the same first ones.
    let again = folder().join("again");
    draw(&done().out, &again, &["--number", "3", "--threads", "1"]);
    let bytes = |folder: &Path, n: usize| read_field(folder.join(format!("sample_{n:03}.nii.gz"))).unwrap().value;
    for n in 1..=3 {
        assert!(bytes(first, n) == bytes(&again, n));
    }
    assert_eq!(files_below(&again).len(), 6, "{:?}", files_below(&again));
    // Drawn together with the registration.
    let settings = format!("{}[output]\nuncertainty = true\n", fs::read_to_string(quick_settings()).unwrap());
    let settings = files::bytes(&folder().join("with_samples.toml"), settings.as_bytes());
    let run = Register::of(small_phantom(), folder().join("with_samples")).with("--start", near()).flag("--quiet");
    run.with("--config", settings).with("--samples", "3").command().assert().success();
    let (beside, after) = (folder().join("with_samples/samples"), folder().join("after_it"));
    draw(&folder().join("with_samples"), &after, &["--number", "3"]);
    for n in 1..=3 {
        assert!(bytes(&after, n) == bytes(&beside, n), "sample {n}");
    }
    aventail().arg("inspect").arg(beside.join(SAMPLES)).assert().success();
    // The report shows what the first three add, as their own page does; without samples it does not.
    let turns = |page: &Path| {
        let html = fs::read_to_string(page).unwrap();
        html.split_once("<div class=\"turns\">").map(|(_, rest)| rest.split_once("</div>").unwrap().0.to_owned())
    };
    let shown = turns(&folder().join("with_samples/report.html")).unwrap();
    assert!(shown.matches("<figure>").count() == 3 && shown.matches("data:image/png;base64,").count() == 3);
    assert!(turns(&beside.join("samples.html")).unwrap() == shown);
    assert!(turns(&done().out.join("report.html")).is_none());
    let other = folder().join("other_seed");
    draw(&done().out, &other, &["--number", "2", "--seed", "7"]);
    assert!(bytes(first, 1) != bytes(&other, 1));
    // Fewer samples leave none of the earlier ones.
    draw(&done().out, &again, &["--number", "2"]);
    assert_eq!(files_below(&again).len(), 5, "{:?}", files_below(&again));
}

#[test]
fn bones_stay_rigid_and_nothing_folds_that_did_not() {
    let (about, set) = samples::read(drawn()).unwrap();
    let push = read_field(done().out.join("planning_to_fraction.nii.gz")).unwrap().value;
    let labels = read_labels(&phantom().bones, None).unwrap().value;
    let grid = push.grid().clone();
    let moved = |l: usize| {
        let x = grid.centre(grid.voxel(l));
        (x, x + Vector3::from(push.data()[l].map(f64::from)))
    };
    let mut sampled = vec![push.data().to_vec(); NUMBER];
    let mut room = vec![Vector3::zeros(); NUMBER];
    let mut most = 0f64;
    for l in 0..grid.len() {
        let (x, there) = moved(l);
        set.at(&x, &there, &mut room);
        for (field, added) in sampled.iter_mut().zip(&room) {
            most = most.max(added.norm());
            (0..3).for_each(|a| field[l][a] += added[a] as f32);
        }
    }
    assert!(most > 0.5 && most < 60.0, "{most}");
    for bone in &about.bones {
        let own: Vec<usize> = (0..grid.len()).filter(|l| labels.volume.data()[*l] == bone.label).collect();
        let (Some(first), Some(last)) = (own.first(), own.last()) else { continue };
        let ((a, there), (b, far)) = (moved(*first), moved(*last));
        let mut others = room.clone();
        set.at(&a, &there, &mut room);
        set.at(&b, &far, &mut others);
        for (u, v) in room.iter().zip(&others) {
            let change = ((far + v) - (there + u)).norm() - (far - there).norm();
            assert!(change.abs() < 1e-5, "{}: {change}", bone.name);
        }
    }
    let computed = read_image(done().out.join("computed.nii.gz")).unwrap().value.map(|v| *v > 0.0);
    // Between bones that meet, rigid motions of their own fold cells in truth, too.
    let meets = |cell: usize| {
        let at = grid.voxel(cell);
        let around = |a: usize| at[a].saturating_sub(2)..(at[a] + 4).min(grid.size()[a]);
        let mut found = 0;
        around(2).any(|k| {
            around(1).any(|j| {
                around(0).any(|i| {
                    let label = *labels.volume.at([i, j, k]);
                    let other = label != 0 && found != 0 && label != found;
                    found = if label != 0 { label } else { found };
                    other
                })
            })
        })
    };
    let folds = |field: Vec<[f32; 3]>| {
        let displacement = Volume::new(grid.clone(), field).unwrap();
        let folded = folded_cells(&PushField { displacement, computed: computed.clone() });
        folded.into_iter().filter(|cell| !meets(*cell)).count()
    };
    let before = folds(push.data().to_vec());
    let more = sampled.into_iter().map(|field| folds(field).saturating_sub(before) as f64 / grid.len() as f64);
    let most = more.fold(0.0, f64::max);
    println!("at most {:.4} % more of the cells fold", 100.0 * most);
    // docs/decisions/samples.md has those of real scans.
    assert!(most <= 1e-4, "{:.4} % more of the cells fold", 100.0 * most);
}

#[test]
fn where_dose_rises_evenly_its_deviation_is_slope_times_displacement() {
    // 0.25 Gy/mm from front to back over the whole scan.
    let planning = read_image(&phantom().planning).unwrap().value;
    let wide = planning.grid().clone();
    let ramp = Volume::from_fn(wide.clone(), |l| 30.0 + 0.25 * wide.centre(wide.voxel(l)).y as f32);
    let lift = -ramp.extremes()[0].min(0.0);
    let dose = files::image(&folder().join("ramp.nii.gz"), &ramp.map(|d| d + lift));
    let out = folder().join("ramp_there.nii.gz");
    let (code, text) = accumulate(&dose, &out, &["--no-page", "--samples", drawn().to_str().unwrap()]);
    assert_eq!(code, 0, "{text}");
    let sd = read_image(folder().join("ramp_there_sd.nii.gz")).unwrap().value;
    let (_, set) = samples::read(drawn()).unwrap();
    let push = read_field(done().out.join("planning_to_fraction.nii.gz")).unwrap().value;
    let body = read_image(done().out.join("body.nii.gz")).unwrap().value;
    let mut room = vec![Vector3::zeros(); NUMBER];
    let (mut checked, inner) = (0, |p: &Point3<f64>| {
        let index = wide.index(p);
        (0..3).all(|a| index[a] > 6.0 && index[a] < wide.size()[a] as f64 - 7.0)
    });
    for l in (0..wide.len()).step_by(37).filter(|l| body.data()[*l] > 0.0) {
        let x = wide.centre(wide.voxel(l));
        let there = x + Vector3::from(push.data()[l].map(f64::from));
        if !inner(&there) {
            continue;
        }
        set.at(&x, &there, &mut room);
        if room.iter().any(|u| !inner(&(there + u))) {
            continue;
        }
        let mean = room.iter().map(|u| u.y).sum::<f64>() / NUMBER as f64;
        let square = room.iter().map(|u| (u.y - mean).powi(2)).sum::<f64>() / (NUMBER - 1) as f64;
        let (wanted, found) = (0.25 * square.sqrt(), f64::from(sd.data()[l]));
        assert!((found - wanted).abs() < 1e-3 + 0.01 * wanted, "{found} for {wanted} at {x}");
        checked += 1;
    }
    assert!(checked > 300, "{checked}");
}

#[test]
fn figures_have_intervals_and_limits_within_are_undecided() {
    let (dose, contours) = (patient("dose.nii.gz"), patient("contours.json"));
    let names: Vec<String> =
        aventail::io::read_contours(&contours).unwrap().0.structures.iter().map(|s| s.name.clone()).collect();
    let out = folder().join("interval.nii.gz");
    let structures = ["--structures", contours.to_str().unwrap(), "--samples", drawn().to_str().unwrap()];
    let (code, text) = accumulate(&dose, &out, &[&structures[..], &["--at", "30"]].concat());
    assert_eq!(code, 0, "{text}");
    let told = read_json(&folder().join("interval.json"));
    let bands = told["samples"]["structures"].as_array().unwrap();
    assert!(bands.len() >= 2 && told["samples"]["number"] == NUMBER, "{told}");
    let mut widest: Option<(String, f64, f64, f64)> = None;
    for band in bands {
        for figure in band["figures"].as_array().unwrap() {
            let of = |key: &str| figure[key].as_f64().unwrap();
            let (low, value, high) = (of("low"), of("value"), of("high"));
            assert!(low <= high, "{figure}");
            let name = format!("{}:{}", band["name"].as_str().unwrap(), figure["figure"].as_str().unwrap());
            if widest.as_ref().is_none_or(|(_, l, h, _)| high - low > h - l) {
                widest = Some((name, low, high, value));
            }
        }
    }
    let (name, low, high, _) = widest.unwrap();
    assert!(high - low > 0.05, "{name}: {low} to {high}");
    assert!(names.iter().any(|n| name.starts_with(n.as_str())), "{name}");
    // Beside the dose: its deviation and percentiles, in their order.
    let map = |word: &str| read_image(folder().join(format!("interval_{word}.nii.gz"))).unwrap().value;
    let (found, p05, p95) = (read_image(&out).unwrap().value, map("p05"), map("p95"));
    assert!(p05.data().iter().zip(p95.data()).all(|(l, h)| l <= h));
    assert!(found.grid().matches(p05.grid(), 1e-3) && map("sd").extremes()[1] > 0.5);
    aventail().arg("inspect").arg(folder().join("interval.json")).assert().success();
    // Limits: within, below and above the interval.
    let limits = [(0.5 * (low + high), "undecided"), (high + 1.0, "kept"), (low - 1.0, "not kept")];
    let each = limits.map(|(value, _)| format!("{name}<={value}"));
    let asked: Vec<&str> = each.iter().flat_map(|limit| ["--limit", limit]).collect();
    let (code, text) = accumulate(&dose, &out, &[&structures[..], &["--at", "30"], &asked].concat());
    let told: Vec<&str> = text.lines().filter(|line| line.contains("limit ")).collect();
    assert!(code == 0 && told.len() == 3, "{text}");
    let page = fs::read_to_string(folder().join("interval.html")).unwrap();
    for ((_, word), line) in limits.iter().zip(told) {
        assert!(line.contains(&format!(": {word} (")), "{word}: {text}");
        assert!(page.contains("Limits") && page.contains(word) && page.contains("90 % intervals"));
    }
    let (code, text) = accumulate(&dose, &out, &[&structures[..], &["--limit", "nowhere:D95<=3"]].concat());
    assert!(code == 2 && text.contains("nowhere") && text.contains("structures:"), "{text}");
}

#[test]
fn what_fractions_have_in_common_is_told() {
    let (dose, field) = (patient("dose.nii.gz"), done().out.join("planning_to_fraction.nii.gz"));
    let out = folder().join("twice.nii.gz");
    let sum = |samples: [&Path; 2], weights: [&str; 2]| {
        let mut command = aventail();
        command.args(["dose", "accumulate", "-q", "--no-page", "--dose"]).args([&dose, &dose]);
        command.arg("--fields").args([&field, &field]).arg("--weights").args(weights);
        command.arg("--grid").arg(&phantom().planning).arg("--samples").args(samples).arg("--out").arg(&out);
        command.output().unwrap()
    };
    // A fraction twice has all in common, with any weights.
    for weights in [["0.5", "0.5"], ["0.8", "0.2"]] {
        let output = sum([drawn(), drawn()], weights);
        assert!(output.status.success() && String::from_utf8_lossy(&output.stdout).contains("100 % of that variance"));
        let told = read_json(&folder().join("twice.json"));
        let percent = told["samples"]["common_percent"].as_f64().unwrap();
        assert!((percent - 100.0).abs() < 0.1, "{percent}");
    }
    // Other seeds have nothing in common that they ought to have.
    let other = folder().join("seeded");
    copy(drawn(), &other);
    let mut about = read_json(&other.join(SAMPLES));
    about["options"]["seed"] = 5.into();
    fs::write(other.join(SAMPLES), about.to_string()).unwrap();
    let output = sum([drawn(), &other], ["0.5", "0.5"]);
    let text = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.code() == Some(2) && text.contains("seed 0") && text.contains("seed 5"), "{text}");
}

#[test]
fn histograms_of_plannings_structures_in_a_dose_of_the_fraction() {
    // The phantom's planned dose stands for one of the fraction.
    let (dose, contours, field) =
        (patient("dose.nii.gz"), patient("contours.json"), done().out.join("planning_to_fraction.nii.gz"));
    let dvh = |out: &Path, more: &[&str]| {
        let mut command = aventail();
        command.args(["dose", "dvh", "-q", "--dose"]).arg(&dose).arg("--structures").arg(&contours);
        command.arg("--out").arg(out).args(more).output().unwrap()
    };
    let out = folder().join("dvh_there");
    let (field, samples) = (field.to_str().unwrap(), drawn().to_str().unwrap());
    let all = [
        "--planning-to-fraction",
        field,
        "--samples",
        samples,
        "--limit",
        "spinal_cord:mean>=0",
        "spinal_cord:Dmax>=0",
    ];
    let output = dvh(&out, &all);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let text = String::from_utf8(output.stdout).unwrap();
    assert!(text.contains("limit spinal_cord mean") && text.contains("kept"), "{text}");
    assert!(text.contains("limit spinal_cord Dmax"), "{text}");
    assert_eq!(
        files_below(&out).len(),
        7,
        "curves, figures, intervals, JSON, picture, page, run: {:?}",
        files_below(&out)
    );
    // As carried back to planning by `dose map`, but for the grid of the dose.
    let mapped = folder().join("dvh_mapped.nii.gz");
    let mut command = aventail();
    command.args(["dose", "map", "-q", "--to", "planning", "--dose"]).arg(&dose).arg("--grid").arg(&dose);
    command.args(["--planning-to-fraction", field, "--samples", samples, "--structures"]).arg(&contours);
    command.arg("--out").arg(&mapped).assert().success();
    let wanted = read_json(&folder().join("dvh_mapped.json"))["samples"]["structures"].clone();
    let found = read_json(&out.join("dvh.json"));
    let figures = |all: &Value| -> Vec<(String, [f64; 3])> {
        let figure = |f: &Value| ["value", "low", "high"].map(|key| f[key].as_f64().unwrap());
        let of = |s: &Value| ("mean".to_owned() + s["name"].as_str().unwrap(), figure(&s["figures"][0]));
        all.as_array().unwrap().iter().map(of).collect()
    };
    let (found, wanted) = (figures(&found[0]["samples"]["structures"]), figures(&wanted));
    assert!(found.len() >= 2 && found.len() == wanted.len());
    for ((name, found), (other, wanted)) in found.iter().zip(&wanted) {
        let wide = wanted[2] - wanted[1];
        let near = |a: f64, b: f64| (a - b).abs() < 0.15 + 0.1 * wide;
        assert!(name == other && (0..3).all(|n| near(found[n], wanted[n])), "{name}: {found:?} for {wanted:?}");
    }
    assert!(found.iter().any(|(_, [_, low, high])| high - low > 0.05), "{found:?}");
    let lines = fs::read_to_string(out.join("dvh_intervals.csv")).unwrap();
    assert!(lines.starts_with("dose,structure,figure,unit,value,low,high") && lines.lines().count() > 12, "{lines}");
    // Without a field they would say nothing.
    let output = dvh(&folder().join("dvh_refused"), &["--samples", samples]);
    assert!(
        output.status.code() == Some(2) && String::from_utf8_lossy(&output.stderr).contains("--planning-to-fraction")
    );
    assert!(!folder().join("dvh_refused").exists());
}

#[test]
fn a_dose_without_gradient_is_sure_and_the_other_way_varies_alike() {
    let planning = read_image(&phantom().planning).unwrap().value;
    let even = files::image(&folder().join("even.nii.gz"), &Volume::filled(planning.grid().clone(), 20.0));
    let out = folder().join("even_there.nii.gz");
    let (code, text) = accumulate(&even, &out, &["--no-page", "--samples", drawn().to_str().unwrap()]);
    assert_eq!(code, 0, "{text}");
    let sd = read_image(folder().join("even_there_sd.nii.gz")).unwrap().value;
    let grid = sd.grid().clone();
    let inner = |l: &usize| grid.voxel(*l).iter().zip(grid.size()).all(|(v, n)| *v > 10 && v + 11 < n);
    assert!((0..grid.len()).filter(inner).all(|l| sd.data()[l] < 1e-3));
    // Planning's dose on the fraction varies as much as the fraction's on planning.
    let deviation = |to: &str| {
        let out = folder().join(format!("to_{to}.nii.gz"));
        let field = done().out.join("planning_to_fraction.nii.gz");
        let grid = if to == "fraction" { &phantom().fraction } else { &phantom().planning };
        let mut command = aventail();
        command.args(["dose", "map", "-q", "--no-page", "--to", to, "--dose"]).arg(patient("dose.nii.gz"));
        command.arg("--planning-to-fraction").arg(field).arg("--grid").arg(grid).arg("--out").arg(&out);
        command.arg("--samples").arg(drawn()).assert().success();
        read_json(&out.with_file_name(format!("to_{to}.json")))["samples"]["steep_sd_gy"].as_f64().unwrap()
    };
    let (there, back) = (deviation("fraction"), deviation("planning"));
    assert!(there > 0.05 && (there / back - 1.0).abs() < 0.35, "{there} {back}");
}

/// `warp` from planning to fraction with the run's field and samples.
fn warp(input: &Path, out: &Path, more: &[&str]) -> (i32, String) {
    let mut command = aventail();
    command.args(["warp", "-q", "--from", "planning", "--to", "fraction", "--input"]).arg(input).arg("--out").arg(out);
    command.arg("--field").arg(done().out.join("fraction_to_planning.nii.gz")).arg("--samples").arg(drawn()).args(more);
    let output = command.output().unwrap();
    (output.status.code().unwrap(), String::from_utf8([output.stdout, output.stderr].concat()).unwrap())
}

#[test]
fn contours_and_labels_tell_where_they_may_be() {
    let out = folder().join("contours_there.json");
    let (code, text) = warp(&patient("contours.json"), &out, &[]);
    assert_eq!(code, 0, "{text}");
    let there = aventail::io::read_contours(&out).unwrap().0;
    let volume = |name: &str| {
        let own = there.structures.iter().find(|s| s.name == name).unwrap_or_else(|| panic!("no {name}"));
        own.volume(there.spacing_of(own, 6.0))
    };
    let names: Vec<&String> = there.structures.iter().map(|s| &s.name).filter(|n| !n.ends_with(" %")).collect();
    assert!(names.len() >= 2 && there.structures.len() == 4 * names.len(), "{text}");
    for name in names {
        let [any, half, sure] = [5, 50, 95].map(|percent| volume(&format!("{name} {percent} %")));
        assert!(sure < half && half < any, "{name}: {sure} {half} {any}");
        assert!((half / volume(name) - 1.0).abs() < 0.15, "{name}: {half} for {}", volume(name));
    }
    let out = folder().join("labels_there.nii.gz");
    let (code, text) = warp(&phantom().bones, &out, &["--kind", "labels"]);
    assert_eq!(code, 0, "{text}");
    let found = read_labels(&out, None).unwrap().value;
    let (label, _) = found.names.iter().find(|(_, n)| *n == "mandible").unwrap();
    let share = read_image(folder().join("labels_there_share_mandible.nii.gz")).unwrap().value;
    let voxels = |least: f32| share.data().iter().filter(|v| **v >= least).count();
    let own = found.volume.data().iter().filter(|l| *l == label).count();
    assert!(share.grid().matches(found.volume.grid(), 1e-3) && share.extremes()[1] <= 1.0);
    assert!(voxels(0.95) < own && own < voxels(0.05), "{} {own} {}", voxels(0.95), voxels(0.05));
    // Of an image, backwards, or with points they have no meaning.
    assert_eq!(warp(&phantom().planning, &out, &["--kind", "image"]).0, 2);
    assert_eq!(warp(&phantom().landmarks, &folder().join("points.csv"), &[]).0, 2);
}

#[test]
fn what_does_not_belong_together_is_refused() {
    let dose = patient("dose.nii.gz");
    let out = folder().join("refused.nii.gz");
    let own = drawn().to_str().unwrap();
    // Two folders for one dose, another method, a folder that holds none.
    let (code, text) = accumulate(&dose, &out, &["--samples", own, own]);
    assert!(code == 2 && text.contains("one for each dose"), "{text}");
    let ct = phantom().fraction.to_str().unwrap();
    let (code, text) = accumulate(&dose, &out, &["--samples", own, "--method", "energy-mass", "--ct", ct]);
    assert!(code == 2 && text.contains("interpolat"), "{text}");
    let (code, text) = accumulate(&dose, &out, &["--samples", done().out.to_str().unwrap()]);
    assert!(code == 3 && text.contains("samples.json"), "{text}");
    // Samples of another registration.
    let stranger = folder().join("stranger");
    copy(drawn(), &stranger);
    let mut about = read_json(&stranger.join(SAMPLES));
    for field in about["fields"].as_array_mut().unwrap() {
        field["sha256"] = "0".repeat(64).into();
    }
    fs::write(stranger.join(SAMPLES), about.to_string()).unwrap();
    let (code, text) = accumulate(&dose, &out, &["--samples", stranger.to_str().unwrap()]);
    assert!(code == 4 && text.contains("samples-of-another-run"), "{text}");
    assert!(!out.exists() && !folder().join("refused_sd.nii.gz").exists());
    // A run that tells nothing of its uncertainty, and numbers out of range.
    let unsure = Register::quick("unsure");
    unsure.command().assert().success();
    let output = aventail().arg("samples").arg(&unsure.out).arg("-q").output().unwrap();
    let text = String::from_utf8(output.stderr).unwrap();
    assert!(output.status.code() == Some(4) && text.contains("uncertainty"), "{text}");
    assert!(!unsure.out.join("samples").exists());
    aventail().arg("samples").arg(&done().out).args(["--number", "1"]).assert().code(2);
    Register::quick("one_sample").with("--samples", "1").command().assert().code(2);
    assert!(!folder().join("one_sample").exists());
}

#[test]
fn a_scan_and_itself_leave_next_to_nothing_open() {
    let same = Register::of(small_phantom(), folder().join("same")).fraction(&small_phantom().planning);
    let same = same.with("--start", near()).with("--samples", "6").flag("--quiet");
    same.command().assert().success();
    let (_, set) = samples::read(&folder().join("same/samples")).unwrap();
    let push = read_field(folder().join("same/planning_to_fraction.nii.gz")).unwrap().value;
    let body = read_image(folder().join("same/body.nii.gz")).unwrap().value;
    let labels = read_labels(&small_phantom().bones, None).unwrap().value;
    let grid = push.grid();
    let mut room = vec![Vector3::zeros(); 6];
    let (mut square, mut n) = (0.0, 0);
    let soft = |l: &usize| body.data()[*l] > 0.0 && labels.volume.data()[*l] == 0;
    for l in (0..grid.len()).step_by(11).filter(soft) {
        let x = grid.centre(grid.voxel(l));
        set.at(&x, &(x + Vector3::from(push.data()[l].map(f64::from))), &mut room);
        square += room.iter().map(Vector3::norm_squared).sum::<f64>();
        n += room.len();
    }
    let deviation = (square / f64::from(n as u32)).sqrt();
    println!("a scan and itself: {deviation:.3} mm");
    assert!(deviation < 0.5, "{deviation}");
}
