//! Structure sets: every structure, point and reference as it is written.

use super::*;
use crate::geometry::Grid;
use crate::io::dicom::fixture::{items, numbers, oblique, open, origin, series_in, string};
use nalgebra::Matrix3;

fn square(height: f64, low: f64, high: f64) -> Polygon {
    Polygon { height, points: vec![[low, low], [high, low], [high, high + 0.123_456_7], [low, high]] }
}

fn roi(number: i64, name: &str, interpreted_type: &str) -> Roi {
    Roi {
        number,
        name: name.into(),
        interpreted_type: interpreted_type.into(),
        colour: Some([9, 80, 250]),
        ..Roi::default()
    }
}

fn about(series: &Series) -> DerivedStructures<'_> {
    DerivedStructures {
        role: "structures",
        description: "planning contours on fraction",
        derivation: "Contours carried by aventail. For research, not for treatment.",
        number: 902,
        drawn_on: series,
    }
}

/// Contours on slices 0 and 2 of a grid, and above it.
fn drawn(grid: &Grid) -> (Contours, Vec<Roi>) {
    let axes = *grid.direction();
    let height = |k: f64| axes.column(2).dot(&grid.world(&Vector3::new(0.0, 0.0, k)).coords);
    let structure = |name: &str, polygons| Structure { name: name.into(), colour: None, polygons };
    let structures = vec![
        structure("Kiefer links ä", vec![square(height(0.0), -9.0, 9.0), square(height(2.0), -9.0, 9.0)]),
        structure("empty", Vec::new()),
        structure(
            "ring",
            vec![square(height(1.45), -9.0, 9.0), square(height(1.45), -3.0, 3.0), square(height(7.0), 0.0, 1.0)],
        ),
    ];
    (Contours { axes, structures }, vec![roi(3, "Kiefer links ä", "ORGAN"), roi(7, "empty", ""), roi(5, "ring", "PTV")])
}

#[test]
fn structures_keep_name_number_type_colour_and_every_point() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("RS.dcm");
    let grid = oblique([9, 9, 4]);
    let series = series_in("1.2.3.4", "fraction", "1.9.1", &grid);
    let (contours, rois) = drawn(&grid);
    write_structures(&path, &contours, &rois, &about(&series), &origin()).unwrap();
    let object = open(&path);
    assert_eq!(string(&object, tags::APPROVAL_STATUS), "UNAPPROVED");
    assert!(string(&object, tags::STRUCTURE_SET_LABEL).len() <= 16);
    assert!(string(&object, tags::STRUCTURE_SET_DESCRIPTION).contains("not for treatment"));
    let [frame] = items(&object, tags::REFERENCED_FRAME_OF_REFERENCE_SEQUENCE) else { panic!() };
    assert_eq!(string(frame, tags::FRAME_OF_REFERENCE_UID), "1.9.1");
    let [study] = items(frame, tags::RT_REFERENCED_STUDY_SEQUENCE) else { panic!() };
    assert_eq!(string(study, tags::REFERENCED_SOP_INSTANCE_UID), "1.2.3.4");
    let [listed] = items(study, tags::RT_REFERENCED_SERIES_SEQUENCE) else { panic!() };
    assert_eq!(string(listed, tags::SERIES_INSTANCE_UID), series.uid);
    assert_eq!(items(listed, tags::CONTOUR_IMAGE_SEQUENCE).len(), 4);
    let named = items(&object, tags::STRUCTURE_SET_ROI_SEQUENCE);
    let observed = items(&object, tags::RTROI_OBSERVATIONS_SEQUENCE);
    let outlined = items(&object, tags::ROI_CONTOUR_SEQUENCE);
    assert_eq!([named.len(), observed.len(), outlined.len()], [3; 3]);
    for (n, (number, name, kind)) in
        [(3.0, "Kiefer links ä", "ORGAN"), (7.0, "empty", ""), (5.0, "ring", "PTV")].iter().enumerate()
    {
        assert_eq!(numbers(&named[n], tags::ROI_NUMBER), [*number]);
        assert_eq!(string(&named[n], tags::ROI_NAME).trim_end(), *name);
        assert_eq!(numbers(&observed[n], tags::REFERENCED_ROI_NUMBER), [*number]);
        assert_eq!(string(&observed[n], tags::RTROI_INTERPRETED_TYPE).trim_end(), *kind);
        assert_eq!(numbers(&outlined[n], tags::REFERENCED_ROI_NUMBER), [*number]);
        assert_eq!(numbers(&outlined[n], tags::ROI_DISPLAY_COLOR), [9.0, 80.0, 250.0]);
    }
    assert!(outlined[1].get(tags::CONTOUR_SEQUENCE).is_none());
    let [low, high] = items(&outlined[0], tags::CONTOUR_SEQUENCE) else { panic!() };
    for (item, polygon, slice) in
        [(low, &contours.structures[0].polygons[0], 0), (high, &contours.structures[0].polygons[1], 2)]
    {
        assert_eq!(string(item, tags::CONTOUR_GEOMETRIC_TYPE), "CLOSED_PLANAR");
        assert_eq!(numbers(item, tags::NUMBER_OF_CONTOUR_POINTS), [4.0]);
        let data = numbers(item, tags::CONTOUR_DATA);
        let expected: Vec<f64> = polygon
            .points
            .iter()
            .flat_map(|p| contours.world(*p, polygon.height).iter().copied().collect::<Vec<_>>())
            .collect();
        assert!(data.len() == 12 && data.iter().zip(expected).all(|(a, b)| (a - b).abs() <= 0.51e-4));
        let [image] = items(item, tags::CONTOUR_IMAGE_SEQUENCE) else { panic!() };
        assert_eq!(string(image, tags::REFERENCED_SOP_INSTANCE_UID), series.slices[slice].uid);
    }
}

