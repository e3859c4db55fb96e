//! Organs beside the bones: their labels, and volumes that are known to change.

use crate::chainmail::VolumeChange;
use crate::config::Config;
use crate::error::{Error, Result};
use crate::io;
use crate::volume::LabelMap;
use crate::warning::Warning;
use clap::Args;
use std::path::{Path, PathBuf};

/// Options on organs.
#[derive(Debug, Args, Clone, Default)]
pub struct OrganArgs {
    /// Labels of organs on the planning grid, beside those of the bones: a map with names, a mask named by its file, or a
    /// DICOM structure set, of which the organs count that the settings name
    #[arg(long, value_name = "FILE")]
    pub organs: Option<PathBuf>,
    /// Volume of an organ in the fraction over that in planning, for example parotid_left=0.8; repeat it for several
    #[arg(long, value_name = "ORGAN=FACTOR", value_parser = parse_change)]
    pub volume_change: Vec<VolumeChange>,
}

impl OrganArgs {
    /// Lays the changes over those of the settings.
    ///
    /// # Errors
    /// [`Error::Usage`] when a factor makes no sense or the settings cannot use it.
    pub(super) fn apply(&self, config: &mut Config) -> Result<()> {
        for change in &self.volume_change {
            config.chainmail.volume_change.retain(|c| c.organ != change.organ);
            config.chainmail.volume_change.push(change.clone());
        }
        match config.problem().filter(|_| !self.volume_change.is_empty()) {
            Some(problem) => Err(Error::usage(problem, "correct --volume-change, or the settings it goes with")),
            None => Ok(()),
        }
    }
}

fn parse_change(text: &str) -> Result<VolumeChange, String> {
    let (organ, factor) = text.split_once('=').ok_or("ORGAN=FACTOR is needed, for example parotid_left=0.8")?;
    let factor = factor.parse().map_err(|_| format!("`{factor}` is no number"))?;
    let change = VolumeChange { organ: organ.to_owned(), factor };
    change.problem().map_or(Ok(change), Err)
}

/// Reads organs and adds them to the labels of the bones, which they never replace. Of a DICOM structure set, in which many
/// structures lie over each other, those that the settings name. Returns what reading found.
///
/// # Errors
/// [`Error::Read`] and [`Error::Input`] for files that are no label map of the bones' grid, and for names that exist already.
pub(super) fn add(labels: &mut LabelMap, path: &Path, config: &Config) -> Result<Vec<Warning>> {
    let read = io::read_organs(path, &config.chainmail.organs_named(), labels.volume.grid())?;
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
    use super::*;
    use crate::geometry::Grid;
    use crate::io::WriteOptions;
    use crate::volume::Volume;

    #[test]
    fn changes_are_read_and_refused() {
        assert_eq!(parse_change("a_b=0.8"), Ok(VolumeChange { organ: "a_b".into(), factor: 0.8 }));
        for bad in ["a", "a=", "a=x", "a=0", "a=NaN", "a=7"] {
            assert!(parse_change(bad).is_err(), "{bad}");
        }
        let args = OrganArgs { organs: None, volume_change: vec![parse_change("a=0.8").unwrap()] };
        let mut config = Config::default();
        config.chainmail.volume_change = vec![parse_change("a=1.5").unwrap(), parse_change("b=1.1").unwrap()];
        args.apply(&mut config).unwrap();
        let factors: Vec<f64> = config.chainmail.volume_change.iter().map(|c| c.factor).collect();
        assert_eq!(factors, [1.1, 0.8]);
        config.chainmail.relaxation = Vec::new();
        assert!(args.apply(&mut config).is_err());
    }

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
        io::write_labels(&path, &organ, &WriteOptions::default()).unwrap();
        let mut both = bones.clone();
        add(&mut both, &path, &Config::default()).unwrap();
        assert_eq!(both.names[&6], "parotid_left");
        assert_eq!(&both.volume.data()[..4], &[5, 5, 6, 6]);
        assert!(add(&mut both, &path, &Config::default()).unwrap_err().to_string().contains("parotid_left"));
        let other = Grid::axis_aligned([4, 3, 3], [1.0; 3], [9.0, 0.0, 0.0]).unwrap();
        let mut elsewhere = LabelMap { volume: Volume::filled(other, 5), names: bones.names };
        assert_eq!(add(&mut elsewhere, &path, &Config::default()).unwrap_err().exit_code(), 4);
    }
}
