//! Body and skeleton on real CTs that are not distributed: the folder is named by `AVENTAIL_CASES`, without it these
//! tests have nothing to do.

use aventail::body::{self, BodyOptions};
use aventail::io;
use aventail::skeleton;
use aventail::stats::percentile;
use aventail::volume::distance::{erode, squared_distance};
use aventail::volume::{Mask, Volume};
use nalgebra::Point3;
use std::path::PathBuf;

fn cases() -> Option<PathBuf> {
    std::env::var_os("AVENTAIL_CASES").map(PathBuf::from)
}

/// Voxels of the mask that face its outside.
fn surface(mask: &Mask) -> Mask {
    let least = mask.grid().spacing().into_iter().fold(f64::INFINITY, f64::min);
    let inner = erode(mask, least);
    let at = |l: usize| mask.data()[l] && !inner.data()[l];
    Volume::from_fn(mask.grid().clone(), at)
}

/// 95th percentile of the distance from one surface to the other, mm.
fn p95(from: &Mask, to: &Mask) -> f64 {
    let distance = squared_distance(&surface(to), true);
    let mut values: Vec<f64> = surface(from)
        .data()
        .iter()
        .zip(distance.data())
        .filter(|(s, _)| **s)
        .map(|(_, d)| f64::from(*d).sqrt())
        .collect();
    values.sort_by(f64::total_cmp);
    percentile(&values, 95.0)
}

#[test]
fn body_agrees_with_the_reference() {
    let Some(cases) = cases() else { return };
    let ct = io::read_image(cases.join("planning_ct.nii.gz")).unwrap().value;
    let reference = io::read_image(cases.join("body.nii.gz")).unwrap().value.map(|v| *v > 0.5);
    let body = body::find(&ct, None, &BodyOptions::default()).unwrap();
    let common = body.data().iter().zip(reference.data()).filter(|(a, b)| **a && **b).count();
    let dice = 2.0 * common as f64 / (body.count() + reference.count()) as f64;
    let (there, back) = (p95(&body, &reference), p95(&reference, &body));
    println!("body: Dice {dice:.4}, 95th percentile {there:.2} and {back:.2} mm");
    assert!(dice >= 0.98 && there <= 3.0 && back <= 3.0);
}

#[test]
fn joints_agree_with_the_reference() {
    let Some(cases) = cases() else { return };
    let labels = io::read_labels(cases.join("bones.nii.gz"), Some(&cases.join("bones.json"))).unwrap().value;
    let built = skeleton::build(&labels).unwrap();
    let text = std::fs::read_to_string(cases.join("joints_reference.json")).unwrap();
    let reference: serde_json::Value = serde_json::from_str(&text).unwrap();
    let mut neck = Vec::new();
    for joint in reference["joints"].as_array().unwrap() {
        let name = |key: &str| joint[key].as_str().unwrap();
        let centre: [f64; 3] = std::array::from_fn(|a| joint["centre"][a].as_f64().unwrap());
        let bone = built.skeleton.bones.iter().find(|b| b.name == name("child")).unwrap();
        let parent = &built.skeleton.bones[bone.parent.unwrap()].name;
        assert_eq!(parent, name("parent"));
        let off = (bone.joint.centre - Point3::from(centre)).norm();
        println!("{:24} {off:5.1} mm", name("name"));
        // C7 on T1 is extrapolated in the reference.
        if name("child").starts_with("vertebrae_C") && name("name") != "C7-T1" || name("child") == "skull" {
            neck.push(off);
        }
    }
    assert_eq!(neck.len(), 7);
    let mean = neck.iter().sum::<f64>() / 7.0;
    println!("mean from C7-C6 to atlanto-occipital: {mean:.2} mm");
    assert!(mean <= 5.0);
}
