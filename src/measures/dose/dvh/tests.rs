//! Histograms by hand, and structures that once vanished.

use super::*;
use crate::geometry::Grid;
use crate::volume::contour::{Polygon, Structure};
use nalgebra::Matrix3;

fn close(a: f64, b: f64, what: &str) {
    assert!((a - b).abs() < 1e-6, "{what}: {a} {b}");
}

#[test]
fn a_wedge_of_dose_by_hand() {
    // 100 planes of 10 x 10 voxels with 0, 1, ... 99 Gy; a voxel has 0.006 ml.
    let grid = Grid::axis_aligned([100, 10, 10], [1.0, 2.0, 3.0], [0.0; 3]).unwrap();
    let dose = Volume::from_fn(grid.clone(), |l| grid.voxel(l)[0] as f32);
    let all = LabelMap { volume: Volume::filled(grid.clone(), 4), names: [(4, "target".to_owned())].into() };
    let d = dvh(&dose, &all, &[50.0, 99.5], 1.0).remove(0);
    close(d.volume_ml, 60.0, "volume");
    close(d.own_ml, 60.0, "own volume");
    close(d.mean, 49.5, "mean");
    close(d.d95, 5.0, "D95");
    close(d.d50, 50.0, "D50");
    close(d.d2, 98.0, "D2");
    close(d.d003cc, 99.0, "D0.03cc");
    close(d.v[0].percent, 50.0, "V50");
    close(d.v[1].percent, 0.0, "V99.5");
    close(d.cumulative[0], 1.0, "start");
    close(d.cumulative[30], 0.7, "V30");
    assert_eq!((d.name.as_str(), d.cumulative.len()), ("target", 101));
    // A dose grid that ends half way: the rest counts with nothing, and it says so.
    let short = Grid::axis_aligned([50, 10, 10], [1.0, 2.0, 3.0], [0.0; 3]).unwrap();
    let half = dvh(&Volume::filled(short, 10.0), &all, &[], 1.0).remove(0);
    close(half.outside_ml, 30.0, "outside");
    close(half.mean, 5.0, "mean of half");
    let found = doubts(&[half, d]);
    assert!(found.len() == 1 && found[0].message.contains("30.000 of 60.000 ml"), "{found:?}");
}

/// Boxes of contours: `low` to `high` along both axes on each plane.
fn boxes(name: &str, [low, high]: [f64; 2], heights: impl IntoIterator<Item = f64>) -> Structure {
    let points = vec![[low, low], [high, low], [high, high], [low, high]];
    let polygons = heights.into_iter().map(|height| Polygon { height, points: points.clone() }).collect();
    Structure { name: name.into(), colour: None, polygons }
}

/// A wedge of 1 Gy per mm along x on voxels of 4 mm, 20 mm to either side of the middle; 30 Gy there.
fn wedge() -> Volume<f32> {
    let grid = Grid::axis_aligned([11; 3], [4.0; 3], [-20.0; 3]).unwrap();
    Volume::from_fn(grid.clone(), |l| 30.0 + grid.centre(grid.voxel(l)).x as f32)
}

#[test]
fn no_structure_vanishes_and_no_layer_is_lost() {
    let structures = vec![
        boxes("through_centres", [-8.0, 8.0], (-3..3).map(|k| 4.0 * f64::from(k))),
        boxes("cochlea", [1.0, 3.0], [1.0, 2.0, 3.0]),
        boxes("half", [12.0, 32.0], (-3..3).map(|k| 4.0 * f64::from(k))),
        boxes("beyond", [93.0, 107.0], (-3..3).map(|k| 4.0 * f64::from(k))),
        boxes("nothing", [0.0, 0.0], []),
    ];
    let all = Contours { axes: Matrix3::identity(), structures };
    let list = dvh_of_contours(&wedge(), &all, &[20.0], 0.1);
    assert_eq!(list.len(), 5);
    let near = |a: f64, b: f64, what: &str| assert!((a - b).abs() < 0.01 * b, "{what}: {a} {b}");
    near(list[0].own_ml, 6.144, "own volume");
    near(list[0].volume_ml, 6.144, "sampled volume");
    near(list[0].mean, 30.0, "mean through centres");
    near(list[1].volume_ml, 0.012, "volume of a cochlea");
    near(list[1].mean, 32.0, "mean of a cochlea");
    // The dose ends at 22 mm along x and y: a quarter of the square, half of it along each.
    near(list[2].outside_ml, 0.75 * 9.6, "outside");
    near(list[3].outside_ml, list[3].volume_ml, "all outside");
    assert!(list[3].mean.is_nan() && list[3].d95.is_nan() && list[4].mean.is_nan());
    let found: Vec<(String, String)> = doubts(&list).into_iter().map(|w| (w.code, w.message)).collect();
    assert_eq!(found.len(), 3, "{found:?}");
    for ((code, message), (expected, word)) in found.iter().zip([
        ("structure-outside-dose", "\"half\""),
        ("structure-outside-dose", "wholly outside"),
        ("structure-empty", "\"nothing\""),
    ]) {
        assert!(code == expected && message.contains(word), "{found:?}");
    }
}

#[test]
fn coarse_labels_are_sampled_inside_their_voxels() {
    let grid = Grid::axis_aligned([2, 2, 2], [8.0; 3], [-4.0; 3]).unwrap();
    let map = LabelMap { volume: Volume::filled(grid, 1), names: [(1, "box".to_owned())].into() };
    let d = dvh(&wedge(), &map, &[], 0.1).remove(0);
    assert!((d.volume_ml - 4.096).abs() < 1e-9 && (d.mean - 30.0).abs() < 1e-4, "{d:?}");
    assert!((d.max - 36.0).abs() < 1e-4, "the outer parts lie at 6 mm: {}", d.max);
}
