//! `aventail warp` and the test objects, as users meet them: exact answers, round trips, every kind of file, refusals.

#![expect(clippy::unwrap_used, reason = "a test that cannot read what it wrote fails")]

use crate::support::{aventail, files, folder};
use assert_cmd::assert::Assert;
use aventail::io::{read_contours, read_field, read_image, read_label_map};
use std::fs;
use std::path::{Path, PathBuf};

fn at(name: &str) -> PathBuf {
    folder().join(name)
}

/// Runs `aventail warp --quiet --json` with words and paths.
fn warp(words: &[&str]) -> Assert {
    aventail().arg("warp").args(["--quiet", "--json"]).args(words).assert()
}

fn json(run: Assert) -> serde_json::Value {
    serde_json::from_slice(&run.success().get_output().stdout).unwrap()
}

/// Runs a command line that must be refused, and leaves nothing behind.
fn refused(words: &[&str], code: i32, names: &[&str]) {
    let run = warp(words).code(code);
    let message = String::from_utf8(run.get_output().stderr.clone()).unwrap();
    for name in names {
        assert!(message.contains(name), "`{name}` is not in\n{message}");
    }
    assert!(!message.contains("panicked"), "{message}");
    if let Some(n) = words.iter().position(|w| *w == "--out" || *w == "--out-field") {
        assert!(!Path::new(words[n + 1]).exists(), "{} was left behind", words[n + 1]);
    }
}

/// A test object's folder, made once.
fn object(name: &str) -> PathBuf {
    static LOCK: std::sync::Mutex<()> = std::sync::Mutex::new(());
    let _one_at_a_time = LOCK.lock();
    let out = at(name);
    if !out.join("landmarks.csv").exists() {
        aventail().args(["phantom", "--spacing", "3x3x3", "--field", name, "--out"]).arg(&out).assert().success();
    }
    out
}

fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

/// Columns of a CSV by name.
fn points(path: &Path, prefix: &str) -> Vec<[f64; 3]> {
    let mut table = csv::Reader::from_path(path).unwrap();
    let header = table.headers().unwrap().clone();
    let find = |c: &str| header.iter().position(|h| h == format!("{prefix}{c}")).unwrap();
    let columns = ["x", "y", "z"].map(find);
    table.records().map(|r| r.unwrap()).map(|r| columns.map(|c| r[c].parse().unwrap())).collect()
}

fn farthest(a: &[[f64; 3]], b: &[[f64; 3]]) -> f64 {
    assert_eq!(a.len(), b.len());
    let apart = |(p, q): (&[f64; 3], &[f64; 3])| (0..3).map(|c| (p[c] - q[c]).powi(2)).sum::<f64>().sqrt();
    a.iter().zip(b).map(apart).fold(0.0, f64::max)
}

const INVERTIBLE: [&str; 4] = ["shift", "rotation", "scaling", "swirl"];

#[test]
fn points_go_there_and_back_within_a_hundredth_of_a_millimetre() {
    for name in INVERTIBLE {
        let dir = object(name);
        let (push, marks) = (dir.join("planning_to_fraction.nii.gz"), dir.join("landmarks.csv"));
        let (there, back) = (dir.join("there.csv"), dir.join("back.csv"));
        let field = ["--field", text(&push)];
        warp(
            &[&field[..], &["--from", "planning", "--to", "fraction", "--input", text(&marks), "--out", text(&there)]]
                .concat(),
        )
        .success();
        let run = json(warp(
            &[&field[..], &["--from", "fraction", "--to", "planning", "--input", text(&there), "--out", text(&back)]]
                .concat(),
        ));
        let (before, after) = (points(&marks, "planning_"), points(&marks, "fraction_"));
        // The file's field is linear between voxels; the formula of the swirl is not.
        let bound = if name == "swirl" { 0.05 } else { 0.001 };
        assert!(farthest(&points(&there, ""), &after) < bound, "{name}: {}", farthest(&points(&there, ""), &after));
        assert!(farthest(&points(&back, ""), &before) < 0.01, "{name}");
        assert_eq!(run["mapped"]["unsolved"], 0);
        assert!(run["mapped"]["residual_mm"]["max"].as_f64().unwrap() < 1e-3, "{run}");
    }
}

