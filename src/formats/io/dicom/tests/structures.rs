//! Structure sets.

use super::super::{Role, StructureSet, describe_series, frame_of, missing_images, read_structure_set, summary};
use super::make::*;
use crate::findings;
use crate::io::{read_contour_file, read_contours, read_grid, read_image};
use crate::warning::Warning;
use dicom_core::VR;
use dicom_dictionary_std::tags;

const PLANAR: &str = "CLOSED_PLANAR";

fn closed(polygons: Vec<Vec<[f64; 3]>>) -> Vec<(&'static str, Vec<[f64; 3]>)> {
    polygons.into_iter().map(|p| (PLANAR, p)).collect()
}

#[test]
fn contours_come_with_names_and_what_is_left_out_is_told() {
    let dir = tempfile::tempdir().unwrap();
    let (outer, inner) = (square(4.0, 33.0), square(2.0, 33.0));
    let reversed: Vec<[f64; 3]> = inner.iter().rev().copied().collect();
    // Along the outer contour, over a bridge, around the inner one and back.
    let keyhole = [outer.as_slice(), &outer[..1], &reversed[3..], &reversed[..]].concat();
    let tilted = vec![("POINT", vec![[1.0, 2.0, 3.0]]), ("OPEN_PLANAR", square(1.0, 33.0))];
    let path = write(
        dir.path(),
        "rs",
        &structure_set(&[
            Roi { name: "Kiefer links ä", contours: closed(vec![outer.clone(), square(4.0, 36.0)]) },
            Roi { name: "ring", contours: closed(vec![outer.clone(), inner.clone()]) },
            Roi { name: "ring", contours: closed(vec![keyhole]) },
            Roi { name: "iso", contours: tilted },
            Roi { name: "empty", contours: vec![] },
            // Between the slices of the CT.
            Roi { name: "between", contours: closed(vec![square(1.0, 34.4), vec![[0.0, 0.0, 34.4]; 2]]) },
        ]),
    );
    let set = read_structure_set(&path).unwrap();
    let names: Vec<&str> = set.rois.iter().map(|r| r.name.as_str()).collect();
    assert_eq!(names, ["Kiefer links ä", "ring", "ring (3)", "iso", "empty", "between"]);
    let areas: Vec<f64> = set.contours.structures.iter().map(|s| s.area(33.0)).collect();
    assert!((areas[0] - 64.0).abs() < 1e-9 && (areas[1] - 48.0).abs() < 1e-9, "{areas:?}");
    assert!((areas[2] - 48.0).abs() < 1e-6, "the keyhole's {areas:?}");
    assert!((set.contours.structures[5].area(34.4) - 4.0).abs() < 1e-9);
    assert_eq!(set.rois.iter().map(|r| r.empty).collect::<Vec<_>>(), [false, false, false, true, true, false]);
    let roi = &set.rois[0];
    assert_eq!(
        (roi.interpreted_type.as_str(), roi.colour, roi.generation_algorithm.as_str()),
        ("ORGAN", Some([1, 2, 3]), "MANUAL")
    );
    assert_eq!((set.frame_of_reference.as_str(), set.label.as_str()), ("1.8", "bones"));
    assert!(set.referenced_series.contains("1.7.2"));
    let codes: Vec<&str> = set.warnings.iter().map(|w| w.code.as_str()).collect();
    assert_eq!(codes, ["structures-names", "structures-left-out", "structures-empty"]);
    assert!(set.warnings[1].message.contains("iso (1 OPEN_PLANAR, 1 POINT)"), "{:?}", set.warnings);
    assert!(set.warnings[1].message.contains("between (1 of 2 points)"), "{:?}", set.warnings);
    assert!(set.warnings[2].message.contains("iso, empty"), "{:?}", set.warnings);
    let file = read_contour_file(dir.path()).unwrap();
    assert_eq!((file.contours.structures.len(), &file.path, file.frame), (4, &path, None));
    assert_eq!(read_contours(&path).unwrap().0, file.contours);
}

#[test]
fn a_first_point_that_ends_a_contour_too_is_one_point_and_counts_are_checked() {
    let dir = tempfile::tempdir().unwrap();
    let mut points = square(4.0, 33.0);
    points.push(points[0]);
    let mut set = structure_set(&[Roi { name: "closed", contours: closed(vec![points]) }]);
    let read = read_structure_set(write(dir.path(), "rs", &set)).unwrap();
    assert_eq!(read.contours.structures[0].polygons[0].points.len(), 4);
    // It says 7 points and holds 5.
    let mut rois = set.take_element(tags::ROI_CONTOUR_SEQUENCE).unwrap().into_value().into_items().unwrap();
    let mut contours = rois[0].take_element(tags::CONTOUR_SEQUENCE).unwrap().into_value().into_items().unwrap();
    put(&mut contours[0], tags::NUMBER_OF_CONTOUR_POINTS, VR::IS, "7");
    put_items(&mut rois[0], tags::CONTOUR_SEQUENCE, contours.into_vec());
    put_items(&mut set, tags::ROI_CONTOUR_SEQUENCE, rois.into_vec());
    // It is left out by name, and nothing is left here.
    let error = read_structure_set(write(dir.path(), "rs", &set)).unwrap_err();
    assert!(error.code() == "structures-empty", "{error}");
}

