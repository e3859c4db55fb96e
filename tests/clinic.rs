//! From a planning system and back: the phantom as DICOM, and what a registration of it writes as DICOM.

#![expect(clippy::unwrap_used, reason = "a test that cannot read what it wrote fails")]

use crate::support::{aventail, copy, dicom_phantom as phantom, files_below, folder, near, quick_settings};
use aventail::field::{Chain, InvertOptions, Link, Motion, resample_contours};
use aventail::io::dicom::registration::{read_deformable, read_rigid};
use aventail::io::dicom::{read_dose, read_series, read_structure_set};
use aventail::io::{
    Stored, WriteOptions, read_bone_transforms, read_contours, read_field, read_image, read_labels, write_image,
};
use aventail::volume::contour::Polygon;
use aventail::volume::{LabelMap, Volume};
use nalgebra::{Vector2, Vector3};
use std::path::{Path, PathBuf};
use std::sync::OnceLock;

/// A registration of the first fraction from DICOM folders, given back as DICOM.
fn day() -> &'static Path {
    static OUT: OnceLock<PathBuf> = OnceLock::new();
    OUT.get_or_init(|| {
        let (dicom, out) = (phantom().join("dicom"), folder().join("day"));
        let mut run = aventail();
        run.arg("register").arg("--config").arg(quick_settings()).arg("--planning").arg(dicom.join("planning"));
        run.arg("--bones").arg(phantom().join("bones.nii.gz")).arg("--fraction").arg(dicom.join("fraction"));
        run.arg("--structures").arg(dicom.join("planning/RS.dcm")).arg("--dose").arg(dicom.join("planning/RD.dcm"));
        run.args(["--dicom", "--quiet", "--start", &near(), "--out"]).arg(&out).assert().success();
        out
    })
}

/// A registration of planning and fraction from other files, with these options, near its motion.
fn register(name: &str, settings: &Path, scans: [&Path; 2], more: &[&str]) -> PathBuf {
    searched(name, settings, scans, &[&["--start", &near()], more].concat())
}

/// The same wherever the options let it begin.
fn searched(name: &str, settings: &Path, [planning, fraction]: [&Path; 2], more: &[&str]) -> PathBuf {
    let out = folder().join(name);
    let mut run = aventail();
    run.arg("register").arg("--config").arg(settings).args(more).args(["--quiet", "--out"]).arg(&out);
    run.arg("--planning").arg(planning).arg("--fraction").arg(fraction);
    run.arg("--bones").arg(phantom().join("bones.nii.gz")).assert().success();
    out
}

/// How far the bones of two runs lie apart at most, mm, on a sphere of 100 mm around the middle of the phantom.
fn bones_apart(a: &Path, b: &Path) -> f64 {
    let read = |out: &Path| read_bone_transforms(out.join("bone_transforms.json")).unwrap();
    let (a, b) = (read(a), read(b));
    assert!(!a.is_empty() && a.keys().eq(b.keys()));
    let middle = read_image(phantom().join("planning_ct.nii.gz")).unwrap().value;
    let size = middle.grid().size().map(|n| n as f64 / 2.0);
    let middle = middle.grid().world(&Vector3::from(size));
    let sides = (0..3).flat_map(|a| [-100.0, 100.0].map(|d| Vector3::ith(a, d)));
    let points: Vec<_> = sides.map(|s| middle + s).collect();
    let apart = |name: &String| points.iter().map(|p| (a[name] * p - b[name] * p).norm()).fold(0.0, f64::max);
    a.keys().map(apart).fold(0.0, f64::max)
}

/// Runs a command that must be refused with this exit code; what it says.
fn refused(code: i32, words: &[&str], paths: &[(&str, &Path)]) -> String {
    let mut run = aventail();
    run.args(words);
    for (option, path) in paths {
        match option.strip_suffix('=') {
            Some(head) => run.arg("--field").arg(format!("{head}={}", path.display())),
            None => run.arg(option).arg(path),
        };
    }
    let done = run.assert().code(code);
    String::from_utf8_lossy(&done.get_output().stderr).into_owned()
}

/// Runs a command; what it prints.
fn done(words: &[&str], paths: &[(&str, &Path)]) -> String {
    let mut run = aventail();
    run.args(words);
    paths.iter().for_each(|(option, path)| _ = run.arg(option).arg(path));
    let done = run.assert().success();
    String::from_utf8_lossy(&done.get_output().stdout).into_owned()
}

const TO_FRACTION: [&str; 6] = ["warp", "--quiet", "--from", "planning", "--to", "fraction"];
const TO_PLANNING: [&str; 6] = ["warp", "--quiet", "--from", "fraction", "--to", "planning"];

/// Distance of a point to an outline, mm.
fn to_outline(p: [f64; 2], outline: &[[f64; 2]]) -> f64 {
    let p = Vector2::from(p);
    let ends = outline.iter().zip(outline.iter().cycle().skip(1));
    let each = ends.map(|(a, b)| {
        let (a, b) = (Vector2::from(*a), Vector2::from(*b));
        let along = ((p - a).dot(&(b - a)) / (b - a).norm_squared().max(1e-12)).clamp(0.0, 1.0);
        (p - a - (b - a) * along).norm()
    });
    each.fold(f64::MAX, f64::min)
}

fn greatest_difference(a: &Volume<f32>, b: &Volume<f32>) -> f32 {
    assert!(a.grid().matches(b.grid(), 1e-3), "{:?} {:?}", a.grid(), b.grid());
    a.data().iter().zip(b.data()).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max)
}