#[test]
fn images_labels_and_dose_land_where_the_formula_says_with_either_field() {
    for name in ["rotation", "swirl"] {
        let dir = object(name);
        let exact = read_image(dir.join("fraction_image.nii.gz")).unwrap().value;
        let own = read_label_map(dir.join("fraction_labels.nii.gz"), None).unwrap().value;
        for (field, inverted) in [("fraction_to_planning.nii.gz", false), ("planning_to_fraction.nii.gz", true)] {
            let (field, out) = (dir.join(field), dir.join("warped.nii.gz"));
            let common = ["--field", text(&field), "--from", "planning", "--to", "fraction", "--out", text(&out)];
            let (image, labels) = (dir.join("planning_image.nii.gz"), dir.join("planning_labels.nii.gz"));
            let grid = dir.join("fraction_image.nii.gz");
            let grid = ["--grid", text(&grid)];
            let mut rms = Vec::new();
            for how in ["linear", "cubic"] {
                let run = json(warp(
                    &[&common[..], &grid, &["--kind", "image", "--interpolation", how, "--input", text(&image)]]
                        .concat(),
                ));
                assert_eq!(!run["mapped"]["residual_mm"].is_null(), inverted, "{run}");
                let warped = read_image(&out).unwrap().value;
                let apart = warped.data().iter().zip(exact.data()).map(|(a, b)| f64::from(a - b).powi(2));
                rms.push((apart.sum::<f64>() / exact.data().len() as f64).sqrt());
            }
            assert!(rms[0] < 12.0 && rms[1] < 0.6 * rms[0], "{name}: {rms:?} HU");
            warp(&[&common[..], &grid, &["--kind", "labels", "--input", text(&labels)]].concat()).success();
            let warped = read_label_map(&out, None).unwrap().value;
            assert_eq!(warped.names, own.names);
            assert_eq!(warped.counts()[&4], 1, "the single voxel survives");
            let (same, all) = warped
                .volume
                .data()
                .iter()
                .zip(own.volume.data())
                .filter(|(_, b)| **b == 1)
                .fold((0u32, 0u32), |(same, all), (a, b)| (same + u32::from(a == b), all + 1));
            assert!(f64::from(same) > 0.9 * f64::from(all), "{name}: {same} of {all}");
        }
    }
}

#[test]
fn a_dose_is_never_negative_and_zero_outside() {
    let dir = object("shift");
    let grid = aventail::geometry::Grid::axis_aligned([20, 20, 20], [2.0; 3], [-20.0; 3]).unwrap();
    // A sharp peak makes cubic interpolation undershoot.
    let dose = aventail::volume::Volume::from_fn(grid.clone(), |n| if grid.voxel(n)[0] > 9 { 60.0 } else { 0.0 });
    let (input, out) = (files::image(&at("dose.nii.gz"), &dose), at("dose_out.nii.gz"));
    let field = dir.join("fraction_to_planning.nii.gz");
    let common = ["--field", text(&field), "--from", "planning", "--to", "fraction", "--kind", "dose"];
    warp(&[&common[..], &["--interpolation", "cubic", "--input", text(&input), "--out", text(&out)]].concat())
        .success();
    let warped = read_image(&out).unwrap().value;
    assert!(warped.data().iter().all(|d| *d >= 0.0) && warped.data()[0].to_bits() == 0);
    let negative = files::image(&at("negative.nii.gz"), &dose.map(|d| d - 30.0));
    let out = at("n.nii.gz");
    refused(
        &[&common[..], &["--input", text(&negative), "--out", text(&out)]].concat(),
        4,
        &["negative.nii.gz", "-30"],
    );
}

