//! Doses: every value and place as it is written.

use super::*;
use crate::geometry::Grid;
use crate::io::dicom::fixture::{items, numbers, oblique, open, origin, string};
use nalgebra::{Matrix3, Point3, Vector3};

fn about(plans: &BTreeSet<String>) -> DerivedDose<'_> {
    DerivedDose {
        role: "dose",
        description: "planned dose on fraction",
        comment: "Carried by registration, not recalculated",
        number: 903,
        frame_of_reference: "1.9.1",
        kind: "PHYSICAL",
        summation: "PLAN",
        plans,
        carried_by: Some(&[[uids::DEFORMABLE_SPATIAL_REGISTRATION_STORAGE, "2.25.5"]]),
    }
}

#[test]
fn every_value_comes_back_within_a_step_where_it_was() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("RD.dcm");
    let right = oblique([5, 4, 3]);
    let mut mirrored = *right.direction();
    mirrored.column_mut(2).neg_mut();
    let left = Grid::new([5, 4, 3], right.spacing(), right.origin(), mirrored).unwrap();
    let plans = BTreeSet::from(["1.2.3.77".to_owned()]);
    for grid in [right, left] {
        let dose = Volume::from_fn(grid.clone(), |n| if n % 7 == 0 { 0.0 } else { 71.3 / (n as f32) });
        write_dose(&path, &dose, &about(&plans), &origin()).unwrap();
        let object = open(&path);
        for (tag, expected) in [
            (tags::DOSE_UNITS, "GY"),
            (tags::DOSE_TYPE, "PHYSICAL"),
            (tags::DOSE_SUMMATION_TYPE, "PLAN"),
            (tags::SPATIAL_TRANSFORM_OF_DOSE, "NON_RIGID"),
            (tags::FRAME_OF_REFERENCE_UID, "1.9.1"),
        ] {
            assert_eq!(string(&object, tag), expected);
        }
        let [plan] = items(&object, tags::REFERENCED_RT_PLAN_SEQUENCE) else { panic!() };
        assert_eq!(string(plan, tags::REFERENCED_SOP_INSTANCE_UID), "1.2.3.77");
        let [registration] = items(&object, tags::REFERENCED_SPATIAL_REGISTRATION_SEQUENCE) else { panic!() };
        assert_eq!(string(registration, tags::REFERENCED_SOP_INSTANCE_UID), "2.25.5");
        let [step] = numbers(&object, tags::DOSE_GRID_SCALING)[..] else { panic!() };
        assert!(step <= 71.3 / 1.9e9);
        let pointer = object.element(tags::FRAME_INCREMENT_POINTER).unwrap().value().to_tag().unwrap();
        assert_eq!(pointer, tags::GRID_FRAME_OFFSET_VECTOR);
        let offsets = numbers(&object, tags::GRID_FRAME_OFFSET_VECTOR);
        assert!(offsets[0].abs() < 1e-12 && offsets.is_sorted());
        let bytes = object.element(tags::PIXEL_DATA).unwrap().to_bytes().unwrap();
        let stored: Vec<u32> = bytes.as_chunks::<4>().0.iter().map(|b| u32::from_le_bytes(*b)).collect();
        assert_eq!(stored.len(), 60);
        assert!(stored.iter().all(|s| i32::try_from(*s).is_ok()));
        let position = Point3::from_slice(&numbers(&object, tags::IMAGE_POSITION_PATIENT));
        let o = numbers(&object, tags::IMAGE_ORIENTATION_PATIENT);
        let (row, column) = (Vector3::new(o[0], o[1], o[2]), Vector3::new(o[3], o[4], o[5]));
        let [down, across] = numbers(&object, tags::PIXEL_SPACING)[..] else { panic!() };
        for (n, value) in stored.iter().enumerate() {
            let (i, j, k) = (n % 5, n / 5 % 4, n / 20);
            let place =
                position + row * (across * i as f64) + column * (down * j as f64) + row.cross(&column) * offsets[k];
            let voxel = grid.voxel_at(&place).unwrap();
            assert!((grid.centre(voxel) - place).norm() < 1e-6);
            assert!((f64::from(*value) * step - f64::from(*dose.at(voxel))).abs() <= step, "{voxel:?}");
        }
    }
}

#[test]
fn what_is_no_dose_is_refused_and_no_dose_at_all_is_written() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("RD.dcm");
    let grid = Grid::new([2, 1, 1], [1.0; 3], Point3::origin(), Matrix3::identity()).unwrap();
    let dose = |values: [f32; 2]| Volume::new(grid.clone(), values.to_vec()).unwrap();
    for bad in [[0.0, -1e-6], [f32::NAN, 1.0], [f32::INFINITY, 1.0]] {
        let error = write_dose(&path, &dose(bad), &about(&BTreeSet::new()), &origin()).unwrap_err().to_string();
        assert!(error.contains("no dose") && error.contains("RD.dcm"), "{error}");
    }
    assert!(!path.exists());
    let none = BTreeSet::new();
    let unmoved = DerivedDose { carried_by: None, ..about(&none) };
    write_dose(&path, &dose([0.0, 0.0]), &unmoved, &origin()).unwrap();
    let object = open(&path);
    assert!(numbers(&object, tags::DOSE_GRID_SCALING)[0] > 0.0);
    assert_eq!(string(&object, tags::SPATIAL_TRANSFORM_OF_DOSE), "NONE");
    assert!(object.get(tags::REFERENCED_RT_PLAN_SEQUENCE).is_none());
    assert!(object.get(tags::REFERENCED_SPATIAL_REGISTRATION_SEQUENCE).is_none());
}
