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
            let text = path.to_str()?;
            let (root, choice) = text.rsplit_once('#')?;
            let root = PathBuf::from(root);
            root.exists().then(|| Self { root, choice: Some(choice.to_owned()) })
        };
        let whole = Self { root: path.into(), choice: None };
        if path.exists() { whole } else { split().unwrap_or(whole) }
    }
}

/// The folder or file that a path means, without what is chosen there.
pub(super) fn root_of(path: &Path) -> PathBuf {
    Place::of(path).root
}
