//! `aventail pose` and landmarks on bones: the skeleton moved by hand, by file and by points.

#![expect(clippy::unwrap_used, reason = "a test that cannot read what it wrote fails")]

use crate::support::files::labels;
use crate::support::{Register, aventail, bones_alone, files_below, folder, phantom};
use assert_cmd::Command;
use aventail::field::jacobian;
use aventail::geometry::Rigid;
use aventail::io::{read_bone_transforms, read_field, read_image, read_labels};
use aventail::volume::{LabelMap, Volume};
use nalgebra::{Point3, Vector3};
use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::OnceLock;

fn pose(out: &Path, motion: &[&str]) -> Command {
    let mut command = aventail();
    command.arg("pose").arg("--planning").arg(&phantom().planning).arg("--bones").arg(&phantom().bones);
    command.arg("--out").arg(out).args(motion);
    command
}

fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

/// The thesis's example (6.2.2): one shoulder is lifted.
const ELEVATION: &str = "[bones.clavicula_right]\nlateral_deg = 12.0\nshift_mm = [0.0, 0.0, 5.0]\n";

/// The lifted shoulder, made once.
fn lifted() -> &'static (PathBuf, BTreeMap<String, Rigid>) {
    static RUN: OnceLock<(PathBuf, BTreeMap<String, Rigid>)> = OnceLock::new();
    RUN.get_or_init(|| {
        let file = folder().join("elevation.toml");
        fs::write(&file, ELEVATION).unwrap();
        let out = folder().join("lifted");
        pose(&out, &["--pose", text(&file), "--margin", "30"]).assert().success();
        let transforms = read_bone_transforms(out.join("bone_transforms.json")).unwrap();
        (out, transforms)
    })
}

/// What a folder's push field holds, with whether each voxel was computed.
fn push_of(out: &Path) -> aventail::field::PushField {
    let field = read_field(out.join("planning_to_fraction.nii.gz")).unwrap().value;
    let computed = Volume::filled(field.grid().clone(), true);
    aventail::field::PushField { displacement: field, computed }
}

#[test]
fn a_lifted_shoulder_takes_the_arm_along_and_leaves_the_rest() {
    let (out, t) = lifted();
    let moved = |bone: &str, at: [f64; 3]| (t[bone] * Point3::from(at) - Point3::from(at)).norm();
    assert!(moved("skull", [0.0; 3]) < 1e-9 && moved("scapula_left", [100.0, 0.0, -150.0]) < 1e-9);
    let arm = t["humerus_right"];
    assert!((arm.rotation.angle().to_degrees() - 12.0).abs() < 1e-6);
    assert!((arm.to_homogeneous() - t["scapula_right"].to_homogeneous()).amax() < 1e-9, "arm and blade move as one");
    let lift = arm * Point3::new(-180.0, 0.0, -180.0) - Point3::new(-180.0, 0.0, -180.0);
    assert!(lift.z > 15.0, "upwards: {lift:?}");
    let (planning, made) =
        (read_image(&phantom().planning).unwrap(), read_image(out.join("planning_on_fraction.nii.gz")).unwrap());
    let more: Vec<usize> = (0..3).map(|a| made.value.grid().size()[a] - planning.value.grid().size()[a]).collect();
    assert_eq!(more, [12, 12, 10], "30 mm on all sides of 5 x 5 x 6 mm voxels");
    assert!(out.join("report.html").is_file() && out.join("fraction_to_planning.nii.gz").is_file());
}

