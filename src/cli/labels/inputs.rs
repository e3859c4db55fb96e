//! The files of `aventail labels merge`: masks, label maps, folders and structure sets.

use crate::error::{Error, Result};
use crate::findings;
use crate::io::dicom::{Role, check_frames, is_dicom_path, is_segmentation, is_structure_set};
use crate::io::{
    is_json, names_beside, read_bones, read_grid, read_label_map, read_label_map_on, read_label_names, read_labels,
};
use crate::volume::LabelMap;
use crate::warning::Warning;
use std::path::{Path, PathBuf};

/// Ends of the names of images.
const IMAGES: [&str; 4] = [".nii.gz", ".nii", ".mha", ".nrrd"];

/// One file.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct LabelSource {
    pub(super) path: PathBuf,
    /// The name that the command line gives.
    pub(super) given: Option<String>,
}

/// All files, in the order in which they keep voxels.
pub(super) struct LabelSources {
    pub(super) all: Vec<LabelSource>,
    /// Files of folders that are no images.
    pub(super) passed_over: Vec<String>,
}

impl LabelSources {
    /// Of arguments: `FILE`, `NAME=FILE`, or a folder.
    ///
    /// # Errors
    /// [`Error::Read`] for a folder that cannot be listed or holds no image; [`Error::Usage`] for a name that cannot be one.
    pub(super) fn of(arguments: &[PathBuf]) -> Result<Self> {
        let mut sources = Self { all: Vec::new(), passed_over: Vec::new() };
        for argument in arguments {
            let source = LabelSource::of(argument)?;
            if source.given.is_none() && source.path.is_dir() {
                sources.folder(&source.path)?;
            } else {
                sources.all.push(source);
            }
        }
        Ok(sources)
    }

    /// Takes the images of a folder, by name; one without any may hold a structure set.
    fn folder(&mut self, folder: &Path) -> Result<()> {
        let failed = |e: std::io::Error| Error::read(folder, e.to_string(), "name a folder of masks that you may read");
        let mut files = Vec::new();
        for entry in std::fs::read_dir(folder).map_err(failed)? {
            files.push(entry.map_err(failed)?.path());
        }
        files.sort();
        let (images, others): (Vec<PathBuf>, Vec<PathBuf>) = files.into_iter().partition(|f| is_image(f));
        if images.is_empty() {
            if others.iter().any(|f| is_structure_set(f) || is_segmentation(f)) {
                self.all.push(LabelSource { path: folder.to_owned(), given: None });
                return Ok(());
            }
            let remedy =
                "name a folder of masks (.nii.gz, .nii, .mha, .nrrd), as TotalSegmentator writes it without --ml";
            return Err(Error::read(folder, "it holds no image, no structure set and no segmentation", remedy));
        }
        self.all.extend(images.into_iter().map(|path| LabelSource { path, given: None }));
        self.passed_over.extend(others.iter().map(|f| f.display().to_string()));
        Ok(())
    }
}

fn is_image(file: &Path) -> bool {
    let name = file.file_name().unwrap_or_default().to_string_lossy().to_lowercase();
    // Hidden files are other programs' notes, such as macOS's.
    !name.starts_with('.') && IMAGES.iter().any(|end| name.ends_with(end))
}

impl LabelSource {
    fn of(argument: &Path) -> Result<Self> {
        let plain = || Self { path: argument.to_owned(), given: None };
        let Some((name, file)) = argument.to_str().and_then(|t| t.split_once('=')).filter(|_| !argument.exists())
        else {
            return Ok(plain());
        };
        let wrong = name.is_empty() || name != name.trim() || name.chars().any(|c| c.is_control() || c == '/');
        if wrong || file.is_empty() {
            let problem = format!("{}: there is no such file, and it is no NAME=FILE", argument.display());
            return Err(Error::usage(problem, "give it as NAME=FILE, for example skull=head_bone.nii.gz"));
        }
        Ok(Self { path: file.into(), given: Some(name.to_owned()) })
    }

    /// The name of a mask: as given, else its file's.
    pub(super) fn name(&self) -> Result<String> {
        if let Some(name) = &self.given {
            return Ok(name.clone());
        }
        let file = self.path.file_name().unwrap_or_default().to_string_lossy();
        let length = file.len() - IMAGES.iter().find(|e| file.to_lowercase().ends_with(*e)).map_or(0, |e| e.len());
        let stem = file.get(..length).unwrap_or(&file);
        let stem = stem.strip_suffix(".seg").unwrap_or(stem).trim();
        if stem.is_empty() || stem.chars().any(char::is_control) {
            let problem = "its name gives its structure no name";
            return Err(Error::input(self.path.display().to_string(), problem, "give it as NAME=FILE"));
        }
        Ok(stem.to_owned())
    }

