//! Plans are read as they are written, and what makes no sense is refused by name.

use super::super::skeleton::tests::example;
use super::*;
use crate::postures::pose_of;

fn load(text: &str) -> Result<PosturePlan> {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("postures.toml");
    std::fs::write(&path, text).unwrap();
    read_postures(&path, &example())
}

/// The greatest difference of any number.
fn apart(a: &PosturePlan, b: &PosturePlan) -> f64 {
    let numbers = |p: &PosturePlan| {
        let mut all = vec![p.scale, p.truncation_sd, p.limits.overlap_mm.unwrap_or(-1.0)];
        all.extend(p.mean.iter().chain(p.modes.iter().flat_map(|m| &m.values)).flatten());
        all.extend(p.joints.iter().flat_map(|j| j.sd.iter().chain(j.range.iter().flatten())));
        all.extend(p.volumes.iter().flat_map(|v| v.range));
        all.extend(p.postures.iter().flat_map(|p| sixes(&p.pose)).flatten());
        all
    };
    let (a, b) = (numbers(a), numbers(b));
    assert_eq!(a.len(), b.len());
    a.iter().zip(&b).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
}

#[test]
fn written_plans_read_back() {
    let mut plan = PosturePlan::usual(&example());
    assert!(plan.modes.len() == 3 && plan.joints[0].sd[5] > 0.0, "the neck bends: {:?}", plan.modes);
    (plan.scale, plan.limits.overlap_mm, plan.limits.folded_cells) = (1.5, Some(0.7), 12);
    plan.mean[2][1] = -0.25;
    plan.volumes.push(VolumeRange { organ: "a gland".into(), range: [0.7, 0.95] });
    let mut pose = pose_of(&plan.mean);
    pose.joints[0].translation = [1.0, 2.0, -3.0];
    plan.postures.push(NamedPose { name: "the \"first\"".into(), pose });
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("postures.toml");
    write_postures(&path, &example(), &plan, &["A head.".into()]).unwrap();
    let back = read_postures(&path, &example()).unwrap();
    assert!(apart(&plan, &back) < 1e-12);
    assert_eq!(back.limits, plan.limits);
    let names = |p: &PosturePlan| {
        let modes = p.modes.iter().map(|m| m.name.clone());
        modes
            .chain(p.volumes.iter().map(|v| v.organ.clone()))
            .chain(p.postures.iter().map(|p| p.name.clone()))
            .collect::<Vec<_>>()
    };
    assert_eq!(names(&back), names(&plan));
    assert_eq!(back.draw(3, 9).held, plan.draw(3, 9).held);
}

#[test]
fn a_plan_changes_what_it_names_and_nothing_else() {
    let usual = PosturePlan::usual(&example());
    assert!(apart(&load("scale = 1\n").unwrap(), &usual) == 0.0);
    let plan = load("[neck]\nflexion_sd_deg = 5\n[bones.skull]\naxial_deg = [0, 1]\naxial_sd_deg = 0.5\n").unwrap();
    let flexion = |p: &PosturePlan| {
        p.modes.iter().find(|m| m.name == "neck flexion").unwrap().values.iter().map(|v| v[0]).sum::<f64>()
    };
    let lateral = |p: &PosturePlan| {
        p.modes.iter().find(|m| m.name == "neck lateral").unwrap().values.iter().map(|v| v[1]).sum::<f64>()
    };
    assert!((flexion(&plan) - 5.0).abs() < 1e-12 && (lateral(&plan) - lateral(&usual)).abs() < 1e-12);
    assert_eq!((plan.joints[2].range[2], plan.joints[2].sd[2]), ([0.0, 1.0], 0.5));
    assert_eq!(plan.joints[1], usual.joints[1]);
    let still = load("defaults = false\n[couch]\nshift_sd_mm = [1, 2, 3]\n").unwrap();
    assert!(still.dimensions() == 3 && still.modes.is_empty());
    assert_eq!(load("neck.rest_sd_deg = [0, 0, 1]").unwrap().joints[2].sd[..3], [0.0, 0.0, 1.0]);
}

#[test]
fn refusals_name_the_file_the_key_and_the_value() {
    let cases = [
        ("[bones.skul]", &["bones.skul", "no such bone", "skull"][..]),
        ("[bones.vertebrae_T1]", &["vertebrae_T1", "root", "[couch]"]),
        ("bones.skull.flexion_sd_deg = -1", &["bones.skull.flexion_sd_deg", "below 0"]),
        ("bones.skull.flexion_deg = [3, -3]", &["bones.skull.flexion_deg = [3, -3]", "greater"]),
        ("bones.skull.flexion_deg = [-3, 30]", &["bones.skull.flexion_deg", "range of -12.5 to 10", "--skeleton"]),
        ("couch.shift_sd_mm = [1, 2]", &["couch.shift_sd_mm", "3 finite numbers"]),
        ("couch.flexion_sd_deg = 1", &["couch.flexion_sd_deg", "unknown key"]),
        ("volumes.gland = [0.9, 0.7]", &["volumes.gland", "greater"]),
        ("scale = 0", &["scale = 0", "0.01"]),
        ("scales = 1", &["scales", "unknown key"]),
        ("[[modes]]\nname = \"neck axial\"", &["modes[0]", "there is a mode"]),
        ("[[postures]]\nbones.tail.flexion_deg = 1", &["postures[0].bones.tail", "no such bone"]),
        ("postures = 3", &["postures", "tables"]),
        ("limits.folded_cells = -1", &["limits.folded_cells", "below 0"]),
    ];
    for (text, parts) in cases {
        let error = load(text).unwrap_err().to_string();
        for part in parts.iter().chain(&["postures.toml"]) {
            assert!(error.contains(part), "{text}: {error}");
        }
    }
}