/// What lies in an even number of contours of a plane is outside, by whichever name they say so.
#[test]
fn contours_that_exclude_each_other_are_read() {
    let dir = tempfile::tempdir().unwrap();
    for kind in ["CLOSEDPLANAR_XOR", "CLOSED_PLANAR_XOR"] {
        let ring = [square(4.0, 33.0), square(2.0, 33.0)].map(|points| (kind, points)).to_vec();
        let set = read_structure_set(write(dir.path(), "rs", &structure_set(&[Roi { name: "ring", contours: ring }])));
        let set = set.unwrap();
        let area = set.contours.structures[0].area(33.0);
        assert!((area - 48.0).abs() < 1e-9 && set.warnings.is_empty(), "{kind}: {area} {:?}", set.warnings);
    }
}

#[test]
fn sets_without_a_frame_are_told_and_several_or_mixed_refused() {
    let dir = tempfile::tempdir().unwrap();
    let mut set = structure_set(&[Roi { name: "a", contours: closed(vec![square(1.0, 0.0)]) }]);
    let mut item = Set::new_empty();
    put(&mut item, tags::ROI_NUMBER, VR::IS, "1");
    put_items(&mut set, tags::STRUCTURE_SET_ROI_SEQUENCE, vec![item]);
    set.remove_element(tags::REFERENCED_FRAME_OF_REFERENCE_SEQUENCE);
    write(dir.path(), "rs", &set);
    let read = read_structure_set(dir.path()).unwrap();
    assert!(read.frame_of_reference.is_empty() && read.rois[0].name == "ROI 1");
    assert!(read.warnings[0].is(findings::DICOM_FRAME), "{:?}", read.warnings);
    write(dir.path(), "rs2", &set);
    let error = read_structure_set(dir.path()).unwrap_err();
    assert!(error.code() == "structures-several" && error.to_string().contains("rs2"), "{error}");
    let sagittal: Vec<[f64; 3]> = square(3.0, 5.0).iter().map(|[x, y, z]| [*z, *y, *x]).collect();
    let both = [
        Roi { name: "axial", contours: closed(vec![square(4.0, 0.0)]) },
        Roi { name: "sagittal", contours: closed(vec![sagittal.clone()]) },
    ];
    let path = write(dir.path(), "rs", &structure_set(&both));
    let read = read_structure_set(&path).unwrap();
    assert!(!read.rois[0].empty && read.rois[1].empty);
    let told = read.warnings.iter().find(|w| w.is(findings::STRUCTURES_PLANES)).unwrap();
    assert!(told.message.contains("\"sagittal\"") && told.message.contains("90.0"), "{told:?}");
    let alone = structure_set(&[Roi { name: "sagittal", contours: closed(vec![sagittal.clone()]) }]);
    let read = read_structure_set(write(dir.path(), "rs", &alone)).unwrap();
    let polygon = &read.contours.structures[0].polygons[0];
    assert!((read.contours.structures[0].area(5.0) - 36.0).abs() < 1e-9);
    let back = read.contours.world(polygon.points[1], polygon.height);
    assert!((back.coords - nalgebra::Vector3::from(sagittal[1])).norm() < 1e-9);
    assert!(read.contours.axes.determinant() > 0.99);
    let nothing = structure_set(&[Roi { name: "iso", contours: vec![("POINT", vec![[0.0; 3]])] }]);
    assert_eq!(read_structure_set(write(dir.path(), "rs", &nothing)).unwrap_err().code(), "structures-empty");
}

