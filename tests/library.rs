//! `aventail library`: artificial CTs in sampled postures, and modes of fitted ones.

#![expect(clippy::unwrap_used, reason = "a test that cannot read what it wrote fails")]

use crate::support::files::labels;
use crate::support::{Register, aventail, bones_alone, files_below, folder, shared, small_phantom};
use assert_cmd::Command;
use aventail::geometry::Rigid;
use aventail::io::{read_bone_transforms, read_contours, read_field, read_image, read_labels};
use aventail::postures::{PosturePlan, sixes};
use aventail::skeleton;
use aventail::volume::{LabelMap, Volume};
use nalgebra::{Point3, Vector3};
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::OnceLock;

/// One chosen posture, then those that are drawn.
const PLAN: &str = "scale = 1.5\n[[postures]]\nname = \"chin up\"\ncouch.shift_mm = [2.0, 0.0, 3.0]\n\
                    bones.skull.flexion_deg = -4.0\nbones.vertebrae_C3.flexion_deg = -3.0\n";

fn plan_file(name: &str, text: &str) -> PathBuf {
    let path = folder().join(name);
    fs::write(&path, text).unwrap();
    path
}

fn library(out: &Path, more: &[&str]) -> Command {
    let files = small_phantom();
    let mut command = aventail();
    command.args(["library", "--quiet", "--seed", "5", "--planning"]).arg(&files.planning);
    command.arg("--bones").arg(&files.bones).arg("--out").arg(out).args(more);
    command
}

fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

fn json_of(path: &Path) -> Value {
    serde_json::from_slice(&fs::read(path).unwrap()).unwrap()
}

/// Three postures with everything that goes along, made once.
fn made() -> &'static PathBuf {
    static RUN: OnceLock<PathBuf> = OnceLock::new();
    RUN.get_or_init(|| {
        let plan = plan_file("plan.toml", PLAN);
        let beside = small_phantom().planning.parent().unwrap();
        let (contours, dose) = (beside.join("contours.json"), beside.join("dose.nii.gz"));
        let out = folder().join("made");
        let more = [
            "--plan",
            text(&plan),
            "--sample",
            "2",
            "--structures",
            text(&contours),
            "--dose",
            text(&dose),
            "--noise",
            "20",
        ];
        library(&out, &more).assert().success();
        out
    })
}

fn entries(manifest: &Value) -> Vec<&Value> {
    ["training", "implausible"].iter().flat_map(|list| manifest[list].as_array().unwrap()).collect()
}

#[test]
fn the_datalist_names_files_that_are_there_with_their_checksums() {
    let out = made();
    let manifest = json_of(&out.join("library.json"));
    let all = entries(&manifest);
    assert_eq!(
        (all.len(), manifest["numTraining"].as_u64().unwrap() as usize),
        (3, manifest["training"].as_array().unwrap().len())
    );
    for entry in &all {
        for role in [
            "image",
            "ct",
            "label",
            "contours",
            "dose",
            "planning_to_fraction",
            "fraction_to_planning",
            "pose",
            "bone_transforms",
        ] {
            let path = entry[role].as_str().unwrap_or_else(|| panic!("{role}"));
            assert!(!Path::new(path).is_absolute() && out.join(path).is_file(), "{path}");
        }
        assert!(entry["image"].as_str().unwrap().ends_with("image.nii.gz"), "the noisy one");
    }
    assert_eq!(manifest["labels"]["0"], "background");
    let check = aventail().args(["inspect", "--json"]).arg(out).assert().success();
    let check: Value = serde_json::from_slice(&check.get_output().stdout).unwrap();
    let listed = manifest["outputs"].as_array().unwrap().len();
    let found = check.to_string();
    assert_eq!(listed, 3 * 10 + 2, "{found}");
    for list in ["missing", "changed", "of_another_run"] {
        assert!(found.contains(&format!("\"{list}\":[]")), "{list}: {found}");
    }
    let page = fs::read_to_string(out.join("library.html")).unwrap();
    assert!(page.contains("posture_003") && page.contains("chin up") && !page.contains("src=\"/"));
}

