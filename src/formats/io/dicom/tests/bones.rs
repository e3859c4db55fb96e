//! Structures to bones.

use super::super::{BoneNames, labels_from_structures, organs_from_structures, read_structure_set};
use super::make::*;
use crate::geometry::Grid;
use crate::io::read_bones;
use crate::skeleton::anatomy::Kind;

#[test]
fn common_names_are_bones_and_others_are_not() {
    let names = BoneNames::default();
    for own in Kind::names() {
        assert_eq!(names.bone(&own).as_ref(), Some(&own));
    }
    for (spelt, bone) in [
        ("Bone_Mandible", "mandible"),
        ("MANDIBLE", "mandible"),
        ("Unterkiefer", "mandible"),
        ("VB_C1", "vertebrae_C1"),
        ("C1", "vertebrae_C1"),
        ("Atlas", "vertebrae_C1"),
        ("VB_T01", "vertebrae_T1"),
        ("Th12", "vertebrae_T12"),
        ("HWK 7", "vertebrae_C7"),
        ("Vertebra L5", "vertebrae_L5"),
        ("Femur_Head_L", "femur_left"),
        ("femur head right", "femur_right"),
        ("Lt Femur", "femur_left"),
        ("Clavicle_R", "clavicula_right"),
        ("Rib01_L", "rib_left_1"),
        ("rib r 12", "rib_right_12"),
        ("Bone_Hyoid", "hyoid"),
        ("Schädel", "skull"),
        ("Bone_Ilium_L", "hip_left"),
    ] {
        assert_eq!(names.bone(spelt).as_deref(), Some(bone), "{spelt}");
    }
    for other in
        ["PTV", "C8", "C0", "T13", "Rib13_L", "Femur", "Mandible_PRV05", "Parotid_L", "L", "R", "Lung_L", "BODY", ""]
    {
        assert_eq!(names.bone(other), None, "{other}");
    }
}

#[test]
fn a_file_of_names_comes_first() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("names.toml");
    std::fs::write(&path, "[bones]\n\"Kiefer links ä\" = \"mandible\"\n\"C1\" = \"\"\n").unwrap();
    let names = BoneNames::read(&path).unwrap();
    assert_eq!(names.bone("kiefer_LINKS Ä").as_deref(), Some("mandible"));
    assert_eq!((names.bone("c1"), names.bone("C2").as_deref()), (None, Some("vertebrae_C2")));
    std::fs::write(&path, "[bones]\n\"a\" = \"jawbone\"\n").unwrap();
    assert!(BoneNames::read(&path).unwrap_err().to_string().contains("jawbone"));
    std::fs::write(&path, "[bone]\n").unwrap();
    assert_eq!(BoneNames::read(&path).unwrap_err().exit_code(), 3);
}

#[test]
fn bones_are_drawn_on_the_planning_grid() {
    let dir = tempfile::tempdir().unwrap();
    let tube = |half: f64, shift: f64| {
        let polygon = |z: f64| square(half, z).into_iter().map(|[x, y, z]| [x + shift, y, z]).collect();
        (0..4).map(|k| ("CLOSED_PLANAR", polygon(f64::from(k) * 3.0))).collect::<Vec<_>>()
    };
    let rois = [
        Roi { name: "Bone_Mandible", contours: tube(4.0, 0.0) },
        // Drawn over the mandible's left by 2 mm.
        Roi { name: "VB_C1", contours: tube(4.0, 6.0) },
        Roi { name: "PTV 70", contours: tube(9.0, 0.0) },
        Roi { name: "sternum", contours: tube(1.0, 500.0) },
    ];
    let path = write(dir.path(), "rs", &structure_set(&rois));
    let set = read_structure_set(&path).unwrap();
    let grid = Grid::axis_aligned([50, 40, 12], [0.5, 0.5, 1.5], [-15.25, -26.75, -1.5]).unwrap();
    let drawn = labels_from_structures(&set, &grid, &BoneNames::default()).unwrap();
    assert_eq!(drawn.unrecognised, ["PTV 70"]);
    let names: Vec<&str> = drawn.map.names.values().map(String::as_str).collect();
    assert_eq!(names, ["mandible", "sternum", "vertebrae_C1"]);
    let at = |x: f64, y: f64, z: f64| {
        let label = drawn.map.volume.data()[grid.linear(grid.voxel_at(&[x, y, z].into()).unwrap())];
        drawn.map.names.get(&label).map(String::as_str)
    };
    assert_eq!(at(-10.9, -17.0, 4.5), Some("mandible"));
    assert_eq!(at(-11.3, -17.0, 4.5), None);
    // Each has its half of what both were drawn over.
    assert_eq!((at(-4.3, -17.0, 4.5), at(-3.7, -17.0, 4.5)), (Some("mandible"), Some("vertebrae_C1")));
    assert_eq!((at(-7.0, -17.0, 9.2), at(-7.0, -17.0, 13.5)), (Some("mandible"), None));
    let codes: Vec<&str> = drawn.warnings.iter().map(|w| w.code.as_str()).collect();
    assert_eq!(codes, ["bones-unnamed", "bones-outside"]);
    let read = read_bones(&path, None, &grid).unwrap();
    assert_eq!((&read.value, &read.path), (&drawn.map, &path));
    let far = Grid::axis_aligned([5, 4, 3], [1.0; 3], [900.0; 3]).unwrap();
    assert_eq!(read_bones(&path, None, &far).unwrap_err().code(), "bones-unnamed");
}

#[test]
fn organs_are_those_that_are_asked_for() {
    let dir = tempfile::tempdir().unwrap();
    let tube = |half: f64| {
        (0..4).map(|k| ("CLOSED_PLANAR", square(half, f64::from(k) * 3.0))).collect::<Vec<(&str, Vec<[f64; 3]>)>>()
    };
    let rois = [
        Roi { name: "BODY", contours: tube(9.0) },
        Roi { name: "Parotid_L", contours: tube(4.0) },
        Roi { name: "GTV", contours: tube(2.0) },
    ];
    let path = write(dir.path(), "rs", &structure_set(&rois));
    let set = read_structure_set(&path).unwrap();
    let grid = Grid::axis_aligned([40, 40, 8], [0.5, 0.5, 1.5], [-16.75, -26.75, -0.75]).unwrap();
    let wanted = ["parotid l", "liver"].map(str::to_owned);
    let map = organs_from_structures(&set, &grid, &wanted).unwrap();
    // Named as asked for; neither what encloses it nor what lies in it takes its voxels.
    assert_eq!(map.names, [(1, "parotid l".to_owned())].into());
    let expected = 16 * 16 * 8;
    assert_eq!(map.counts(), [(1, expected)].into());
    let far = Grid::axis_aligned([5, 4, 3], [1.0; 3], [900.0; 3]).unwrap();
    assert_eq!(organs_from_structures(&set, &far, &wanted).unwrap_err().exit_code(), 4);
    let error = organs_from_structures(&set, &grid, &["liver".to_owned()]).unwrap_err();
    assert!(error.exit_code() == 4 && error.to_string().contains("Parotid_L"), "{error}");
}