#[test]
fn one_odd_structure_is_left_out_by_name() {
    let dir = tempfile::tempdir().unwrap();
    let tilted: Vec<[f64; 3]> = square(40.0, 33.0).iter().map(|[x, y, z]| [*x, *y, z + 0.2 * x]).collect();
    let mut all = structure_set(&[
        Roi { name: "tilted", contours: closed(vec![tilted.clone()]) },
        Roi { name: "short", contours: closed(vec![square(2.0, 33.0)]) },
        Roi { name: "whole", contours: closed(vec![square(2.0, 33.0)]) },
        Roi { name: "other", contours: closed(vec![square(3.0, 33.0)]) },
    ]);
    all.update_value(tags::ROI_CONTOUR_SEQUENCE, |value| {
        let item = &mut value.items_mut().unwrap()[1];
        item.update_value(tags::CONTOUR_SEQUENCE, |value| {
            put(&mut value.items_mut().unwrap()[0], tags::CONTOUR_DATA, VR::DS, "1\\2\\3\\4");
        });
    });
    let read = read_structure_set(write(dir.path(), "rs", &all)).unwrap();
    assert_eq!(read.rois.iter().map(|r| r.empty).collect::<Vec<_>>(), [true, true, false, false]);
    let codes: Vec<&str> = read.warnings.iter().map(|w| w.code.as_str()).collect();
    assert_eq!(codes, ["structures-odd", "structures-planes"]);
    assert!(read.warnings[0].message.contains("\"short\"") && read.warnings[1].message.contains("\"tilted\""));
    assert!((read.contours.structures[2].area(33.0) - 16.0).abs() < 1e-9);
}

#[test]
fn numbers_that_belong_to_several_structures_are_refused() {
    let dir = tempfile::tempdir().unwrap();
    let two = || {
        structure_set(&[
            Roi { name: "cord", contours: closed(vec![square(1.0, 33.0)]) },
            Roi { name: "parotid", contours: closed(vec![square(2.0, 33.0)]) },
        ])
    };
    let renumbered = |sequence, number| {
        let mut set = two();
        set.update_value(sequence, |value| put(&mut value.items_mut().unwrap()[1], number, VR::IS, "1"));
        write(dir.path(), "rs", &set)
    };
    let error = read_structure_set(renumbered(tags::STRUCTURE_SET_ROI_SEQUENCE, tags::ROI_NUMBER)).unwrap_err();
    let text = error.to_string();
    assert!(error.code() == "structures-numbers" && text.contains("\"cord\" and \"parotid\""), "{text}");
    let error = read_structure_set(renumbered(tags::ROI_CONTOUR_SEQUENCE, tags::REFERENCED_ROI_NUMBER)).unwrap_err();
    assert!(error.code() == "structures-numbers" && error.to_string().contains("\"cord\""), "{error}");
    let mut set = two();
    set.update_value(tags::RTROI_OBSERVATIONS_SEQUENCE, |value| {
        let item = &mut value.items_mut().unwrap()[1];
        put(item, tags::REFERENCED_ROI_NUMBER, VR::IS, "1.0");
        put(item, tags::RTROI_INTERPRETED_TYPE, VR::CS, "PTV");
    });
    let read = read_structure_set(write(dir.path(), "rs", &set)).unwrap();
    assert!(read.warnings[0].is(findings::STRUCTURES_NUMBERS) && read.rois[0].interpreted_type == "ORGAN");
}

/// A set of two axial structures, the second in the frame of reference `other`.
fn of_two_frames(other: &str) -> Set {
    let axial = |name| Roi { name, contours: closed(vec![square(2.0, 0.0)]) };
    let mut set = structure_set(&[axial("cord"), axial("gland")]);
    set.update_value(tags::STRUCTURE_SET_ROI_SEQUENCE, |value| {
        if let Some(item) = value.items_mut().and_then(|items| items.last_mut()) {
            put(item, tags::REFERENCED_FRAME_OF_REFERENCE_UID, VR::UI, other);
        }
    });
    set
}

#[test]
fn structures_of_another_frame_of_reference_are_left_out_by_name() {
    let dir = tempfile::tempdir().unwrap();
    let read = |set: &Set| read_structure_set(write(dir.path(), "rs", set)).unwrap();
    let kept = |set: &StructureSet| set.drawn().map(|(roi, _)| roi.name.clone()).collect::<Vec<_>>();
    let told = |set: &StructureSet, name: &str, frame: &str| {
        let [one] = set.warnings.as_slice() else { panic!("{:?}", set.warnings) };
        assert!(
            one.is(findings::STRUCTURES_FRAME) && one.message.contains(name) && one.message.contains(frame),
            "{one:?}"
        );
    };
    let first = read(&of_two_frames("1.88"));
    assert_eq!((kept(&first), first.frame_of_reference.as_str()), (vec!["cord".to_owned()], "1.8"));
    told(&first, "\"gland\"", "1.88");
    // That of the CT counts, where the set says which it is.
    let mut set = of_two_frames("1.88");
    let (mut image, mut series, mut study, mut frame) =
        (Set::new_empty(), Set::new_empty(), Set::new_empty(), Set::new_empty());
    put(&mut image, tags::REFERENCED_SOP_CLASS_UID, VR::UI, CT);
    put(&mut image, tags::REFERENCED_SOP_INSTANCE_UID, VR::UI, "1.5.0");
    put_items(&mut series, tags::CONTOUR_IMAGE_SEQUENCE, vec![image]);
    put(&mut series, tags::SERIES_INSTANCE_UID, VR::UI, "1.7.2");
    put_items(&mut study, tags::RT_REFERENCED_SERIES_SEQUENCE, vec![series]);
    put(&mut frame, tags::FRAME_OF_REFERENCE_UID, VR::UI, "1.88");
    put_items(&mut frame, tags::RT_REFERENCED_STUDY_SEQUENCE, vec![study]);
    put_items(&mut set, tags::REFERENCED_FRAME_OF_REFERENCE_SEQUENCE, vec![frame]);
    let ct = read(&set);
    assert_eq!((kept(&ct), ct.frame_of_reference.as_str()), (vec!["gland".to_owned()], "1.88"));
    told(&ct, "\"cord\"", "1.8");
    // Whoever asks for the frame alone gets the same.
    let frame = frame_of(Role::Structures.at(&dir.path().join("rs"))).unwrap();
    assert_eq!(frame.as_deref(), Some("1.88"));
}