#[test]
fn bones_move_as_the_pose_says_and_the_fields_move_them_so() {
    let out = made();
    let labels = read_labels(&small_phantom().bones, None).unwrap().value;
    let skeleton = skeleton::build(&labels).unwrap().skeleton;
    for name in ["posture_001", "posture_002", "posture_003"] {
        let own = out.join(name);
        let pose = aventail::io::pose::read_pose(own.join("pose.toml"), &skeleton).unwrap();
        let posed = skeleton.transforms(&pose);
        let written = read_bone_transforms(own.join("bone_transforms.json")).unwrap();
        for (bone, t) in skeleton.bones.iter().zip(&posed) {
            assert!((written[&bone.name].to_homogeneous() - t.to_homogeneous()).amax() < 1e-6, "{}", bone.name);
        }
        let push = read_field(own.join("planning_to_fraction.nii.gz")).unwrap().value;
        let grid = push.grid();
        let transform = |l: usize| labels.names.get(&labels.volume.data()[l]).and_then(|n| written.get(n));
        let off = |(l, t): (usize, &Rigid)| {
            let x = grid.centre(grid.voxel(l));
            (t * x - x - Vector3::from(push.data()[l].map(f64::from))).norm()
        };
        let worst = (0..grid.len()).filter_map(|l| Some((l, transform(l)?))).map(off).fold(0.0, f64::max);
        assert!(worst < 1e-2, "{name}: {worst}");
        let most =
            posed.iter().zip(&skeleton.bones).map(|(t, b)| (t * b.centroid - b.centroid).norm()).fold(0.0, f64::max);
        assert!(most > 1.0, "{name} moves: {most}");
    }
}

#[test]
fn a_posture_is_what_pose_makes_of_it_and_noise_is_noise() {
    let out = made();
    let own = out.join("posture_002");
    let again = folder().join("posed");
    let files = small_phantom();
    let mut pose = aventail();
    pose.args(["pose", "--quiet", "--planning"]).arg(&files.planning).arg("--bones").arg(&files.bones);
    pose.arg("--pose").arg(own.join("pose.toml")).arg("--out").arg(&again).assert().success();
    let ct = read_image(own.join("ct.nii.gz")).unwrap().value;
    // Angles go through a file of degrees: a voxel may be rounded the other way.
    let posed = read_image(again.join("planning_on_fraction.nii.gz")).unwrap().value;
    assert!(ct.data().iter().zip(posed.data()).all(|(a, b)| (a - b).abs() <= 1.0));
    let image = read_image(own.join("image.nii.gz")).unwrap().value;
    let noise: Vec<f64> =
        image.data().iter().zip(ct.data()).filter(|(_, hu)| **hu > -500.0).map(|(a, b)| f64::from(a - b)).collect();
    let sd = (noise.iter().map(|v| v * v).sum::<f64>() / noise.len() as f64).sqrt();
    assert!((sd - 20.0).abs() < 1.5, "{sd}");
    // Contours and dose have come along.
    let beside = files.planning.parent().unwrap();
    let volume = |path: &Path| {
        let contours = read_contours(path).unwrap().0;
        contours.structures.iter().map(|s| (s.name.clone(), s.volume(9.0))).collect::<BTreeMap<_, _>>()
    };
    let (before, after) = (volume(&beside.join("contours.json")), volume(&own.join("contours.json")));
    assert_eq!(before.keys().collect::<Vec<_>>(), after.keys().collect::<Vec<_>>());
    let peak = |path: &Path| read_image(path).unwrap().value.extremes()[1];
    let ratio = peak(&own.join("dose.nii.gz")) / peak(&beside.join("dose.nii.gz"));
    assert!((0.9..=1.001).contains(&ratio), "{ratio}");
}

