//! Spatial Registrations: written, and read back by the text of the standard.

use super::*;
use crate::geometry::about as turn_about;
use crate::io::dicom::fixture::{items, numbers, oblique, open, origin, series_in, string};
use crate::io::dicom::write::When;
use nalgebra::{Point3, Vector3};

fn shift() -> Rigid {
    turn_about(&Point3::new(10.0, -220.0, 333.0), Vector3::new(0.2, -0.1, 0.4), Vector3::new(-31.25, 7.0, 512.0))
}

fn written(path: &Path) -> Written {
    let from = series_in("1.2.3.4", "planning", "1.9.1", &oblique([3, 3, 3]));
    let to = series_in("1.2.3.5", "fraction", "1.9.2", &oblique([3, 3, 4]));
    let about = DerivedRegistration { role: "rigid", description: "couch shift", number: 904, from: &from, to: &to };
    write_rigid(path, &shift(), &about, &origin()).unwrap()
}

#[test]
fn a_reader_of_the_standard_takes_source_points_to_the_registered_frame() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("REG.dcm");
    let [class, instance] = written(&path);
    let object = open(&path);
    assert_eq!((string(&object, tags::SOP_CLASS_UID), string(&object, tags::SOP_INSTANCE_UID)), (class, instance));
    assert_eq!(string(&object, tags::FRAME_OF_REFERENCE_UID), "1.9.2");
    assert_eq!(string(&object, tags::MODALITY), "REG");
    assert_eq!(string(&object, tags::CONTENT_DATE), "20261125");
    let [own, other] = items(&object, tags::REGISTRATION_SEQUENCE) else { panic!() };
    let matrix = |item: &InMemDicomObject| {
        let [registration] = items(item, tags::MATRIX_REGISTRATION_SEQUENCE) else { panic!() };
        let [matrix] = items(registration, tags::MATRIX_SEQUENCE) else { panic!() };
        assert_eq!(string(matrix, tags::FRAME_OF_REFERENCE_TRANSFORMATION_MATRIX_TYPE), "RIGID");
        numbers(matrix, tags::FRAME_OF_REFERENCE_TRANSFORMATION_MATRIX)
    };
    assert_eq!(string(own, tags::FRAME_OF_REFERENCE_UID), "1.9.2");
    assert_eq!(Matrix4::from_row_slice(&matrix(own)), Matrix4::identity());
    assert_eq!(string(other, tags::FRAME_OF_REFERENCE_UID), "1.9.1");
    assert_eq!(items(other, tags::REFERENCED_IMAGE_SEQUENCE).len(), 3);
    // PS3.3 Equation C.20.2-1, row by row.
    let m = matrix(other);
    let p = [31.0, -7.5, 250.0];
    let got: [f64; 3] = [0, 1, 2].map(|r| m[4 * r] * p[0] + m[4 * r + 1] * p[1] + m[4 * r + 2] * p[2] + m[4 * r + 3]);
    assert!((Point3::from(got) - shift() * Point3::from(p)).norm() < 1e-6);
    // Images of its own study and of the other are listed apart.
    assert_eq!(items(&object, tags::REFERENCED_SERIES_SEQUENCE).len(), 1);
    let [study] = items(&object, tags::STUDIES_CONTAINING_OTHER_REFERENCED_INSTANCES_SEQUENCE) else { panic!() };
    assert_eq!(string(study, tags::STUDY_INSTANCE_UID), "1.2.3.5");
    let [back] = &read_rigid(&path).unwrap()[..] else { panic!() };
    assert_eq!((back.from.as_str(), back.to.as_str()), ("1.9.1", "1.9.2"));
    assert!((back.rigid.to_homogeneous() - shift().to_homogeneous()).abs().max() < 1e-9);
}

/// The written object with its second matrix changed.
fn changed(path: &Path, mut change: impl FnMut(&mut InMemDicomObject)) {
    written(path);
    let mut object = open(path);
    object.update_value(tags::REGISTRATION_SEQUENCE, |value| change(&mut value.items_mut().unwrap()[1]));
    object.write_to_file(path).unwrap();
}

fn with_matrices(matrices: &[Matrix4<f64>]) -> impl FnMut(&mut InMemDicomObject) {
    let items: Vec<InMemDicomObject> = matrices.iter().map(matrix_item).collect();
    move |o: &mut InMemDicomObject| {
        let registration = item([sequence(tags::MATRIX_SEQUENCE, items.clone())]);
        o.put(sequence(tags::MATRIX_REGISTRATION_SEQUENCE, vec![registration]));
    }
}

#[test]
fn several_matrices_count_where_their_order_does_not() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("REG.dcm");
    let translation = |x: f64| Matrix4::new_translation(&Vector3::new(x, 2.0 * x, -3.0));
    changed(&path, with_matrices(&[translation(2.0), Matrix4::identity(), translation(5.0)]));
    let rigid = read_rigid(&path).unwrap()[0].rigid;
    assert!((rigid * Point3::origin() - Point3::new(7.0, 14.0, -6.0)).norm() < 1e-9);
    changed(&path, with_matrices(&[shift().to_homogeneous(), translation(5.0)]));
    assert!(read_rigid(&path).unwrap_err().to_string().contains("order"));
}

#[test]
fn what_cannot_be_trusted_is_refused() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("REG.dcm");
    let mut projective = Matrix4::identity();
    projective[(3, 0)] = 1e-3;
    for (matrix, word) in [(Matrix4::new_scaling(1.1), "scales"), (projective, "last row")] {
        changed(&path, with_matrices(&[matrix]));
        assert!(read_rigid(&path).unwrap_err().to_string().contains(word), "{word}");
    }
    changed(&path, |o| {
        o.remove_element(tags::FRAME_OF_REFERENCE_UID);
    });
    assert!(read_rigid(&path).unwrap_err().to_string().contains("no frame of reference"));
    changed(&path, with_matrices(&[]));
    assert!(read_rigid(&path).unwrap_err().to_string().contains("no matrix"));
    std::fs::write(&path, b"no DICOM").unwrap();
    assert_eq!(read_rigid(&path).unwrap_err().exit_code(), 3);
    let series = series_in("1.2.3.4", "planning", "1.9.1", &oblique([2, 2, 2]));
    let about = DerivedRegistration { role: "r", description: "d", number: 1, from: &series, to: &series };
    let undated = Origin { when: When::default(), ..origin() };
    let error = write_rigid(&path, &shift(), &about, &undated).unwrap_err().to_string();
    assert!(error.contains("date"), "{error}");
}

#[test]
fn two_scans_of_one_frame_are_read_again() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("REG.dcm");
    let series = series_in("1.2.3.4", "planning", "1.9.1", &oblique([2, 2, 2]));
    let about = DerivedRegistration { role: "r", description: "d", number: 1, from: &series, to: &series };
    for rigid in [shift(), Rigid::identity()] {
        write_rigid(&path, &rigid, &about, &origin()).unwrap();
        let [back] = &read_rigid(&path).unwrap()[..] else { panic!() };
        assert_eq!((back.from.as_str(), back.to.as_str()), ("1.9.1", "1.9.1"));
        assert!((back.rigid.to_homogeneous() - rigid.to_homogeneous()).abs().max() < 1e-9);
    }
}