fn field_difference(a: &Volume<[f32; 3]>, b: &Volume<[f32; 3]>) -> f32 {
    assert!(a.grid().matches(b.grid(), 1e-3), "{:?} {:?}", a.grid(), b.grid());
    a.data().iter().flatten().zip(b.data().iter().flatten()).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max)
}

#[test]
fn the_phantom_as_dicom_is_the_phantom() {
    let (out, dicom) = (phantom(), phantom().join("dicom"));
    for (series, image) in
        [("planning", "planning_ct"), ("fraction", "fraction_ct"), ("fraction_2", "fraction_2/fraction_ct")]
    {
        let (ct, _) = read_series(dicom.join(series)).unwrap().value;
        let expected = read_image(out.join(format!("{image}.nii.gz"))).unwrap().value;
        assert!(greatest_difference(&ct, &expected) < 0.01, "{series}");
    }
    let dose = read_dose(dicom.join("planning")).unwrap().value;
    let expected = read_image(out.join("dose.nii.gz")).unwrap().value;
    assert!(greatest_difference(&dose.volume, &expected) < 1e-5);
    let set = read_structure_set(dicom.join("planning")).unwrap();
    let (contours, _) = read_contours(out.join("contours.json")).unwrap();
    assert_eq!(
        set.rois.iter().map(|r| r.interpreted_type.as_str()).collect::<Vec<_>>()[..3],
        ["EXTERNAL", "CTV", "PTV"]
    );
    for (a, b) in set.contours.structures.iter().zip(&contours.structures) {
        assert_eq!((&a.name, a.colour), (&b.name, b.colour));
        assert!((a.volume(9.0) / b.volume(9.0) - 1.0).abs() < 1e-4, "{}", a.name);
    }
    let (_, planning) = read_series(dicom.join("planning")).unwrap().value;
    let (_, fraction) = read_series(dicom.join("fraction")).unwrap().value;
    let truth = read_deformable(dicom.join("registration/fraction.dcm")).unwrap();
    assert_eq!((&truth.from, &truth.to), (&planning.frame_of_reference, &fraction.frame_of_reference));
    let expected = read_field(out.join("true_planning_to_fraction.nii.gz")).unwrap().value;
    assert!(field_difference(&truth.displacement, &expected) < 1e-3);
}

#[test]
fn a_registration_goes_back_as_dicom() {
    let (dicom, out) = (phantom().join("dicom"), day());
    let (_, planning) = read_series(dicom.join("planning")).unwrap().value;
    let (_, fraction) = read_series(dicom.join("fraction")).unwrap().value;
    let (ct, series) = read_series(out.join("dicom/ct")).unwrap().value;
    let expected = read_image(out.join("planning_on_fraction.nii.gz")).unwrap().value;
    assert!(greatest_difference(&ct, &expected) < 0.01);
    assert_eq!((&series.patient, &series.study.uid), (&fraction.patient, &fraction.study.uid));
    assert_eq!(series.frame_of_reference, fraction.frame_of_reference);
    assert_ne!(series.uid, fraction.uid);
    let set = read_structure_set(out.join("dicom/RS.dcm")).unwrap();
    assert!(set.referenced_series.contains(&fraction.uid) && set.frame_of_reference == fraction.frame_of_reference);
    let before = read_structure_set(dicom.join("planning")).unwrap();
    for (a, b) in before.rois.iter().zip(&set.rois) {
        assert_eq!(
            (&a.name, a.number, &a.interpreted_type, a.colour),
            (&b.name, b.number, &b.interpreted_type, b.colour)
        );
    }
    let dose = read_dose(out.join("dicom/RD.dcm")).unwrap().value;
    assert_eq!(dose.series.frame_of_reference, fraction.frame_of_reference);
    assert_eq!(dose.plans, read_dose(dicom.join("planning")).unwrap().value.plans);
    let frames = [&planning.frame_of_reference, &fraction.frame_of_reference];
    for (name, [from, to]) in [("planning_to_fraction", frames), ("fraction_to_planning", [frames[1], frames[0]])] {
        let field = read_deformable(out.join(format!("dicom/REG_{name}.dcm"))).unwrap();
        assert_eq!([&field.from, &field.to], [from, to], "{name}");
        let expected = read_field(out.join(format!("{name}.nii.gz"))).unwrap().value;
        assert!(field_difference(&field.displacement, &expected) < 1e-3, "{name}");
    }
    let couch = read_rigid(out.join("dicom/REG_couch.dcm")).unwrap();
    assert_eq!([&couch[0].from, &couch[0].to], frames);
}

#[test]
fn a_set_without_fault_is_listed_without_a_problem() {
    let run = aventail().arg("inspect").arg(phantom().join("dicom")).assert().success();
    let text = String::from_utf8_lossy(&run.get_output().stdout).into_owned();
    assert!(text.contains("REG") && text.contains("RTSTRUCT") && !text.contains("problem"), "{text}");
}

