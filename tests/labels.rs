//! Labels: masks joined to one map, and `--bones auto` with a program that stands in for TotalSegmentator.

#![expect(clippy::unwrap_used, reason = "a test that cannot read what it wrote fails")]

use crate::support::{Register, aventail, files, folder, small_phantom};
use aventail::io::{self, read_labels};
use aventail::volume::{LabelMap, Volume};
use serde_json::Value;
use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::OnceLock;

/// A folder in this file's folder.
fn place(name: &str) -> PathBuf {
    let place = folder().join(name);
    fs::create_dir_all(&place).unwrap();
    place
}

/// The phantom's planning CT and structure set as DICOM.
fn dicom_planning() -> &'static Path {
    static MADE: OnceLock<PathBuf> = OnceLock::new();
    MADE.get_or_init(|| {
        let data = place("dicom_phantom");
        aventail().args(["phantom", "--dicom", "--spacing", "9x9x9", "--out"]).arg(&data).assert().success();
        data.join("dicom/planning")
    })
}

/// The phantom's bones.
fn bones() -> &'static LabelMap {
    static MAP: OnceLock<LabelMap> = OnceLock::new();
    MAP.get_or_init(|| read_labels(&small_phantom().bones, None).unwrap().value)
}

/// Those of its structures that `keep` gives another name or none.
fn renamed(keep: impl Fn(&str) -> Option<String>) -> LabelMap {
    let all = bones();
    let new: BTreeMap<u16, Option<String>> = all.names.iter().map(|(l, n)| (*l, keep(n))).collect();
    let mut numbers: BTreeMap<&str, u16> = BTreeMap::new();
    for (label, name) in &new {
        if let Some(name) = name {
            numbers.entry(name).or_insert(*label);
        }
    }
    let number = |l: &u16| new.get(l).and_then(Option::as_deref).map_or(0, |n| numbers[n]);
    let names = numbers.iter().map(|(n, l)| (*l, (*n).to_owned())).collect();
    LabelMap { volume: all.volume.map(number), names }
}

/// One structure of the phantom as a mask without a name.
fn mask(file: &Path, name: &str) -> PathBuf {
    let one = renamed(|n| (n == name).then(|| n.to_owned()));
    let volume = one.volume.map(|l| u16::from(*l > 0));
    files::labels(file, &LabelMap { volume, names: BTreeMap::new() })
}

/// The name at each voxel.
fn by_name(map: &LabelMap) -> Vec<&str> {
    map.volume.data().iter().map(|l| map.names.get(l).map_or("", String::as_str)).collect()
}

fn refused(arguments: &[&Path], code: i32, words: &[&str]) {
    let run = aventail().args(["labels", "merge"]).args(arguments).assert().code(code);
    let message = String::from_utf8_lossy(&run.get_output().stderr).into_owned();
    for word in words {
        assert!(message.contains(word), "`{word}` is not in\n{message}");
    }
    assert!(message.contains("\n  remedy: "), "{message}");
}

#[test]
fn a_folder_of_masks_becomes_the_label_map_that_it_came_from() {
    let masks = place("masks");
    for name in bones().names.values() {
        mask(&masks.join(format!("{name}.nii.gz")), name);
    }
    mask(&masks.join("spleen.nii.gz"), "no such bone");
    mask(&masks.join("liver.nii.gz"), "skull");
    fs::write(masks.join("statistics.json"), "{}").unwrap();
    let out = folder().join("merged.nii.gz");
    let mut merge = aventail();
    merge.args(["labels", "merge", "--only-bones", "--json", "--out"]).args([&out, &masks]);
    let run = merge.assert().success();
    let told: Value = serde_json::from_slice(&run.get_output().stdout).unwrap();
    let merged = read_labels(&out, None).unwrap().value;
    assert_eq!(by_name(&merged), by_name(bones()));
    let number = |name: &str| merged.names.iter().find(|n| n.1 == name).map(|n| *n.0);
    // By the anatomy: sacrum 1, ..., C1 26, skull 27, mandible 28.
    assert_eq!((number("vertebrae_C1"), number("skull"), number("mandible")), (Some(26), Some(27), Some(28)));
    assert_eq!((&told["empty"][0], &told["left_out"][0]), (&"spleen".into(), &"liver".into()), "{told}");
    assert!(told["passed_over"][0].as_str().unwrap().ends_with("statistics.json"), "{told}");
    assert_eq!((told["warnings"].as_array().unwrap().len(), told["overlaps"].as_array().unwrap().len()), (0, 0));
    aventail().args(["skeleton", "--bones"]).arg(&out).assert().success();
}

