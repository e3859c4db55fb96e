//! What a report records of its inputs.

use serde::Deserialize;
use std::path::PathBuf;

/// One input of an earlier run, as its report records it.
#[derive(Debug, Clone, PartialEq, Eq, Deserialize)]
pub struct RecordedInput {
    /// Role, for example `planning`.
    pub role: String,
    /// Where it lies, seen from the folder of the report, or as it was given.
    pub path: PathBuf,
    /// SHA-256 of the file then.
    pub sha256: String,
    /// What was given behind `#`.
    #[serde(default)]
    pub entry: Option<String>,
}

impl RecordedInput {
    /// The path as it was given, with what stood behind `#`.
    pub fn given(&self) -> PathBuf {
        let mut path = self.path.clone().into_os_string();
        if let Some(entry) = &self.entry {
            path.push("#");
            path.push(entry);
        }
        path.into()
    }
}