#[test]
fn a_registration_alone_is_listed_with_the_frames_that_it_joins() {
    let [planning, fraction] = ["planning", "fraction"]
        .map(|name| read_series(phantom().join("dicom").join(name)).unwrap().value.1.frame_of_reference);
    let shown = |name: &str| done(&["inspect"], &[("--anonymous", day().join("dicom").join(name).as_path())]);
    let couch = shown("REG_couch.dcm");
    let rigid = format!("points of frame B ({planning}) go to frame A ({fraction}), LPS mm, by");
    for words in ["rigid registration, frame B to A", &rigid, "1.000000", "patient hidden"] {
        assert!(couch.contains(words), "{words}: {couch}");
    }
    let field = shown("REG_fraction_to_planning.dcm");
    let goes = format!("points of frame A ({fraction}) go to frame B ({planning})");
    assert!(field.contains("deformable registration, frame A to B") && field.contains(&goes), "{field}");
}

/// An image carried by a registration names the series it was made of, of another frame of reference: once told as a problem.
#[test]
fn a_series_carried_by_registration_is_listed_without_a_problem() {
    let all = folder().join("carried");
    for name in ["planning", "fraction"] {
        copy(&phantom().join("dicom").join(name), &all.join(name));
    }
    let (push, out) = (day().join("dicom/REG_planning_to_fraction.dcm"), all.join("on_planning"));
    let (planning, fraction) = (all.join("planning"), all.join("fraction"));
    let files: [(&str, &Path); 4] =
        [("--field", &push), ("--input", &fraction), ("--dicom-like", &planning), ("--out", &out)];
    done(&[&TO_PLANNING[..], &["--kind", "image"]].concat(), &files);
    let shown = done(&["inspect"], &[("--anonymous", all.as_path())]);
    assert!(shown.contains("of another frame of reference") && !shown.contains("problem"), "{shown}");
}

#[test]
fn a_folder_of_series_images_and_a_run_shows_all_of_them() {
    let mixed = folder().join("mixed");
    copy(&phantom().join("dicom/planning"), &mixed.join("series"));
    copy(day(), &mixed.join("day"));
    std::fs::copy(phantom().join("bones.nii.gz"), mixed.join("bones.nii.gz")).unwrap();
    let shown = done(&["inspect"], &[("--anonymous", mixed.as_path())]);
    let at = |words: &str| shown.find(words).unwrap_or_else(|| panic!("{words}: {shown}"));
    assert!(at("as its report says") < at("slices, ") && at("slices, ") < at("label map, "), "{shown}");
    // What the run wrote is told with the run alone.
    assert!(!shown.contains("REG") && shown.contains("RTSTRUCT"), "{shown}");
    let images = folder().join("images");
    std::fs::create_dir_all(&images).unwrap();
    for name in ["planning_ct.nii.gz", "bones.nii.gz"] {
        std::fs::copy(phantom().join(name), images.join(name)).unwrap();
    }
    let shown = done(&["inspect"], &[("--anonymous", images.as_path())]);
    assert!(shown.contains("label map, ") && shown.contains("planning_ct.nii.gz lies on the grid of"), "{shown}");
}

#[test]
fn the_report_says_whose_series_it_read_unless_that_is_left_out() {
    let report = |out: &Path| -> serde_json::Value {
        serde_json::from_slice(&std::fs::read(out.join("report.json")).unwrap()).unwrap()
    };
    let own = report(day());
    let about = |role: &str| {
        let inputs = own["inputs"].as_array().unwrap();
        inputs.iter().find(|i| i["role"] == role).unwrap()["about"].clone()
    };
    let series = read_series(phantom().join("dicom/fraction")).unwrap().value.1;
    assert_eq!(about("fraction")["series"], series.uid.as_str());
    assert_eq!(about("fraction")["patient"]["id"], series.patient.id.as_str());
    assert!(!series.patient.id.is_empty() && about("bones").is_null(), "labels are a plain file");
    let page = std::fs::read_to_string(day().join("report.html")).unwrap();
    assert!(page.contains(&format!("number {}", series.patient.id)));
    let text = std::fs::read_to_string(anonymous().join("report.json")).unwrap();
    for word in [&series.patient.id, &series.patient.name] {
        assert!(!text.contains(&format!("\"{word}\"")), "{word}");
    }
    assert!(text.contains(&series.uid));
}

/// A run from DICOM that is given back with structures and dose.
fn given_back(name: &str, settings: &Path, more: &[&str]) -> PathBuf {
    let planning = phantom().join("dicom/planning");
    let [set, dose] = ["RS.dcm", "RD.dcm"].map(|file| planning.join(file).display().to_string());
    let words = [&["--dicom", "--structures", &set, "--dose", &dose], more].concat();
    register(name, settings, [&planning, &phantom().join("dicom/fraction")], &words)
}

/// One that keeps the patient's name to itself.
fn anonymous() -> &'static Path {
    static OUT: OnceLock<PathBuf> = OnceLock::new();
    OUT.get_or_init(|| given_back("anonymous", quick_settings(), &["--anonymous"]))
}

#[test]
fn no_object_of_an_anonymous_run_tells_the_patient() {
    let out = anonymous();
    let named = read_series(phantom().join("dicom/fraction")).unwrap().value.1.patient;
    assert!(!named.id.is_empty() && !named.name.is_empty());
    let (_, series) = read_series(out.join("dicom/ct")).unwrap().value;
    assert_eq!((series.patient.id.as_str(), series.patient.name.as_str()), ("", ""));
    let files = files_below(&out.join("dicom"));
    assert!(files.len() > 6 && files.iter().any(|name| name.ends_with("RS.dcm")), "{files:?}");
    for name in files {
        let bytes = std::fs::read(out.join("dicom").join(&name)).unwrap();
        for word in [&named.id, &named.name] {
            assert!(!bytes.windows(word.len()).any(|part| part == word.as_bytes()), "{name} tells {word}");
        }
    }
}

