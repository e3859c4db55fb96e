//! No result takes the place of an input: by whatever path it is named, and whatever files a DICOM series has.

use super::checksum::require_file;
use super::dicom;
use super::held::Guarded;
use super::identity::identity;
use super::series_path::root_of;
use crate::error::Result;
use std::path::{Component, Path, PathBuf};

/// Refuses work whose results would take the place of its inputs, and inputs that are missing, before anything is read.
///
/// # Errors
/// [`Error::Read`](crate::error::Error::Read) for an input that cannot be opened; [`Error::Input`](crate::error::Error::Input) for a result that is an input, by whatever path.
pub fn check_files(inputs: &[&Path], outputs: &[PathBuf]) -> Result<()> {
    for input in inputs {
        // Opening a pipe would wait for its writer.
        if std::fs::metadata(root_of(input)).map_or(true, |m| m.is_file() || m.is_dir()) {
            require_file(input)?;
        }
    }
    let guarded = guarded(inputs);
    outputs.iter().try_for_each(|output| guarded.iter().try_for_each(|input| input.spare(output)))
}

/// Inputs that stay as they are: of a DICOM series all DICOM files in its folder.
pub(super) fn guarded(inputs: &[&Path]) -> Vec<Guarded> {
    let folder = |input: &Path| std::fs::canonicalize(dicom::folder_of(input)?).ok();
    let of = |input: &&Path| Guarded {
        input: input.to_path_buf(),
        identity: identity(&root_of(input)),
        folder: folder(input),
        is_part: dicom::is_place,
    };
    inputs.iter().map(of).collect()
}

/// The file that a report names by `path`: seen from `folder`, where the report lies, else from where this process works,
/// else from the folder that it was written into; names that JSON could not hold are found by their likeness. Where there
/// is none, the path as it is.
pub fn recorded_file(folder: &Path, path: &Path, written_into: Option<&Path>) -> PathBuf {
    let places: Vec<PathBuf> = [Some(folder.join(path)), Some(path.to_owned()), written_into.map(|f| f.join(path))]
        .into_iter()
        .flatten()
        .collect();
    let there = places.iter().find(|p| root_of(p).exists()).cloned();
    there.or_else(|| places.iter().find_map(|p| alike(p))).unwrap_or_else(|| path.to_owned())
}

/// A file whose path reads like this one.
fn alike(path: &Path) -> Option<PathBuf> {
    if !path.to_string_lossy().contains(char::REPLACEMENT_CHARACTER) {
        return None;
    }
    path.components().try_fold(PathBuf::new(), |so_far, part| {
        let whole = so_far.join(part);
        if whole.symlink_metadata().is_ok() || !matches!(part, Component::Normal(_)) {
            return Some(whole);
        }
        let folder = if so_far.as_os_str().is_empty() { Path::new(".") } else { &so_far };
        let named = |e: &std::fs::DirEntry| e.file_name().to_string_lossy() == part.as_os_str().to_string_lossy();
        let found = std::fs::read_dir(folder).ok()?.flatten().find(named)?;
        Some(so_far.join(found.file_name()))
    })
}

#[cfg(test)]
mod tests {
    use super::super::identity::{relative_to, same_file};
    use super::*;

    #[cfg(unix)]
    #[test]
    fn recorded_files_are_found_from_anywhere() {
        use std::os::unix::ffi::OsStrExt;
        let dir = tempfile::tempdir().unwrap();
        let odd = dir.path().join(std::ffi::OsStr::from_bytes(b"d\xff"));
        std::fs::create_dir_all(&odd).unwrap();
        std::fs::create_dir(dir.path().join("out")).unwrap();
        let file = odd.join(std::ffi::OsStr::from_bytes(b"ct\xfe.nii"));
        std::fs::write(&file, b"x").unwrap();
        let out = dir.path().join("out");
        let written = relative_to(&out, &file).to_string_lossy().into_owned();
        assert!(same_file(&recorded_file(&out, Path::new(&written), None), &file), "{written}");
        assert!(same_file(&recorded_file(Path::new("elsewhere"), Path::new(&written), Some(&out)), &file));
        assert_eq!(recorded_file(&out, Path::new("../none.nii"), None), Path::new("../none.nii"));
    }

    #[cfg(unix)]
    #[test]
    fn one_file_by_any_path_is_spared() {
        let dir = tempfile::tempdir().unwrap();
        let at = |name: &str| dir.path().join(name);
        std::fs::write(at("ct.nii"), b"x").unwrap();
        std::fs::create_dir(at("sub")).unwrap();
        std::os::unix::fs::symlink(at("ct.nii"), at("soft.nii")).unwrap();
        std::os::unix::fs::symlink("nowhere", at("dangling.nii")).unwrap();
        std::fs::hard_link(at("ct.nii"), at("hard.nii")).unwrap();
        for output in [at("ct.nii"), at("sub/../ct.nii"), at("soft.nii"), at("hard.nii")] {
            let error = check_files(&[&at("ct.nii")], &[at("new.nii"), output.clone()]).unwrap_err();
            let text = error.to_string();
            assert!(error.exit_code() == 4 && text.contains(&at("ct.nii").display().to_string()), "{text}");
            assert!(text.contains(&output.display().to_string()) && text.contains("[input-overwritten]"), "{text}");
        }
        check_files(&[&at("ct.nii")], &[at("new.nii"), at("dangling.nii")]).unwrap();
        assert_eq!(check_files(&[&at("dangling.nii")], &[]).unwrap_err().exit_code(), 3);
    }
}