#[test]
fn the_first_named_keeps_what_overlaps_and_the_volume_is_told() {
    let here = place("overlap");
    let (skull, jaw) = (mask(&here.join("skull.nii.gz"), "skull"), mask(&here.join("bone.nii.gz"), "skull"));
    let out = here.join("out.nii.gz");
    let named = |name: &str, file: &Path| format!("{name}={}", file.display());
    let mut merge = aventail();
    merge.args(["labels", "merge", &named("mandible", &jaw)]).arg(&skull).arg("--out").arg(&out).arg("--json");
    let run = merge.assert().success();
    let told: Value = serde_json::from_slice(&run.get_output().stdout).unwrap();
    let voxels = bones().counts()[bones().names.iter().find(|n| n.1 == "skull").unwrap().0];
    let ml = voxels as f64 * 0.729;
    let overlap = &told["overlaps"][0];
    assert_eq!((overlap["kept_by"].as_str(), overlap["voxels"].as_u64()), (Some("mandible"), Some(voxels as u64)));
    assert!((overlap["volume_ml"].as_f64().unwrap() - ml).abs() < 1e-6, "{told}");
    assert_eq!(told["warnings"][0]["code"], "labels-overlap");
    assert_eq!(overlap["nothing_left"], true);
    assert_eq!(read_labels(&out, None).unwrap().value.names.into_values().collect::<Vec<_>>(), ["mandible"]);
    // One structure of a label map alone.
    let phantom = &small_phantom().bones;
    aventail().args(["labels", "merge", &named("skull", phantom), "--out"]).arg(&out).assert().success();
    let alone = read_labels(&out, None).unwrap().value;
    assert_eq!(by_name(&alone), by_name(&renamed(|n| (n == "skull").then(|| n.to_owned()))));
}

#[test]
fn what_is_not_one_map_is_refused() {
    let here = place("refused");
    let bones = small_phantom().bones.as_path();
    let skull = mask(&here.join("skull.nii.gz"), "skull");
    let out = here.join("out.nii.gz");
    let to = |more: &[&'static str], files: &[&Path], code: i32, words: &[&str]| {
        let mut all: Vec<&Path> = files.to_vec();
        all.extend(more.iter().map(Path::new));
        all.extend([Path::new("--out"), &out]);
        refused(&all, code, words);
        assert!(!out.exists(), "{words:?}");
    };
    to(&[], &[bones, &skull], 4, &["[labels-doubled]", "skull", "bones.nii.gz"]);
    let plain =
        files::labels(&here.join("plain.nii.gz"), &LabelMap { names: BTreeMap::new(), ..self::bones().clone() });
    to(&[], &[&plain], 4, &["[labels-nameless]", "values besides 0"]);
    to(&[], &[&small_phantom().planning], 4, &["planning_ct.nii.gz", "no integer"]);
    let coarse = Volume::filled(aventail::geometry::Grid::axis_aligned([3; 3], [2.0; 3], [7.0; 3]).unwrap(), 1);
    let coarse = files::labels(&here.join("hyoid.nii.gz"), &LabelMap { volume: coarse, names: BTreeMap::new() });
    to(&[], &[&skull, &coarse], 4, &["[labels-elsewhere]", "size [3, 3, 3]", "spacing [9.000, 9.000, 9.000]"]);
    let absent = PathBuf::from(format!("tibia={}", bones.display()));
    to(&[], &[&absent], 4, &["tibia is none of its structures"]);
    to(&[], &[&here.join("nothing.nii.gz")], 3, &["nothing.nii.gz"]);
    to(&[], &[&place("refused/empty")], 3, &["no image"]);
    refused(&[&skull, Path::new("--out"), &skull], 4, &["[input-overwritten]"]);
    refused(&[&skull, Path::new("--out"), &here.join("out.mha")], 2, &["names of labels"]);
}

