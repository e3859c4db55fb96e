//! CT series: every voxel, place and identity as it is written.

use super::*;
use crate::io::dicom::fixture::{ct_of, items, numbers, oblique, open, origin, series_in, string};
use nalgebra::{Matrix3, Point3};

fn image(grid: &Grid) -> Volume<f32> {
    Volume::from_fn(grid.clone(), |n| (n as f32).mul_add(0.9, -1024.0))
}

/// Pixels, which dicom-rs reads without their sign.
fn stored(object: &InMemDicomObject) -> Vec<i16> {
    assert_eq!(numbers(object, tags::PIXEL_REPRESENTATION), [1.0]);
    let words = object.element(tags::PIXEL_DATA).unwrap().to_multi_int::<u16>().unwrap();
    words.into_iter().map(u16::cast_signed).collect()
}

#[test]
fn slices_hold_every_value_and_lie_where_the_grid_does() {
    let dir = tempfile::tempdir().unwrap();
    let grid = oblique([7, 5, 4]);
    let ct = image(&grid);
    let source = series_in("1.2.3.4", "source", "1.9", &grid);
    let about = DerivedCt { sources: &[&source], ..ct_of("ct", "1.9") };
    let series = write_ct(dir.path(), &ct, &about, &origin()).unwrap();
    assert_eq!(series, ct_series(&grid, &about, &origin()));
    for k in 0..4 {
        let object = open(&dir.path().join(format!("CT.{:04}.dcm", k + 1)));
        assert_eq!(object.meta().transfer_syntax(), uids::EXPLICIT_VR_LITTLE_ENDIAN);
        assert_eq!(string(&object, tags::SOP_INSTANCE_UID), series.slices[k].uid);
        assert_eq!(object.meta().media_storage_sop_instance_uid().trim_end_matches('\0'), series.slices[k].uid);
        for (tag, expected) in [
            (tags::SOP_CLASS_UID, uids::CT_IMAGE_STORAGE),
            (tags::MODALITY, "CT"),
            (tags::PATIENT_NAME, "Müller^Jürgen"),
            (tags::PATIENT_ID, "HN 0001"),
            (tags::PATIENT_BIRTH_DATE, "19500102"),
            (tags::STUDY_INSTANCE_UID, "1.2.3.4"),
            (tags::STUDY_DATE, "20261124"),
            (tags::SERIES_DATE, "20261125"),
            (tags::SERIES_INSTANCE_UID, &series.uid),
            (tags::FRAME_OF_REFERENCE_UID, "1.9"),
            (tags::PATIENT_POSITION, "HFS"),
            (tags::IMAGE_TYPE, "DERIVED\\SECONDARY\\AXIAL"),
            (tags::SPECIFIC_CHARACTER_SET, "ISO_IR 192"),
            (tags::MANUFACTURER, "aventail"),
        ] {
            assert_eq!(string(&object, tag), expected, "{tag}");
        }
        assert_eq!(numbers(&object, tags::INSTANCE_NUMBER), [k as f64 + 1.0]);
        let position = Point3::from_slice(&numbers(&object, tags::IMAGE_POSITION_PATIENT));
        let o = numbers(&object, tags::IMAGE_ORIENTATION_PATIENT);
        let spacing = numbers(&object, tags::PIXEL_SPACING);
        let [intercept] = numbers(&object, tags::RESCALE_INTERCEPT)[..] else { panic!() };
        let stored = stored(&object);
        assert_eq!(numbers(&object, tags::COLUMNS), [7.0]);
        assert_eq!((numbers(&object, tags::ROWS), stored.len()), (vec![5.0], 35));
        for (n, value) in stored.iter().enumerate() {
            let (i, j) = (n % 7, n / 7);
            // The equation of PS3.3 C.7.6.2.1.1: columns run along the first direction, with the second spacing.
            let place = |a: usize| position[a] + o[a] * spacing[1] * i as f64 + o[3 + a] * spacing[0] * j as f64;
            let apart = (grid.centre([i, j, k]) - Point3::from([0, 1, 2].map(place))).norm();
            assert!(apart < 1e-9, "{i} {j} {k}: {apart} mm");
            assert!((f64::from(*value) + intercept - f64::from(*ct.at([i, j, k]))).abs() <= 0.5);
        }
        let sources = items(&object, tags::SOURCE_IMAGE_SEQUENCE);
        assert_eq!(sources.len(), 4);
        assert_eq!(string(&sources[1], tags::REFERENCED_SOP_INSTANCE_UID), source.slices[1].uid);
    }
}

#[test]
fn the_same_input_gives_the_same_bytes_and_another_other_uids() {
    let grid = oblique([3, 3, 2]);
    let bytes = |origin: &Origin| {
        let dir = tempfile::tempdir().unwrap();
        write_ct(dir.path(), &image(&grid), &ct_of("ct", "1.9"), origin).unwrap();
        std::fs::read(dir.path().join("CT.0002.dcm")).unwrap()
    };
    assert_eq!(bytes(&origin()), bytes(&origin()));
    let mut other = origin();
    other.parts[1] = "other settings".into();
    let [a, b] = [origin(), other].map(|o| ct_series(&grid, &ct_of("ct", "1.9"), &o));
    assert!(a.uid != b.uid && a.slices[0].uid != b.slices[0].uid && a.slices[0].uid != a.slices[1].uid);
}

#[test]
fn values_choose_the_intercept_or_are_refused() {
    let grid = Grid::new([2, 1, 1], [1.0; 3], Point3::origin(), Matrix3::identity()).unwrap();
    let written = |values: [f32; 2]| {
        let dir = tempfile::tempdir().unwrap();
        let ct = Volume::new(grid.clone(), values.to_vec()).unwrap();
        write_ct(dir.path(), &ct, &ct_of("ct", "1.9"), &origin())?;
        let object = open(&dir.path().join("CT.0001.dcm"));
        let stored = stored(&object);
        Ok::<_, Error>((numbers(&object, tags::RESCALE_INTERCEPT)[0], stored))
    };
    assert_eq!(written([-1024.0, 3071.4]).unwrap(), (-1024.0, vec![0, 4095]));
    assert_eq!(written([-1500.0, 31_743.0]).unwrap(), (-1024.0, vec![-476, 32_767]));
    assert_eq!(written([-1024.0, 32_767.0]).unwrap(), (0.0, vec![-1024, 32_767]));
    for bad in [[0.0, 32_768.0], [-32_769.0, 32_000.0], [f32::NAN, 0.0], [0.0, f32::INFINITY]] {
        assert_eq!(written(bad).unwrap_err().exit_code(), 5, "{bad:?}");
    }
}

#[test]
fn a_series_without_a_date_leads_to_objects_without_one() {
    let mut series = series_in("1.2.3.4", "source", "1.9", &oblique([2, 2, 2]));
    assert_eq!(Origin::beside(&series, None, vec![]).when.date, "20261125");
    series.date = String::new();
    assert_eq!(Origin::beside(&series, None, vec![]).when.date, "20261124");
    series.study.date = String::new();
    let origin = Origin::beside(&series, None, vec![]);
    let dir = tempfile::tempdir().unwrap();
    let ct = image(&oblique([2, 2, 2]));
    write_ct(dir.path(), &ct, &ct_of("ct", "1.9"), &origin).unwrap();
    assert!(open(&dir.path().join("CT.0001.dcm")).get(tags::SERIES_DATE).is_none());
}
