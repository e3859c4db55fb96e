//! Files as the world writes them: damaged neighbours, several acquisitions, unknown representations, character sets.

use super::super::{read_dose, read_structure_set, summary};
use super::make::*;
use crate::io::read_image;
use dicom_core::{DataElement, PrimitiveValue, Tag, VR};
use dicom_dictionary_std::tags;
use std::path::Path;

/// The file of slice `k` of a series.
fn name(k: usize) -> String {
    format!("IM{}", (k * 7 + 3) % 11)
}

/// The code of what reading a folder gives, and its text.
fn refusal(dir: &Path) -> (String, String) {
    let error = read_image(dir).unwrap_err();
    (error.code().to_owned(), error.to_string())
}

/// Where bytes stand in a file.
fn find(bytes: &[u8], wanted: &[u8]) -> usize {
    bytes.windows(wanted.len()).position(|w| w == wanted).unwrap()
}

fn edit(path: &Path, change: impl FnOnce(&mut Vec<u8>)) {
    let mut bytes = std::fs::read(path).unwrap();
    change(&mut bytes);
    std::fs::write(path, bytes).unwrap();
}

#[test]
fn a_slice_that_cannot_be_read_is_named() {
    for k in [0, 2, 5] {
        let dir = series(|_, _| ());
        let path = dir.path().join(name(k));
        let whole = std::fs::read(&path).unwrap();
        let pixels = find(&whole, &[0xe0, 0x7f, 0x10, 0]);
        // In the meta information, in the header, before and in the pixels, nothing, and zeros.
        let lengths = [150, 300, 420, pixels, pixels + 20, 0, 100];
        for length in lengths {
            std::fs::write(&path, &whole[..length]).unwrap();
            // Pixels are missed when they are read.
            let cut = length <= pixels;
            let (code, text) = refusal(dir.path());
            assert!(text.contains(&name(k)) && (code == "dicom-damaged") == cut, "{length}: {text}");
        }
        std::fs::write(&path, vec![0; whole.len()]).unwrap();
        assert_eq!(refusal(dir.path()).0, "dicom-damaged");
    }
}

#[test]
fn what_cannot_belong_to_a_series_is_harmless() {
    let dir = series(|_, _| ());
    let expected = read_image(dir.path()).unwrap().value;
    let at = |name: &str| dir.path().join(name);
    for (name, bytes) in [
        ("notes.txt", &b"text"[..]),
        ("README", b"text"),
        ("plan.pdf", b"%PDF-1.4\0\0\xff"),
        ("._IM3", b"\0\x05\x16\x07\0"),
        ("Thumbs.db", b"\xd0\xcf\0"),
    ] {
        std::fs::write(at(name), bytes).unwrap();
    }
    let read = read_image(dir.path()).unwrap();
    assert!(read.value == expected && read.warnings.is_empty(), "{:?}", read.warnings);
    // A damaged object of another series, and an empty file of another kind, are told.
    let whole = std::fs::read(write(dir.path(), "RD", &dose("1.5.60", &[0.0, 4.0], |_| 0))).unwrap();
    std::fs::write(at("RD"), &whole[..whole.len() - 300]).unwrap();
    std::fs::write(at("log.txt"), []).unwrap();
    let read = read_image(dir.path()).unwrap();
    assert!(read.value == expected && read.warnings[0].code == "dicom-damaged", "{:?}", read.warnings);
    assert!(read.warnings[0].message.contains("RD") && read.warnings[0].message.contains("log.txt"));
    std::fs::write(at("IM99"), b"\0\x01\x02").unwrap();
    assert_eq!(refusal(dir.path()).0, "dicom-damaged");
}