#[test]
fn other_settings_make_other_objects() {
    let settings = folder().join("scattered.toml");
    let text = std::fs::read_to_string(quick_settings()).unwrap();
    std::fs::write(&settings, format!("resampling = \"five-tetrahedra\"\n{text}")).unwrap();
    let other = given_back("scattered", &settings, &[]);
    let [one, other] = [day(), &other].map(|out| read_series(out.join("dicom/ct")).unwrap().value);
    assert_ne!(one.0.data(), other.0.data(), "the settings change the image");
    assert_ne!(one.1.uid, other.1.uid);
    assert!(one.1.slices.iter().zip(&other.1.slices).all(|(a, b)| a.uid != b.uid));
}

#[test]
fn what_is_no_dicom_cannot_go_back_as_dicom() {
    let file = |name: &str| phantom().join(name);
    let mut run = aventail();
    run.arg("register").arg("--planning").arg(file("planning_ct.nii.gz")).arg("--bones").arg(file("bones.nii.gz"));
    run.arg("--fraction")
        .arg(file("fraction_ct.nii.gz"))
        .args(["--dicom", "--quiet", "--out"])
        .arg(folder().join("none"));
    let done = run.assert().code(2);
    let said = String::from_utf8_lossy(&done.get_output().stderr).into_owned();
    assert!(said.contains("planning_ct.nii.gz") && said.contains("DICOM results need DICOM input"), "{said}");
}

#[test]
fn a_run_from_dicom_is_the_run_from_nifti() {
    let (day, dicom) = (day(), phantom().join("dicom"));
    // NRRD, since NIfTI keeps positions as 32-bit floats only.
    let scans = ["planning", "fraction"].map(|name| {
        let (ct, _) = read_series(dicom.join(name)).unwrap().value;
        let path = folder().join(format!("{name}.nrrd"));
        write_image(&path, &ct, Stored::Int16, &WriteOptions::default()).unwrap();
        path
    });
    let nifti = register("day_nifti", quick_settings(), scans.each_ref().map(PathBuf::as_path), &[]);
    let apart = bones_apart(day, &nifti);
    assert!(apart < 1e-6, "{apart}");
    let set = read_structure_set(dicom.join("planning/RS.dcm")).unwrap();
    let link = |from: &str, to: &str| {
        let field = read_field(nifti.join(format!("{from}_to_{to}.nii.gz"))).unwrap().value;
        [Link { name: "it".into(), from: from.into(), to: to.into(), motion: Motion::Field(Box::new(field)) }]
    };
    let (push, back) = (link("planning", "fraction"), link("fraction", "planning"));
    let forward = Chain::between(&push, "planning", "fraction", &InvertOptions::default()).unwrap();
    let back = Chain::between(&back, "fraction", "planning", &InvertOptions::default()).unwrap();
    let (expected, _) = resample_contours(&set.contours, &forward, &back, back.grid().unwrap());
    let carried = read_structure_set(day.join("dicom/RS.dcm")).unwrap().contours;
    for old in &expected.structures {
        let new = carried.structures.iter().find(|s| s.name == old.name).unwrap();
        let at = |height: f64| old.polygons.iter().filter(move |p| (p.height - height).abs() < 0.01);
        let off = |p: &Polygon, v: &[f64; 2]| at(p.height).map(|o| to_outline(*v, &o.points)).fold(f64::MAX, f64::min);
        let worst = new.polygons.iter().flat_map(|p| p.points.iter().map(move |v| off(p, v))).fold(0.0, f64::max);
        assert!(worst < 0.01, "{}: {worst} mm", old.name);
        assert!((old.volume(9.0) / new.volume(9.0) - 1.0).abs() < 1e-3, "{}", old.name);
    }
    // What `warp` makes of the same structures is the same file but for its names.
    let (warped, pull) = (folder().join("warped.json"), nifti.join("fraction_to_planning.nii.gz"));
    done(
        &["warp", "--quiet", "--from", "planning", "--to", "fraction"],
        &[
            ("--field", &pull),
            ("--input", &dicom.join("planning/RS.dcm")),
            ("--grid", &nifti.join("planning_on_fraction.nii.gz")),
            ("--out", &warped),
        ],
    );
    let warped = read_contours(&warped).unwrap().0;
    for old in &warped.structures {
        let new = carried.structures.iter().find(|s| s.name == old.name).unwrap();
        let at = |height: f64| old.polygons.iter().filter(move |p| (p.height - height).abs() < 0.01);
        let off = |p: &Polygon, v: &[f64; 2]| at(p.height).map(|o| to_outline(*v, &o.points)).fold(f64::MAX, f64::min);
        let worst = new.polygons.iter().flat_map(|p| p.points.iter().map(move |v| off(p, v))).fold(0.0, f64::max);
        println!("{}: {worst} mm from warp's", old.name);
        assert!(worst < 0.01, "{}: {worst} mm from warp's", old.name);
    }
    let warped = folder().join("day_dose.nii.gz");
    let (plan, given) = (dicom.join("planning/RD.dcm"), day.join("dicom/RD.dcm"));
    let pull = day.join("fraction_to_planning.nii.gz");
    done(
        &["dose", "map", "--to", "fraction"],
        &[("--fraction-to-planning", &pull), ("--dose", &plan), ("--grid", &given), ("--out", &warped)],
    );
    let (dose, expected) = (read_dose(&given).unwrap().value.volume, read_image(&warped).unwrap().value);
    // Both are 32-bit floats, of displacements that were interpolated in another order.
    let (peak, off) = (dose.extremes()[1], greatest_difference(&dose, &expected));
    assert!(peak > 10.0 && off < 1e-5 * peak, "{off} of {peak} Gy");
}