#[test]
fn a_registration_finds_the_posture_again() {
    let own = made().join("posture_001");
    let out = folder().join("found");
    let register = Register::of(small_phantom(), out.clone()).fraction(own.join("ct.nii.gz"));
    register.with("--config", bones_alone()).flag("--quiet").command().assert().success();
    let of = |folder: &Path| read_bone_transforms(folder.join("bone_transforms.json")).unwrap()["skull"];
    let (truth, found) = (of(&own), of(&out));
    let labels = read_labels(&small_phantom().bones, None).unwrap().value;
    let bones = skeleton::build(&labels).unwrap().skeleton.bones;
    let p: Point3<f64> = bones.iter().find(|b| b.name == "skull").unwrap().centroid;
    // Of a bone that is large beside voxels of 9 mm.
    let (off, moved) = ((found * p - truth * p).norm(), (truth * p - p).norm());
    println!("skull off by {off:.3} of {moved:.2} mm");
    assert!(off < 1.5 && moved > 8.0, "{off} of {moved}");
}

#[test]
fn the_same_seed_gives_the_same_bits_and_a_stopped_run_goes_on() {
    let out = folder().join("gone_on");
    let plan = plan_file("plan_again.toml", PLAN);
    library(&out, &["--plan", text(&plan), "--sample", "1", "--threads", "1", "--no-fields"]).assert().success();
    let bytes = |folder: &Path, name: &str| fs::read(folder.join(name)).unwrap();
    for name in ["posture_001/ct.nii.gz", "posture_002/ct.nii.gz", "posture_002/labels.nii.gz", "posture_002/pose.toml"]
    {
        assert!(
            bytes(&out, name) == bytes(made(), name),
            "{name}: threads, fields and number of postures change nothing"
        );
    }
    assert!(!files_below(&out).iter().any(|f| f.contains("planning_to_fraction")));
    // As if it had been stopped: no manifest, one posture whole, one damaged.
    fs::remove_file(out.join("library.json")).unwrap();
    fs::write(out.join("posture_002/labels.nii.gz"), b"x").unwrap();
    let made_at = |name: &str| json_of(&out.join(name).join("posture.json"))["seconds"].as_f64().unwrap();
    let before = made_at("posture_001");
    library(&out, &["--plan", text(&plan), "--sample", "2", "--no-fields"]).assert().success();
    assert!((made_at("posture_001") - before).abs() < f64::EPSILON, "kept");
    assert!(bytes(&out, "posture_002/labels.nii.gz") == bytes(made(), "posture_002/labels.nii.gz"), "made again");
    assert!(bytes(&out, "posture_003/ct.nii.gz") == bytes(made(), "posture_003/ct.nii.gz"));
    // Other settings begin anew, and what is no longer a posture of the library goes.
    library(&out, &["--sample", "1", "--no-fields"]).assert().success();
    let names = files_below(&out);
    assert!(names.iter().all(|n| !n.starts_with("posture_002") && !n.starts_with("posture_003")), "{names:?}");
}

#[test]
fn what_makes_no_library_is_refused_and_leaves_nothing() {
    let refused = |out: &str, more: &[&str], code: i32, word: &str| {
        let out = folder().join(out);
        let run = library(&out, more).assert().code(code);
        let error = String::from_utf8(run.get_output().stderr.clone()).unwrap();
        assert!(error.contains(word), "{more:?}: {error}");
        let left: Vec<String> = files_below(&out).into_iter().filter(|f| !f.ends_with(".toml")).collect();
        assert!(left.is_empty(), "{left:?}");
    };
    let plan = |name: &str, text: &str| plan_file(name, text).to_str().unwrap().to_owned();
    let unknown = plan("unknown.toml", "bones.tail.flexion_sd_deg = 1\n");
    let reversed = plan("reversed.toml", "bones.skull.flexion_deg = [3, -3]\n");
    let wild = plan("wild.toml", "scale = 20\n[bones.mandible]\nshift_sd_mm = [20, 20, 20]\n");
    refused("r", &[], 2, "--sample");
    refused("r", &["--sample", "0"], 2, "0");
    refused("r", &["--sample", "2", "--plan", &unknown], 4, "no such bone");
    refused("r", &["--sample", "2", "--plan", &reversed], 4, "greater than the second");
    refused("r", &["--sample", "2", "--volume-change", "parotid=1..0.7"], 2, "greater");
    refused("r", &["--sample", "2", "--volume-change", "parotid=0.7..1"], 2, "parotid");
    refused("r", &["--sample", "2", "--noise", "-1"], 2, "noise");
    refused("r", &["--sample", "1", "--reject", "--plan", &wild], 4, "postures-implausible");
    // A plan that lies where the library's own would be written.
    let out = folder().join("over");
    fs::create_dir_all(&out).unwrap();
    fs::write(out.join("postures.toml"), PLAN).unwrap();
    refused("over", &["--sample", "1", "--plan", text(&out.join("postures.toml"))], 4, "input-overwritten");
    assert_eq!(fs::read_to_string(out.join("postures.toml")).unwrap(), PLAN);
}