/// The outermost half voxel of a dose counts for both: a fine grid has voxels there.
#[test]
fn a_dose_is_carried_as_dose_map_carries_it() {
    let dir = object("shift");
    let grid = |n: usize, by: f64| aventail::geometry::Grid::axis_aligned([n; 3], [by; 3], [-20.0; 3]).unwrap();
    let coarse = grid(10, 4.0);
    let dose = aventail::volume::Volume::from_fn(coarse.clone(), |n| 10.0 + coarse.voxel(n)[2] as f32);
    let dose = files::image(&at("coarse_dose.nii.gz"), &dose);
    let fine = files::image(&at("fine.nii.gz"), &aventail::volume::Volume::filled(grid(60, 1.0), 0.0));
    let field = dir.join("fraction_to_planning.nii.gz");
    let [warped, mapped] = ["warped_dose.nii.gz", "mapped_dose.nii.gz"].map(at);
    let common = ["--grid", text(&fine), "--kind", "dose", "--input", text(&dose), "--out", text(&warped)];
    warp(&[&["--field", text(&field), "--from", "planning", "--to", "fraction"][..], &common].concat()).success();
    let map = ["dose", "map", "--to", "fraction", "--grid", text(&fine), "--fraction-to-planning", text(&field)];
    aventail().args(map).args(["--dose", text(&dose), "--out", text(&mapped)]).assert().success();
    let [warped, mapped] = [warped, mapped].map(|path| read_image(path).unwrap().value);
    let differ = warped.data().iter().zip(mapped.data()).filter(|(a, b)| a.to_bits() != b.to_bits()).count();
    assert_eq!(differ, 0);
    let inside = warped.data().iter().filter(|d| **d > 0.0).count();
    // Ten voxels of 4 mm to their outer faces, as far as the fine grid sees them; nine between their centres.
    assert!(inside > 37 * 37 * 37, "{inside}");
}

#[test]
fn every_layout_is_written_read_and_maps_alike() {
    let dir = object("swirl");
    let (push, marks) = (dir.join("planning_to_fraction.nii.gz"), dir.join("landmarks.csv"));
    let exact = read_field(&push).unwrap().value;
    for (format, end) in [
        ("nifti", "nii.gz"),
        ("mha", "mha"),
        ("nrrd", "nrrd"),
        ("dispvect", "nii.gz"),
        ("niftyreg-displacement", "nii"),
        ("niftyreg-deformation", "nii.gz"),
    ] {
        let out = dir.join(format!("{format}.{end}"));
        let export = ["--field", text(&push), "--from", "planning", "--to", "fraction", "--dvf-format", format];
        warp(&[&export[..], &["--out-field", text(&out)]].concat()).success();
        let back = read_field(&out).unwrap().value;
        let apart = back.data().iter().flatten().zip(exact.data().iter().flatten()).map(|(a, b)| (a - b).abs());
        assert!(apart.fold(0.0, f32::max) < 1e-4, "{format}");
        // Its header tells the direction, so that it needs no FROM:TO.
        let there = dir.join(format!("{format}.csv"));
        warp(&[
            "--field",
            text(&out),
            "--from",
            "planning",
            "--to",
            "fraction",
            "--input",
            text(&marks),
            "--out",
            text(&there),
        ])
        .success();
        assert!(farthest(&points(&there, ""), &points(&marks, "fraction_")) < 0.05, "{format}");
    }
    let wrong = dir.join("wrong.mha");
    let words = ["--field", text(&push), "--from", "planning", "--to", "fraction", "--dvf-format", "dispvect"];
    refused(&[&words[..], &["--out-field", text(&wrong)]].concat(), 2, &["wrong.mha", "nii.gz"]);
}

