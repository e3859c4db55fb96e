//! Named structures of several files as one label map.

use crate::error::{Error, Result};
use crate::findings;
use crate::geometry::Grid;
use crate::io::dicom::BoneNames;
use crate::skeleton::anatomy::Kind;
use crate::volume::{LabelMap, Volume};
use crate::warning::{Warning, counted};
use serde::Serialize;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Number of the first structure that is no bone; bones have their place in the skeleton's anatomy.
const OTHERS: u16 = 101;

/// Most overlaps that are told one by one.
const MOST: usize = 10;

/// A label map that grows: the structure that comes first keeps a voxel.
pub struct Merging {
    only_bones: bool,
    names: BoneNames,
    /// The grid, and the file that it is of.
    grid: Option<(Grid, PathBuf)>,
    /// Numbers in the order of coming, from 1.
    labels: Vec<u16>,
    parts: Vec<MergedPart>,
    /// Voxels that a later structure (second) has in common with an earlier one.
    overlaps: BTreeMap<(u16, u16), usize>,
    left_out: Vec<String>,
    renamed: Vec<Renamed>,
}

/// A structure that came.
struct MergedPart {
    name: String,
    file: PathBuf,
    /// Voxels that it keeps.
    kept: usize,
}

/// A structure of the result.
#[derive(Debug, Clone, Serialize)]
pub struct Structure {
    /// Its number.
    pub label: u16,
    /// Its name.
    pub name: String,
    /// The file that it comes from.
    pub from: String,
    /// Voxels in the result.
    pub voxels: usize,
    /// Their volume, ml.
    pub volume_ml: f64,
}

/// A bone in another spelling.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Renamed {
    /// As the file names it.
    pub from: String,
    /// As the skeleton does.
    pub to: String,
}

/// Two structures with voxels in common.
#[derive(Debug, Clone, Serialize)]
pub struct Overlap {
    /// The one that keeps them.
    pub kept_by: String,
    /// The one that loses them.
    pub lost_by: String,
    /// How many.
    pub voxels: usize,
    /// Their volume, ml.
    pub volume_ml: f64,
    /// Whether nothing is left of the loser.
    pub nothing_left: bool,
}

/// What became of the structures.
#[derive(Debug, Clone, Serialize)]
pub struct Merged {
    /// By number.
    pub structures: Vec<Structure>,
    /// By the names of those that keep, then those that lose.
    pub overlaps: Vec<Overlap>,
    /// Structures that are no bones.
    pub left_out: Vec<String>,
    /// Bones in other spellings.
    pub renamed: Vec<Renamed>,
}

impl Merging {
    /// Nothing yet; with `only_bones` structures that are no bone of the skeleton stay out.
    pub fn new(only_bones: bool) -> Self {
        Self {
            only_bones,
            names: BoneNames::default(),
            grid: None,
            labels: Vec::new(),
            parts: Vec::new(),
            overlaps: BTreeMap::new(),
            left_out: Vec::new(),
            renamed: Vec::new(),
        }
    }

    /// Says the grid that all must have, and the file that it is of.
    pub fn on(&mut self, file: &Path, grid: Grid) {
        self.labels = vec![0; grid.len()];
        self.grid = Some((grid, file.to_owned()));
    }

    /// Adds the named structures of a map that have voxels; with `spelt` bones get the skeleton's spelling.
    ///
    /// # Errors
    /// [`Error::Input`] when its grid is another, or a name is there already.
    pub fn add(&mut self, file: &Path, map: LabelMap, spelt: bool) -> Result<()> {
        match &self.grid {
            Some((grid, first)) => same_grid(grid, first, map.volume.grid(), file)?,
            None => self.on(file, map.volume.grid().clone()),
        }
        let mut numbers = vec![0u16; usize::from(u16::MAX) + 1];
        for label in map.counts().into_keys() {
            let Some(own) = map.names.get(&label) else { continue };
            let bone = self.names.bone(own).filter(|_| spelt);
            let name = bone.unwrap_or_else(|| own.clone());
            if self.only_bones && Kind::of(&name).is_none() {
                self.left_out.push(own.clone());
                continue;
            }
            if let Some(other) = self.parts.iter().find(|p| p.name == name) {
                return Err(doubled(file, own, &name, &other.file));
            }
            if name != *own {
                self.renamed.push(Renamed { from: own.clone(), to: name.clone() });
            }
            self.parts.push(MergedPart { name, file: file.to_owned(), kept: 0 });
            numbers[usize::from(label)] = u16::try_from(self.parts.len())
                .map_err(|_| Error::input(file.display().to_string(), "no label number is left", "give fewer files"))?;
        }
        for (have, label) in self.labels.iter_mut().zip(map.volume.data()) {
            let number = numbers[usize::from(*label)];
            if number == 0 {
                continue;
            }
            if *have == 0 {
                *have = number;
                self.parts[usize::from(number) - 1].kept += 1;
            } else {
                *self.overlaps.entry((*have, number)).or_default() += 1;
            }
        }
        Ok(())
    }