#[test]
fn fewer_images_than_are_promised_are_told() {
    let dir = series(|_, set| put(set, tags::IMAGES_IN_ACQUISITION, VR::IS, "8"));
    let warnings = read_image(dir.path()).unwrap().warnings;
    assert!(warnings.len() == 1 && warnings[0].code == "dicom-fewer", "{warnings:?}");
    assert!(warnings[0].message.contains("8 images") && warnings[0].message.contains("6 are there"), "{warnings:?}");
    let dir = series(|_, set| put(set, tags::IMAGES_IN_ACQUISITION, VR::IS, "6"));
    assert!(read_image(dir.path()).unwrap().warnings.is_empty());
    let dir = series(|k, set| {
        put(set, tags::CONCATENATION_UID, VR::UI, "1.4.1");
        put_u16(set, tags::IN_CONCATENATION_NUMBER, k as u16 + 2);
    });
    let (code, text) = refusal(dir.path());
    assert!(code == "dicom-fewer" && text.contains("7 parts"), "{text}");
    let dir = series(|_, set| put(set, tags::SOP_INSTANCE_UID, VR::UI, "1.5.0"));
    let (code, text) = refusal(dir.path());
    assert!(code == "dicom-duplicates" && text.contains("one SOP Instance UID (1.5.0)"), "{text}");
}

#[test]
fn acquisitions_that_alternate_are_refused() {
    type Tell = dyn Fn(&mut Set, usize);
    let tells: [(&str, &Tell); 5] = [
        ("acquisition 2", &|set, n| put(set, tags::ACQUISITION_NUMBER, VR::IS, &(n + 1).to_string())),
        ("kernel B50f", &|set, n| put(set, tags::CONVOLUTION_KERNEL, VR::SH, ["B30f", "B50f"][n])),
        ("slice thickness 1.50 mm", &|set, n| put(set, tags::SLICE_THICKNESS, VR::DS, ["3", "1.5"][n])),
        ("image type", &|set, n| put(set, tags::IMAGE_TYPE, VR::CS, ["ORIGINAL\\PRIMARY", "DERIVED\\PRIMARY"][n])),
        ("time later", &|_, _| ()),
    ];
    for (words, tell) in tells {
        let told = |group: &dyn Fn(usize) -> usize| {
            series(|k, set| {
                tell(set, group(k));
                let seconds = k as f64 + if words == "time later" { 60.0 * group(k) as f64 } else { 0.0 };
                let clock = format!("10{:02}{:06.3}", (seconds / 60.0) as u32, seconds % 60.0);
                put(set, tags::ACQUISITION_TIME, VR::TM, &clock);
            })
        };
        let dir = told(&|k| k % 2);
        let (code, text) = refusal(dir.path());
        assert!(code == "dicom-acquisitions" && text.contains(words), "{words}: {text}");
        // One that goes on where another ends.
        let dir = told(&|k| k / 3);
        assert!(read_image(dir.path()).is_ok(), "{words}");
    }
}

#[test]
fn slices_may_lie_a_little_off_their_places() {
    let jitter = [0.05, -0.05, 0.04, 0.05, -0.05, -0.05];
    let dir = series(|k, set| {
        put(set, tags::IMAGE_POSITION_PATIENT, VR::DS, &list(&[-10.0, -20.0, 30.0 + 3.0 * k as f64 + jitter[k]]));
    });
    let spacing = read_image(dir.path()).unwrap().value.grid().spacing()[2];
    assert!((spacing - 3.0).abs() < 0.03, "{spacing}");
    let dir = series(|k, set| {
        let off = if k == 3 { 0.2 } else { 0.0 };
        put(set, tags::IMAGE_POSITION_PATIENT, VR::DS, &list(&[-10.0, -20.0, 30.0 + 3.0 * k as f64 + off]));
    });
    assert_eq!(refusal(dir.path()).0, "dicom-gap");
}

/// A private sequence in Implicit VR, with its end.
fn private() -> Vec<u8> {
    let mut bytes = vec![0xfe, 0xff, 0x00, 0xe0, 0xff, 0xff, 0xff, 0xff];
    bytes.extend([0x09, 0x00, 0x10, 0x00, 4, 0, 0, 0, b'T', b'E', b'S', b'T']);
    bytes.extend([0xfe, 0xff, 0x0d, 0xe0, 0, 0, 0, 0]);
    bytes.extend([0xfe, 0xff, 0xdd, 0xe0, 0, 0, 0, 0]);
    bytes
}