#[test]
fn a_chain_of_fields_and_a_rigid_transform_is_the_formulas_one_after_the_other() {
    let (shift, turn) = (object("shift"), object("rotation"));
    let rigid = files::bytes(&at("couch.txt"), b"1 0 0 5\n0 1 0 0\n0 0 1 -2\n0 0 0 1\n");
    let input = files::bytes(&at("chain.txt"), b"point\n2\n3 4 5\n-20 10 -15\n");
    let one = format!("planning:day1={}", text(&shift.join("planning_to_fraction.nii.gz")));
    let two = format!("day2:day1={}", text(&turn.join("planning_to_fraction.nii.gz")));
    let three = format!("day2:couch={}#lps", text(&rigid));
    let fields = ["--field", &one, "--field", &two, "--field", &three];
    let (direct, all) = (at("direct.txt"), at("all.mha"));
    let run = json(warp(
        &[&fields[..], &["--from", "planning", "--to", "couch", "--input", text(&input), "--out", text(&direct)]]
            .concat(),
    ));
    assert!(run["steps"][1].as_str().unwrap().contains("inverted numerically"), "{run}");
    let read = |path: &Path| -> Vec<[f64; 3]> {
        let text = fs::read_to_string(path).unwrap();
        text.lines()
            .skip(2)
            .map(|l| l.split(' ').map(|w| w.parse().unwrap()).collect::<Vec<f64>>().try_into().unwrap())
            .collect()
    };
    use aventail::phantom::Formula;
    let truth: Vec<[f64; 3]> = read(&input)
        .into_iter()
        .map(|p| Formula::Rotation.pull(&Formula::Shift.push(&p.into())).unwrap())
        .map(|p| [p.x + 5.0, p.y, p.z - 2.0])
        .collect();
    assert!(farthest(&read(&direct), &truth) < 0.003, "{}", farthest(&read(&direct), &truth));
    // The same as one field.
    warp(&[&fields[..], &["--from", "planning", "--to", "couch", "--out-field", text(&all)]].concat()).success();
    let composed = at("composed.txt");
    warp(&[
        "--field",
        text(&all),
        "--from",
        "planning",
        "--to",
        "couch",
        "--input",
        text(&input),
        "--out",
        text(&composed),
    ])
    .success();
    assert!(farthest(&read(&composed), &truth) < 0.003);
    let back = at("chain_back.txt");
    let reversed = ["--field", &three, "--field", &two, "--field", &one];
    warp(
        &[&reversed[..], &["--from", "couch", "--to", "planning", "--input", text(&direct), "--out", text(&back)]]
            .concat(),
    )
    .success();
    assert!(farthest(&read(&back), &read(&input)) < 0.01);
}

#[test]
fn a_bare_matrix_is_asked_for_its_space() {
    // greedy's matrix in RAS mm: points of the fixed image at (-8, 12, -4) LPS come from (-16, 24, -8).
    let matrix = files::bytes(&at("greedy.mat"), b"1 0 0 8\n0 1 0 -12\n0 0 1 4\n0 0 0 1\n");
    let (input, out) = (files::bytes(&at("bare.csv"), b"name,x,y,z\na,1,2,3\n"), at("bare_out.csv"));
    let field = format!("fixed:moving={}", text(&matrix));
    let line = |field: &str, more: &[&str]| {
        let words =
            ["--field", field, "--from", "fixed", "--to", "moving", "--input", text(&input), "--out", text(&out)];
        words.iter().chain(more).map(|w| (*w).to_owned()).collect::<Vec<String>>()
    };
    let run = |words: &[String]| warp(&words.iter().map(String::as_str).collect::<Vec<_>>());
    let asked = line(&field, &[]);
    refused(
        &asked.iter().map(String::as_str).collect::<Vec<_>>(),
        4,
        &["greedy.mat", "--space ras", "FSL", "space-unknown"],
    );
    // The table is LPS whatever the matrix is.
    for (field, more, expected) in [
        (field.clone(), vec!["--space", "ras"], [1.0 - 8.0, 2.0 + 12.0, 3.0 + 4.0]),
        (field.clone(), vec!["--space", "lps"], [1.0 + 8.0, 2.0 - 12.0, 3.0 + 4.0]),
        (format!("{field}#ras"), vec![], [1.0 - 8.0, 2.0 + 12.0, 3.0 + 4.0]),
    ] {
        run(&line(&field, &more)).success();
        assert!(farthest(&points(&out, ""), &[expected]) < 1e-6, "{field} {more:?}: {:?}", points(&out, ""));
    }
}

