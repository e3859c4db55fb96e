//! Doses in Gy.

use super::super::{Role, check_frames, read_dose, read_doses};
use super::make::*;
use crate::io::{read_dose as read_any, read_image};
use dicom_core::{DataElement, PrimitiveValue, VR};
use dicom_dictionary_std::tags;

const PLANE: usize = SIZE[0] * SIZE[1];

#[test]
fn planes_ascend_whatever_their_offsets_say() {
    let dir = tempfile::tempdir().unwrap();
    let write = |offsets: &[f64]| write(dir.path(), "d", &dose("1.5.60", offsets, |n| n as u16));
    for offsets in [[0.0, 4.0, 8.0], [30.0, 34.0, 38.0]] {
        let read = read_dose(write(&offsets)).unwrap();
        let volume = &read.value.volume;
        assert_eq!((volume.grid().size(), volume.grid().spacing()), ([5, 4, 3], [1.5, 2.0, 4.0]));
        assert_eq!(volume.grid().origin(), [-10.0, -20.0, 30.0].into());
        assert!((volume.data()[PLANE + 3] - 0.23).abs() < 1e-6);
        assert_eq!((read.value.summation.as_str(), read.value.plans.first().unwrap().as_str()), ("PLAN", "1.6.1"));
        assert!(read.warnings.is_empty());
    }
    for offsets in [[0.0, -4.0, -8.0], [30.0, 26.0, 22.0]] {
        let volume = read_image(write(&offsets)).unwrap().value;
        assert_eq!(volume.grid().origin(), [-10.0, -20.0, 22.0].into());
        assert!(volume.grid().direction().determinant() > 0.9);
        assert!((volume.data()[PLANE + 3] - 0.23).abs() < 1e-6 && (volume.data()[3] - 0.43).abs() < 1e-6);
    }
    for (offsets, word) in [
        (vec![0.0, 4.0, 9.0], "not evenly spaced"),
        (vec![29.0, 33.0, 37.0], "begins with 29"),
        (vec![0.0], "one plane"),
    ] {
        let error = read_dose(write(&offsets)).unwrap_err();
        assert!(error.code() == "dose-planes" && error.to_string().contains(word), "{error}");
    }
}

/// Of a patient who lies with his feet first rows run to the right, and the normal of the slices points down.
#[test]
fn absolute_offsets_are_heights_whatever_way_the_normal_points() {
    let dir = tempfile::tempdir().unwrap();
    for (offsets, lowest, first_is_lowest) in
        [([30.0, 26.0, 22.0], 22.0, false), ([30.0, 34.0, 38.0], 30.0, true), ([0.0, 4.0, 8.0], 22.0, false)]
    {
        let mut set = dose("1.5.60", &offsets, |n| n as u16);
        put(&mut set, tags::IMAGE_ORIENTATION_PATIENT, VR::DS, "-1\\0\\0\\0\\1\\0");
        let volume = read_dose(write(dir.path(), "d", &set)).unwrap().value.volume;
        let height = |k: usize| volume.grid().centre([0, 0, k]).z;
        let (k, z) = (0..3).map(|k| (k, height(k))).min_by(|a, b| a.1.total_cmp(&b.1)).unwrap();
        assert!((z - lowest).abs() < 1e-9, "{offsets:?}: the lowest plane lies at {z} mm");
        let frame = if first_is_lowest { 0 } else { 2 };
        assert!((volume.at([3, 0, k]) - (frame * PLANE + 3) as f32 * 0.01).abs() < 1e-6, "{offsets:?}: another plane");
    }
}

#[test]
fn thirty_two_bits_are_read_and_relative_doses_refused() {
    let dir = tempfile::tempdir().unwrap();
    let mut set = dose("1.5.60", &[0.0, 4.0], |_| 0);
    put_u16(&mut set, tags::BITS_ALLOCATED, 32);
    put_u16(&mut set, tags::BITS_STORED, 32);
    put_u16(&mut set, tags::HIGH_BIT, 31);
    put(&mut set, tags::DOSE_GRID_SCALING, VR::DS, "1e-8");
    // As 16-bit words, the low one first: 4 000 000 000.
    let words = [0x2800u16, 0xee6b].repeat(2 * PLANE);
    set.put(DataElement::new(tags::PIXEL_DATA, VR::OW, PrimitiveValue::U16(words.into())));
    let path = write(dir.path(), "d", &set);
    assert!(read_image(&path).unwrap().value.data().iter().all(|d| (d - 40.0).abs() < 1e-4));
    for (tag, text, word) in [(tags::DOSE_UNITS, "RELATIVE", "RELATIVE"), (tags::DOSE_TYPE, "ERROR", "ERROR")] {
        let mut set = dose("1.5.60", &[0.0, 4.0], |_| 0);
        put(&mut set, tag, VR::CS, text);
        let error = read_image(write(dir.path(), "d", &set)).unwrap_err();
        assert!(error.code() == "dose-units" && error.to_string().contains(word), "{error}");
    }
}