#[test]
fn holes_become_keyholes_and_planes_find_their_image() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("RS.dcm");
    let grid = oblique([9, 9, 4]);
    let series = series_in("1.2.3.4", "fraction", "1.9.1", &grid);
    let (contours, rois) = drawn(&grid);
    write_structures(&path, &contours, &rois, &about(&series), &origin()).unwrap();
    let object = open(&path);
    let [ring, beyond] = items(&items(&object, tags::ROI_CONTOUR_SEQUENCE)[2], tags::CONTOUR_SEQUENCE) else {
        panic!()
    };
    assert_eq!(numbers(ring, tags::NUMBER_OF_CONTOUR_POINTS), [10.0]);
    let points: Vec<[f64; 2]> = numbers(ring, tags::CONTOUR_DATA)
        .chunks(3)
        .map(|p| (contours.axes.transpose() * Vector3::from_column_slice(p)).xy().into())
        .collect();
    let next = points.iter().cycle().skip(1);
    let area: f64 = points.iter().zip(next).map(|(a, b)| 0.5 * (a[0] * b[1] - b[0] * a[1])).sum();
    let solid = |half: f64| 4.0 * half * half + half * 0.123_456_7;
    assert!((area.abs() - (solid(9.0) - solid(3.0))).abs() < 0.01, "{area}");
    // Height 1.45 is nearer to slice 1; height 7 is beyond the last slice.
    let [image] = items(ring, tags::CONTOUR_IMAGE_SEQUENCE) else { panic!() };
    assert_eq!(string(image, tags::REFERENCED_SOP_INSTANCE_UID), series.slices[1].uid);
    assert!(beyond.get(tags::CONTOUR_IMAGE_SEQUENCE).is_none());
}

#[test]
fn what_dicom_has_no_room_for_is_refused() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("RS.dcm");
    let series = series_in("1.2.3.4", "fraction", "1.9.1", &oblique([9, 9, 4]));
    let contours = |n: usize| Contours {
        axes: Matrix3::identity(),
        structures: (0..n).map(|k| Structure { name: k.to_string(), colour: None, polygons: Vec::new() }).collect(),
    };
    let refused = |rois: &[Roi], series: &Series, word: &str| {
        let error = write_structures(&path, &contours(rois.len()), rois, &about(series), &origin()).unwrap_err();
        assert!(error.to_string().contains(word), "{error}");
    };
    refused(&[roi(1, "a", ""), roi(1, "b", "")], &series, "number 1");
    refused(&[roi(1, &"x".repeat(65), "")], &series, "64 characters");
    refused(&[roi(1, "a\\b", "")], &series, "backslash");
    let bare = Series { slices: Vec::new(), ..series.clone() };
    refused(&[roi(1, "a", "")], &bare, "no slices");
    assert!(!path.exists());
    assert!(write_structures(&path, &contours(2), &[roi(1, "a", "")], &about(&series), &origin()).is_err());
}