#[test]
fn unknown_representations_are_those_of_the_dictionary() {
    let put_bytes = |set: &mut Set, tag: Tag, bytes: &[u8]| {
        set.put(DataElement::new(tag, VR::UN, PrimitiveValue::U8(bytes.into())));
    };
    let expected = read_image(series(|_, _| ()).path()).unwrap().value;
    let dir = series(|k, set| {
        put_bytes(set, Tag(0x0009, 0x1001), &private());
        put_bytes(set, tags::IMAGE_POSITION_PATIENT, format!("-10\\-20\\{} ", 30 + 3 * k).as_bytes());
        put_bytes(set, tags::ROWS, &(SIZE[1] as u16).to_le_bytes());
    });
    for k in 0..SIZE[2] {
        edit(&dir.path().join(name(k)), |bytes| {
            let at = find(bytes, &[0x09, 0, 0x01, 0x10, b'U', b'N', 0, 0]);
            bytes[at + 8..at + 12].copy_from_slice(&[0xff; 4]);
        });
    }
    assert_eq!(read_image(dir.path()).unwrap().value, expected);
    // A known sequence, of known and of undefined length, and the same in explicit encoding.
    let dir = tempfile::tempdir().unwrap();
    let mut set = dose("1.5.60", &[0.0, 4.0], |_| 100);
    let mut item = vec![0xfe, 0xff, 0x00, 0xe0, 14, 0, 0, 0];
    item.extend([0x08, 0x00, 0x55, 0x11, 6, 0, 0, 0]);
    item.extend(b"1.6.77");
    put_bytes(&mut set, tags::REFERENCED_RT_PLAN_SEQUENCE, &item);
    let path = write(dir.path(), "d", &set);
    assert!(read_dose(&path).unwrap().value.plans.contains("1.6.77"));
    item.extend([0xfe, 0xff, 0xdd, 0xe0, 0, 0, 0, 0]);
    // The same length in explicit encoding: letters of two, and a length of two bytes.
    for letters in [None, Some([b'U', b'I', 6, 0])] {
        let mut item = item.clone();
        if let Some(letters) = letters {
            item[12..16].copy_from_slice(&letters);
        }
        put_bytes(&mut set, tags::REFERENCED_RT_PLAN_SEQUENCE, &item);
        let path = write(dir.path(), "d", &set);
        edit(&path, |bytes| {
            let at = find(bytes, &[0x0c, 0x30, 0x02, 0, b'U', b'N', 0, 0]);
            bytes[at + 8..at + 12].copy_from_slice(&[0xff; 4]);
        });
        assert!(read_dose(&path).unwrap().value.plans.contains("1.6.77"), "{letters:?}");
    }
    let dir = tempfile::tempdir().unwrap();
    let mut contour = Set::new_empty();
    put(&mut contour, tags::CONTOUR_GEOMETRIC_TYPE, VR::CS, "CLOSED_PLANAR");
    put_bytes(&mut contour, tags::CONTOUR_DATA, b"0\\0\\3\\4\\0\\3\\4\\4\\3\\0\\4\\3 ");
    let mut set = structure_set(&[Roi { name: "a", contours: vec![("CLOSED_PLANAR", square(1.0, 3.0))] }]);
    set.update_value(tags::ROI_CONTOUR_SEQUENCE, |value| {
        put_items(&mut value.items_mut().unwrap()[0], tags::CONTOUR_SEQUENCE, vec![contour.clone()]);
    });
    let read = read_structure_set(write(dir.path(), "rs", &set)).unwrap();
    assert!((read.contours.structures[0].area(3.0) - 16.0).abs() < 1e-9);
}

#[test]
fn names_are_read_by_their_character_sets() {
    let dir = tempfile::tempdir().unwrap();
    let mut set = structure_set(&[Roi { name: "a", contours: vec![("CLOSED_PLANAR", square(1.0, 3.0))] }]);
    put(&mut set, tags::SPECIFIC_CHARACTER_SET, VR::CS, "\\ISO 2022 IR 87");
    let bytes = b"Yamada^Tarou=\x1b$B;3ED\x1b(B^\x1b$BB@O:\x1b(B ";
    set.put(DataElement::new(tags::PATIENT_NAME, VR::UN, PrimitiveValue::U8(bytes[..].into())));
    set.update_value(tags::STRUCTURE_SET_ROI_SEQUENCE, |value| {
        // A separator's byte within a pair; an item inherits the set's character set.
        let name = DataElement::new(tags::ROI_NAME, VR::UN, PrimitiveValue::U8(b"\x1b$B%\\\x1b(B"[..].into()));
        value.items_mut().unwrap()[0].put(name);
    });
    let read = read_structure_set(write(dir.path(), "rs", &set)).unwrap();
    assert_eq!((read.patient.name.as_str(), read.rois[0].name.as_str()), ("Yamada^Tarou=山田^太郎", "ボ"));
}

