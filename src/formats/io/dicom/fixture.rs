//! What tests of written objects start from.

use super::series::{Patient, Series, Study};
use super::write::{DerivedCt, Origin, When, ct_series};
use crate::geometry::Grid;
use dicom_core::Tag;
use dicom_object::{FileDicomObject, InMemDicomObject, open_file};
use nalgebra::{Point3, Rotation3, Vector3};
use std::path::Path;

/// A patient whose name is no ASCII, in a study with a date.
pub(super) fn origin() -> Origin {
    let patient =
        Patient {
            name: "Müller^Jürgen".into(), id: "HN 0001".into(), birth_date: "19500102".into(), sex: "O".into()
        };
    let study = Study { uid: "1.2.3.4".into(), date: "20261124".into(), id: "7".into(), ..Study::default() };
    let when = When { date: "20261125".into(), time: "101112".into() };
    Origin { patient, study, when, parts: vec!["1.2.3.9".into(), "settings".into()] }
}

/// A grid of that size, turned about every axis, with uneven spacing and a position that takes many digits.
pub(super) fn oblique(size: [usize; 3]) -> Grid {
    let turn = Rotation3::from_scaled_axis(Vector3::new(0.2, -0.35, 0.5)).into_inner();
    Grid::new(size, [1.1, 0.9, 1.0 / 0.35], Point3::new(-120.123_456_789, 33.3, -801.000_123_4), turn).unwrap()
}

/// A CT series of a frame of reference, as it would be written for a grid.
pub(super) fn ct_of<'a>(role: &'a str, frame_of_reference: &'a str) -> DerivedCt<'a> {
    DerivedCt {
        role,
        description: "test",
        derivation: "made by a test",
        number: 901,
        frame_of_reference,
        patient_position: "HFS",
        sources: &[],
    }
}

/// The series of a grid in a study.
pub(super) fn series_in(study: &str, role: &str, frame_of_reference: &str, grid: &Grid) -> Series {
    let mut origin = origin();
    origin.study.uid = study.into();
    ct_series(grid, &ct_of(role, frame_of_reference), &origin)
}

pub(super) fn open(path: &Path) -> FileDicomObject<InMemDicomObject> {
    open_file(path).unwrap()
}

pub(super) fn string(object: &InMemDicomObject, tag: Tag) -> String {
    object.element(tag).unwrap().to_str().unwrap().into_owned()
}

/// Numbers of an element, each of whose texts is a decimal string that fits.
pub(super) fn numbers(object: &InMemDicomObject, tag: Tag) -> Vec<f64> {
    let element = object.element(tag).unwrap();
    if element.vr() == dicom_core::VR::DS {
        assert!(element.to_str().unwrap().split('\\').all(|t| t.trim().len() <= 16));
    }
    element.to_multi_float64().unwrap()
}

pub(super) fn items(object: &InMemDicomObject, tag: Tag) -> &[InMemDicomObject] {
    object.element(tag).unwrap().items().unwrap()
}
