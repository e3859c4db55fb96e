//! From a planning system and back: the phantom as DICOM, and what a registration of it writes as DICOM.

use crate::support::{aventail, folder, quick_settings};
use aventail::io::dicom::registration::{read_deformable, read_rigid};
use aventail::io::dicom::{read_dose, read_series, read_structure_set};
use aventail::io::{read_contours, read_field, read_image};
use aventail::volume::Volume;
use std::path::{Path, PathBuf};
use std::sync::OnceLock;

/// The phantom with its DICOM set.
fn phantom() -> &'static Path {
    static OUT: OnceLock<PathBuf> = OnceLock::new();
    OUT.get_or_init(|| {
        let out = folder().join("phantom");
        aventail().args(["phantom", "--dicom", "--spacing", "9x9x9", "--out"]).arg(&out).assert().success();
        out
    })
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
    let (dicom, out) = (phantom().join("dicom"), folder().join("day"));
    let mut run = aventail();
    run.arg("register").arg("--config").arg(quick_settings()).arg("--planning").arg(dicom.join("planning"));
    run.arg("--bones").arg(phantom().join("bones.nii.gz")).arg("--fraction").arg(dicom.join("fraction"));
    run.arg("--structures").arg(dicom.join("planning/RS.dcm")).arg("--dose").arg(dicom.join("planning/RD.dcm"));
    run.args(["--dicom", "--quiet", "--out"]).arg(&out).assert().success();
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
    assert!(said.contains("planning_ct.nii.gz") && said.contains("--dicom needs DICOM"), "{said}");
}
