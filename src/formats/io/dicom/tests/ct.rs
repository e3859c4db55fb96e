//! Series in order, and what is wrong with others.

use super::super::read_series;
use super::make::*;
use crate::error::Error;
use crate::findings;
use crate::io::checksum::sha256_file;
use crate::io::{read_grid, read_image};
use dicom_core::VR;
use dicom_dictionary_std::tags;
use nalgebra::Vector3;

/// The refusal of a series that is changed so.
fn refused(code: &str, words: &[&str], change: impl Fn(usize, &mut Set)) {
    let dir = series(change);
    let error: Error = read_image(dir.path()).unwrap_err();
    let text = error.to_string();
    assert_eq!(error.code(), code, "{text}");
    words.iter().for_each(|word| assert!(text.contains(word), "{word}: {text}"));
}

fn moved(set: &mut Set, by: [f64; 3], k: usize) {
    let p = [-10.0 + by[0], -20.0 + by[1], 30.0 + 3.0 * k as f64 + by[2]];
    put(set, tags::IMAGE_POSITION_PATIENT, VR::DS, &list(&p));
}

#[test]
fn slices_are_ordered_by_position_and_scaled_one_by_one() {
    let dir = series(|k, set| {
        if k == 4 {
            put(set, tags::RESCALE_SLOPE, VR::DS, "1");
            put(set, tags::RESCALE_INTERCEPT, VR::DS, "-1000");
        }
    });
    let read = read_series(dir.path()).unwrap();
    let (volume, series) = &read.value;
    let grid = volume.grid();
    assert_eq!(grid.size(), SIZE);
    // Pixel Spacing begins with the distance between rows.
    assert_eq!(grid.spacing(), [1.5, 2.0, 3.0]);
    assert_eq!(grid.origin(), [-10.0, -20.0, 30.0].into());
    for at in 0..grid.len() {
        let [i, j, k] = grid.voxel(at);
        let expected = if k == 4 { f32::from(stored(i, j, k)) - 1000.0 } else { hu(i, j, k) };
        assert_eq!(volume.data()[at], expected, "{i} {j} {k}");
    }
    assert!(read.warnings.is_empty(), "{:?}", read.warnings);
    assert_eq!((series.uid.as_str(), series.number, series.modality.as_str()), ("1.7.2", Some(2), "CT"));
    assert_eq!((series.patient.name.as_str(), series.frame_of_reference.as_str()), ("Müller^Jürgen", "1.8"));
    assert_eq!(series.slices[3].uid, "1.5.3");
    assert_eq!(series.slices[3].position, [-10.0, -20.0, 39.0].into());
    assert_eq!(sha256_file(dir.path()).unwrap(), read.sha256);
    assert!(read_grid(dir.path()).unwrap().0.matches(grid, 1e-9));
}

#[test]
fn any_position_of_the_patient_comes_out_right() {
    // Prone, feet first, decubitus, sagittal and oblique: rows and columns as they lie in the
    // patient.
    let (s, c) = 0.3f64.sin_cos();
    for o in [
        [-1.0, 0.0, 0.0, 0.0, -1.0, 0.0],
        [1.0, 0.0, 0.0, 0.0, -1.0, 0.0],
        [0.0, 1.0, 0.0, -1.0, 0.0, 0.0],
        [0.0, 1.0, 0.0, 0.0, 0.0, -1.0],
        [c, s, 0.0, -s, c, 0.0],
        [1.0, 0.0, 0.0, 0.0, c, -s],
    ] {
        let (row, column) = (Vector3::new(o[0], o[1], o[2]), Vector3::new(o[3], o[4], o[5]));
        let normal = row.cross(&column);
        // Slices are numbered against the normal.
        let place = |k: usize| Vector3::new(-10.0, -20.0, 30.0) - normal * 3.0 * k as f64;
        let dir = series(|k, set| {
            put(set, tags::IMAGE_ORIENTATION_PATIENT, VR::DS, &list(&o));
            put(set, tags::IMAGE_POSITION_PATIENT, VR::DS, &list(place(k).as_slice()));
        });
        let read = read_image(dir.path()).unwrap().value;
        assert!(read.grid().direction().determinant() > 0.99);
        for (i, j, k) in [(0, 0, 0), (4, 1, 5), (2, 3, 1)] {
            let world = place(k) + row * 1.5 * i as f64 + column * 2.0 * j as f64;
            let voxel = read.grid().voxel_at(&world.into()).unwrap();
            assert_eq!(read.data()[read.grid().linear(voxel)], hu(i, j, k), "{o:?}");
            assert!((read.grid().centre(voxel).coords - world).norm() < 1e-4);
        }
    }
}

