//! What is written comes back through the room's own readers.

use super::fixture::{ct_of, oblique, origin};
use super::write::{DerivedDose, DerivedStructures, write_ct, write_dose, write_structures};
use super::{Roi, read_dose, read_series, read_structure_set};
use crate::geometry::Grid;
use crate::volume::Volume;
use crate::volume::contour::{Contours, Polygon, Structure};
use nalgebra::Vector3;
use std::collections::BTreeSet;

/// A grid, and the same place with the slices stored from the other end: a left-handed one.
fn both() -> [Grid; 2] {
    let right = oblique([8, 7, 5]);
    let mut direction = *right.direction();
    direction.column_mut(2).neg_mut();
    let left = Grid::new([8, 7, 5], right.spacing(), right.centre([0, 0, 4]), direction).unwrap();
    [right, left]
}

/// Every voxel of `a` is found in `b` at its place, within `step`.
fn same(a: &Volume<f32>, b: &Volume<f32>, step: f32) {
    assert_eq!(a.grid().len(), b.grid().len());
    for (n, value) in a.data().iter().enumerate() {
        let place = a.grid().centre(a.grid().voxel(n));
        let voxel = b.grid().voxel_at(&place).unwrap();
        assert!((b.grid().centre(voxel) - place).norm() < 1e-6);
        assert!((value - b.at(voxel)).abs() <= step, "{voxel:?}: {value} {}", b.at(voxel));
    }
}

#[test]
fn a_ct_comes_back() {
    for grid in both() {
        let dir = tempfile::tempdir().unwrap();
        let ct = Volume::from_fn(grid, |n| (n as f32).mul_add(7.3, -1000.0).min(3000.0));
        let written = write_ct(dir.path(), &ct, &ct_of("ct", "1.9"), &origin()).unwrap();
        let (back, series) = read_series(dir.path()).unwrap().value;
        same(&ct, &back, 0.501);
        assert_eq!(
            (&series.uid, &series.patient, &series.study.uid),
            (&written.uid, &written.patient, &written.study.uid)
        );
        assert_eq!(
            (&series.frame_of_reference, &series.patient_position),
            (&written.frame_of_reference, &written.patient_position)
        );
        for slice in &series.slices {
            let own = written.slices.iter().find(|s| s.uid == slice.uid).unwrap();
            assert!((own.position - slice.position).norm() < 1e-6);
        }
    }
}

#[test]
fn a_dose_comes_back() {
    for grid in both() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("RD.dcm");
        let dose = Volume::from_fn(grid, |n| 64.2 * (n as f32 * 0.1).sin().abs());
        let plans = BTreeSet::from(["1.2.3.77".to_owned()]);
        let about = DerivedDose {
            role: "dose",
            description: "dose",
            comment: "test",
            number: 3,
            frame_of_reference: "1.9",
            kind: "PHYSICAL",
            summation: "PLAN",
            plans: &plans,
            carried_by: None,
        };
        write_dose(&path, &dose, &about, &origin()).unwrap();
        let back = read_dose(&path).unwrap().value;
        same(&dose, &back.volume, 1e-5);
        assert_eq!((back.summation.as_str(), back.kind.as_str(), &back.plans), ("PLAN", "PHYSICAL", &plans));
        assert_eq!(back.series.frame_of_reference, "1.9");
    }
}

#[test]
fn contours_come_back_with_their_holes() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("RS.dcm");
    let grid = oblique([9, 9, 6]);
    let series = super::write::ct_series(&grid, &ct_of("ct", "1.9"), &origin());
    let axes = *grid.direction();
    let square = |k: usize, half: f64| {
        let middle = axes.transpose() * grid.centre([4, 4, k]).coords;
        let corner = |x: f64, y: f64| [middle.x + half * x, middle.y + half * y];
        let points = vec![corner(-1.0, -1.0), corner(1.0, -1.0), corner(1.0, 1.0), corner(-1.0, 1.0)];
        Polygon { height: middle.z, points }
    };
    let ring = (1..5).flat_map(|k| [square(k, 3.5), square(k, 1.25)]).collect();
    let full = (0..6).map(|k| square(k, 2.0)).collect();
    let structure = |name: &str, polygons| Structure { name: name.into(), colour: None, polygons };
    let contours = Contours {
        axes,
        structures: vec![structure("Ring ä", ring), structure("none", Vec::new()), structure("full", full)],
    };
    let roi = |number, name: &str, kind: &str| Roi {
        number,
        name: name.into(),
        interpreted_type: kind.into(),
        colour: Some([1, 2, 250]),
        ..Roi::default()
    };
    let rois = [roi(4, "Ring ä", "AVOIDANCE"), roi(9, "none", ""), roi(2, "full", "PTV")];
    let about =
        DerivedStructures { role: "rs", description: "contours", derivation: "test", number: 2, drawn_on: &series };
    write_structures(&path, &contours, &rois, &about, &origin()).unwrap();
    let back = read_structure_set(&path).unwrap();
    assert_eq!(back.frame_of_reference, "1.9");
    assert!(back.referenced_series.contains(&series.uid));
    for (n, roi) in rois.iter().enumerate() {
        let read = &back.rois[n];
        assert_eq!((read.number, &read.name, &read.interpreted_type), (roi.number, &roi.name, &roi.interpreted_type));
        assert_eq!((read.colour, read.empty), (roi.colour, n == 1));
        let [a, b] = [&contours.structures[n], &back.contours.structures[n]];
        assert!((a.volume(2.0) - b.volume(2.0)).abs() < 1e-2, "{}", roi.name);
        let spacing = grid.spacing()[2];
        let [inside, again] = [contours.solid(a, spacing), back.contours.solid(b, spacing)];
        for at in 0..400 {
            let share = |k: f64| 8.0 * (f64::from(at) * k).fract();
            let place = grid.world(&Vector3::new(share(0.618), share(0.754_877), 0.7 * share(0.569_84)));
            // Distances are sampled along axes that each chooses for itself.
            let depths = [inside.depth(&place), again.depth(&place)];
            let near = depths.iter().any(|d| d.abs() < 1.0);
            assert!(!near || (depths[0] - depths[1]).abs() < 0.08, "{}: {depths:?}", roi.name);
            assert!(near || depths[0].signum() * depths[1].signum() > 0.0, "{}: {depths:?}", roi.name);
        }
    }
}