    /// The label map, numbered, and what became of the structures.
    ///
    /// # Errors
    /// [`Error::Input`] when it has no structure.
    pub fn finish(self) -> Result<(LabelMap, Merged)> {
        let Some((grid, first)) = self.grid.filter(|_| self.parts.iter().any(|p| p.kept > 0)) else {
            let problem = match self.left_out.as_slice() {
                [] => "all masks are empty".to_owned(),
                some => format!("none of the structures is a bone of the skeleton: {}", some.join(", ")),
            };
            let remedy = "give masks of bones with TotalSegmentator's names, or leave out --only-bones";
            return Err(Error::input("labels", problem, remedy));
        };
        let numbers = numbers(self.parts.iter().map(|p| p.name.as_str()))
            .ok_or_else(|| Error::input(first.display().to_string(), "no label number is left", "give fewer files"))?;
        let ml = |voxels: usize| voxels as f64 * grid.spacing().iter().product::<f64>() / 1000.0;
        let part = |n: u16| &self.parts[usize::from(n) - 1];
        let overlaps = self.overlaps.iter().map(|(&(have, lost), &voxels)| Overlap {
            kept_by: part(have).name.clone(),
            lost_by: part(lost).name.clone(),
            voxels,
            volume_ml: ml(voxels),
            nothing_left: part(lost).kept == 0,
        });
        let structures = self.parts.iter().zip(&numbers).filter(|(p, _)| p.kept > 0).map(|(p, &label)| Structure {
            label,
            name: p.name.clone(),
            from: p.file.display().to_string(),
            voxels: p.kept,
            volume_ml: ml(p.kept),
        });
        let (mut structures, mut overlaps): (Vec<_>, Vec<_>) = (structures.collect(), overlaps.collect());
        structures.sort_by_key(|s| s.label);
        overlaps.sort_by(|a, b| (&a.kept_by, &a.lost_by).cmp(&(&b.kept_by, &b.lost_by)));
        let table: Vec<u16> = std::iter::once(0).chain(numbers).collect();
        let labels = self.labels.into_iter().map(|l| table[usize::from(l)]).collect();
        let names = structures.iter().map(|s| (s.label, s.name.clone())).collect();
        let map = LabelMap { volume: Volume::new(grid, labels)?, names };
        Ok((map, Merged { structures, overlaps, left_out: self.left_out, renamed: self.renamed }))
    }
}

impl Merged {
    /// What is to be known of overlaps, the largest first.
    pub fn warnings(&self) -> Vec<Warning> {
        let told = |o: &&Overlap| {
            let left = if o.nothing_left { "; nothing of it is left" } else { "" };
            let them = if o.voxels == 1 { "it" } else { "them" };
            let message = format!(
                "{} and {} have {} ({:.2} ml) in common: {} keeps {them}, {} loses {them}{left}",
                o.kept_by,
                o.lost_by,
                counted(o.voxels, "voxel", "voxels"),
                o.volume_ml,
                o.kept_by,
                o.lost_by
            );
            Warning::new(findings::LABELS_OVERLAP, message)
        };
        let mut all: Vec<&Overlap> = self.overlaps.iter().collect();
        all.sort_by_key(|o| (!o.nothing_left, std::cmp::Reverse(o.voxels)));
        let rest = all.split_off(all.len().min(MOST));
        let mut warnings: Vec<Warning> = all.iter().map(told).collect();
        if !rest.is_empty() {
            let ml: f64 = rest.iter().map(|o| o.volume_ml).sum();
            let message =
                format!("{} more pairs of structures have {ml:.2} ml in common; --json lists them", rest.len());
            warnings.push(Warning::new(findings::LABELS_OVERLAP, message));
        }
        warnings
    }
}

/// The number of each name: a bone's place in the anatomy, and behind them the others by the alphabet.
fn numbers<'a>(names: impl Iterator<Item = &'a str> + Clone) -> Option<Vec<u16>> {
    let bones = Kind::names();
    let bone = |name: &str| bones.iter().position(|b| b == name);
    let mut others: Vec<&str> = names.clone().filter(|n| bone(n).is_none()).collect();
    others.sort_unstable();
    let number = |name: &str| match bone(name) {
        Some(place) => u16::try_from(place + 1).ok(),
        None => u16::try_from(others.binary_search(&name).ok()?).ok()?.checked_add(OTHERS),
    };
    names.map(number).collect()
}