#[test]
fn a_registration_in_dicom_is_a_field() {
    let (day, dicom) = (day(), phantom().join("dicom"));
    let (pull, nifti) = (day.join("dicom/REG_fraction_to_planning.dcm"), day.join("fraction_to_planning.nii.gz"));
    let planning = dicom.join("planning");
    let dose = [&TO_FRACTION[..], &["--kind", "dose"]].concat();
    let image = [&TO_FRACTION[..], &["--kind", "image"]].concat();
    let [a, b] = ["a", "b"].map(|name| folder().join(format!("by_{name}.nii.gz")));
    let plan = planning.join("RD.dcm");
    // The frame of reference of the dose is planning's, so that the field needs no FROM:TO.
    done(&dose, &[("--field", &pull), ("--input", &plan), ("--out", &a)]);
    done(&dose, &[("--field", &nifti), ("--input", &plan), ("--out", &b)]);
    let [a, b] = [a, b].map(|path| read_image(path).unwrap().value);
    assert!(a.extremes()[1] > 10.0 && greatest_difference(&a, &b) < 1e-3);
    let out = folder().join("never.nii.gz");
    let wrong = |head: &str, input: &Path| {
        refused(4, &image, &[(head, pull.as_path()), ("--input", input), ("--out", out.as_path())])
    };
    let said = wrong("planning:fraction=", &planning);
    assert!(said.contains("points the other way"), "{said}");
    let said = wrong("fraction:planning=", &dicom.join("fraction_2"));
    assert!(said.contains("joins the frames of reference"), "{said}");
    // Nobody names its frames.
    let nowhere = phantom().join("planning_ct.nii.gz");
    let said = refused(2, &image, &[("--field", &pull), ("--input", &nowhere), ("--out", &out)]);
    assert!(said.contains("FROM:TO=FILE"), "{said}");
    let scans: [(&str, &Path); 2] = [("--planning", &planning), ("--fraction", &dicom.join("fraction"))];
    let judged = folder().join("judged");
    let all = |option| [&scans[..], &[(option, pull.as_path()), ("--out", judged.as_path())]].concat();
    done(&["evaluate", "--quiet"], &all("--fraction-to-planning"));
    let said = refused(4, &["evaluate", "--quiet"], &all("--planning-to-fraction"));
    assert!(said.contains("points the other way"), "{said}");
}

#[test]
fn results_of_the_fraction_come_back_as_dicom() {
    let (day, dicom) = (day(), phantom().join("dicom"));
    let (planning, fraction) = (dicom.join("planning"), dicom.join("fraction"));
    let (_, own) = read_series(&planning).unwrap().value;
    let (_, other) = read_series(&fraction).unwrap().value;
    let (push, dose) = (day.join("dicom/REG_planning_to_fraction.dcm"), day.join("dicom/RD.dcm"));
    let at = |name: &str| folder().join(name);
    let map = ["dose", "map", "--to", "planning"];
    let out = at("RD_back.dcm");
    let [field, like] = [("--planning-to-fraction", push.as_path()), ("--dicom-like", planning.as_path())];
    let common: [(&str, &Path); 4] = [field, ("--dose", &dose), ("--grid", &planning), ("--out", &out)];
    // The fraction's dose is the planned one, carried; planning's own is calculated.
    let said = done(&map, &[&common[..], &[like]].concat());
    assert!(said.contains("warning (dose-carried)") && said.contains("not calculated"), "{said}");
    let back = read_dose(&out).unwrap().value;
    assert_eq!(back.series.frame_of_reference, own.frame_of_reference);
    assert_eq!((&back.series.patient, &back.series.study.uid), (&own.patient, &own.study.uid));
    assert_eq!(back.plans, read_dose(planning.join("RD.dcm")).unwrap().value.plans);
    // One result is one object, by whatever file of the field; another result is another.
    let copy = at("push_copy.dcm");
    std::fs::copy(&push, &copy).unwrap();
    let again = at("RD_again.dcm");
    let by_copy =
        [("--planning-to-fraction", copy.as_path()), ("--dose", &dose), ("--grid", &planning), ("--out", &again)];
    done(&map, &[&by_copy[..], &[like]].concat());
    assert_eq!(std::fs::read(&out).unwrap(), std::fs::read(&again).unwrap());
    let couch = day.join("dicom/REG_couch.dcm");
    let shifted = at("RD_couch.dcm");
    let by_couch = [("--field", couch.as_path()), ("--input", &dose), ("--out", &shifted), like];
    done(&[&TO_PLANNING[..], &["--kind", "dose"]].concat(), &by_couch);
    assert_ne!(read_dose(&shifted).unwrap().value.series.uid, back.series.uid);
    let plain = at("RD_back.nii.gz");
    let images: [(&str, &Path); 4] = [field, ("--dose", &dose), ("--grid", &planning), ("--out", &plain)];
    done(&map, &images);
    let (calculated, forth) = (planning.join("RD.dcm"), ["dose", "map", "--to", "fraction", "--no-page"]);
    let first =
        |dose: &Path, out: &Path| done(&forth, &[field, ("--dose", dose), ("--grid", &fraction), ("--out", out)]);
    assert!(!first(&calculated, &at("once.nii.gz")).contains("dose-carried"));
    assert!(first(&at("once.nii.gz"), &at("twice.nii.gz")).contains("warning (dose-carried)"));
    assert!(greatest_difference(&back.volume, &read_image(&plain).unwrap().value) < 1e-5);
    let said = refused(2, &map, &common);
    assert!(said.contains("--dicom-like"), "{said}");
    let said = refused(4, &map, &[&common[..], &[("--dicom-like", fraction.as_path())]].concat());
    assert!(said.contains("another frame of reference"), "{said}");
    // Contours, by the inverse of the push field; the fraction's on planning's slices.
    let (set, out) = (day.join("dicom/RS.dcm"), at("RS_back.dcm"));
    done(&TO_PLANNING, &[("--field", &push), ("--input", &set), ("--out", &out), like]);
    let back = read_structure_set(&out).unwrap();
    assert!(back.referenced_series.contains(&own.uid) && back.frame_of_reference == own.frame_of_reference);
    let before = read_structure_set(planning.join("RS.dcm")).unwrap();
    assert!(before.rois.iter().map(|r| (&r.name, r.number)).eq(back.rois.iter().map(|r| (&r.name, r.number))));
    let (old, new) = (before.contours.structures[0].volume(9.0), back.contours.structures[0].volume(9.0));
    assert!(old > 0.0 && (new / old - 1.0).abs() < 0.2, "{old} {new}");
    // An image, by the couch shift alone.
    let (couch, out) = (day.join("dicom/REG_couch.dcm"), at("ct_couch"));
    let image = [&TO_FRACTION[..], &["--kind", "image"]].concat();
    let carried: [(&str, &Path); 3] = [("--field", &couch), ("--input", &planning), ("--dicom-like", &fraction)];
    done(&image, &[&carried[..], &[("--out", &out)]].concat());
    let (moved, series) = read_series(&out).unwrap().value;
    assert_eq!(series.frame_of_reference, other.frame_of_reference);
    let plain = at("ct_couch.nii.gz");
    let images: [(&str, &Path); 4] =
        [("--field", &couch), ("--input", &planning), ("--grid", &fraction), ("--out", &plain)];
    done(&image, &images);
    assert!(greatest_difference(&moved, &read_image(&plain).unwrap().value) < 0.51);
    let (before, _) = read_series(&planning).unwrap().value;
    assert_ne!(before.data(), moved.data());
    let said = refused(2, &image, &[&carried[..], &[("--out", &out)]].concat());
    assert!(said.contains("alone in its folder"), "{said}");
}

