//! Organs beside the bones: their labels join one label map.

use super::labels::read_organs;
use crate::error::{Error, Result};
use crate::volume::LabelMap;
use crate::warning::Warning;
use std::path::Path;

/// Reads organs and adds them to the labels of the bones, which they never replace. Of a DICOM structure set, in which many
/// structures lie over each other, those of the names `named`. Returns what reading found.
///
/// # Errors
/// [`Error::Read`] and [`Error::Input`] for files that are no label map of the bones' grid, and for names that exist already.
pub fn add_organs(labels: &mut LabelMap, path: &Path, named: &[String]) -> Result<Vec<Warning>> {
    let read = read_organs(path, named, labels.volume.grid())?;
    let mut organs = read.value;
    let refuse = |problem: String, remedy: &str| Err(Error::input(path.display().to_string(), problem, remedy));
    let counts = organs.counts();
    if organs.names.is_empty() && counts.len() == 1 {
        let stem = path.file_name().unwrap_or_default().to_string_lossy();
        let name = stem.split('.').next().unwrap_or_default().to_owned();
        organs.names = counts.keys().map(|l| (*l, name.clone())).collect();
    }
    if !organs.volume.grid().matches(labels.volume.grid(), 1e-2) {
        return refuse("its grid is not that of the bone labels".into(), "resample it onto the planning grid");
    }
    let mut number = labels.names.keys().chain(labels.counts().keys()).copied().max().unwrap_or(0);
    let mut new = vec![0u16; usize::from(u16::MAX) + 1];
    for label in counts.keys() {
        let Some(name) = organs.names.get(label) else {
            return refuse(
                format!("label {label} has no name"),
                "name its labels in the header, or give one mask per organ",
            );
        };
        if labels.names.values().any(|n| n == name) {
            return refuse(format!("{name} is also a label of --bones"), "give each structure once");
        }
        let Some(next) = number.checked_add(1) else {
            return refuse("no label number is left".into(), "use smaller numbers in --bones");
        };
        number = next;
        new[usize::from(*label)] = number;
        labels.names.insert(number, name.clone());
    }
    for (own, organ) in labels.volume.data_mut().iter_mut().zip(organs.volume.data()).filter(|(own, _)| **own == 0) {
        *own = new[usize::from(*organ)];
    }
    Ok(read.warnings)
}

#[cfg(test)]
mod tests {
    use super::super::{WriteOptions, write_labels};
    use super::*;
    use crate::geometry::Grid;
    use crate::volume::Volume;

    #[test]
    fn organs_join_the_bones_and_never_replace_them() {
        let folder = tempfile::tempdir().unwrap();
        let grid = Grid::axis_aligned([4, 3, 3], [1.0; 3], [0.0; 3]).unwrap();
        let bones = LabelMap {
            volume: Volume::from_fn(grid.clone(), |l| if l % 4 < 2 { 5 } else { 0u16 }),
            names: [(5, "skull".to_owned())].into(),
        };
        let organ = LabelMap { volume: Volume::from_fn(grid.clone(), |l| u16::from(l % 4 > 0)), names: [].into() };
        let path = folder.path().join("parotid_left.nii.gz");
        write_labels(&path, &organ, &WriteOptions::default()).unwrap();
        let mut both = bones.clone();
        add_organs(&mut both, &path, &[]).unwrap();
        assert_eq!(both.names[&6], "parotid_left");
        assert_eq!(&both.volume.data()[..4], &[5, 5, 6, 6]);
        assert!(add_organs(&mut both, &path, &[]).unwrap_err().to_string().contains("parotid_left"));
        let other = Grid::axis_aligned([4, 3, 3], [1.0; 3], [9.0, 0.0, 0.0]).unwrap();
        let mut elsewhere = LabelMap { volume: Volume::filled(other, 5), names: bones.names };
        assert_eq!(add_organs(&mut elsewhere, &path, &[]).unwrap_err().exit_code(), 4);
    }
}