/// A ball of soft tissue away from bones, as an organ's mask.
fn gland() -> PathBuf {
    let ct = read_image(&small_phantom().planning).unwrap().value;
    let bones = read_labels(&small_phantom().bones, None).unwrap().value;
    let grid = ct.grid();
    let ball = |centre: Point3<f64>| {
        (0..grid.len()).filter(|&l| (grid.centre(grid.voxel(l)) - centre).norm() < 22.0).collect::<Vec<_>>()
    };
    let soft = |l: &usize| bones.volume.data()[*l] == 0 && (-150.0..150.0).contains(&ct.data()[*l]);
    let fits = |all: &Vec<usize>| all.len() > 50 && all.iter().all(soft);
    let found = (0..grid.len()).filter(|l| soft(l)).map(|l| ball(grid.centre(grid.voxel(l)))).find(fits).unwrap();
    let mut mask = Volume::filled(grid.clone(), 0u16);
    found.iter().for_each(|l| mask.data_mut()[*l] = 1);
    labels(&folder().join("gland.nii.gz"), &LabelMap { volume: mask, names: BTreeMap::new() })
}

#[test]
fn organs_take_volumes_of_their_range() {
    let out = folder().join("shrunk");
    let gland = gland();
    library(&out, &["--organs", text(&gland), "--volume-change", "gland=0.7..0.8", "--sample", "1", "--no-fields"])
        .assert()
        .success();
    let volume = &json_of(&out.join("posture_001/posture.json"))["volumes"][0];
    let (factor, reached) = (volume["factor"].as_f64().unwrap(), volume["reached"].as_f64().unwrap());
    assert!(volume["organ"] == "gland" && (0.7..=0.8).contains(&factor), "{volume}");
    assert!((reached / factor - 1.0).abs() < 0.1, "{volume}");
    let names = read_labels(out.join("posture_001/labels.nii.gz"), None).unwrap().value.names;
    assert!(names.values().any(|n| n == "gland"));
}

#[test]
fn usual_postures_displace_bones_as_far_as_was_measured() {
    let skeleton = skeleton::build(&shared::coarse().bones).unwrap().skeleton;
    let plan = PosturePlan::usual(&skeleton);
    let at = |name: &str| skeleton.bones.iter().position(|b| b.name == name).unwrap();
    let (c4, c6, skull, jaw) = (at("vertebrae_C4"), at("vertebrae_C6"), at("skull"), at("mandible"));
    // Displacement against C4 to C6, here against their mean motion.
    let mut sums = [0.0; 2];
    for n in 0..512 {
        let drawn = plan.draw(n, 1);
        assert!(drawn.held == 0 && skeleton.excess(&drawn.pose).iter().all(skeleton::Excess::is_zero), "{n}");
        let t = skeleton.transforms(&drawn.pose);
        for (sum, bone) in sums.iter_mut().zip([skull, jaw]) {
            let p = skeleton.bones[bone].centroid;
            let with_neck = nalgebra::center(&(t[c4] * p), &(t[c6] * p));
            *sum += (t[bone] * p - with_neck).norm() / 512.0;
        }
    }
    // Polat 2007: 4.7 +- 2.5 mm of the skull; 4.4 +- 2.5 mm of the mandible, which is not quite reached.
    assert!((sums[0] - 4.7).abs() < 0.6 && (2.5..4.9).contains(&sums[1]), "{sums:?}");
}

