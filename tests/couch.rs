//! The couch shift: on which bones it is matched, what it leaves of them, and that it decides about no field.

#![expect(clippy::unwrap_used, reason = "a test that cannot read what it wrote fails")]

use crate::support::{Register, small_phantom};
use aventail::io;
use nalgebra::{Isometry3, Matrix4, Point3, Rotation3, Translation3, UnitQuaternion, Vector3};
use serde_json::Value;
use std::collections::BTreeMap;
use std::fs;
use std::path::Path;

fn report(out: &Path) -> Value {
    serde_json::from_str(&fs::read_to_string(out.join("report.json")).unwrap()).unwrap()
}

/// Each bone's motion by its name, from the file that users read.
fn motions(out: &Path) -> BTreeMap<String, Matrix4<f64>> {
    let file: Value = serde_json::from_str(&fs::read_to_string(out.join("bone_transforms.json")).unwrap()).unwrap();
    let rows = |m: &Value| Matrix4::from_fn(|r, c| m[r][c].as_f64().expect("a number"));
    file.as_object().expect("bones by name").iter().map(|(name, bone)| (name.clone(), rows(bone))).collect()
}

/// Root mean square distance, over the voxels of each bone in a box, of its own motion from a motion of the whole.
fn left(out: &Path, whole: &Isometry3<f64>, within: Option<[f64; 6]>) -> BTreeMap<String, f64> {
    let labels = io::read_labels(&small_phantom().bones, None).unwrap().value;
    let (grid, motions) = (labels.volume.grid(), motions(out));
    let mut sums: BTreeMap<String, (f64, f64)> = BTreeMap::new();
    for (n, label) in labels.volume.data().iter().enumerate().filter(|(_, label)| **label > 0) {
        let x = grid.centre(grid.voxel(n));
        let Some(motion) = labels.names.get(label).and_then(|name| motions.get(name)) else { continue };
        if within.is_some_and(|b| (0..3).any(|a| x[a] < b[a] || x[a] > b[a + 3])) {
            continue;
        }
        let sum = sums.entry(labels.names[label].clone()).or_default();
        *sum = (sum.0 + (motion.transform_point(&x) - whole * x).norm_squared(), sum.1 + 1.0);
    }
    sums.into_iter().map(|(name, (sum, n))| (name, (sum / n).sqrt())).collect()
}

fn vector(value: &Value) -> Vector3<f64> {
    Vector3::from_fn(|a, _| value[a].as_f64().expect("a number"))
}

/// Names of the bones that a run was matched on, when what it says of every bone is what its own files give.
fn matched(out: &Path, within: Option<[f64; 6]>) -> Vec<String> {
    let couch = &report(out)["couch"];
    let shift = Translation3::from(vector(&couch["shift_mm"]));
    let turn = Rotation3::new(vector(&couch["rotation_deg"]).map(f64::to_radians));
    let centre = Point3::from(vector(&couch["centre"]));
    let shifted = Isometry3::from_parts(shift, UnitQuaternion::identity());
    let at = centre.coords + shift.vector - turn * centre.coords;
    let turned = Isometry3::from_parts(at.into(), UnitQuaternion::from_rotation_matrix(&turn));
    let [plain, with_turn] = [shifted, turned].map(|whole| left(out, &whole, within));
    let residuals = couch["residuals"].as_array().expect("a list");
    assert_eq!(residuals.len(), plain.len());
    for residual in residuals {
        let name = residual["bone"].as_str().unwrap();
        for (key, own) in [("shift_mm", &plain), ("rotation_mm", &with_turn)] {
            let told = residual[key].as_f64().unwrap();
            assert!((told - own[name]).abs() < 1e-3, "{name}, {key}: {told}, by its voxels {}", own[name]);
        }
    }
    couch["on"].as_array().unwrap().iter().map(|name| name.as_str().unwrap().to_owned()).collect()
}

#[test]
fn it_is_matched_on_what_is_asked_and_changes_no_field() {
    let plain = Register::quick("plain");
    plain.command().assert().success();
    let spine = matched(&plain.out, None);
    assert!(
        spine.len() >= 3 && spine.iter().all(|name| name.starts_with("vertebrae_") || name == "skull"),
        "{spine:?}"
    );
    let named = Register::quick("named").with("--match", "skull");
    named.command().assert().success();
    assert_eq!(matched(&named.out, None), ["skull"]);
    let couch = &report(&named.out)["couch"];
    let skull = couch["residuals"].as_array().unwrap().iter().find(|r| r["bone"] == "skull").unwrap();
    assert!(skull["rotation_mm"].as_f64().unwrap() < 1e-6, "one bone alone is brought home whole: {skull}");
    let own = &motions(&named.out)["skull"];
    let angle = ((own.fixed_view::<3, 3>(0, 0).trace() - 1.0) / 2.0).clamp(-1.0, 1.0).acos().to_degrees();
    assert!((vector(&couch["rotation_deg"]).norm() - angle).abs() < 1e-3);
    // The lower half of the scan alone.
    let grid = io::read_labels(&small_phantom().bones, None).unwrap().value.volume.grid().clone();
    let [low, high] = grid.corners().iter().fold([[f64::MAX; 3], [f64::MIN; 3]], |[low, high], c| {
        [std::array::from_fn(|a| low[a].min(c[a])), std::array::from_fn(|a| high[a].max(c[a]))]
    });
    let within = [low[0], low[1], low[2], high[0], high[1], f64::midpoint(low[2], high[2])];
    let boxed = Register::quick("boxed").with("--match", within.map(|v| v.to_string()).join(","));
    boxed.command().assert().success();
    let in_box = matched(&boxed.out, Some(within));
    assert!(!in_box.is_empty() && !in_box.contains(&"skull".to_owned()), "{in_box:?}");
    let shifts = [&plain, &named, &boxed].map(|run| vector(&report(&run.out)["couch"]["shift_mm"]));
    assert!((shifts[0] - shifts[1]).norm() > 0.5 && (shifts[0] - shifts[2]).norm() > 0.5, "{shifts:?}");
    for name in ["planning_to_fraction.nii.gz", "fraction_to_planning.nii.gz"] {
        let file = |run: &Register| fs::read(run.out.join(name)).unwrap();
        assert!(file(&plain) == file(&named) && file(&plain) == file(&boxed), "{name}");
    }
}

#[test]
fn what_names_no_bone_is_refused_with_the_names_that_there_are() {
    let refused = |name: &str, option: &str, value: &str, words: &[&str]| {
        let run = Register::quick(name).with(option, value);
        let told = run.command().assert().code(2).get_output().stderr.clone();
        let text = String::from_utf8(told).unwrap();
        assert!(words.iter().all(|word| text.contains(word)), "{text}");
        assert!(!run.out.exists(), "nothing is left");
    };
    refused("no_bone", "--match", "vertebra_C5", &["vertebra_C5", "no bone", "vertebrae_C5"]);
    refused("empty", "--match", "skull,,mandible", &["a name is empty"]);
    refused("three", "--match", "1,2,3", &["3 numbers are no box"]);
    refused("order", "--match", "9,9,9,0,0,0", &["least x, y, z"]);
    refused("air", "--match", "-9000,-9000,-9000,-8000,-8000,-8000", &["no bone lies in the box"]);
    refused("roi_three", "--roi", "1,2,3", &["3 numbers are no box", "x0,y0,z0,x1,y1,z1"]);
    refused("roi_one", "--roi", "7", &["1 number is no box"]);
}