#[test]
fn bones_keep_their_volume_to_the_last_digit_of_the_file() {
    let (out, transforms) = lifted();
    let labels = read_labels(&phantom().bones, None).unwrap().value;
    let push = push_of(out);
    let grid = push.displacement.grid().clone();
    let bone = |l: usize| labels.names.get(&labels.volume.data()[l]).and_then(|n| transforms.get(n));
    // What the file rounds is the exact transform, whose Jacobian is 1 to double precision ...
    for l in (0..grid.len()).filter(|&l| labels.volume.data()[l] > 0) {
        let x = grid.centre(grid.voxel(l));
        let exact: Vector3<f64> = bone(l).unwrap() * x - x;
        let stored = Vector3::from(push.displacement.data()[l].map(f64::from));
        assert!((exact - stored).amax() <= 1e-6 * exact.amax().max(1.0), "{exact:?} {stored:?}");
    }
    for (name, t) in transforms {
        assert!((t.to_homogeneous().determinant() - 1.0).abs() < 1e-6, "{name}");
    }
    // ... and in the file's single precision it is 1 within 1e-4.
    let (map, strides) = (jacobian(&push).to_volume(), grid.strides());
    let mut cells = 0;
    for l in 0..grid.len() - strides.iter().sum::<usize>() {
        let corners = (0..8).map(|c| l + (0..3).filter(|a| c >> a & 1 == 1).map(|a| strides[a]).sum::<usize>());
        let label = labels.volume.data()[l];
        if label > 0 && corners.into_iter().all(|m| labels.volume.data()[m] == label) {
            cells += 1;
            assert!((map.data()[l] - 1.0).abs() < 1e-4, "{}", map.data()[l]);
        }
    }
    assert!(cells > 1000);
}

#[test]
fn a_report_and_a_file_of_transforms_make_the_same_posture_again() {
    let (out, _) = lifted();
    let bytes = |folder: &Path| fs::read(folder.join("planning_to_fraction.nii.gz")).unwrap();
    let again = folder().join("lifted_again");
    let report = out.join("report.json");
    aventail()
        .arg("pose")
        .arg("--config")
        .arg(&report)
        .arg("--margin")
        .arg("30")
        .arg("--out")
        .arg(&again)
        .assert()
        .success();
    assert_eq!(bytes(out), bytes(&again));
    let by_file = folder().join("lifted_by_file");
    pose(&by_file, &["--transforms", text(&out.join("bone_transforms.json")), "--margin", "30"]).assert().success();
    let (a, b) = (push_of(out), push_of(&by_file));
    let worst = a.displacement.data().iter().flatten().zip(b.displacement.data().iter().flatten());
    assert!(worst.map(|(a, b)| (a - b).abs()).fold(0.0, f32::max) < 1e-3);
}

/// Four landmarks on each of some bones, moved exactly as the phantom's bones truly move.
fn landmarks(bones: &[&str]) -> (PathBuf, BTreeMap<String, Rigid>) {
    let truth = read_bone_transforms(phantom().planning.with_file_name("true_bone_transforms.json")).unwrap();
    let labels = read_labels(&phantom().bones, None).unwrap().value;
    let grid = labels.volume.grid();
    let mut rows = String::from("bone,name,planning_x,planning_y,planning_z,fraction_x,fraction_y,fraction_z\n");
    for bone in bones {
        let label = labels.names.iter().find(|(_, n)| n == bone).map(|(l, _)| *l).unwrap();
        let own: Vec<usize> = (0..grid.len()).filter(|&l| labels.volume.data()[l] == label).collect();
        for n in 0..6 {
            let p = grid.centre(grid.voxel(own[n * (own.len() - 1) / 5]));
            let q = truth[*bone] * p;
            writeln!(rows, "{bone},p{n},{},{},{},{},{},{}", p.x, p.y, p.z, q.x, q.y, q.z).unwrap();
        }
    }
    let path = folder().join(format!("landmarks_on_{}.csv", bones.len()));
    fs::write(&path, rows).unwrap();
    (path, truth)
}