    /// Its structures, each with a name; `None` for a mask without a voxel.
    ///
    /// # Errors
    /// As reading the file; [`Error::Input`] for what is neither a mask nor a label map with names, and where it has no structure
    /// of the given name; [`Error::Usage`] for a structure set without a grid.
    pub(super) fn read(
        &self,
        grid: Option<&Path>,
        names: Option<&Path>,
        warnings: &mut Vec<Warning>,
    ) -> Result<Option<LabelMap>> {
        let what = self.path.display().to_string();
        let loaded = if is_segmentation(&self.path) {
            match grid {
                Some(image) => {
                    check_frames(Role::Structures.at(&self.path), Role::Image.at(image))?;
                    read_label_map_on(&self.path, &read_grid(image)?.0)?
                }
                None => read_labels(&self.path, None)?,
            }
        } else if is_dicom_path(&self.path) {
            let Some(image) = grid else {
                let problem = format!("{what}: a structure set is drawn on a grid, and none is given");
                return Err(Error::usage(problem, "name the planning CT with --grid"));
            };
            check_frames(Role::Structures.at(&self.path), Role::Image.at(image))?;
            read_bones(&self.path, names.filter(|n| !is_json(n)), &read_grid(image)?.0)?
        } else {
            read_label_map(&self.path, None)?
        };
        warnings.extend(loaded.warnings);
        let mut map = loaded.value;
        let labels: Vec<u16> = map.counts().into_keys().collect();
        let refuse = |problem: String, remedy: &str| {
            Err(Error::refused(findings::LABELS_NAMELESS, what.clone(), problem, remedy))
        };
        if let (true, [_, _, ..], Some(names)) = (map.names.is_empty(), labels.as_slice(), names.filter(|n| is_json(n)))
        {
            map.names = read_label_names(names)?;
        }
        if map.names.is_empty() {
            return match labels.as_slice() {
                [] => Ok(None),
                [label] => {
                    map.names.insert(*label, self.name()?);
                    Ok(Some(map))
                }
                many => refuse(
                    format!("it has {} values besides 0 ({}) and no names: no mask", many.len(), some(many)),
                    &match names_beside(&self.path) {
                        Some(names) => format!("{names} lies beside it: give --labels {names}"),
                        None => "give a mask of one structure, or a label map with names in its header or in --labels (JSON)"
                            .to_owned(),
                    },
                ),
            };
        }
        let nameless: Vec<u16> = labels.iter().copied().filter(|l| !map.names.contains_key(l)).collect();
        if !nameless.is_empty() {
            return refuse(
                format!("labels without a name: {}", some(&nameless)),
                "name every label that occurs, in the header's table or in --labels (JSON)",
            );
        }
        let Some(given) = &self.given else { return Ok(Some(map).filter(|_| !labels.is_empty())) };
        let label = labels.iter().copied().find(|l| map.names.get(l) == Some(given));
        if map.names.values().all(|n| n != given) {
            let there: Vec<&str> = labels.iter().filter_map(|l| map.names.get(l)).map(String::as_str).collect();
            return refuse(
                format!("{given} is none of its structures: {}", there.join(", ")),
                "NAME=FILE takes the structure NAME out of a label map; give the name that it has there",
            );
        }
        map.names.retain(|l, _| Some(*l) == label);
        Ok(label.map(|_| map))
    }
}

/// The first of many numbers.
fn some(labels: &[u16]) -> String {
    let shown: Vec<String> = labels.iter().take(10).map(u16::to_string).collect();
    let more = if labels.len() > 10 { ", ..." } else { "" };
    format!("{}{more}", shown.join(", "))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn masks_are_named_by_argument_or_file() {
        let name = |text: &str| LabelSource::of(Path::new(text)).unwrap().name().unwrap();
        assert_eq!(name("a/vertebrae_C1.nii.gz"), "vertebrae_C1");
        assert_eq!(name("Bone.left.NII.GZ"), "Bone.left");
        assert_eq!(name("jaw.seg.nrrd"), "jaw");
        assert_eq!(name("skull=a/b=c.mha"), "skull");
        assert_eq!(LabelSource::of(Path::new("skull=a/b=c.mha")).unwrap().path, Path::new("a/b=c.mha"));
        for wrong in ["=a.nii", "skull=", "a/b=c.nii", " skull=a.nii"] {
            assert_eq!(LabelSource::of(Path::new(wrong)).unwrap_err().exit_code(), 2, "{wrong}");
        }
        assert_eq!(LabelSource::of(Path::new("a/.nii")).unwrap().name().unwrap_err().exit_code(), 4);
    }
}
