//! Which file a path leads to, whether a result would overwrite an input, and where a file lies seen from a folder.

use super::checksum::require_file;
use super::dicom;
use crate::error::{Error, Result};
use std::fs::Metadata;
use std::path::{Component, Path, PathBuf};

/// What two paths to one file have in common.
#[derive(Debug, PartialEq, Eq)]
enum Identity {
    /// Device and number of the file itself.
    #[cfg(unix)]
    Node(u64, u64),
    /// The path without links.
    #[cfg(not(unix))]
    Path(PathBuf),
}

/// The file that a path leads to, through links; `None` where there is none.
fn identity(path: &Path) -> Option<Identity> {
    #[cfg(unix)]
    return std::fs::metadata(path).ok().map(|m| node(&m));
    #[cfg(not(unix))]
    return std::fs::canonicalize(path).ok().map(Identity::Path);
}

#[cfg(unix)]
fn node(of: &Metadata) -> Identity {
    use std::os::unix::fs::MetadataExt;
    Identity::Node(of.dev(), of.ino())
}

/// Whether two paths lead to one file that exists, through links of any kind.
pub fn same_file(a: &Path, b: &Path) -> bool {
    identity(a).is_some_and(|a| Some(a) == identity(b))
}

/// Whether `path` itself, no link followed, is the open file with this metadata. Where the system gives files no number it
/// is taken for granted.
pub(super) fn is_still(path: &Path, open: &Metadata) -> bool {
    #[cfg(unix)]
    return std::fs::symlink_metadata(path).is_ok_and(|m| m.is_file() && node(&m) == node(open));
    #[cfg(not(unix))]
    return open.is_file() && path.exists();
}

/// Whether an open file has more names than one.
pub(super) fn has_other_names(open: &Metadata) -> bool {
    #[cfg(unix)]
    return std::os::unix::fs::MetadataExt::nlink(open) > 1;
    #[cfg(not(unix))]
    return !open.is_file();
}

/// Refuses work whose results would take the place of its inputs, and inputs that are missing, before anything is read.
///
/// # Errors
/// [`Error::Read`] for an input that cannot be opened; [`Error::Input`] for a result that is an input, by whatever path.
pub fn check_files(inputs: &[&Path], outputs: &[PathBuf]) -> Result<()> {
    for input in inputs {
        // Opening a pipe would wait for its writer.
        if std::fs::metadata(dicom::root_of(input)).map_or(true, |m| m.is_file() || m.is_dir()) {
            require_file(input)?;
        }
    }
    outputs.iter().try_for_each(|output| spare(inputs, output))
}

/// Whether a file that exists is, or belongs to, an input: of a DICOM series all DICOM files in its folder
/// do.
fn belongs(file: &Path, own: &Identity, input: &Path) -> bool {
    let root = dicom::root_of(input);
    if identity(&root).as_ref() == Some(own) {
        return true;
    }
    let inside = || {
        let folder = std::fs::canonicalize(dicom::folder_of(input)?).ok()?;
        Some(std::fs::canonicalize(file).ok()?.starts_with(folder))
    };
    file.is_file() && dicom::is_place(file) && inside().unwrap_or(false)
}

/// Refuses a result that is one of the inputs.
pub(super) fn spare<P: AsRef<Path>>(inputs: &[P], output: &Path) -> Result<()> {
    let Some(own) = identity(output) else { return Ok(()) };
    match inputs.iter().find(|input| belongs(output, &own, input.as_ref())) {
        None => Ok(()),
        Some(input) => {
            let (input, output) = (input.as_ref().display().to_string(), output.display().to_string());
            let problem = if input == output {
                "the result would take the place of this input".to_owned()
            } else {
                format!("the result {output} is the same file and would take the place of this input")
            };
            Err(Error::refused("input-overwritten", input, problem, "give another --out, or copy the input elsewhere"))
        }
    }
}

/// A file's path as seen from `folder`, so that both can be moved together; absolute where they have nothing but the root
/// in common, and as it is where it is not there.
pub fn relative_to(folder: &Path, file: &Path) -> PathBuf {
    let parent = file.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let (Ok(folder), Ok(parent), Some(name)) =
        (std::fs::canonicalize(folder), std::fs::canonicalize(parent), file.file_name())
    else {
        return file.to_owned();
    };
    let named = |p: &Path| p.components().filter(|c| matches!(c, Component::Normal(_))).count();
    let shared: PathBuf =
        folder.components().zip(parent.components()).take_while(|(a, b)| a == b).map(|(a, _)| a).collect();
    if named(&shared) == 0 && named(&folder) > 0 {
        return parent.join(name);
    }
    let up = folder.components().count() - shared.components().count();
    let down = parent.strip_prefix(&shared).unwrap_or(Path::new(""));
    std::iter::repeat_n(Path::new(".."), up).collect::<PathBuf>().join(down).join(name)
}

/// A path as text in JSON; bytes that are no text become replacement characters instead of ending the run.
///
/// # Errors
/// As the serializer's.
pub fn path_as_text<S: serde::Serializer>(path: &Path, serializer: S) -> std::result::Result<S::Ok, S::Error> {
    serializer.serialize_str(&path.to_string_lossy())
}

/// The file that a report names by `path`: seen from `folder`, where the report lies, else from where this process works,
/// else from the folder that it was written into; names that JSON could not hold are found by their likeness. Where there
/// is none, the path as it is.
pub fn recorded_file(folder: &Path, path: &Path, written_into: Option<&Path>) -> PathBuf {
    let places: Vec<PathBuf> = [Some(folder.join(path)), Some(path.to_owned()), written_into.map(|f| f.join(path))]
        .into_iter()
        .flatten()
        .collect();
    let there = places.iter().find(|p| dicom::root_of(p).exists()).cloned();
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
    use super::*;

    #[test]
    fn paths_are_told_from_the_folder() {
        let dir = tempfile::tempdir().unwrap();
        let (a, b) = (dir.path().join("a/deep"), dir.path().join("b"));
        for folder in [&a, &b] {
            std::fs::create_dir_all(folder).unwrap();
        }
        std::fs::write(b.join("ct.nii"), b"x").unwrap();
        assert_eq!(relative_to(&a, &b.join("ct.nii")), Path::new("../../b/ct.nii"));
        assert_eq!(relative_to(&b, &b.join("ct.nii")), Path::new("ct.nii"));
        assert_eq!(relative_to(&b, &a.join("../../b/ct.nii")), Path::new("ct.nii"));
        let gone = b.join("nowhere/ct.nii");
        assert_eq!(relative_to(&a, &gone), gone);
    }

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
