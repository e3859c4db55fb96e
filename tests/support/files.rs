//! Files that are wrong in one way each.

use aventail::geometry::Grid;
use aventail::io::{Stored, WriteOptions, write_image, write_labels};
use aventail::volume::{LabelMap, Volume};
use std::fs;
use std::path::{Path, PathBuf};

/// A small valid image as an uncompressed NIfTI file, altered byte by byte.
pub fn nifti(path: &Path, alter: impl FnOnce(&mut Vec<u8>)) -> PathBuf {
    let grid = Grid::axis_aligned([6, 5, 4], [2.0, 2.0, 3.0], [10.0, -20.0, 30.0]).expect("a grid");
    image(path, &Volume::from_fn(grid, |l| (l % 97) as f32));
    let mut bytes = fs::read(path).expect("it was written");
    alter(&mut bytes);
    fs::write(path, bytes).expect("the folder can be written to");
    path.to_path_buf()
}

/// Puts an int16 into a NIfTI header.
pub fn put_i16(bytes: &mut [u8], at: usize, value: i16) {
    bytes[at..at + 2].copy_from_slice(&value.to_le_bytes());
}

/// Puts a float32 into a NIfTI header.
pub fn put_f32(bytes: &mut [u8], at: usize, value: f32) {
    bytes[at..at + 4].copy_from_slice(&value.to_le_bytes());
}

/// Writes an image as float32.
pub fn image(path: &Path, image: &Volume<f32>) -> PathBuf {
    write_image(path, image, Stored::Float32, &WriteOptions::default()).expect("the image can be written");
    path.to_path_buf()
}

/// Writes a label map.
pub fn labels(path: &Path, map: &LabelMap) -> PathBuf {
    write_labels(path, map, &WriteOptions::default()).expect("the labels can be written");
    path.to_path_buf()
}

/// Writes bytes.
pub fn bytes(path: &Path, bytes: &[u8]) -> PathBuf {
    fs::write(path, bytes).expect("the folder can be written to");
    path.to_path_buf()
}