#[test]
fn missing_slices_are_named_by_their_neighbours() {
    let skip = |gone: &'static [usize]| {
        move |k: usize, set: &mut Set| moved(set, [0.0, 0.0, 3.0 * gone.iter().filter(|g| **g <= k).count() as f64], k)
    };
    refused("dicom-gap", &["a slice is missing between z = 36.00 mm and z = 42.00 mm", "3.00 mm apart"], skip(&[3]));
    refused("dicom-gap", &["2 slices are missing between z = 33.00 mm and z = 42.00 mm"], skip(&[2, 2]));
    refused("dicom-gap", &["but 4.00 mm between z = 42.00 mm and z = 46.00 mm"], |k, set| {
        moved(set, [0.0, 0.0, f64::from(u8::from(k == 5))], k);
    });
    // One that lies too near is as odd as one that lies too far.
    refused("dicom-gap", &["but 2.00 mm between z = 42.00 mm and z = 44.00 mm"], |k, set| {
        moved(set, [0.0, 0.0, -f64::from(u8::from(k == 5))], k);
    });
    // A hundredth is rounding.
    let dir = series(|k, set| moved(set, [0.0, 0.0, 0.01 * (k % 2) as f64], k));
    assert!((read_image(dir.path()).unwrap().value.grid().spacing()[2] - 3.002).abs() < 1e-9);
}

#[test]
fn slices_on_one_place_are_one_or_refused() {
    let dir = series(|_, _| ());
    let once = read_image(dir.path()).unwrap();
    write(dir.path(), "copy", &slice(2));
    let mut other = slice(4);
    put(&mut other, tags::SOP_INSTANCE_UID, VR::UI, "1.5.44");
    write(dir.path(), "export", &other);
    let read = read_image(dir.path()).unwrap();
    assert_eq!(read.value, once.value);
    assert!(
        read.warnings.len() == 1 && read.warnings[0].message.contains("2 images are there twice"),
        "{:?}",
        read.warnings
    );
    assert_eq!(sha256_file(dir.path()).unwrap(), read.sha256);
    // The same values beside the place are another slice.
    let mut beside = slice(2);
    put(&mut beside, tags::SOP_INSTANCE_UID, VR::UI, "1.5.22");
    moved(&mut beside, [4.0, 0.0, 0.0], 2);
    let aside = write(dir.path(), "beside", &beside);
    assert_eq!(read_image(dir.path()).unwrap_err().code(), "dicom-duplicates");
    std::fs::remove_file(aside).unwrap();
    let mut phase = slice(3);
    put(&mut phase, tags::SOP_INSTANCE_UID, VR::UI, "1.5.33");
    put(&mut phase, tags::ACQUISITION_NUMBER, VR::IS, "2");
    pixels(&mut phase, vec![7; SIZE[0] * SIZE[1]]);
    write(dir.path(), "phase", &phase);
    let error = read_image(dir.path()).unwrap_err();
    let text = error.to_string();
    assert_eq!(error.code(), "dicom-duplicates", "{text}");
    assert!(text.contains("z = 39.00 mm") && text.contains("acquisition 2") && text.contains("phases"), "{text}");
}