#[test]
fn the_example_plan_is_read() {
    let skeleton = skeleton::build(&shared::coarse().bones).unwrap().skeleton;
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("data/postures.toml");
    let plan = aventail::io::postures::read_postures(path, &skeleton).unwrap();
    assert_eq!(plan.postures.iter().map(|p| p.name.as_str()).collect::<Vec<_>>(), ["chin up", "mouth open"]);
    assert!(plan.dimensions() > 30 && plan.dimensions() < 256, "{}", plan.dimensions());
}

#[test]
fn modes_of_fractions_come_back_from_their_reports() {
    let posed = folder().join("for_fit");
    let files = small_phantom();
    let pose = plan_file("still.toml", "bones.skull.flexion_deg = 1.0\n");
    let mut command = aventail();
    command.args(["pose", "--quiet", "--planning"]).arg(&files.planning).arg("--bones").arg(&files.bones);
    command.arg("--pose").arg(&pose).arg("--out").arg(&posed).assert().success();
    // Its report in other postures: the neck bends, by 2 degrees of one standard deviation.
    let report = json_of(&posed.join("report.json"));
    let bones: Vec<String> =
        report["bones"].as_array().unwrap().iter().map(|b| b["name"].as_str().unwrap().into()).collect();
    let at = bones.iter().position(|b| b == "vertebrae_C5").unwrap();
    let fraction = |name: &str, degrees: f64| {
        let own = folder().join(name);
        fs::create_dir_all(&own).unwrap();
        let mut report = report.clone();
        for joint in report["pose"]["joints"].as_array_mut().unwrap() {
            *joint = json!({ "rotation": [0.0, 0.0, 0.0], "translation": [0.0, 0.0, 0.0] });
        }
        report["pose"]["joints"][at]["rotation"][0] = json!(degrees.to_radians());
        report["pose"]["joints"][0]["translation"] = json!([500.0, 3.0, degrees]);
        fs::write(own.join("report.json"), report.to_string()).unwrap();
        own
    };
    let (a, b, c) = (fraction("f1", -1.0), fraction("f2", 1.0), fraction("f3", 3.0));
    let out = folder().join("modes");
    let fit = |out: &Path, runs: &[&PathBuf]| {
        let mut command = aventail();
        command.args(["library", "--json", "--fit"]).args(runs).arg("--out").arg(out);
        command
    };
    let run = fit(&out, &[&a, &b, &c]).assert().success();
    let told: Value = serde_json::from_slice(&run.get_output().stdout).unwrap();
    assert!(
        (told["modes"][0]["share"].as_f64().unwrap() - 1.0).abs() < 1e-9
            && told["modes"].as_array().unwrap().len() == 1
    );
    assert_eq!(told["warnings"][0]["code"], "few-fractions");
    let skeleton = skeleton::build(&read_labels(&files.bones, None).unwrap().value).unwrap().skeleton;
    let plan = aventail::io::postures::read_postures(out.join("postures.toml"), &skeleton).unwrap();
    assert!((plan.mean[at][0] - 1.0).abs() < 1e-9 && (plan.modes[0].values[at][0] - 2.0).abs() < 1e-9);
    assert!(plan.mean[0][3].abs() < 1e-12, "scanner origins are no motion of the couch");
    assert!(plan.joints[0].sd[3] > 0.0 && (0..64).any(|n| sixes(&plan.draw(n, 1).pose)[at][0] > 2.0));
    fit(&folder().join("one"), &[&a]).assert().code(2);
    // Another patient's planning CT.
    let mut other = json_of(&c.join("report.json"));
    other["inputs"][0]["sha256"] = json!("0");
    fs::write(c.join("report.json"), other.to_string()).unwrap();
    let run = fit(&folder().join("two"), &[&a, &c]).assert().code(4);
    assert!(String::from_utf8_lossy(&run.get_output().stderr).contains("other-planning"));
}
