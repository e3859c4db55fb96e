//! Real files, where `AVENTAIL_CASES` names their folder.

use super::super::*;
use nalgebra::Point3;
use std::path::Path;

/// As tests/support/skip.rs has it for the program's tests.
fn skipped(why: &str) {
    use std::io::Write;
    let line = format!("skipped: {why}\n");
    let _ = std::io::stderr().write_all(line.as_bytes());
    if let Some(file) = std::env::var_os("AVENTAIL_SKIPPED").filter(|file| !file.is_empty()) {
        let mut file = std::fs::OpenOptions::new().create(true).append(true).open(file).unwrap();
        file.write_all(line.as_bytes()).unwrap();
    }
}

/// Against numbers that SimpleITK 2.5 gives for the same files.
#[test]
fn real_files_as_simpleitk_reads_them() {
    let Some(cases) = std::env::var_os("AVENTAIL_CASES").filter(|folder| !folder.is_empty()) else {
        skipped("real_files_as_simpleitk_reads_them: AVENTAIL_CASES names no folder of real cases");
        return;
    };
    let cases = Path::new(&cases);
    let planning = read_image(cases.join("planning_ct.nii.gz")).unwrap();
    let grid = planning.value.grid();
    assert_eq!((grid.size(), grid.spacing()), ([469, 267, 90], [1.0, 1.0, 3.0]));
    assert_eq!(grid.origin(), Point3::new(22.0, -403.0, -267.0));
    let mean = planning.value.data().iter().map(|v| f64::from(*v)).sum::<f64>() / grid.len() as f64;
    assert!((mean - -730.047_973_348_878_9).abs() < 1e-9, "{mean}");
    assert!(planning.warnings.is_empty());
    let bones = read_labels(cases.join("bones.nii.gz"), Some(&cases.join("bones.json"))).unwrap().value;
    assert!(bones.volume.grid().matches(grid, 1e-9));
    let sum: f64 = bones.volume.data().iter().map(|l| f64::from(*l)).sum();
    assert!((sum / grid.len() as f64 - 0.058_652_430_730_243_91).abs() < 1e-12);
    assert!(!read_landmarks(cases.join("small/landmarks.csv")).unwrap().is_empty());
}