/// A dose of the beam whose number ends the UID.
fn beam(uid: &str, plan: &str, kind: &str) -> Set {
    let number = uid.rsplit('.').next().unwrap();
    let mut set = dose(uid, &[0.0, 4.0], |_| 299 + number.parse::<u16>().unwrap());
    put(&mut set, tags::DOSE_SUMMATION_TYPE, VR::CS, kind);
    referring(&mut set, plan, Some(number));
    set
}

fn referring(set: &mut Set, plan: &str, beam: Option<&str>) {
    let mut item = Set::new_empty();
    put(&mut item, tags::REFERENCED_SOP_INSTANCE_UID, VR::UI, plan);
    if let Some(number) = beam {
        let mut own = Set::new_empty();
        put(&mut own, tags::REFERENCED_BEAM_NUMBER, VR::IS, number);
        let mut group = Set::new_empty();
        put(&mut group, tags::REFERENCED_FRACTION_GROUP_NUMBER, VR::IS, "1");
        put_items(&mut group, tags::REFERENCED_BEAM_SEQUENCE, vec![own]);
        put_items(&mut item, tags::REFERENCED_FRACTION_GROUP_SEQUENCE, vec![group]);
    }
    put_items(set, tags::REFERENCED_RT_PLAN_SEQUENCE, vec![item]);
}

#[test]
fn nothing_is_counted_twice_or_joined() {
    let dir = tempfile::tempdir().unwrap();
    let first = beam("1.5.1", "1.6.1", "BEAM");
    write(dir.path(), "a", &first);
    write(dir.path(), "a (1)", &first);
    let read = read_dose(dir.path()).unwrap();
    assert!(read.value.volume.data().iter().all(|d| (d - 3.0).abs() < 1e-5));
    assert!(read.warnings.iter().any(|w| w.code == "dicom-duplicates"), "{:?}", read.warnings);
    let refused = |word: &str, change: &dyn Fn(&mut Set)| {
        let mut other = beam("1.5.2", "1.6.1", "BEAM");
        change(&mut other);
        write(dir.path(), "a (1)", &other);
        let error = read_dose(dir.path()).unwrap_err();
        assert!(error.code() == "dose-sum" && error.to_string().contains(word), "{word}: {error}");
    };
    refused("one SOP Instance UID", &|s| put(s, tags::SOP_INSTANCE_UID, VR::UI, "1.5.1"));
    refused("do not say of which beam", &|s| referring(s, "1.6.1", None));
    refused("a beam has several doses", &|s| referring(s, "1.6.1", Some("1")));
    refused("several patients", &|s| put(s, tags::PATIENT_ID, VR::LO, "8"));
    refused("several frames of reference", &|s| put(s, tags::FRAME_OF_REFERENCE_UID, VR::UI, "1.88"));
    refused("one program in one way", &|s| put(s, tags::SOFTWARE_VERSIONS, VR::LO, "2"));
    refused("not all doses of single beams", &|s| put(s, tags::DOSE_SUMMATION_TYPE, VR::CS, "FRACTION"));
    refused("the same dose in every voxel", &|s| {
        *s = beam("1.5.1", "1.6.1", "BEAM");
        put(s, tags::SOP_INSTANCE_UID, VR::UI, "1.5.2");
        referring(s, "1.6.1", Some("2"));
    });
    // What is cut off may be a beam.
    write(dir.path(), "a (1)", &beam("1.5.2", "1.6.1", "BEAM"));
    let whole = std::fs::read(dir.path().join("a (1)")).unwrap();
    std::fs::write(dir.path().join("a (1)"), &whole[..600]).unwrap();
    assert_eq!(read_dose(dir.path()).unwrap_err().code(), "dicom-damaged");
}

