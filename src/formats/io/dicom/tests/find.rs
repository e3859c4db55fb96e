//! Listing folders.

use super::super::{find, summary};
use super::make::*;
use dicom_core::VR;
use dicom_dictionary_std::tags;

fn folder() -> tempfile::TempDir {
    let dir = series(|_, _| ());
    std::fs::create_dir(dir.path().join("rt")).unwrap();
    let rt = dir.path().join("rt");
    let contour = ("CLOSED_PLANAR", square(2.0, 33.0));
    write(&rt, "rs", &structure_set(&[Roi { name: "mandible", contours: vec![contour] }]));
    write(&rt, "rd", &dose("1.5.60", &[0.0, 4.0, 8.0], |n| n as u16));
    std::fs::write(rt.join("readme.txt"), "text").unwrap();
    let whole = std::fs::read(rt.join("rd")).unwrap();
    std::fs::write(rt.join("broken"), &whole[..500]).unwrap();
    dir
}

#[test]
fn a_folder_is_listed_by_series_with_what_is_no_dicom() {
    let dir = folder();
    let found = find(&[dir.path()]).unwrap();
    assert_eq!((found.objects.len(), found.others.len(), found.damaged.len()), (8, 1, 1));
    let words: Vec<String> = found.groups().iter().map(|g| g.words()).collect();
    assert!(words[0].starts_with("series 2: CT of 2026-01-03") && words[0].ends_with("6 slices"), "{words:?}");
    assert_eq!(words.len(), 3);
    assert!(find(&[dir.path().join("none")]).is_err());
}

#[test]
fn the_summary_tells_what_refers_to_what_and_hides_names() {
    let dir = folder();
    let told = summary(dir.path(), false).unwrap();
    let text = told.to_string();
    for word in [
        "Müller^Jürgen",
        "1950-06-07",
        "6 slices, 5 x 4 x 6, 1.5 x 2 x 3 mm",
        "1 structure,",
        "refers to entry 1",
        "1 other file\n",
        "PLAN PHYSICAL GY",
    ] {
        assert!(text.contains(word), "{word}: {text}");
    }
    assert!(text.contains("note: its plan is not here"), "the plan of the dose: {text}");
    let entry = told.entries.iter().find(|e| e.modality == "RTSTRUCT").unwrap();
    assert_eq!((entry.frame.as_str(), &entry.refers_to, entry.description.as_str()), ("A", &vec![1], "bones"));
    let hidden = summary(dir.path(), true).unwrap();
    let json = serde_json::to_string(&hidden).unwrap();
    for secret in ["Müller", "19500607", "1950-06-07", "\"7\""] {
        assert!(!hidden.to_string().contains(secret) && !json.contains(secret), "{secret}: {json}");
    }
    let dir = series(|k, set| {
        let z = 30.0 + 3.0 * k as f64 + if k > 2 { 3.0 } else { 0.0 };
        put(set, tags::IMAGE_POSITION_PATIENT, VR::DS, &list(&[0.0, 0.0, z]));
    });
    let text = summary(dir.path(), false).unwrap().to_string();
    assert!(text.contains("problem: a slice is missing between z = 36.00 mm and z = 42.00 mm"), "{text}");
}
