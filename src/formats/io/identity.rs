//! Which file a path leads to, through links, and where a file lies seen from a folder.

use std::ffi::{OsStr, OsString};
use std::fs::Metadata;
use std::path::{Component, Path, PathBuf};

/// What two paths to one file have in common.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum Identity {
    /// Device and number of the file itself.
    #[cfg(unix)]
    Node(u64, u64),
    /// The path without links.
    #[cfg(not(unix))]
    Path(PathBuf),
}

/// The file that a path leads to, through links; `None` where there is none.
pub(super) fn identity(path: &Path) -> Option<Identity> {
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

/// The whole path of what is there, without links, as people and other programs write it: on Windows without the
/// prefix `\\?\` that the standard library puts before it.
///
/// # Errors
/// Where nothing is there, or a folder on the way may not be read.
pub fn whole_path(path: &Path) -> std::io::Result<PathBuf> {
    dunce::canonicalize(path)
}

/// A file's path as seen from `folder`, so that both can be moved together; absolute where they have nothing but the root
/// in common, and as it is where it is not there. Its parts are joined by `/` on every system: it goes into reports and
/// links of pages, which are read elsewhere.
pub fn relative_to(folder: &Path, file: &Path) -> PathBuf {
    let parent = file.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let (Ok(folder), Ok(parent), Some(name)) = (whole_path(folder), whole_path(parent), file.file_name()) else {
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
    let parts = std::iter::repeat_n(OsStr::new(".."), up).chain(down.iter());
    let mut path = OsString::new();
    for part in parts {
        path.push(part);
        path.push("/");
    }
    path.push(name);
    path.into()
}

/// A path as text in JSON; bytes that are no text become replacement characters instead of ending the run.
///
/// # Errors
/// As the serializer's.
pub fn path_as_text<S: serde::Serializer>(path: &Path, serializer: S) -> std::result::Result<S::Ok, S::Error> {
    serializer.serialize_str(&path.to_string_lossy())
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
}
