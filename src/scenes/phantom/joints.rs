//! The phantom's true skeleton: where its joints are by construction.

use super::asymmetry::placed;
use super::spine::DISCS;
use super::trunk_bones::{ELBOW, RIBS_EACH_SIDE, SHOULDER, rib_head};
use crate::skeleton::{Bone, Joint, Skeleton};
use nalgebra::{Matrix3, Point3};
use std::collections::BTreeMap;

/// Rotation ranges of White and Panjabi (1990), "Clinical Biomechanics of the Spine", representative values: half of
/// flexion-extension, lateral bending and axial rotation to one side, degrees, from C0-C1 down to T6-T7.
const SPINE_RANGES: [[f64; 3]; 14] = [
    [12.5, 5.0, 5.0],
    [10.0, 5.0, 40.0],
    [5.0, 10.0, 3.0],
    [7.5, 11.0, 7.0],
    [10.0, 11.0, 7.0],
    [10.0, 8.0, 7.0],
    [8.5, 7.0, 6.0],
    [4.5, 4.0, 2.0],
    [2.0, 5.0, 9.0],
    [2.0, 6.0, 8.0],
    [2.0, 5.0, 8.0],
    [2.0, 6.0, 8.0],
    [2.0, 6.0, 8.0],
    [2.5, 6.0, 8.0],
];

/// One joint of the table: bone, parent, joint name, centre, ranges in degrees (plus or minus), shift range in mm.
struct Row {
    bone: String,
    parent: Option<String>,
    joint: String,
    centre: [f64; 3],
    degrees: [f64; 3],
    shift: f64,
    source: &'static str,
}

/// Vertebra names from the root up.
fn column() -> Vec<String> {
    let thoracic = (1..=7).rev().map(|n| format!("vertebrae_T{n}"));
    thoracic.chain((1..=7).rev().map(|n| format!("vertebrae_C{n}"))).collect()
}

fn spine_rows() -> Vec<Row> {
    let white = "White and Panjabi 1990";
    let names = column();
    let mut rows = vec![Row {
        bone: names[0].clone(),
        parent: None,
        joint: "root".into(),
        centre: [0.0, DISCS[11][0], DISCS[11][1] - 10.0],
        degrees: [180.0; 3],
        shift: 1000.0,
        source: "unlimited: the root",
    }];
    for n in 1..names.len() {
        let short = |s: &str| s.trim_start_matches("vertebrae_").to_owned();
        let (child, parent) = (short(&names[n]), short(&names[n - 1]));
        // Joints from T6-T7 up; the two highest of the column are the atlanto-axial one and C2-C3.
        let centre = match n {
            13 => [0.0, -7.0, -16.0],
            _ => [0.0, DISCS[12 - n][0], DISCS[12 - n][1]],
        };
        let joint = if n == 13 { "atlanto-axial".into() } else { format!("{child}-{parent}") };
        let degrees = SPINE_RANGES[14 - n];
        let parent = Some(names[n - 1].clone());
        rows.push(Row { bone: names[n].clone(), parent, joint, centre, degrees, shift: 2.0, source: white });
    }
    let degrees = SPINE_RANGES[0];
    let parent = Some("vertebrae_C1".into());
    let joint = "atlanto-occipital".into();
    rows.push(Row {
        bone: "skull".into(),
        parent,
        joint,
        centre: [0.0, 2.0, -4.0],
        degrees,
        shift: 2.0,
        source: white,
    });
    rows
}

fn other_rows() -> Vec<Row> {
    let source = "phantom: wide enough for every posture that it is posed in";
    let row = |bone: &str, parent: &str, joint: &str, centre: [f64; 3], degrees: [f64; 3], shift: f64| Row {
        bone: bone.into(),
        parent: Some(parent.into()),
        joint: joint.into(),
        centre,
        degrees,
        shift,
        source,
    };
    let mut rows = vec![
        row("mandible", "skull", "temporomandibular", [0.0, -1.0, 9.0], [30.0, 5.0, 5.0], 8.0),
        row("hyoid", "vertebrae_C3", "hyoid suspension", [0.0, -45.0, -66.0], [20.0, 10.0, 10.0], 15.0),
        row("sternum", "vertebrae_T1", "sternum on the first ribs", [0.0, -46.0, -178.0], [5.0; 3], 5.0),
    ];
    for (side, word) in [(1.0, "left"), (-1.0, "right")] {
        let at = |[x, y, z]: [f64; 3]| [side * x, y, z];
        for n in 1..=RIBS_EACH_SIDE {
            let (bone, parent) = (format!("rib_{word}_{n}"), format!("vertebrae_T{n}"));
            let joint = format!("costovertebral {word} {n}");
            rows.push(row(&bone, &parent, &joint, at(rib_head(n - 1)), [8.0; 3], 3.0));
        }
        let mut arm = |bone: &str, parent: &str, joint: &str, centre: [f64; 3], degrees: [f64; 3], shift: f64| {
            let parent = if parent == "sternum" { parent.into() } else { format!("{parent}_{word}") };
            rows.push(row(&format!("{bone}_{word}"), &parent, &format!("{joint} {word}"), at(centre), degrees, shift));
        };
        arm("clavicula", "sternum", "sternoclavicular", [24.0, -47.0, -171.0], [30.0, 45.0, 30.0], 4.0);
        arm("scapula", "clavicula", "acromioclavicular", [168.0, 14.0, -133.0], [30.0, 40.0, 30.0], 6.0);
        arm("humerus", "scapula", "glenohumeral", SHOULDER, [180.0, 120.0, 90.0], 6.0);
        arm("ulna", "humerus", "elbow", ELBOW, [150.0, 10.0, 10.0], 3.0);
        arm("radius", "ulna", "radioulnar", ELBOW, [20.0, 20.0, 90.0], 3.0);
    }
    rows
}

/// The skeleton in the planning posture. `labels` gives each bone's label, centroid and volume in cubic mm.
///
/// All axes are the world's: x to the left, y to the back, z to the head.
pub(super) fn skeleton(labels: &BTreeMap<String, (u16, Point3<f64>, f64)>) -> Skeleton {
    let rows: Vec<Row> = spine_rows().into_iter().chain(other_rows()).collect();
    let place = |name: &str| rows.iter().position(|r| r.bone == name);
    let bones = rows.iter().filter_map(|r| {
        let (label, centroid, volume_mm3) = *labels.get(&r.bone)?;
        let joint = Joint {
            name: r.joint.clone(),
            centre: placed(&r.centre.into()).into(),
            axes: Matrix3::identity(),
            rotation_range_deg: r.degrees.map(|d| [-d, d]),
            translation_range_mm: [r.shift; 3],
            source: r.source.into(),
        };
        let parent = r.parent.as_deref().and_then(place);
        Some(Bone { name: r.bone.clone(), label, parent, joint, centroid, volume_mm3 })
    });
    Skeleton { bones: bones.collect() }
}