#[test]
fn landmarks_on_bones_replace_or_start_the_fit() {
    let given = ["skull", "mandible", "vertebrae_C2", "vertebrae_C7", "humerus_left", "humerus_right"];
    let (file, truth) = landmarks(&given);
    let replaced =
        Register::phantom("replaced").with("--bone-landmarks", &file).with("--bone-landmarks-use", "replace");
    let replaced = replaced.with("--config", bones_alone());
    replaced.command().assert().success();
    let found = read_bone_transforms(replaced.out.join("bone_transforms.json")).unwrap();
    for bone in given {
        assert!((found[bone].to_homogeneous() - truth[bone].to_homogeneous()).amax() < 1e-5, "{bone}");
    }
    // A vertebra between two that are given lies near its true place.
    let c4 = Point3::new(0.0, 10.0, -70.0);
    assert!((found["vertebrae_C4"] * c4 - truth["vertebrae_C4"] * c4).norm() < 3.0);
    let posed = folder().join("posed_by_landmarks");
    pose(&posed, &["--bone-landmarks", text(&file)]).assert().success();
    assert_eq!(read_bone_transforms(posed.join("bone_transforms.json")).unwrap(), found);

    let started = Register::phantom("started").with("--bone-landmarks", &file).with("--config", bones_alone());
    started.command().assert().success();
    let report: serde_json::Value =
        serde_json::from_slice(&fs::read(started.out.join("report.json")).unwrap()).unwrap();
    let by_image = report["bones"].as_array().unwrap().iter().filter(|b| b["determined_by"] == "image").count();
    assert!(by_image > 10, "{by_image} bones were refined by the image");
}