#[test]
fn names_beside_a_label_map_are_pointed_at_and_taken() {
    let here = place("beside");
    let all = bones();
    let most = renamed(|n| (n != "hyoid").then(|| n.to_owned()));
    let bare = files::labels(&here.join("all.nii.gz"), &LabelMap { names: BTreeMap::new(), ..most });
    let table = serde_json::json!({ "labels": all.names });
    fs::write(here.join("other.json"), "{\"outputs\": []}").unwrap();
    let out = here.join("out.nii.gz");
    refused(&[&bare, Path::new("--out"), &out], 4, &["no names", "with names in its header or in --labels (JSON)"]);
    let names = files::bytes(&here.join("bones.json"), table.to_string().as_bytes());
    let hint = format!("{0} lies beside it: give --labels {0}", names.display());
    refused(&[&bare, Path::new("--out"), &out], 4, &[&hint]);
    let skeleton = aventail().arg("skeleton").arg("--bones").arg(&bare).assert().code(4);
    assert!(String::from_utf8_lossy(&skeleton.get_output().stderr).contains(&hint));
    // A mask keeps the name of its file.
    let hyoid = mask(&here.join("hyoid.nii.gz"), "hyoid");
    let mut merge = aventail();
    merge.args(["labels", "merge"]).args([&hyoid, &bare]).arg("--labels").arg(&names).arg("--out").arg(&out);
    merge.assert().success();
    let found = read_labels(&out, None).unwrap().value;
    assert_eq!(by_name(&found), by_name(all));
}

#[test]
fn structure_sets_are_drawn_on_the_grid() {
    let here = place("structures");
    let ct = dicom_planning();
    let set = ct.join("RS.dcm");
    let names = files::bytes(&here.join("names.toml"), b"[bones]\nspinal_cord = \"sacrum\"\n");
    let hyoid = mask(&here.join("hyoid.nii.gz"), "hyoid");
    let out = here.join("out.nii.gz");
    refused(&[&set, Path::new("--out"), &out], 2, &["--grid"]);
    let mut merge = aventail();
    merge.args(["labels", "merge"]).args([&set, &hyoid]).arg("--grid").arg(ct).arg("--labels").arg(&names);
    merge.arg("--out").arg(&out).assert().success();
    let found: Vec<String> = read_labels(&out, None).unwrap().value.names.into_values().collect();
    assert!(found.contains(&"sacrum".to_owned()) && found.contains(&"hyoid".to_owned()), "{found:?}");
    // The skeleton takes the set too, once it knows the grid.
    let mut skeleton = aventail();
    skeleton.arg("skeleton").arg("--bones").arg(&set).arg("--labels").arg(&names);
    skeleton.assert().code(2);
    let run = skeleton.arg("--planning").arg(ct).assert().success();
    assert!(String::from_utf8_lossy(&run.get_output().stdout).contains("sacrum"));
}

/// With a program that does what TotalSegmentator does to its arguments and files.
#[cfg(unix)]
mod auto {
    use super::*;
    use crate::support::{Register, files_below};
    use assert_cmd::Command;
    use std::os::unix::fs::PermissionsExt;

