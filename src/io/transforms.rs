//! `bone_transforms.json`: a rigid transform per bone, by name.

use super::checksum::read_bytes;
use crate::error::{Error, Result};
use crate::geometry::{Rigid, rigid_from_matrix};
use nalgebra::Matrix4;
use std::collections::BTreeMap;
use std::path::Path;

/// Reads `{name: 4x4}`, rows of the matrix from planning to fraction, LPS mm.
///
/// # Errors
/// [`Error::Read`] when the file is missing or not of this form; [`Error::Input`], naming the bone, when a matrix is not rigid.
pub fn read_bone_transforms(path: impl AsRef<Path>) -> Result<BTreeMap<String, Rigid>> {
    let path = path.as_ref();
    let rows: BTreeMap<String, [[f64; 4]; 4]> = serde_json::from_slice(&read_bytes(path)?).map_err(|e| {
        Error::read(
            path,
            format!("it is no list of bone transforms ({e})"),
            "give a bone_transforms.json: {\"skull\": [[...4 numbers...], ...4 rows...], ...}",
        )
    })?;
    let rigid = |(name, rows): (String, [[f64; 4]; 4])| {
        let m = Matrix4::from_fn(|r, c| rows[r][c]);
        let last = [0.0, 0.0, 0.0, 1.0];
        let transform =
            rigid_from_matrix(&m).filter(|_| rows[3].iter().zip(last).all(|(a, b): (&f64, f64)| (a - b).abs() < 1e-9));
        transform.map(|t| (name.clone(), t)).ok_or_else(|| {
            Error::input(
                path.display().to_string(),
                format!("the matrix of {name} is no rotation with a shift: {rows:?}"),
                "bones are rigid: give a rotation in the upper left 3x3 block, a shift in mm, last row 0 0 0 1",
            )
        })
    };
    rows.into_iter().map(rigid).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reads_rigid_matrices_and_names_the_bone_of_others() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("t.json");
        let read = |text: &str| {
            std::fs::write(&path, text).unwrap();
            read_bone_transforms(&path)
        };
        let all = read(r#"{"skull": [[0,-1,0,5],[1,0,0,6],[0,0,1,7],[0,0,0,1]]}"#).unwrap();
        assert!(
            (all["skull"] * nalgebra::Point3::new(1.0, 0.0, 0.0) - nalgebra::Point3::new(5.0, 7.0, 7.0)).norm() < 1e-12
        );
        for (bad, name) in [
            (r#"{"skull": [[2,0,0,5],[0,1,0,6],[0,0,1,7],[0,0,0,1]]}"#, "skull"),
            (r#"{"skull": [[1,0,0,5],[0,1,0,6],[0,0,1,7],[1,0,0,1]]}"#, "skull"),
            (r#"{"skull": [[1,0,0],[0,1,0]]}"#, "t.json"),
            ("[]", "t.json"),
        ] {
            let error = read(bad).unwrap_err().to_string();
            assert!(error.contains(name), "{error}");
        }
    }
}