/// The other direction of a field is written as an object that readers take for what it is.
#[test]
fn a_chain_is_written_as_a_registration() {
    let (day, dicom) = (day(), phantom().join("dicom"));
    let (planning, fraction) = (dicom.join("planning"), dicom.join("fraction"));
    let push = day.join("dicom/REG_planning_to_fraction.dcm");
    let ends: [(&str, &Path); 2] = [("--dicom-like", &fraction), ("--dicom-to", &planning)];
    // The inverse of the push field, from the fraction to planning.
    let out = folder().join("REG_inverse.dcm");
    done(&TO_PLANNING, &[&[("--field", push.as_path()), ("--out-field", &out)][..], &ends].concat());
    let (_, from) = read_series(&fraction).unwrap().value;
    let (ct, to) = read_series(&planning).unwrap().value;
    // Series numbers tell objects apart that lie in one study.
    let number = |path: &Path| {
        let told: serde_json::Value =
            serde_json::from_str(&done(&["inspect", "--json"], &[("--anonymous", path)])).unwrap();
        told["dicom"][0]["entries"][0]["number"].as_i64().unwrap()
    };
    let others = ["couch", "couch_rotation", "planning_to_fraction", "fraction_to_planning"];
    let others = others.map(|name| number(&day.join(format!("dicom/REG_{name}.dcm"))));
    assert!(!others.contains(&number(&out)), "{others:?}");
    let read = read_deformable(&out).unwrap();
    assert_eq!((&read.from, &read.to), (&from.frame_of_reference, &to.frame_of_reference));
    // The same by another format, on the same grid.
    let plain_file = folder().join("inverse.nii.gz");
    done(&TO_PLANNING, &[("--field", push.as_path()), ("--grid", &fraction), ("--out-field", &plain_file)]);
    let plain = read_field(&plain_file).unwrap().value;
    let most = field_difference(&read.displacement, &plain);
    assert!(most < 1e-4, "{most} mm");
    // It carries planning to the fraction as the other format does.
    let [by_dicom, by_other] = ["by_dicom.nii.gz", "by_other.nii.gz"].map(|name| folder().join(name));
    let image = [&TO_FRACTION[..], &["--kind", "image"]].concat();
    for (field, carried) in [(&out, &by_dicom), (&plain_file, &by_other)] {
        done(&image, &[("--field", field), ("--input", &planning), ("--grid", &fraction), ("--out", carried)]);
    }
    let [a, b] = [by_dicom, by_other].map(|path| read_image(path).unwrap().value);
    assert!(greatest_difference(&a, &b) < 0.1 && a.extremes()[1] > 0.4 * ct.extremes()[1]);

    let field = ("--field", push.as_path());
    let said = refused(2, &TO_PLANNING, &[field, ("--out-field", &out)]);
    assert!(said.contains("--dicom-to"), "{said}");
    let said = refused(2, &TO_PLANNING, &[&[field, ("--out-field", &folder().join("x.nrrd"))][..], &ends].concat());
    assert!(said.contains("written as DICOM"), "{said}");
    // The registration joins other scans than these.
    let ends: [(&str, &Path); 2] = [("--dicom-like", &dicom.join("fraction_2")), ("--dicom-to", &planning)];
    refused(4, &TO_PLANNING, &[&[field, ("--out-field", &folder().join("x.dcm"))][..], &ends].concat());
}