    const STANDS_IN: &str = r#"#!/bin/sh
here=HERE
[ "$1" = --version ] && { echo 2.11.0; exit 0; }
echo "$@" >> "$here/log"
task=total
while [ $# -gt 0 ]; do
  case "$1" in
    -i) in=$2; shift 2 ;;
    -o) out=$2; shift 2 ;;
    --ml) ml=yes; shift ;;
    --task) task=$2; shift 2 ;;
    --roi_subset) classes=yes; shift; while [ $# -gt 0 ] && [ "${1#-}" = "$1" ]; do shift; done ;;
    *) echo "error: unrecognized arguments: $1" >&2; exit 2 ;;
  esac
done
[ "$ml" = yes ] && [ -f "$in" ] || { echo "no input, or no --ml" >&2; exit 2; }
case "$in" in *.nii|*.nii.gz) ;; *) echo "Unknown file type" >&2; exit 1 ;; esac
[ "$classes" = yes ] && [ $task != total ] && [ $task != total_mr ] && { echo "ValueError: roi_subset only works with task 'total'" >&2; exit 1; }
[ -f "$here/fails_$task" ] && { echo "working"; echo "RuntimeError: no memory for $task" >&2; exit 1; }
echo "Predicting $task" >&2
cp "$here/$task.nii.gz" "$out"
"#;

    /// A folder with the program and what it will give: `total` counts mandible and hyoid as skull.
    fn stand_in(name: &str) -> PathBuf {
        let here = place(name);
        let program = files::bytes(
            &here.join("TotalSegmentator"),
            STANDS_IN.replace("HERE", &format!("'{}'", here.display())).as_bytes(),
        );
        fs::set_permissions(&program, fs::Permissions::from_mode(0o755)).unwrap();
        let own = |n: &str| if matches!(n, "mandible" | "hyoid") { "skull" } else { n }.to_owned();
        files::labels(&here.join("total.nii.gz"), &renamed(|n| Some(own(n))));
        let only = |one: &'static str| move |n: &str| ["skull", one].contains(&n).then(|| n.to_owned());
        files::labels(&here.join("craniofacial_structures.nii.gz"), &renamed(only("mandible")));
        files::labels(&here.join("headneck_bones_vessels.nii.gz"), &renamed(only("hyoid")));
        here
    }

    /// A command with the stand-in first on its path; with `None` there is no such program.
    fn on_path(mut command: Command, here: Option<&Path>) -> Command {
        let path = here.map_or("/usr/bin:/bin".to_owned(), |h| format!("{}:/usr/bin:/bin", h.display()));
        command.env("PATH", path);
        command
    }

    fn skeleton(here: &Path, planning: &Path) -> Command {
        let mut command = aventail();
        command.args(["skeleton", "--bones", "auto", "--json", "--planning"]).arg(planning);
        command.arg("--out").arg(here.join("skeleton.toml"));
        command
    }

    fn runs(here: &Path) -> Vec<String> {
        fs::read_to_string(here.join("log")).unwrap_or_default().lines().map(str::to_owned).collect()
    }

    /// What `auto` keeps.
    fn kept(here: &Path) -> Vec<String> {
        files_below(here).into_iter().filter(|f| f.starts_with("bones_auto")).collect()
    }

    #[test]
    fn labels_are_made_once_and_kept_for_the_next_fraction() {
        let here = stand_in("made");
        let register = Register { out: here.join("day1"), ..Register::quick("unused").bones("auto") };
        let run = on_path(register.command(), Some(&here)).assert().success();
        let message = String::from_utf8_lossy(&run.get_output().stderr).into_owned();
        assert!(!message.contains("Predicting"), "--quiet is quiet: {message}");
        let all = runs(&here);
        assert_eq!(all.len(), 3, "{all:?}");
        assert!(all[0].contains("--task total --roi_subset sacrum vertebrae_S1") && !all[0].contains("mandible"));
        assert!(all[1].ends_with("--task craniofacial_structures") && all[2].ends_with("headneck_bones_vessels"));
        let files = kept(&here);
        assert!(files.len() == 2 && files[0].ends_with(".json") && files[1].ends_with(".nii.gz"), "{files:?}");
        let made = read_labels(here.join(&files[1]), None).unwrap().value;
        assert_eq!(by_name(&made), by_name(bones()), "mandible and hyoid are taken out of the skull");
        let report: Value = serde_json::from_slice(&fs::read(here.join("day1/report.json")).unwrap()).unwrap();
        let warned = report["warnings"].as_array().unwrap().iter().any(|w| w["code"] == "bones-auto");
        assert!(warned && report.to_string().contains(&files[1]), "{}", report["warnings"]);
        // The next fraction, on a machine without the program.
        let next = Register { out: here.join("day2"), ..register };
        on_path(next.command(), None).assert().success();
        assert_eq!(runs(&here).len(), 3);
        // Corrected by hand: no longer what was made.
        files::labels(&here.join(&files[1]), bones());
        let run = on_path(skeleton(&here, &small_phantom().planning), Some(&here)).assert().code(4);
        let message = String::from_utf8_lossy(&run.get_output().stderr).into_owned();
        assert!(message.contains("[bones-auto-changed]") && message.contains(&files[1]), "{message}");
        // Another planning CT has labels of its own.
        on_path(skeleton(&here, &small_phantom().fraction), Some(&here)).assert().code(3);
    }

    /// An image that passes for an MR: the grey values of a T1 on the phantom.
    fn mr(here: &Path, ct: &Path) -> PathBuf {
        let ct = io::read_image(ct).unwrap().value;
        let grey = |hu: &f32| match *hu {
            hu if hu < -300.0 => 5.0,
            hu if hu < 0.0 => 850.0,
            hu if hu < 150.0 => 350.0,
            _ => 60.0,
        };
        let file = here.join("mr.nii.gz");
        io::write_image(&file, &ct.map(grey), io::Stored::Int16, &io::WriteOptions::default()).unwrap();
        file
    }

    #[test]
    fn an_mr_is_labelled_by_tasks_of_its_own() {
        let here = stand_in("mr");
        let spine = |n: &str| n == "sacrum" || n.starts_with("vertebrae");
        files::labels(&here.join("vertebrae_mr.nii.gz"), &renamed(|n| spine(n).then(|| n.to_owned())));
        let limb = |n: &str| ["humerus", "scapula", "clavicula", "femur", "hip"].iter().any(|own| n.starts_with(own));
        // All vertebrae are one class there.
        let rest = renamed(|n| if limb(n) { Some(n.to_owned()) } else { spine(n).then(|| "vertebrae".to_owned()) });
        files::labels(&here.join("total_mr.nii.gz"), &rest);
        let scan = mr(&here, &small_phantom().planning);
        let register = Register { out: here.join("day1"), ..Register::quick("unused").bones("auto") };
        let register = register.planning(&scan).with("--planning-modality", "mr").flag("--estimate");
        on_path(register.command(), Some(&here)).assert().success();
        let all = runs(&here);
        assert_eq!(all.len(), 2, "{all:?}");
        assert!(
            all[0].contains("--task total_mr --roi_subset humerus_left") && !all[0].contains("vertebrae"),
            "{all:?}"
        );
        assert!(all[1].ends_with("--task vertebrae_mr"), "{all:?}");
        let files = kept(&here);
        let made = read_labels(here.join(&files[1]), None).unwrap().value;
        let own = renamed(|n| (spine(n) || limb(n)).then(|| n.to_owned()));
        assert_eq!(by_name(&made), by_name(&own), "one vertebra each, and no label for what no task finds");
        let record: Value = serde_json::from_slice(&fs::read(here.join(&files[0])).unwrap()).unwrap();
        assert!(record["is_mr"] == true && record["licence"].as_str().unwrap().contains("vertebrae_mr"), "{record}");
        // Made once.
        on_path(register.command(), None).assert().success();
        // The same file as a CT has no labels yet: what was made of an MR is none.
        let run = on_path(skeleton(&here, &scan), Some(&here)).assert().code(4);
        let message = String::from_utf8_lossy(&run.get_output().stderr).into_owned();
        assert!(message.contains("[bones-auto-changed]") && message.contains("as of an MR"), "{message}");
        // The fraction's labels by the fraction's modality.
        let fraction = mr(&place("mr/fraction"), &small_phantom().fraction);
        fs::write(here.join("fails_vertebrae_mr"), "").unwrap();
        let run = Register { out: here.join("day2"), fraction, ..Register::quick("unused") };
        let run = run.with("--modality", "mr").with("--fraction-bones", "auto").flag("--estimate").command();
        let run = on_path(run, Some(&here)).assert().code(3);
        let message = String::from_utf8_lossy(&run.get_output().stderr).into_owned();
        assert!(runs(&here)[2].contains("--task total_mr") && message.contains("another grid"), "{message}");
    }

    #[test]
    fn without_the_program_three_ways_are_told() {
        let here = place("absent");
        let run = on_path(skeleton(&here, &small_phantom().planning), None).assert().code(2);
        let message = String::from_utf8_lossy(&run.get_output().stderr).into_owned();
        for way in ["aventail labels merge", "RTSTRUCT", "label map", "--task craniofacial_structures"] {
            assert!(message.contains(way), "{message}");
        }
        let mut bare = aventail();
        bare.args(["skeleton", "--bones", "auto"]).assert().code(2);
        assert!(files_below(&here).is_empty());
    }

    #[test]
    fn failures_leave_nothing_and_say_why() {
        let here = stand_in("failing");
        fs::write(here.join("fails_total"), "").unwrap();
        let run = on_path(skeleton(&here, &small_phantom().planning), Some(&here)).assert().code(3);
        let message = String::from_utf8_lossy(&run.get_output().stderr).into_owned();
        for word in ["--task total", "RuntimeError: no memory for total", "RTSTRUCT"] {
            assert!(message.contains(word), "{message}");
        }
        assert_eq!(kept(&here), [""; 0]);
        fs::remove_file(here.join("fails_total")).unwrap();
        // A further task that fails is told, then and later.
        fs::write(here.join("fails_headneck_bones_vessels"), "").unwrap();
        for _ in 0..2 {
            let run = on_path(skeleton(&here, &small_phantom().planning), Some(&here)).assert().success();
            let told: Value = serde_json::from_slice(&run.get_output().stdout).unwrap();
            let partial = told["warnings"].as_array().unwrap().iter().find(|w| w["code"] == "bones-auto-partial");
            assert!(partial.unwrap()["message"].as_str().unwrap().contains("hyoid"), "{told}");
        }
        let made = read_labels(here.join(&kept(&here)[1]), None).unwrap().value;
        assert!(made.names.values().any(|n| n == "mandible") && made.names.values().all(|n| n != "hyoid"));
    }

    #[test]
    fn dicom_is_given_as_nifti() {
        let here = stand_in("dicom");
        on_path(skeleton(&here, dicom_planning()), Some(&here)).assert().success();
        let all = runs(&here);
        assert!(all.len() == 3 && all[0].contains("/planning.nii.gz -o "), "{all:?}");
        let files = kept(&here);
        assert_eq!(files.len(), 2, "no working folder stays");
        // What a killed run leaves goes with the next.
        files.iter().for_each(|f| fs::remove_file(here.join(f)).unwrap());
        let left = here.join(format!("{}_work/parts", files[1].trim_end_matches(".nii.gz")));
        fs::create_dir_all(&left).unwrap();
        fs::write(left.join("total.nii.gz"), "half").unwrap();
        on_path(skeleton(&here, dicom_planning()), Some(&here)).assert().success();
        assert_eq!(kept(&here), files);
    }
}