#[test]
fn wrong_meta_information_is_not_believed() {
    let expected = read_image(series(|_, _| ()).path()).unwrap().value;
    for syntax in [&b"1.2.840.10008.1.2\0\0\0"[..], b"1.2.840.10008.1.2.2\0", b"                    "] {
        let dir = series(|_, _| ());
        for k in 0..SIZE[2] {
            edit(&dir.path().join(name(k)), |bytes| {
                let at = find(bytes, b"1.2.840.10008.1.2.1\0");
                bytes[at..at + syntax.len()].copy_from_slice(syntax);
                // The length of the group, too.
                bytes[140..144].copy_from_slice(&[7, 0, 0, 0]);
            });
        }
        assert_eq!(read_image(dir.path()).unwrap().value, expected);
    }
}

#[test]
fn lengths_are_not_believed_beyond_the_file() {
    let dir = series(|_, _| ());
    let path = dir.path().join(name(3));
    edit(&path, |bytes| {
        let at = find(bytes, &[0xe0, 0x7f, 0x10, 0, b'O', b'W', 0, 0]);
        bytes[at + 8..at + 12].copy_from_slice(&[0xf0, 0xff, 0xff, 0xff]);
    });
    let (_, text) = refusal(dir.path());
    assert!(text.contains("(7FE0,0010) says 4294967280 bytes") && text.contains(&name(3)), "{text}");
    // Sequences in sequences without end.
    let deep = [
        [0x08, 0, 0x40, 0x11, b'S', b'Q', 0, 0, 255, 255, 255, 255],
        [0xfe, 0xff, 0, 0xe0, 255, 255, 255, 255, 0, 0, 0, 0],
    ];
    let deep: Vec<u8> = (0..5000).flat_map(|_| deep[0].into_iter().chain(deep[1][..8].iter().copied())).collect();
    edit(&path, |bytes| {
        let at = find(bytes, &[0x08, 0, 0x16, 0, b'U', b'I']);
        let end = at + 8 + usize::from(bytes[at + 6]);
        bytes.splice(end..end, deep);
    });
    assert!(refusal(dir.path()).1.contains("more than 48 deep"));
}

#[test]
fn values_of_another_size_are_not_parsed_past_their_end() {
    // A text's element as numbers of 8 bytes: what a parser leaves of it would become the next element, and its length.
    let dir = series(|_, _| ());
    let path = dir.path().join(name(2));
    let whole = std::fs::read(&path).unwrap();
    let head = [&[0x10, 0, 0x20, 0][..], b"LO"].concat();
    let at = find(&whole, &head);
    for vr in [b"FD", b"UL", b"AT"] {
        edit(&path, |bytes| bytes[at + 4..at + 6].copy_from_slice(vr));
        let (code, text) = refusal(dir.path());
        assert!(code == "dicom-damaged" && text.contains("(0010,0020) says 2 bytes"), "{code}: {text}");
    }
}

#[test]
fn the_directory_of_a_medium_means_its_folder() {
    let dir = series(|_, _| ());
    let mut set = Set::new_empty();
    put(&mut set, tags::FILE_SET_ID, VR::CS, "TEST");
    put_items(&mut set, tags::DIRECTORY_RECORD_SEQUENCE, vec![Set::new_empty()]);
    put(&mut set, tags::SOP_CLASS_UID, VR::UI, "1.2.840.10008.1.3.10");
    put(&mut set, tags::SOP_INSTANCE_UID, VR::UI, "1.5.99");
    let path = write(dir.path(), "DICOMDIR", &set);
    assert_eq!(read_image(&path).unwrap().value, read_image(dir.path()).unwrap().value);
    assert_eq!(summary(dir.path(), false).unwrap().other_files, 1);
}