/// Refuses a map of another grid than the first one's.
fn same_grid(first: &Grid, first_file: &Path, own: &Grid, file: &Path) -> Result<()> {
    let tolerance = 0.1 * first.spacing().into_iter().fold(f64::MAX, f64::min);
    if first.matches(own, tolerance) {
        return Ok(());
    }
    let told = |g: &Grid| {
        let (size, spacing, origin) = (g.size(), g.spacing(), g.origin());
        format!("size {size:?}, spacing {spacing:.3?} mm, origin {:.2?} mm", origin.coords.as_slice())
    };
    let problem = format!("its grid ({}) is not that of {} ({})", told(own), first_file.display(), told(first));
    let remedy = "give structures of one scan, or resample them onto one grid with nearest-neighbour interpolation";
    Err(Error::refused(findings::LABELS_ELSEWHERE, file.display().to_string(), problem, remedy))
}

/// That a name is there already.
fn doubled(file: &Path, own: &str, name: &str, other: &Path) -> Error {
    let own = if own == name { own.to_owned() } else { format!("{own}, which is {name},") };
    let problem = format!("{own} is also a structure of {}", other.display());
    let remedy = format!(
        "leave one of them out, name one otherwise (`other_name={}`), or take one structure alone out of a label map \
         (`NAME=FILE`)",
        file.display()
    );
    Error::refused(findings::LABELS_DOUBLED, file.display().to_string(), problem, remedy)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn map(labels: [u16; 6], names: &[(u16, &str)]) -> LabelMap {
        let grid = Grid::axis_aligned([6, 1, 1], [10.0, 10.0, 20.0], [0.0; 3]).unwrap();
        let names = names.iter().map(|(l, n)| (*l, (*n).to_owned())).collect();
        LabelMap { volume: Volume::new(grid, labels.to_vec()).unwrap(), names }
    }

    #[test]
    fn the_first_keeps_the_voxels_and_numbers_do_not_depend_on_the_order() {
        let mut all = Merging::new(false);
        all.add(Path::new("b.nii"), map([7, 7, 7, 0, 0, 0], &[(7, "tumour")]), true).unwrap();
        all.add(Path::new("c.nii"), map([0, 1, 1, 1, 2, 0], &[(1, "Unterkiefer"), (2, "aorta"), (9, "x")]), true)
            .unwrap();
        all.add(Path::new("d.nii"), map([1, 0, 0, 0, 0, 0], &[(1, "sacrum")]), true).unwrap();
        let (merged, told) = all.finish().unwrap();
        // Mandible: behind 27 bones of the axis.
        assert_eq!(merged.volume.data(), [102, 102, 102, 28, 101, 0]);
        let names: Vec<(u16, &str)> = merged.names.iter().map(|(l, n)| (*l, n.as_str())).collect();
        assert_eq!(names, [(28, "mandible"), (101, "aorta"), (102, "tumour")]);
        assert_eq!(told.renamed, [Renamed { from: "Unterkiefer".into(), to: "mandible".into() }]);
        let texts: Vec<String> = told.warnings().into_iter().map(|w| w.message).collect();
        assert!(
            texts[0].contains("have 1 voxel (2.00 ml)") && texts[0].contains("sacrum loses it; nothing"),
            "{texts:?}"
        );
        assert!(texts[1].contains("2 voxels (4.00 ml)") && texts[1].ends_with("mandible loses them"), "{texts:?}");
        assert_eq!(texts.len(), 2);
    }

    #[test]
    fn what_cannot_be_one_map_is_refused() {
        let one = || map([1, 0, 0, 0, 0, 0], &[(1, "hyoid")]);
        let mut all = Merging::new(true);
        all.add(Path::new("a.nii"), one(), true).unwrap();
        let twice = all.add(Path::new("b.nii"), map([0, 1, 0, 0, 0, 0], &[(1, "Zungenbein")]), true).unwrap_err();
        assert!(twice.code() == "labels-doubled" && twice.to_string().contains("a.nii"), "{twice}");
        let grid = Grid::axis_aligned([6, 1, 1], [10.0, 10.0, 20.0], [5.0, 0.0, 0.0]).unwrap();
        let moved = LabelMap { volume: Volume::filled(grid, 1), names: [(1, "skull".to_owned())].into() };
        let moved = all.add(Path::new("c.nii"), moved, true).unwrap_err();
        let text = moved.to_string();
        assert!(moved.code() == "labels-elsewhere" && text.contains("[5.00, ") && text.contains("[0.00, "), "{text}");
        // Said names stay as they are said.
        all.add(Path::new("d.nii"), map([0, 1, 0, 0, 0, 0], &[(1, "Zungenbein")]), false).unwrap();
        let (merged, told) = all.finish().unwrap();
        assert_eq!((merged.names.len(), told.left_out.as_slice()), (1, &["Zungenbein".to_owned()][..]));
        let mut none = Merging::new(true);
        none.add(Path::new("e.nii"), map([1; 6], &[(1, "liver")]), true).unwrap();
        assert!(none.finish().unwrap_err().to_string().contains("liver"));
        assert_eq!(Merging::new(false).finish().unwrap_err().exit_code(), 4);
    }
}