#[test]
fn beams_of_one_plan_are_summed_and_nothing_else() {
    let dir = tempfile::tempdir().unwrap();
    let one = write(dir.path(), "a", &beam("1.5.1", "1.6.1", "BEAM"));
    let alone = read_dose(&one).unwrap();
    assert_eq!(alone.warnings[0].code, "dose-part");
    let two = write(dir.path(), "b", &beam("1.5.2", "1.6.1", "BEAM"));
    let sum = read_doses(&[&one, &two]).unwrap();
    assert!(sum.value.volume.data().iter().all(|d| (d - 6.01).abs() < 1e-5));
    assert!(sum.warnings.len() == 1 && sum.warnings[0].message.contains("2 beams are summed"), "{:?}", sum.warnings);
    assert_eq!(read_any(dir.path()).unwrap().value, sum.value.volume);
    // Of another type, or of a beam that is there already.
    let numbered = |uid: &str, dose_type: &str, number: &str| {
        let mut set = beam(uid, "1.6.1", "BEAM");
        put(&mut set, tags::DOSE_TYPE, VR::CS, dose_type);
        let items = ["beam", "group", "plan"].iter().fold(Vec::new(), |inner: Vec<Set>, level| {
            let mut item = Set::new_empty();
            match *level {
                "beam" => put(&mut item, tags::REFERENCED_BEAM_NUMBER, VR::IS, number),
                "group" => put_items(&mut item, tags::REFERENCED_BEAM_SEQUENCE, inner),
                _ => {
                    put(&mut item, tags::REFERENCED_SOP_INSTANCE_UID, VR::UI, "1.6.1");
                    put_items(&mut item, tags::REFERENCED_FRACTION_GROUP_SEQUENCE, inner);
                }
            }
            vec![item]
        });
        put_items(&mut set, tags::REFERENCED_RT_PLAN_SEQUENCE, items);
        set
    };
    write(dir.path(), "a", &numbered("1.5.1", "PHYSICAL", "1"));
    write(dir.path(), "b", &numbered("1.5.2", "PHYSICAL", "2"));
    assert!(read_doses(&[&one, &two]).unwrap().value.beams.iter().map(|beam| beam[1]).eq([1, 2]));
    for (dose_type, number, word) in [("EFFECTIVE", "2", "not all of one type"), ("PHYSICAL", "1", "several doses")] {
        write(dir.path(), "b", &numbered("1.5.2", dose_type, number));
        let error = read_doses(&[&one, &two]).unwrap_err();
        assert!(error.code() == "dose-sum" && error.to_string().contains(word), "{error}");
    }
    write(dir.path(), "a", &beam("1.5.1", "1.6.1", "BEAM"));
    for (plan, kind, word) in
        [("1.6.2", "BEAM", "do not refer to one plan"), ("1.6.1", "PLAN", "not all doses of single beams")]
    {
        write(dir.path(), "b", &beam("1.5.2", plan, kind));
        let error = read_doses(&[&one, &two]).unwrap_err();
        assert!(error.code() == "dose-sum" && error.to_string().contains(word), "{error}");
    }
}

#[test]
fn other_frames_of_reference_are_refused() {
    let (dir, ct) = (tempfile::tempdir().unwrap(), series(|_, _| ()));
    let mut set = dose("1.5.60", &[0.0, 4.0], |_| 0);
    let path = write(dir.path(), "d", &set);
    check_frames(Role::Dose.at(&path), Role::Image.at(ct.path())).unwrap();
    put(&mut set, tags::FRAME_OF_REFERENCE_UID, VR::UI, "1.88");
    write(dir.path(), "d", &set);
    let error = check_frames(Role::Dose.at(&path), Role::Image.at(ct.path())).unwrap_err();
    assert!(error.code() == "dicom-frame" && error.to_string().contains("1.88"), "{error}");
    set.remove_element(tags::FRAME_OF_REFERENCE_UID);
    write(dir.path(), "d", &set);
    check_frames(Role::Dose.at(&path), Role::Image.at(ct.path())).unwrap();
    // Where a dose is asked for a folder's CT is none.
    assert_eq!(read_any(ct.path()).unwrap_err().code(), "dicom-no-dose");
}

#[test]
fn a_dose_tells_whether_it_is_of_a_whole_plan() {
    let dir = tempfile::tempdir().unwrap();
    for (summation, expected) in
        [("PLAN", true), ("MULTI_PLAN", true), ("FRACTION", false), ("BEAM", false), ("", false)]
    {
        let mut set = dose("1.5.60", &[0.0, 4.0], |n| n as u16);
        put(&mut set, tags::DOSE_SUMMATION_TYPE, VR::CS, summation);
        let read = read_dose(write(dir.path(), "d", &set)).unwrap();
        assert_eq!(read.value.is_of_whole_plan(), expected, "{summation}");
        assert_eq!(read.warnings.iter().any(|w| w.code == "dose-part"), !expected, "{summation}");
    }
}
