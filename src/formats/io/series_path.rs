//! A path that may choose one series in a folder: `FOLDER#NUMBER` or `FOLDER#UID`.

use std::path::{Path, PathBuf};

/// A path with what is chosen there.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Place {
    /// Folder or file.
    pub(super) root: PathBuf,
    /// Series number or Series Instance UID.
    pub(super) choice: Option<String>,
}

impl Place {
    /// A path that exists means itself; else what follows the last `#` chooses in what precedes it.
    pub(super) fn of(path: &Path) -> Self {
        let split = || {
            let (root, choice) = split_choice(path)?;
            root.exists().then(|| Self { root, choice: Some(choice.to_owned()) })
        };
        let whole = Self { root: path.into(), choice: None };
        if path.exists() { whole } else { split().unwrap_or(whole) }
    }
}

/// What precedes the last `#` of a path, and what follows it. Of a path that is no text, the `#` of its last part counts.
pub fn split_choice(path: &Path) -> Option<(PathBuf, &str)> {
    if let Some(text) = path.to_str() {
        return text.rsplit_once('#').map(|(root, choice)| (root.into(), choice));
    }
    let (name, choice) = path.file_name()?.to_str()?.rsplit_once('#')?;
    Some((path.with_file_name(name), choice))
}

/// The folder or file that a path means, without what is chosen there.
pub(super) fn root_of(path: &Path) -> PathBuf {
    Place::of(path).root
}