#[test]
fn a_tilted_gantry_is_refused_with_its_angle() {
    refused("dicom-tilt", &["5.71 degrees", "1.5 mm aside"], |k, set| moved(set, [0.0, 0.3 * k as f64, 0.0], k));
    refused("dicom-tilt", &["displaced", "z = 36.00 mm", "0.8 mm"], |k, set| {
        moved(set, [0.0, if k == 2 { 0.8 } else { 0.0 }, 0.0], k);
    });
}

#[test]
fn images_that_belong_to_no_one_volume_are_refused() {
    refused("dicom-images-differ", &["orientations differ", "0.9950"], |k, set| {
        if k == 1 {
            put(set, tags::IMAGE_ORIENTATION_PATIENT, VR::DS, "0.99500417\\0.09983342\\0\\-0.09983342\\0.99500417\\0");
        }
    });
    refused("dicom-images-differ", &["pixel spacings differ"], |k, set| {
        if k == 3 {
            put(set, tags::PIXEL_SPACING, VR::DS, "2.1\\1.5");
        }
    });
    refused("dicom-frame", &["several frames of reference"], |k, set| {
        if k == 3 {
            put(set, tags::FRAME_OF_REFERENCE_UID, VR::UI, "1.88");
        }
    });
    refused("dicom-incomplete", &["Pixel Spacing"], |_, set| {
        set.remove_element(tags::PIXEL_SPACING);
    });
    refused("dicom-incomplete", &["Rescale Slope"], |_, set| {
        set.remove_element(tags::RESCALE_INTERCEPT);
    });
    refused("dicom-incomplete", &["no pair of perpendicular unit vectors"], |_, set| {
        put(set, tags::IMAGE_ORIENTATION_PATIENT, VR::DS, "1\\0\\0\\0.1\\0.99498744\\0");
    });
    refused("dicom-unit", &["Z_EFF"], |_, set| put(set, tags::RESCALE_TYPE, VR::LO, "Z_EFF"));
}

#[test]
fn localizers_are_left_out() {
    let dir = series(|_, _| ());
    let mut scout = slice(0);
    put(&mut scout, tags::IMAGE_TYPE, VR::CS, "ORIGINAL\\PRIMARY\\LOCALIZER");
    put(&mut scout, tags::SOP_INSTANCE_UID, VR::UI, "1.5.99");
    put(&mut scout, tags::IMAGE_ORIENTATION_PATIENT, VR::DS, "1\\0\\0\\0\\0\\-1");
    write(dir.path(), "scout", &scout);
    let read = read_image(dir.path()).unwrap();
    assert_eq!(read.value.grid().size(), SIZE);
    assert!(read.warnings[0].is(findings::DICOM_LEFT_OUT) && read.warnings[0].message.contains("1 localizers"));
    // A series of its own does not make the choice doubtful.
    put(&mut scout, tags::SERIES_INSTANCE_UID, VR::UI, "1.7.1");
    write(dir.path(), "scout", &scout);
    assert!(read_image(dir.path()).unwrap().warnings.is_empty());
}

#[test]
fn loss_and_a_missing_frame_are_told() {
    let dir = series(|_, set| {
        put(set, tags::LOSSY_IMAGE_COMPRESSION, VR::CS, "01");
        put(set, tags::LOSSY_IMAGE_COMPRESSION_RATIO, VR::DS, "12.5");
        set.remove_element(tags::FRAME_OF_REFERENCE_UID);
        put(set, tags::RESCALE_TYPE, VR::LO, "US");
    });
    let read = read_image(dir.path()).unwrap();
    let codes: Vec<&str> = read.warnings.iter().map(|w| w.code.as_str()).collect();
    assert_eq!(codes, ["dicom-lossy", "dicom-unit", "dicom-frame"]);
    assert!(read.warnings[0].message.contains("12.5"));
}