#[test]
fn motions_that_make_no_sense_are_refused() {
    let refused = |name: &str, arguments: &[&str], code: i32, words: &[&str]| {
        let out = folder().join(name);
        let run = pose(&out, arguments).assert().code(code);
        let message = String::from_utf8(run.get_output().stderr.clone()).unwrap();
        for word in words {
            assert!(message.contains(word), "`{word}` is not in\n{message}");
        }
        assert_eq!(files_below(&out), [""; 0], "left behind after\n{message}");
    };
    let file = |name: &str, text: &str| {
        let path = folder().join(name);
        fs::write(&path, text).unwrap();
        path
    };
    refused("r1", &[], 2, &["--pose", "remedy"]);
    let wing = file("wing.toml", "[bones.wing]\nflexion_deg = 1.0\n");
    refused("r2", &["--pose", text(&wing)], 4, &["wing.toml", "bones.wing"]);
    refused("r3", &["--pose", text(&wing), "--transforms", text(&wing)], 2, &["cannot be used with"]);
    let squeezed = file("squeezed.json", r#"{"skull": [[0.9,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]}"#);
    refused("r4", &["--transforms", text(&squeezed)], 4, &["squeezed.json", "skull"]);
    let alien = file("alien.json", r#"{"tentacle": [[1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]}"#);
    refused("r5", &["--transforms", text(&alien)], 4, &["tentacle"]);
    let few = "bone,name,planning_x,planning_y,planning_z,fraction_x,fraction_y,fraction_z\nskull,a,0,0,0,1,1,1\n";
    refused("r6", &["--bone-landmarks", text(&file("few.csv", few))], 4, &["skull", "1 landmarks"]);
    refused("r7", &["--pose", text(&wing), "--margin=-3"], 2, &["--margin"]);
}

#[test]
fn a_study_of_a_posture_runs_its_stages_once_and_says_what_they_do() {
    let (case, _) = lifted();
    let plan = folder().join("plan.toml");
    fs::write(
        &plan,
        r#"[[table]]
title = "Two ways to carry"
source = "a test"
stage = [
    { id = "nearest", name = "rigid", settings = { preset = "thesis", soft_tissue = "nearest-bone" } },
    { id = "first", name = "chain mail", settings = { preset = "thesis", chainmail = { variant.combination = "prioritisation" } }, published = [
        { patient = "patient 2", folded = 7.8, residual_mean = 0.81, time = "0:34" },
    ] },
]
"#,
    )
    .unwrap();
    let out = folder().join("study");
    let study = || {
        let mut command = aventail();
        command.args(["study", "--case", text(case), "--plan", text(&plan), "--out", text(&out)]);
        String::from_utf8(command.assert().success().get_output().stdout.clone()).unwrap()
    };
    let table = study();
    let files = files_below(&out);
    for file in ["study.html", "study.md", "study.csv", "stages/nearest.json", "stages/first.json"] {
        assert!(files.iter().any(|f| f == file), "{file} is not among {files:?}");
    }
    assert!(table.contains("| *patient 2* | *7.8* |") && table.contains("*0:34 min*"), "{table}");
    let rows = fs::read_to_string(out.join("study.csv")).unwrap();
    let stage = |id: &str| -> serde_json::Value {
        serde_json::from_slice(&fs::read(out.join(format!("stages/{id}.json"))).unwrap()).unwrap()
    };
    assert!(rows.lines().count() >= 3 && rows.contains("chain mail"), "{rows}");
    // Every stage carries the same bones exactly; what lies between them is its own.
    assert_ne!(stage("nearest")["jacobian"], stage("first")["jacobian"]);
    assert_ne!(stage("nearest")["settings"], stage("first")["settings"]);
    // A second call finds both stages done, and writes the same tables.
    let before = fs::metadata(out.join("stages/first.json")).unwrap().modified().unwrap();
    assert_eq!(study(), table);
    assert_eq!(fs::metadata(out.join("stages/first.json")).unwrap().modified().unwrap(), before);
    // What is no finished run is refused before anything is written.
    let nowhere = folder().join("no_study");
    let refused = aventail().args(["study", "--case", text(folder()), "--out", text(&nowhere)]).assert().code(3);
    let message = String::from_utf8(refused.get_output().stderr.clone()).unwrap();
    assert!(message.contains("report.json") && message.contains("finished"), "{message}");
}

/// Tissue within 10 mm of air, as a label of subcutaneous fat would be.
fn fat() -> PathBuf {
    let ct = read_image(&phantom().planning).unwrap().value;
    let bones = read_labels(&phantom().bones, None).unwrap().value;
    let grid = ct.grid();
    let reach = grid.spacing().map(|s| (10.0 / s) as i64);
    let is_air = |at: [i64; 3]| {
        let inside = (0..3).all(|a| (0..grid.size()[a] as i64).contains(&at[a]));
        inside && *ct.at(at.map(|i| i as usize)) < -500.0
    };
    let near_air = |l: usize| {
        let at = grid.voxel(l).map(|i| i as i64);
        let along = |a: usize| (-reach[a]..=reach[a]).map(move |d| (a, d));
        (0..2).flat_map(along).any(|(a, d)| {
            let mut there = at;
            there[a] += d;
            is_air(there)
        })
    };
    let body = read_image(phantom().planning.with_file_name("body.nii.gz")).unwrap().value;
    let fat = |l: usize| body.data()[l] > 0.5 && bones.volume.data()[l] == 0 && near_air(l);
    let mask = Volume::from_fn(grid.clone(), |l| u16::from(fat(l)));
    labels(&folder().join("fat.nii.gz"), &LabelMap { volume: mask, names: BTreeMap::new() })
}

/// A patient who loses weight: the skin comes in with the fat, bones stay, nothing folds.
#[test]
fn fat_that_is_lost_takes_the_skin_along() {
    let (out, still, fat) = (folder().join("thinner"), folder().join("still.toml"), fat());
    fs::write(&still, "# nothing moves\n").unwrap();
    let change = ["--organs", text(&fat), "--volume-change", "fat=0.75"];
    pose(&out, &[&["--pose", text(&still)][..], &change].concat()).assert().success();
    let report: serde_json::Value = serde_json::from_slice(&fs::read(out.join("report.json")).unwrap()).unwrap();
    let reached = report["volume_changes"][0]["reached"].as_f64().unwrap();
    assert!((reached / 0.75 - 1.0).abs() < 0.1, "{}", report["volume_changes"]);
    assert_eq!(report["jacobian"]["all"]["folded"], 0, "{}", report["jacobian"]);
    // What is no air is less by what the fat has lost; the tissue under it gives way a little, too.
    let of = |path: &Path| {
        let ct = read_image(path).unwrap().value;
        let full = |hu: &f32| f64::from(((hu + 1000.0) / 1000.0).clamp(0.0, 1.0));
        ct.data().iter().map(full).sum::<f64>() * ct.grid().voxel_volume()
    };
    let lost = of(&phantom().planning) - of(&out.join("planning_on_fraction.nii.gz"));
    let mask = read_image(&fat).unwrap().value;
    let expected = 0.25 * mask.data().iter().filter(|l| **l > 0.5).count() as f64 * mask.grid().voxel_volume();
    assert!((0.9..1.5).contains(&(lost / expected)), "{lost} for {expected}");
}