#[test]
fn contours_of_a_ball_keep_its_area_under_a_rotation() {
    let dir = object("rotation");
    let mut rings = Vec::new();
    for k in -5..=5 {
        let z = 3.0 * f64::from(k);
        let r = (256.0 - z * z).sqrt();
        let ring = |n: u32| {
            let (sin, cos) = (std::f64::consts::TAU * f64::from(n) / 100.0).sin_cos();
            serde_json::json!([34.0 + r * cos, 5.0 + r * sin, z])
        };
        rings.push((0..100).map(ring).collect::<Vec<_>>());
    }
    let file = |frame: &str| serde_json::json!({"aventail_contours": 1, "frame": frame, "structures": [{"name": "ball", "contours": rings}]});
    let input = files::bytes(&at("ball.json"), file("planning").to_string().as_bytes());
    let out = at("ball_out.json");
    let field = dir.join("planning_to_fraction.nii.gz");
    let grid = dir.join("fraction_image.nii.gz");
    let common = ["--field", text(&field), "--from", "planning", "--to", "fraction", "--grid", text(&grid)];
    warp(&[&common[..], &["--input", text(&input), "--out", text(&out)]].concat()).success();
    let (moved, frame) = read_contours(&out).unwrap();
    assert_eq!(frame.as_deref(), Some("fraction"));
    let centre = aventail::phantom::Formula::Rotation.push(&[34.0, 5.0, 0.0].into());
    let ball = &moved.structures[0];
    let near: Vec<f64> = ball.heights().into_iter().filter(|h| (h - centre.z).abs() < 12.0).collect();
    assert!(near.len() >= 7, "{near:?}");
    for h in near {
        let truth = std::f64::consts::PI * (256.0 - (h - centre.z).powi(2));
        // Planes 3 mm apart make frusta of the ball: a tenth to two tenths of a millimetre of its radius.
        assert!((ball.area(h) / truth - 1.0).abs() < 0.05, "{h}: {}", ball.area(h) / truth);
    }
    let elsewhere = files::bytes(&at("elsewhere.json"), file("fraction").to_string().as_bytes());
    let out = at("e.json");
    refused(
        &[&common[..], &["--input", text(&elsewhere), "--out", text(&out)]].concat(),
        2,
        &["elsewhere.json", "fraction"],
    );
}

#[test]
fn directions_are_never_guessed() {
    let dir = object("shift");
    let (push, marks, image) =
        (dir.join("planning_to_fraction.nii.gz"), dir.join("landmarks.csv"), dir.join("planning_image.nii.gz"));
    let (csv, nii) = (at("r.csv"), at("r.nii.gz"));
    let (csv, nii) = (text(&csv), text(&nii));
    let (push, marks, image) = (text(&push), text(&marks), text(&image));
    // Another tool's file: no direction in its header.
    let plain = read_field(push).unwrap().value;
    let silent = at("silent.mha");
    aventail::io::write_field(&silent, &plain, aventail::field::FieldFormat::MetaImage, &Default::default()).unwrap();
    let silent = text(&silent).to_owned();
    let there = ["--from", "planning", "--to", "fraction"];
    let mark = ["--input", marks, "--out", csv];
    refused(&[&["--field", &silent][..], &there, &mark].concat(), 2, &["silent.mha", "FROM:TO=FILE"]);
    let told = format!("planning:fraction={silent}");
    warp(&[&["--field", &told][..], &there, &mark].concat()).success();
    fs::remove_file(csv).unwrap();
    let against = format!("fraction:planning={push}");
    refused(
        &[&["--field", &against][..], &there, &mark].concat(),
        2,
        &["planning points to fraction", "fraction:planning"],
    );
    refused(&[&["--field", push, "--from", "planning", "--to", "day2"][..], &mark].concat(), 2, &["not to day2"]);
    refused(&[&["--field", push][..], &there, &["--input", image, "--out", nii]].concat(), 2, &["--kind"]);
    let dose = ["--kind", "image", "--input", image, "--out", nii];
    refused(&[&["--field", push][..], &there, &dose].concat(), 2, &["--grid"]);
    refused(&[&["--field", push, "--kind", "image"][..], &there, &mark].concat(), 2, &["--kind has no meaning"]);
    // Layouts that other tools read wrongly without a word.
    for (name, alter) in [("four_d.nii", 4i16), ("intent_0.nii", 0)] {
        let path = at(name);
        aventail::io::write_field(&path, &plain, aventail::field::FieldFormat::Nifti, &Default::default()).unwrap();
        let mut bytes = fs::read(&path).unwrap();
        if alter == 4 {
            files::put_i16(&mut bytes, 40, 4);
            files::put_i16(&mut bytes, 48, 3);
            files::put_i16(&mut bytes, 50, 1);
        } else {
            files::put_i16(&mut bytes, 68, 0);
        }
        fs::write(&path, bytes).unwrap();
        let field = format!("planning:fraction={}", text(&path));
        refused(&[&["--field", &field][..], &there, &mark].concat(), 4, &[name, "remedy", "1007"]);
    }
}

