//! Results beside a scan.

use super::super::like::{CarriedDose, Like};
use super::make::*;
use crate::io::{read_image, read_label_map};
use crate::volume::LabelMap;
use dicom_core::VR;
use dicom_dictionary_std::tags;

#[test]
fn a_result_beside_the_scan_of_another_patient_is_refused() {
    let own = series(|_, _| {});
    let other = series(|_, set| put(set, tags::PATIENT_ID, VR::LO, "8"));
    let out = tempfile::tempdir().unwrap();
    let ct = read_image(own.path()).unwrap().value;
    let [same, strange] = [own.path(), other.path()].map(|path| Like::read(path).unwrap());
    let image = |like: &Like, name: &str| like.image(&out.path().join(name), &ct, Some(own.path()));
    image(&same, "a").unwrap();
    let error = image(&strange, "b").unwrap_err();
    assert!(error.exit_code() == 4 && error.to_string().contains("another patient (\"7\")"), "{error}");
    assert!(!out.path().join("b").exists());
    let dose = write(out.path(), "RD.dcm", &dose("1.5.60", &[0.0, 4.0, 8.0], |n| n as u16));
    let volume = read_image(&dose).unwrap().value;
    let file = out.path().join("c.dcm");
    let error = strange.dose(&file, &volume, CarriedDose::Dose, [&[&dose], &[]]).unwrap_err();
    assert!(error.to_string().contains("another patient") && !file.exists(), "{error}");
    same.dose(&file, &volume, CarriedDose::Dose, [&[&dose], &[]]).unwrap();
    // A deviation is no dose to any reader, and each object of a dose is its own.
    let objects = [CarriedDose::Dose, CarriedDose::Deviation, CarriedDose::Percentile(5), CarriedDose::Percentile(95)]
        .map(|what| {
            same.dose(&file, &volume, what, [&[&dose], &[]]).unwrap();
            let object = dicom_object::open_file(&file).unwrap();
            assert_eq!(read_image(&file).is_err(), what == CarriedDose::Deviation, "{what:?}");
            let text = |tag| object.element(tag).unwrap().to_str().unwrap().trim().to_owned();
            assert_eq!(text(tags::DOSE_TYPE), if what == CarriedDose::Deviation { "ERROR" } else { "PHYSICAL" });
            let words = [tags::SERIES_DESCRIPTION, tags::DOSE_COMMENT].map(text);
            assert!(words.iter().all(|words| words.len() <= 64), "{words:?}");
            [tags::SOP_INSTANCE_UID, tags::SERIES_INSTANCE_UID, tags::SERIES_NUMBER].map(text)
        });
    for n in 0..3 {
        let own: std::collections::BTreeSet<&String> = objects.iter().map(|object| &object[n]).collect();
        assert_eq!(own.len(), 4, "{objects:?}");
    }
    assert!(strange.field(&file, &ct.map(|_| [0.0; 3]), &same).is_err());
    // Labels that come from a segmentation tell whose they are.
    let labels = LabelMap { volume: ct.map(|hu| u16::from(*hu > 1500.0)), names: [(1, "a".to_owned())].into() };
    let seg = out.path().join("seg.dcm");
    same.labels(&seg, &labels, own.path()).unwrap();
    let read = read_label_map(&seg, None).unwrap().value;
    assert!(strange.labels(&file, &read, &seg).unwrap_err().to_string().contains("another patient"));
    same.labels(&file, &read, &seg).unwrap();
}