#[test]
fn a_damaged_set_beside_a_good_one_is_named() {
    let dir = tempfile::tempdir().unwrap();
    let set = structure_set(&[Roi { name: "cord", contours: closed(vec![square(2.0, 0.0)]) }]);
    let good = write(dir.path(), "rs.dcm", &set);
    let bytes = std::fs::read(&good).unwrap();
    let cut = dir.path().join("other.dcm");
    // What is cut off behind its header is a second set.
    for (length, code) in
        [(bytes.len() / 2, "dicom-damaged"), (0, "dicom-damaged"), (bytes.len() - 9, "structures-several")]
    {
        std::fs::write(&cut, &bytes[..length]).unwrap();
        let error = read_structure_set(dir.path()).unwrap_err();
        assert!(error.code() == code && error.to_string().contains("other.dcm"), "{length}: {error}");
        assert!(read_structure_set(&good).unwrap().warnings.is_empty());
    }
    std::fs::write(&cut, &bytes[..bytes.len() / 2]).unwrap();
    std::fs::remove_file(&good).unwrap();
    assert!(read_structure_set(dir.path()).unwrap_err().to_string().contains("other.dcm"));
}

#[test]
fn images_that_a_set_was_drawn_on_and_that_are_gone_are_told_by_whoever_reads_the_series() {
    let dir = series(|_, _| {});
    let mut set = structure_set(&[Roi { name: "cord", contours: closed(vec![square(2.0, 33.0)]) }]);
    set.update_value(tags::REFERENCED_FRAME_OF_REFERENCE_SEQUENCE, |value| {
        let frame = &mut value.items_mut().unwrap()[0];
        let image = |uid: &str| {
            let mut item = Set::new_empty();
            put(&mut item, tags::REFERENCED_SOP_CLASS_UID, VR::UI, CT);
            put(&mut item, tags::REFERENCED_SOP_INSTANCE_UID, VR::UI, uid);
            item
        };
        let (mut series, mut study) = (Set::new_empty(), Set::new_empty());
        put(&mut series, tags::SERIES_INSTANCE_UID, VR::UI, "1.7.2");
        put_items(&mut series, tags::CONTOUR_IMAGE_SEQUENCE, (0..8).map(|k| image(&format!("1.5.{k}"))).collect());
        put_items(&mut study, tags::RT_REFERENCED_SERIES_SEQUENCE, vec![series]);
        put_items(frame, tags::RT_REFERENCED_STUDY_SEQUENCE, vec![study]);
    });
    let beside = write(dir.path(), "rs.dcm", &set);
    let told = |warnings: &[Warning]| {
        let [one] = warnings else { panic!("{warnings:?}") };
        assert!(one.is(findings::DICOM_FEWER), "{one:?}");
        assert!(one.message.contains("of the 8 images") && one.message.contains("1.5.6, 1.5.7"), "{one:?}");
    };
    told(&read_image(dir.path()).unwrap().warnings);
    told(&read_grid(dir.path()).unwrap().1);
    assert!(summary(dir.path(), false).unwrap().to_string().contains("of the 8 images"));
    // A set beside the series is told by it, one elsewhere by who uses both.
    assert_eq!(missing_images(&beside, dir.path()).unwrap(), None);
    let own = describe_series(dir.path()).unwrap().0;
    assert_eq!(read_structure_set(&beside).unwrap().missing_images(&own, dir.path()), None);
    let far = tempfile::tempdir().unwrap();
    let elsewhere = write(far.path(), "rs.dcm", &set);
    told(&missing_images(&elsewhere, dir.path()).unwrap().into_iter().collect::<Vec<_>>());
    let read = read_structure_set(&elsewhere).unwrap();
    told(&read.missing_images(&own, dir.path()).into_iter().collect::<Vec<_>>());
}