/// The phantom's bones where they truly lie in the fraction, on its grid.
fn fraction_labels() -> &'static Path {
    static MADE: OnceLock<PathBuf> = OnceLock::new();
    MADE.get_or_init(make_fraction_labels)
}

fn make_fraction_labels() -> PathBuf {
    let f = small_phantom();
    let out = folder().join("fraction_bones.nii.gz");
    let truth = f.planning.with_file_name("true_planning_to_fraction.nii.gz");
    let mut warp = aventail();
    warp.args(["warp", "--from", "planning", "--to", "fraction", "--kind", "labels", "--field"]).arg(truth);
    warp.arg("--input").arg(&f.bones).arg("--grid").arg(&f.fraction).arg("--out").arg(&out).assert().success();
    out
}

#[test]
fn labels_of_both_scans_place_the_bones_without_an_image() {
    let labels = fraction_labels();
    let run = Register::quick("by_labels").with("--fraction-bones", labels).with("--fit", "labels");
    run.command().assert().success();
    let report: serde_json::Value = serde_json::from_slice(&fs::read(run.out.join("report.json")).unwrap()).unwrap();
    let given = |b: &&serde_json::Value| b["determined_by"] == "given";
    let bones = report["bones"].as_array().unwrap();
    assert!(bones.iter().filter(given).count() > 25, "{}", bones.iter().filter(given).count());
    assert!(report["inputs"].as_array().unwrap().iter().any(|i| i["role"] == "fraction-bones"));
    let read = |path: &Path| -> serde_json::Value { serde_json::from_slice(&fs::read(path).unwrap()).unwrap() };
    let truth = read(&small_phantom().planning.with_file_name("true_bone_transforms.json"));
    let found = read(&run.out.join("bone_transforms.json"));
    let matrix = |m: &serde_json::Value| nalgebra::Matrix4::from_fn(|r, c| m[r][c].as_f64().unwrap());
    let map = io::read_labels(&small_phantom().bones, None).unwrap().value;
    let grid = map.volume.grid();
    let mut errors = Vec::new();
    let placed = bones.iter().filter(given).map(|b| b["name"].as_str().unwrap());
    for name in placed {
        let label = map.names.iter().find(|(_, n)| *n == name).map(|(l, _)| *l).unwrap();
        let own: Vec<usize> = (0..grid.len()).filter(|&l| map.volume.data()[l] == label).collect();
        let [a, b] = [&truth[name], &found[name]].map(matrix);
        let square = |l: &usize| {
            let x = grid.centre(grid.voxel(*l));
            (a.transform_point(&x) - b.transform_point(&x)).norm_squared()
        };
        errors.push((own.iter().map(square).sum::<f64>() / own.len() as f64).sqrt());
    }
    errors.sort_by(f64::total_cmp);
    let middle = errors[errors.len() / 2];
    // Voxels of 9 mm: labels of both scans are staircases of their own, of which thin bones have few steps.
    println!("bones by labels alone, middle {middle:.2} mm, worst {:.2}", errors[errors.len() - 1]);
    assert!(middle < 3.0, "{errors:?}");
    let again = folder().join("by_labels_again");
    let config = run.out.join("report.json");
    aventail().args(["register", "-q", "--config"]).arg(config).arg("--out").arg(&again).assert().success();
    let name = "planning_to_fraction.nii.gz";
    assert!(fs::read(run.out.join(name)).unwrap() == fs::read(again.join(name)).unwrap(), "labels are an input");
}

#[test]
fn labels_that_name_no_bone_of_planning_are_refused() {
    let mut map = io::read_labels(fraction_labels(), None).unwrap().value;
    map.names.values_mut().for_each(|name| *name = format!("left_out_{name}"));
    let path = folder().join("unknown.nii.gz");
    io::write_labels(&path, &map, &io::WriteOptions::default()).unwrap();
    let run = Register::quick("unknown").with("--fraction-bones", &path);
    let told = run.command().assert().code(4).get_output().stderr.clone();
    let told = String::from_utf8(told).unwrap();
    assert!(told.contains("no bone of the skeleton has labels in both scans"), "{told}");
    let run = Register::quick("fit_alone").with("--fit", "labels");
    run.command().assert().code(2);
}