#[test]
fn a_dose_without_a_plan_says_so() {
    let (day, out) = (day(), folder().join("RD_bare.dcm"));
    let dose = [&TO_FRACTION[..], &["--kind", "dose"]].concat();
    let field = day.join("fraction_to_planning.nii.gz");
    let plain = phantom().join("dose.nii.gz");
    let like = phantom().join("dicom/fraction");
    let said = done(&dose, &[("--field", &field), ("--input", &plain), ("--dicom-like", &like), ("--out", &out)]);
    assert!(said.contains("dicom-no-plan"), "{said}");
    assert!(read_dose(&out).unwrap().value.plans.is_empty());
}

#[test]
fn a_fit_begins_where_it_is_told() {
    let couch = day().join("dicom/REG_couch.dcm");
    // Fewer samples leave bones open that lie in a few voxels only.
    let settings = folder().join("bones.toml");
    std::fs::write(&settings, "preset = \"fast\"\nsoft_tissue = \"nearest-bone\"\n[output]\nuncertainty = false\n")
        .unwrap();
    let scans = ["planning", "fraction"].map(|name| phantom().join("dicom").join(name));
    let run = |name: &str, more: &[&str]| searched(name, &settings, scans.each_ref().map(PathBuf::as_path), more);
    let (whole, close) = (run("searched", &[]), run("near", &["--start", couch.to_str().unwrap()]));
    // On voxels of 9 mm the smallest bone is not found to less than this.
    let apart = bones_apart(&whole, &close);
    assert!(apart < 0.2, "{apart} mm");
    assert!(!std::fs::read_to_string(close.join("report.json")).unwrap().contains("start-left"));
    let shift = read_rigid(&couch).unwrap()[0].rigid.translation.vector;
    let far = folder().join("far.txt");
    let [x, y, z] = [shift.x, shift.y, shift.z + 60.0];
    std::fs::write(&far, format!("1 0 0 {x}\n0 1 0 {y}\n0 0 1 {z}\n0 0 0 1\n")).unwrap();
    let found = run("far", &["--start", &format!("{}#lps", far.display())]);
    let said = std::fs::read_to_string(found.join("report.json")).unwrap();
    assert!(said.contains("start-left"), "a start 60 mm off is not told of");
    let apart = bones_apart(&whole, &found);
    assert!(apart < 0.05, "{apart} mm from where the search found them");
    // Repeated, with the space that was given behind the name of the file.
    let again = folder().join("far_again");
    done(&["register", "--quiet"], &[("--config", &found.join("report.json")), ("--out", &again)]);
    assert!(bones_apart(&found, &again) < 1e-12);
    let said = std::fs::read_to_string(again.join("report.json")).unwrap();
    assert!(said.contains("start-left"), "the start of the repeated run is another");
    // It belongs to other scans.
    let strange = phantom().join("dicom/fraction_2");
    let (planning, bones) = (phantom().join("dicom/planning"), phantom().join("bones.nii.gz"));
    let said = refused(
        4,
        &["register", "--quiet"],
        &[
            ("--planning", &planning),
            ("--bones", &bones),
            ("--fraction", &strange),
            ("--start", &couch),
            ("--out", &folder().join("strange")),
        ],
    );
    assert!(said.contains("joins the frames of reference"), "{said}");
}

#[test]
fn labels_go_out_as_a_segmentation_and_come_back_as_bones() {
    let (planning, bones) = (phantom().join("dicom/planning"), phantom().join("bones.nii.gz"));
    let at = |name: &str| folder().join(name);
    let same = at("same.txt");
    std::fs::write(&same, "1 0 0 0\n0 1 0 0\n0 0 1 0\n0 0 0 1\n").unwrap();
    let link = format!("planning:copy={}#lps", same.display());
    let words = ["warp", "--quiet", "--from", "planning", "--to", "copy", "--kind", "labels", "--field", &link];
    let seg = at("SEG.dcm");
    let paths: [(&str, &Path); 3] = [("--input", &bones), ("--dicom-like", &planning), ("--out", &seg)];
    done(&words, &paths);
    let said = refused(2, &words, &[&paths[..2], &[("--out", &at("SEG.nii.gz"))]].concat());
    assert!(said.contains("*.dcm"), "{said}");
    // The same skeleton by the segmentation as by the labels that it was made of.
    let tree = |bones: &Path| done(&["skeleton"], &[("--bones", bones), ("--planning", &planning)]);
    assert_eq!(tree(&seg), tree(&bones));
    assert!(refused(2, &["skeleton"], &[("--bones", &seg)]).contains("where the image ends"));
    // Label maps lie on the same voxels, whether the grid is the series or the NIfTI file of it.
    let expected = read_labels(&bones, None).unwrap().value;
    for grid in [&planning, &phantom().join("planning_ct.nii.gz")] {
        let out = at("merged.nii.gz");
        let seg = seg.to_str().unwrap();
        done(&["labels", "merge", seg], &[("--grid", grid), ("--out", &out)]);
        let merged = read_labels(&out, None).unwrap().value;
        assert!(merged.volume.grid().matches(expected.volume.grid(), 1e-3));
        let name = |map: &LabelMap, n: usize| map.names.get(&map.volume.data()[n]).cloned();
        assert!((0..expected.volume.data().len()).all(|n| name(&merged, n) == name(&expected, n)));
    }
    // What belongs to another scan is refused.
    let strange = phantom().join("dicom/fraction");
    let said = refused(4, &["skeleton"], &[("--bones", &seg), ("--planning", &strange)]);
    assert!(said.contains("another frame of reference"), "{said}");
    let shown = done(&["inspect", seg.to_str().unwrap()], &[]);
    assert!(shown.contains("DICOM Segmentation") && shown.contains("vertebrae_C1"), "{shown}");
}

