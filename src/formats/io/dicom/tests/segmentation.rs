//! Segmentations: bits, fractions and numbers, frames in any order, names by label and term, and what is refused.

use super::super::place::is_segmentation;
use super::make::*;
use crate::geometry::Grid;
use crate::io::{read_bones, read_grid, read_image, read_label_map, read_labels, read_organs};
use dicom_core::{DataElement, PrimitiveValue, Tag, VR};
use dicom_dictionary_std::{tags, uids};
use std::path::Path;

/// Segment and slice of a frame.
type Frame = (u16, usize);
/// Number, label, and code of SNOMED CT with that of its side.
type Named<'a> = (u16, &'a str, &'a str, &'a str);

const JAW: [Named<'static>; 2] = [(1, "Unterkiefer", "91609006", ""), (2, "atlas", "", "")];

fn coded(set: &mut Set, tag: Tag, code: &str, inner: &[Set]) {
    let mut item = Set::new_empty();
    put(&mut item, tags::CODE_VALUE, VR::SH, code);
    put(&mut item, tags::CODING_SCHEME_DESIGNATOR, VR::SH, "SCT");
    put(&mut item, tags::CODE_MEANING, VR::LO, "a meaning");
    if !inner.is_empty() {
        put_items(&mut item, tags::SEGMENTED_PROPERTY_TYPE_MODIFIER_CODE_SEQUENCE, inner.to_vec());
    }
    put_items(set, tag, vec![item]);
}

fn segment((number, label, code, side): Named<'_>) -> Set {
    let mut item = Set::new_empty();
    put_u16(&mut item, tags::SEGMENT_NUMBER, number);
    put(&mut item, tags::SEGMENT_LABEL, VR::LO, label);
    let mut inner = Vec::new();
    if !side.is_empty() {
        let mut one = Set::new_empty();
        put(&mut one, tags::CODE_VALUE, VR::SH, side);
        put(&mut one, tags::CODING_SCHEME_DESIGNATOR, VR::SH, "SCT");
        put(&mut one, tags::CODE_MEANING, VR::LO, "Left");
        inner.push(one);
    }
    coded(&mut item, tags::SEGMENTED_PROPERTY_TYPE_CODE_SEQUENCE, code, &inner);
    item
}

/// Whether a pixel of a frame is set: another row for each slice, segments side by side.
fn is_set((segment, k): Frame, i: usize, j: usize) -> bool {
    j == k % SIZE[1] && (i < 2) == (segment == 1)
}

/// A segmentation on the grid of [`slice`], one frame after the other.
fn segmentation(segments: &[Named<'_>], frames: &[Frame]) -> Set {
    let mut set = base(uids::SEGMENTATION_STORAGE, "1.5.80", "1.7.9", "SEG");
    pixels(&mut set, Vec::new());
    for (tag, value) in [(tags::BITS_ALLOCATED, 1), (tags::BITS_STORED, 1), (tags::HIGH_BIT, 0)] {
        put_u16(&mut set, tag, value);
    }
    put(&mut set, tags::SEGMENTATION_TYPE, VR::CS, "BINARY");
    put(&mut set, tags::NUMBER_OF_FRAMES, VR::IS, &frames.len().to_string());
    put_items(&mut set, tags::SEGMENT_SEQUENCE, segments.iter().map(|s| segment(*s)).collect());
    let mut measures = Set::new_empty();
    put(&mut measures, tags::PIXEL_SPACING, VR::DS, "2\\1.5");
    put(&mut measures, tags::SLICE_THICKNESS, VR::DS, "3");
    let mut turned = Set::new_empty();
    put(&mut turned, tags::IMAGE_ORIENTATION_PATIENT, VR::DS, "1\\0\\0\\0\\1\\0");
    let mut shared = Set::new_empty();
    put_items(&mut shared, tags::PIXEL_MEASURES_SEQUENCE, vec![measures]);
    put_items(&mut shared, tags::PLANE_ORIENTATION_SEQUENCE, vec![turned]);
    put_items(&mut set, tags::SHARED_FUNCTIONAL_GROUPS_SEQUENCE, vec![shared]);
    let own = frames.iter().map(|(number, k)| {
        let (mut place, mut of, mut item) = (Set::new_empty(), Set::new_empty(), Set::new_empty());
        put(&mut place, tags::IMAGE_POSITION_PATIENT, VR::DS, &list(&[-10.0, -20.0, 30.0 + 3.0 * *k as f64]));
        put_items(&mut item, tags::PLANE_POSITION_SEQUENCE, vec![place]);
        put_u16(&mut of, tags::REFERENCED_SEGMENT_NUMBER, *number);
        put_items(&mut item, tags::SEGMENT_IDENTIFICATION_SEQUENCE, vec![of]);
        item
    });
    put_items(&mut set, tags::PER_FRAME_FUNCTIONAL_GROUPS_SEQUENCE, own.collect());
    let places = || (0..SIZE[1]).flat_map(|j| (0..SIZE[0]).map(move |i| (i, j)));
    let all = frames.iter().flat_map(|f| places().map(|(i, j)| is_set(*f, i, j)));
    bits(&mut set, &all.collect::<Vec<_>>());
    set
}

fn bits(set: &mut Set, all: &[bool]) {
    let mut bytes = vec![0u8; all.len().div_ceil(8)];
    all.iter().enumerate().filter(|(_, on)| **on).for_each(|(n, _)| bytes[n / 8] |= 1 << (n % 8));
    bytes.resize(bytes.len().next_multiple_of(2), 0);
    set.put(DataElement::new(tags::PIXEL_DATA, VR::OB, PrimitiveValue::U8(bytes.into())));
}

/// Values of 8 bits instead of bits.
fn bytes(set: &mut Set, kind: &str, values: Vec<u8>) {
    for (tag, value) in [(tags::BITS_ALLOCATED, 8), (tags::BITS_STORED, 8), (tags::HIGH_BIT, 7)] {
        put_u16(set, tag, value);
    }
    put(set, tags::SEGMENTATION_TYPE, VR::CS, kind);
    set.put(DataElement::new(tags::PIXEL_DATA, VR::OB, PrimitiveValue::U8(values.into())));
}

fn ct_grid() -> Grid {
    let dir = series(|_, _| {});
    read_grid(dir.path()).unwrap().0
}

/// Labels of a file, and the code of the refusal where it is refused.
fn refusal(dir: &Path, set: &Set) -> String {
    let error = read_label_map(write(dir, "odd.dcm", set), None).unwrap_err();
    assert!(error.to_string().contains("odd.dcm"), "{error}");
    format!("{} {error}", error.code())
}

#[test]
fn frames_in_any_order_are_slices_and_missing_ones_are_empty() {
    let dir = tempfile::tempdir().unwrap();
    let set = segmentation(&JAW, &[(2, 4), (1, 1), (2, 2), (1, 4)]);
    let path = write(dir.path(), "seg.dcm", &set);
    assert!(is_segmentation(&path) && is_segmentation(dir.path()));
    let read = read_label_map(&path, None).unwrap();
    // A slice more at both ends: what lies beyond the frames is empty.
    let grid = read.value.volume.grid().clone();
    assert_eq!((grid.size(), grid.spacing()), ([5, 4, 6], [1.5, 2.0, 3.0]));
    assert!((grid.origin().z - 30.0).abs() < 1e-9, "{}", grid.origin());
    for k in 0..6 {
        for j in 0..SIZE[1] {
            for i in 0..SIZE[0] {
                let there = |s: u16| [(2, 4), (1, 1), (2, 2), (1, 4)].contains(&(s, k)) && is_set((s, k), i, j);
                let expected = [1, 2].into_iter().find(|s| there(*s)).unwrap_or(0);
                assert_eq!(read.value.volume.data()[grid.linear([i, j, k])], expected, "{i} {j} {k}");
            }
        }
    }
    assert_eq!(read_grid(&path).unwrap().0, grid);
    assert_eq!(read.value.names[&2], "atlas");
    // The same by fractions, of which more than half counts, and by numbers.
    let frames = [(2, 4), (1, 1), (2, 2), (1, 4)];
    let places = || (0..SIZE[1]).flat_map(|j| (0..SIZE[0]).map(move |i| (i, j)));
    let mut parts = set.clone();
    let share = |f: Frame, i, j| if is_set(f, i, j) { 101 } else { 100 };
    bytes(&mut parts, "FRACTIONAL", frames.iter().flat_map(|f| places().map(|(i, j)| share(*f, i, j))).collect());
    put_u16(&mut parts, tags::MAXIMUM_FRACTIONAL_VALUE, 200);
    let shares = read_label_map(write(dir.path(), "part.dcm", &parts), None).unwrap();
    assert_eq!(shares.value, read.value);
    let mut map = segmentation(&JAW, &[(0, 1), (0, 2), (0, 4)]);
    put(&mut map, tags::SOP_CLASS_UID, VR::UI, uids::LABEL_MAP_SEGMENTATION_STORAGE);
    let number = |k, i, j| (1..3).find(|s| frames.contains(&(*s, k)) && is_set((*s, k), i, j)).unwrap_or(0) as u8;
    bytes(
        &mut map,
        "LABELMAP",
        [1, 2, 4].into_iter().flat_map(|k| places().map(move |(i, j)| number(k, i, j))).collect(),
    );
    let numbers = read_label_map(write(dir.path(), "map.dcm", &map), None).unwrap();
    assert_eq!(numbers.value, read.value);
    // No image.
    assert_eq!(read_image(&path).unwrap_err().code(), "dicom-no-ct");
}

#[test]
fn bones_are_named_by_label_or_term_and_lie_on_the_voxels_of_the_image() {
    let dir = tempfile::tempdir().unwrap();
    let segments = [
        (1, "Unterkiefer", "91609006", ""),
        (2, "bone", "51299004", "7771000"),
        (3, "bone", "51299004", "24028007"),
        (4, "liver", "10200004", ""),
    ];
    let set = segmentation(&segments, &[(1, 3), (2, 3), (3, 4), (4, 5)]);
    let path = write(dir.path(), "seg.dcm", &set);
    let grid = ct_grid();
    let read = read_bones(&path, None, &grid).unwrap();
    assert_eq!(read.value.volume.grid(), &grid);
    let names: Vec<&str> = read.value.names.values().map(String::as_str).collect();
    assert_eq!(names, ["mandible", "clavicula_left", "clavicula_right"]);
    assert_eq!(read.value.volume.data()[grid.linear([0, 3, 3])], 1);
    assert_eq!(read.value.volume.data()[grid.linear([4, 0, 4])], 3);
    assert!(read.warnings.iter().any(|w| w.code == "segments-left-out" && w.message.contains("liver")));
    let organs = read_organs(&path, &["Liver".into()], &grid).unwrap();
    assert_eq!((organs.value.names.len(), organs.value.names[&4].as_str()), (1, "Liver"));
    assert!(read_organs(&path, &["kidney".into()], &grid).unwrap_err().to_string().contains("liver"));
    // The same voxels with other axes, as NIfTI has them, and with more slices.
    let axes = nalgebra::Matrix3::from_diagonal(&nalgebra::Vector3::new(-1.0, -1.0, 1.0));
    let far = grid.centre([4, 3, 0]);
    let turned = Grid::new([5, 4, 9], grid.spacing(), far, axes).unwrap();
    let read = read_bones(&path, None, &turned).unwrap();
    assert_eq!(read.value.volume.data()[turned.linear([4, 0, 3])], 1);
    for other in [
        Grid::axis_aligned([5, 4, 6], [1.5, 2.0, 3.0], [-10.4, -20.0, 30.0]).unwrap(),
        Grid::axis_aligned([5, 4, 6], [1.5, 2.0, 2.5], [-10.0, -20.0, 30.0]).unwrap(),
        Grid::axis_aligned([5, 4, 4], [1.5, 2.0, 3.0], [-10.0, -20.0, 30.0]).unwrap(),
    ] {
        assert_eq!(read_bones(&path, None, &other).unwrap_err().code(), "labels-elsewhere", "{other:?}");
    }
    // Terms of older terminologies by what they mean.
    let mut set =
        segmentation(&[(1, "bone", "T-12710", "G-A101"), (2, "bone", "T-12710", "G-A100")], &[(1, 2), (2, 2)]);
    set.update_value(tags::SEGMENT_SEQUENCE, |value| {
        for (item, side) in value.items_mut().into_iter().flatten().zip(["Left", "Right"]) {
            let mut of = Set::new_empty();
            put(&mut of, tags::CODE_VALUE, VR::SH, "G-A10");
            put(&mut of, tags::CODE_MEANING, VR::LO, side);
            let mut kind = Set::new_empty();
            put(&mut kind, tags::CODE_VALUE, VR::SH, "T-12710");
            put(&mut kind, tags::CODING_SCHEME_DESIGNATOR, VR::SH, "SRT");
            put(&mut kind, tags::CODE_MEANING, VR::LO, "Femur");
            put_items(&mut kind, tags::SEGMENTED_PROPERTY_TYPE_MODIFIER_CODE_SEQUENCE, vec![of]);
            put_items(item, tags::SEGMENTED_PROPERTY_TYPE_CODE_SEQUENCE, vec![kind]);
        }
    });
    let femurs = read_bones(write(dir.path(), "srt.dcm", &set), None, &grid).unwrap().value.names;
    assert_eq!(femurs.values().map(String::as_str).collect::<Vec<_>>(), ["femur_left", "femur_right"]);
    let liver = write(dir.path(), "liver.dcm", &segmentation(&[(1, "liver", "10200004", "")], &[(1, 2)]));
    assert_eq!(read_bones(&liver, None, &grid).unwrap_err().code(), "bones-unnamed");
    // What label and term contradict each other in is told.
    let odd = write(dir.path(), "odd.dcm", &segmentation(&[(1, "C2", "14806007", "")], &[(1, 2)]));
    let read = read_bones(&odd, None, &grid).unwrap();
    assert_eq!(read.value.names[&1], "vertebrae_C2");
    assert!(read.warnings.iter().any(|w| w.code == "segments-terms"), "{:?}", read.warnings);
}

#[test]
fn segments_that_overlap_are_refused_by_name_unless_one_is_left_out() {
    let dir = tempfile::tempdir().unwrap();
    let segments = [(1, "C1", "", ""), (2, "C2", "", ""), (3, "body", "", "")];
    let mut set = segmentation(&segments, &[(1, 2), (2, 2), (3, 2)]);
    let frame = SIZE[0] * SIZE[1];
    let mut all = vec![false; 3 * frame];
    all[..3].fill(true);
    all[frame + 3..frame + 5].fill(true);
    all[2 * frame..].fill(true);
    bits(&mut set, &all);
    let told = refusal(dir.path(), &set);
    assert!(told.starts_with("segments-overlap") && told.contains("C1 and body (3 voxels)"), "{told}");
    let path = write(dir.path(), "bones.dcm", &set);
    let bones = read_bones(&path, None, &ct_grid()).unwrap().value;
    assert_eq!(bones.counts().into_iter().collect::<Vec<_>>(), [(1, 3), (2, 2)]);
}

#[test]
fn what_contradicts_itself_is_refused() {
    let dir = tempfile::tempdir().unwrap();
    let good = || segmentation(&JAW, &[(1, 1), (2, 2)]);
    let told = |set: &Set, code: &str, words: &str| {
        let told = refusal(dir.path(), set);
        assert!(told.starts_with(code) && told.contains(words), "{told}");
    };
    told(&segmentation(&JAW, &[(1, 1), (7, 2)]), "segments-odd", "segment 7, which nothing defines");
    let twice = [(1, "jaw", "", ""), (1, "atlas", "", "")];
    told(&segmentation(&twice, &[(1, 1)]), "segments-odd", "\"jaw\" and \"atlas\" have one Segment Number");
    told(&segmentation(&[(0, "jaw", "", "")], &[(1, 1)]), "segments-odd", "Segment Number 0");
    told(&segmentation(&[], &[(1, 1)]), "segments-odd", "no segment");
    told(&segmentation(&JAW, &[]), "segments-odd", "no frame");
    told(&segmentation(&JAW, &[(1, 1), (2, 2), (1, 1)]), "dicom-duplicates", "frames 1 and 3 of \"Unterkiefer\"");
    let mut set = good();
    put(&mut set, tags::NUMBER_OF_FRAMES, VR::IS, "3");
    told(&set, "dicom-incomplete", "describes 2");
    let mut set = good();
    set.update_value(tags::PER_FRAME_FUNCTIONAL_GROUPS_SEQUENCE, |value| {
        for item in value.items_mut().into_iter().flatten() {
            let mut one = Set::new_empty();
            put_u16(&mut one, tags::REFERENCED_SEGMENT_NUMBER, 1);
            put_items(item, tags::SEGMENT_IDENTIFICATION_SEQUENCE, vec![one.clone(), one]);
        }
    });
    told(&set, "segments-odd", "names 2 segments");
    let mut set = good();
    put(&mut set, tags::SEGMENTATION_TYPE, VR::CS, "SURFACE");
    told(&set, "dicom-incomplete", "SURFACE");
    let mut set = good();
    put(&mut set, tags::SOP_CLASS_UID, VR::UI, uids::SURFACE_SEGMENTATION_STORAGE);
    told(&set, "segments-odd", "of surfaces");
    let mut set = good();
    bytes(&mut set, "FRACTIONAL", vec![1; 40]);
    told(&set, "dicom-incomplete", "Maximum Fractional Value");
    let mut set = good();
    bytes(&mut set, "LABELMAP", vec![3; 40]);
    told(&set, "segments-odd", "segment 3, which nothing defines");
    // Too few bits, and frames that begin with a byte each.
    for count in [30, 48] {
        let mut set = good();
        bits(&mut set, &vec![true; count]);
        assert!(refusal(dir.path(), &set).contains("5 x 4 x 2 bits"), "{count}");
    }
    // A place so far away that the slices between would fill the memory.
    let mut set = good();
    set.update_value(tags::PER_FRAME_FUNCTIONAL_GROUPS_SEQUENCE, |value| {
        for item in value.items_mut().into_iter().flatten().take(1) {
            let mut place = Set::new_empty();
            put(&mut place, tags::IMAGE_POSITION_PATIENT, VR::DS, "-10\\-20\\300000000");
            put_items(item, tags::PLANE_POSITION_SEQUENCE, vec![place]);
        }
    });
    let spaced = {
        let mut shared = set.element(tags::SHARED_FUNCTIONAL_GROUPS_SEQUENCE).unwrap().items().unwrap()[0].clone();
        let mut measures = Set::new_empty();
        put(&mut measures, tags::PIXEL_SPACING, VR::DS, "2\\1.5");
        put(&mut measures, tags::SPACING_BETWEEN_SLICES, VR::DS, "3");
        put_items(&mut shared, tags::PIXEL_MEASURES_SEQUENCE, vec![measures]);
        vec![shared]
    };
    put_items(&mut set, tags::SHARED_FUNCTIONAL_GROUPS_SEQUENCE, spaced);
    assert!(refusal(dir.path(), &set).contains("promised"));
    // Two in one folder.
    let two = tempfile::tempdir().unwrap();
    write(two.path(), "a.dcm", &good());
    write(two.path(), "b.dcm", &good());
    let error = read_labels(two.path(), None).unwrap_err();
    assert!(error.code() == "dicom-several" && error.to_string().contains("b.dcm"), "{error}");
}
