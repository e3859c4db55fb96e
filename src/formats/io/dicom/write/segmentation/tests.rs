//! Segmentations: every voxel, name and reference as it is written, and read again.

use super::*;
use crate::io::dicom::fixture::{items, oblique, open, origin, series_in, string};
use crate::io::{read_bones, read_label_map};
use crate::volume::Volume;
use dicom_core::Tag;

fn about(series: &Series) -> DerivedSegmentation<'_> {
    DerivedSegmentation { role: "labels", description: "labels on fraction", number: 904, on: series }
}

/// Labels 3 and 700 on some slices, frames of a size that is no whole byte.
fn map(grid: &Grid) -> LabelMap {
    let value = |n: usize| match n % 11 {
        0 if n > 70 => 3u16,
        4 if n < 190 => 700,
        _ => 0,
    };
    let names = [(3, "femur_left".to_owned()), (700, "Tumor größer".to_owned()), (9, "absent".to_owned())];
    LabelMap { volume: Volume::from_fn(grid.clone(), value), names: names.into() }
}

#[test]
fn every_label_comes_back_where_it_was_with_its_name() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("SEG.dcm");
    let right = oblique([7, 5, 6]);
    let mut mirrored = *right.direction();
    mirrored.column_mut(2).neg_mut();
    let left = Grid::new([7, 5, 6], right.spacing(), right.origin(), mirrored).unwrap();
    for grid in [right, left] {
        let series = series_in("1.2.3.4", "fraction", "1.9.1", &grid);
        let labels = map(&grid);
        write_segmentation(&path, &labels, &about(&series), &origin(), None).unwrap();
        let read = read_label_map(&path, None).unwrap().value;
        let names: Vec<(u16, &str)> = read.names.iter().map(|(n, name)| (*n, name.as_str())).collect();
        assert_eq!(names, [(1, "femur_left"), (2, "Tumor größer")]);
        let own = read.volume.grid();
        for n in 0..grid.len() {
            let voxel = own.voxel_at(&grid.centre(grid.voxel(n)));
            let found = voxel.map_or(0, |v| read.volume.data()[own.linear(v)]);
            let expected = [0, 3, 700].iter().position(|l| *l == labels.volume.data()[n]).unwrap();
            assert_eq!(usize::from(found), expected, "voxel {:?}", grid.voxel(n));
        }
        // On the grid itself, the bone alone.
        let bones = read_bones(&path, None, &grid).unwrap().value;
        let same = |(a, b): (&u16, &u16)| (*a == 1) == (*b == 3);
        assert!(bones.volume.data().iter().zip(labels.volume.data()).all(same));
        let object = open(&path);
        assert_eq!(string(&object, tags::FRAME_OF_REFERENCE_UID), "1.9.1");
        assert_eq!(string(&object, tags::SEGMENTATION_TYPE), "BINARY");
        let segments = items(&object, tags::SEGMENT_SEQUENCE);
        let [kind] = items(&segments[0], tags::SEGMENTED_PROPERTY_TYPE_CODE_SEQUENCE) else { panic!() };
        assert_eq!(string(kind, tags::CODE_VALUE), "71341001");
        let [side] = items(kind, tags::SEGMENTED_PROPERTY_TYPE_MODIFIER_CODE_SEQUENCE) else { panic!() };
        assert_eq!(string(side, tags::CODE_VALUE), "7771000");
        // Every frame names the image of its place.
        let inner = |item: &InMemDicomObject, path: [Tag; 2]| -> InMemDicomObject {
            items(&items(item, path[0])[0], path[1])[0].clone()
        };
        for frame in items(&object, tags::PER_FRAME_FUNCTIONAL_GROUPS_SEQUENCE) {
            let image = inner(frame, [tags::DERIVATION_IMAGE_SEQUENCE, tags::SOURCE_IMAGE_SEQUENCE]);
            let uid = string(&image, tags::REFERENCED_SOP_INSTANCE_UID);
            let slice = series.slices.iter().find(|s| s.uid == uid).unwrap();
            let [place] = items(frame, tags::PLANE_POSITION_SEQUENCE) else { panic!() };
            let position = place.element(tags::IMAGE_POSITION_PATIENT).unwrap().to_multi_float64().unwrap();
            assert!((nalgebra::Point3::from_slice(&position) - slice.position).norm() < 1e-6);
        }
    }
}

#[test]
fn what_a_segmentation_cannot_hold_is_refused() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("SEG.dcm");
    let grid = oblique([7, 5, 6]);
    let series = series_in("1.2.3.4", "fraction", "1.9.1", &grid);
    let refused = |labels: &LabelMap, from: &Origin| {
        let error = write_segmentation(&path, labels, &about(&series), from, None).unwrap_err();
        assert!(error.exit_code() == 5 && !path.exists(), "{error}");
        error.to_string()
    };
    let mut none = map(&grid);
    none.volume.data_mut().fill(0);
    assert!(refused(&none, &origin()).contains("no voxel is labelled"));
    let mut long = map(&grid);
    long.names.insert(3, "a".repeat(65));
    assert!(refused(&long, &origin()).contains("64 characters"));
    let mut undated = origin();
    undated.when.date.clear();
    assert!(refused(&map(&grid), &undated).contains("date"));
}