#[test]
fn a_region_cannot_go_back_as_dicom() {
    let settings = folder().join("region.toml");
    std::fs::write(&settings, "[region]\nlabel = \"mandible\"\n").unwrap();
    let (planning, bones) = (phantom().join("dicom/planning"), phantom().join("bones.nii.gz"));
    let said = refused(
        2,
        &["register", "--quiet", "--dicom"],
        &[
            ("--config", &settings),
            ("--planning", &planning),
            ("--bones", &bones),
            ("--fraction", &phantom().join("dicom/fraction")),
            ("--out", &folder().join("part")),
        ],
    );
    assert!(said.contains("region"), "{said}");
}

/// Gives all DICOM files of a folder one frame of reference.
fn give_frame(from: &Path, to: &Path, uid: &str) {
    std::fs::create_dir_all(to).unwrap();
    for entry in std::fs::read_dir(from).unwrap().flatten() {
        let mut bytes = std::fs::read(entry.path()).unwrap();
        let head = [0x20, 0, 0x52, 0, b'U', b'I'];
        let places: Vec<usize> = (0..bytes.len() - 8).filter(|at| bytes[*at..].starts_with(&head)).collect();
        let of_roi = [0x06, 0x30, 0x24, 0, b'U', b'I'];
        let more = (0..bytes.len() - 8).filter(|at| bytes[*at..].starts_with(&of_roi));
        for at in more.chain(places).collect::<Vec<_>>() {
            let length = usize::from(u16::from_le_bytes([bytes[at + 6], bytes[at + 7]]));
            let value = &mut bytes[at + 8..at + 8 + length];
            value.fill(0);
            value[..uid.len()].copy_from_slice(uid.as_bytes());
        }
        std::fs::write(to.join(entry.file_name()), bytes).unwrap();
    }
}

#[test]
fn scans_that_claim_one_frame_of_reference_are_told_apart() {
    let (dicom, own) = (phantom().join("dicom"), folder().join("one_frame"));
    let [planning, fraction] = ["planning", "fraction"].map(|name| {
        give_frame(&dicom.join(name), &own.join(name), "1.2.3.4");
        own.join(name)
    });
    let run = |name: &str, more: &[&str]| {
        let out = folder().join(name);
        let mut run = aventail();
        run.arg("register").arg("--config").arg(quick_settings()).arg("--planning").arg(&planning);
        run.arg("--bones").arg(phantom().join("bones.nii.gz")).arg("--fraction").arg(&fraction);
        run.arg("--structures").arg(planning.join("RS.dcm")).arg("--dose").arg(planning.join("RD.dcm"));
        run.args(["--dicom", "--start", &near()]).args(more).arg("--out").arg(&out);
        let told = String::from_utf8(run.assert().success().get_output().stderr.clone()).unwrap();
        let report = std::fs::read_to_string(out.join("report.json")).unwrap();
        let said = [told.contains("claim one frame of reference"), report.contains("dicom-one-frame")];
        let set = read_structure_set(out.join("dicom/RS.dcm")).unwrap();
        let series = read_series(out.join("dicom/ct")).unwrap().value.1;
        let couch = read_rigid(out.join("dicom/REG_couch.dcm")).unwrap();
        assert_eq!((couch.len(), couch[0].from.as_str(), &couch[0].to), (1, "1.2.3.4", &series.frame_of_reference));
        assert_eq!(set.frame_of_reference, series.frame_of_reference);
        assert!(read_field(out.join("dicom/REG_fraction_to_planning.dcm")).is_ok());
        (said, set, series)
    };
    let (said, set, series) = run("one_frame_own", &[]);
    assert!(said == [true, true] && series.frame_of_reference != "1.2.3.4");
    assert!(set.referenced_series.contains(&series.uid));
    let scan = read_series(&fraction).unwrap().value.1;
    let (said, set, series) = run("one_frame_same", &["--same-frame"]);
    assert!(said == [false, false] && series.frame_of_reference == "1.2.3.4");
    assert!(set.referenced_series.contains(&scan.uid));
}

#[test]
fn anonymous_objects_have_other_uids() {
    let dose = |out: &Path| read_dose(out.join("dicom/RD.dcm")).unwrap().value;
    let (named, hidden) = (dose(day()), dose(anonymous()));
    assert_eq!(named.volume, hidden.volume);
    assert!(named.uid != hidden.uid && named.series.uid != hidden.series.uid);
    assert!(!named.series.patient.name.is_empty() && hidden.series.patient.name.is_empty());
}
