//! `bone_transforms.json`: each bone's rigid transform.

use crate::error::Result;
use crate::geometry::Rigid;
use crate::io::write_json;
use serde_json::{Map, Value, json};
use std::path::Path;

/// Writes `{name: 4x4}`, rows of the matrix from planning to fraction, LPS mm.
///
/// # Errors
/// [`crate::error::Error::Write`] when the file cannot be written.
pub fn write_bone_transforms<'a>(path: &Path, bones: impl IntoIterator<Item = (&'a str, &'a Rigid)>) -> Result<()> {
    let all: Map<String, Value> = bones.into_iter().map(|(name, t)| (name.to_owned(), matrix(t))).collect();
    write_json(path, &all)
}

fn matrix(transform: &Rigid) -> Value {
    let m = transform.to_homogeneous();
    let rows: [[f64; 4]; 4] = std::array::from_fn(|r| std::array::from_fn(|c| m[(r, c)]));
    json!(rows)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::rigid_from_matrix;
    use crate::report::example;
    use nalgebra::Matrix4;

    #[test]
    fn rows_come_back_as_the_same_transform() {
        let (_, outcome, _) = example::small();
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("bone_transforms.json");
        write_bone_transforms(&path, outcome.bone_fits.iter().map(|b| (b.name.as_str(), &b.transform))).unwrap();
        let back: std::collections::BTreeMap<String, [[f64; 4]; 4]> =
            serde_json::from_slice(&std::fs::read(path).unwrap()).unwrap();
        for bone in &outcome.bone_fits {
            let rows = back[&bone.name];
            let m = Matrix4::from_fn(|r, c| rows[r][c]);
            let off = rigid_from_matrix(&m).unwrap().to_homogeneous() - bone.transform.to_homogeneous();
            assert!(off.abs().max() < 1e-12, "{}", bone.name);
        }
    }
}