#[test]
fn a_fold_has_no_inverse_and_warp_says_so() {
    let dir = object("fold");
    assert!(!dir.join("fraction_image.nii.gz").exists());
    let (field, image, out) =
        (dir.join("planning_to_fraction.nii.gz"), dir.join("planning_image.nii.gz"), dir.join("warped.nii.gz"));
    let words =
        ["--field", text(&field), "--from", "planning", "--to", "fraction", "--kind", "image", "--grid", text(&image)];
    let run = json(warp(&[&words[..], &["--input", text(&image), "--out", text(&out)]].concat()));
    assert!(read_image(&out).unwrap().value.data().iter().all(|v| v.is_finite()));
    assert!(run["mapped"]["residual_mm"]["max"].as_f64().unwrap() < 1e-3, "{run}");
}

#[test]
fn the_phantom_has_two_fractions_a_plan_and_contours_that_warp() {
    let out = at("phantom_plan");
    aventail().args(["phantom", "--spacing", "6x6x6", "--out"]).arg(&out).assert().success();
    let dose = read_image(out.join("dose.nii.gz")).unwrap().value;
    let most = dose.data().iter().copied().fold(0.0, f32::max);
    assert!((60.0..66.0).contains(&most) && dose.data().iter().all(|d| *d >= 0.0), "{most} Gy");
    let (contours, frame) = read_contours(out.join("contours.json")).unwrap();
    assert_eq!(frame.as_deref(), Some("planning"));
    let names: Vec<&str> = contours.structures.iter().map(|s| s.name.as_str()).collect();
    assert_eq!(names, ["body", "ctv", "ptv", "spinal_cord", "brainstem", "parotid_left", "parotid_right"]);
    assert!(contours.structures.iter().all(|s| s.polygons.len() >= 3), "every structure is drawn");
    // The target has its dose, the cord much less: the gradient between them is steep.
    let mean = |name: &str| {
        let structure = contours.structures.iter().find(|s| s.name == name).unwrap();
        let mask = contours.solid(structure, contours.spacing(6.0)).mask(dose.grid());
        let inside: Vec<f64> =
            mask.data().iter().zip(dose.data()).filter(|(m, _)| **m).map(|(_, d)| f64::from(*d)).collect();
        inside.iter().sum::<f64>() / inside.len() as f64
    };
    assert!(mean("ctv") > 59.0 && mean("spinal_cord") < 25.0, "{} {}", mean("ctv"), mean("spinal_cord"));
    let [first, second] =
        ["fraction_ct.nii.gz", "fraction_2/fraction_ct.nii.gz"].map(|f| read_image(out.join(f)).unwrap().value);
    assert_ne!(first.data(), second.data());
    let (field, input, moved) =
        (out.join("true_planning_to_fraction.nii.gz"), out.join("contours.json"), out.join("moved.json"));
    let grid = out.join("fraction_ct.nii.gz");
    let words = ["--field", text(&field), "--from", "planning", "--to", "fraction", "--grid", text(&grid)];
    warp(&[&words[..], &["--input", text(&input), "--out", text(&moved)]].concat()).success();
    let (moved, _) = read_contours(&moved).unwrap();
    let volume = |c: &aventail::volume::contour::Contours, n: usize| {
        let s = &c.structures[n];
        s.heights().iter().map(|h| s.area(*h)).sum::<f64>() * c.spacing(6.0)
    };
    for n in [1, 3, 5, 6] {
        let ratio = volume(&moved, n) / volume(&contours, n);
        assert!((0.85..1.15).contains(&ratio), "{}: {ratio}", contours.structures[n].name);
    }
}
