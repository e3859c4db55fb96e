//! Where labels that `auto` made are kept.

use super::segmentator::BY_HAND;
use crate::error::{Error, Result};
use crate::io::checksum::sha256_file;
use std::path::{Path, PathBuf};

/// Where the labels of a scan are kept.
pub(super) struct LabelsPlace {
    /// SHA-256 of the scan.
    pub planning_sha256: String,
    /// The folder.
    pub folder: PathBuf,
    /// The label map.
    pub labels: PathBuf,
    /// What was run for it.
    pub record: PathBuf,
}

impl LabelsPlace {
    /// In the folder that holds `beside`, so that all fractions of a patient find them.
    pub(super) fn of(beside: &Path, planning: &Path) -> Result<Self> {
        let whole = std::path::absolute(beside).map_err(|e| Error::read(beside, e.to_string(), "name a folder"))?;
        let is_relative = beside.is_relative() && beside.file_name().is_some();
        let folder = if is_relative { beside.parent() } else { whole.parent() }.unwrap_or(&whole);
        let planning_sha256 = sha256_file(planning)?;
        let stem = format!("bones_auto_{}", planning_sha256.get(..12).unwrap_or(&planning_sha256));
        let at = |end: &str| folder.join(format!("{stem}{end}"));
        let (labels, record) = (at(".nii.gz"), at(".json"));
        Ok(Self { planning_sha256, folder: folder.to_owned(), labels, record })
    }

    /// That there are no labels, for a reason.
    pub(super) fn failed(&self, problem: &str) -> Error {
        Error::read(&self.labels, format!("TotalSegmentator did not make it: {problem}"), BY_HAND)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn labels_lie_beside_the_result() {
        let dir = tempfile::tempdir().unwrap();
        let ct = dir.path().join("ct.nii");
        std::fs::write(&ct, b"abc").unwrap();
        let at = |beside: &str| LabelsPlace::of(Path::new(beside), &ct).unwrap().labels;
        // SHA-256 of "abc".
        assert_eq!(at("out"), Path::new("bones_auto_ba7816bf8f01.nii.gz"));
        assert_eq!(at("a/out/"), Path::new("a/bones_auto_ba7816bf8f01.nii.gz"));
        let above = std::env::current_dir().unwrap().parent().unwrap().join("bones_auto_ba7816bf8f01.nii.gz");
        assert_eq!(at("."), above);
    }
}
