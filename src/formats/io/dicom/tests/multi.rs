//! Enhanced CT: several frames in one object.

use super::super::read_series;
use super::make::*;
use crate::io::read_image;
use dicom_core::VR;
use dicom_core::{DataElement, PrimitiveValue};
use dicom_dictionary_std::tags;

fn group(tag: dicom_core::Tag, fill: impl Fn(&mut Set)) -> (dicom_core::Tag, Set) {
    let mut item = Set::new_empty();
    fill(&mut item);
    (tag, item)
}

/// An object whose frames stand in the order given.
fn enhanced(order: &[usize]) -> Set {
    let mut set = base("1.2.840.10008.5.1.4.1.1.2.1", "1.5.70", "1.7.2", "CT");
    let all = order.iter().flat_map(|&k| (0..SIZE[1]).flat_map(move |j| (0..SIZE[0]).map(move |i| stored(i, j, k))));
    pixels(&mut set, all.collect());
    put(&mut set, tags::NUMBER_OF_FRAMES, VR::IS, &order.len().to_string());
    let holder = |groups: Vec<(dicom_core::Tag, Set)>| {
        let mut item = Set::new_empty();
        groups.into_iter().for_each(|(tag, group)| put_items(&mut item, tag, vec![group]));
        item
    };
    let shared = holder(vec![
        group(tags::PIXEL_MEASURES_SEQUENCE, |g| put(g, tags::PIXEL_SPACING, VR::DS, "2\\1.5")),
        group(tags::PLANE_ORIENTATION_SEQUENCE, |g| {
            put(g, tags::IMAGE_ORIENTATION_PATIENT, VR::DS, "1\\0\\0\\0\\1\\0");
        }),
    ]);
    put_items(&mut set, tags::SHARED_FUNCTIONAL_GROUPS_SEQUENCE, vec![shared]);
    let frames = order.iter().map(|&k| {
        holder(vec![
            group(tags::PLANE_POSITION_SEQUENCE, |g| {
                put(g, tags::IMAGE_POSITION_PATIENT, VR::DS, &list(&[-10.0, -20.0, 30.0 + 3.0 * k as f64]));
            }),
            group(tags::PIXEL_VALUE_TRANSFORMATION_SEQUENCE, |g| {
                put(g, tags::RESCALE_SLOPE, VR::DS, if k == 1 { "1" } else { "2" });
                put(g, tags::RESCALE_INTERCEPT, VR::DS, "-1024");
                put(g, tags::RESCALE_TYPE, VR::LO, "HU");
            }),
        ])
    });
    let frames = frames.collect();
    put_items(&mut set, tags::PER_FRAME_FUNCTIONAL_GROUPS_SEQUENCE, frames);
    set
}

#[test]
fn frames_are_ordered_by_their_own_positions() {
    let dir = tempfile::tempdir().unwrap();
    let path = write(dir.path(), "enhanced", &enhanced(&[2, 0, 3, 1]));
    let read = read_series(&path).unwrap();
    let (volume, series) = read.value;
    assert_eq!((volume.grid().size(), volume.grid().spacing()), ([5, 4, 4], [1.5, 2.0, 3.0]));
    for (i, j, k) in [(0, 0, 0), (4, 3, 3), (1, 2, 2)] {
        assert_eq!(volume.data()[volume.grid().linear([i, j, k])], hu(i, j, k));
    }
    let one = volume.data()[volume.grid().linear([2, 2, 1])];
    assert_eq!(one, f32::from(stored(2, 2, 1)) - 1024.0);
    assert_eq!(series.slices.iter().map(|s| s.frame).collect::<Vec<_>>(), [Some(2), Some(4), Some(1), Some(3)]);
}

#[test]
fn frames_that_contradict_the_object_are_refused() {
    let dir = tempfile::tempdir().unwrap();
    let mut set = enhanced(&[0, 1, 2]);
    put(&mut set, tags::NUMBER_OF_FRAMES, VR::IS, "4");
    write(dir.path(), "a", &set);
    let error = read_image(dir.path()).unwrap_err();
    assert!(error.code() == "dicom-incomplete" && error.to_string().contains("describes 3"), "{error}");
    let mut set = enhanced(&[0, 1, 2]);
    set.put(DataElement::new(tags::PIXEL_DATA, VR::OW, PrimitiveValue::U16(vec![1; 40].into())));
    write(dir.path(), "a", &set);
    assert_eq!(read_image(dir.path()).unwrap_err().exit_code(), 3);
    let mut phases = enhanced(&[0, 1, 2, 3, 1]);
    let mut all = vec![5u16; 5 * SIZE[0] * SIZE[1]];
    all[..4].fill(9);
    all[SIZE[0] * SIZE[1]..][..4].fill(8);
    pixels(&mut phases, all);
    write(dir.path(), "a", &phases);
    let error = read_image(dir.path()).unwrap_err();
    assert!(error.code() == "dicom-duplicates" && error.to_string().contains("frame 5"), "{error}");
}
