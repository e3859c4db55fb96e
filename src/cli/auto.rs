//! `--bones auto` of several verbs; the labels are [`crate::io::auto`]'s.

use super::inputs::missing;
use super::terminal::command_line;
use crate::config::{InputRole, RecordedInput};
use crate::error::{Error, Result};
use crate::io::auto::{AUTO, Ask as Made, AutoBones};
use crate::progress::Progress;
use crate::warning::Warning;
use std::path::{Path, PathBuf};

/// What the command line says that matters here.
pub(super) struct Ask<'a> {
    pub bones: Option<&'a Path>,
    pub labels: Option<&'a Path>,
    pub planning: Option<PathBuf>,
    /// Other files that the run will read: known to be there before minutes are spent.
    pub needed: Vec<&'a Path>,
    /// The result beside which the labels are kept.
    pub beside: &'a Path,
    pub quiet: bool,
}

/// The bones of a run.
pub(super) struct Bones {
    /// The file as the command line names it, or of `auto`; `None` where neither says it.
    pub file: Option<PathBuf>,
    /// What is to be known of labels that were made.
    pub warnings: Vec<Warning>,
}

impl Bones {
    /// The file that `--bones` names; of `auto` that of [`AutoBones`]. Bones and names that a report recorded do not count
    /// then.
    ///
    /// # Errors
    /// [`Error::Usage`] when names are given for labels that bring theirs, or no planning CT; else as [`AutoBones::of`].
    pub(super) fn of(ask: Ask<'_>, recorded: &mut Vec<RecordedInput>, progress: &dyn Progress) -> Result<Self> {
        if ask.bones != Some(Path::new(AUTO)) {
            return Ok(Self { file: ask.bones.map(Path::to_owned), warnings: Vec::new() });
        }
        recorded.retain(|i| i.role != InputRole::Bones && i.role != InputRole::Labels);
        if let Some(names) = ask.labels {
            let problem =
                format!("--bones auto and --labels {}: labels that are made have their names", names.display());
            return Err(Error::usage(problem, "leave --labels out, or name a label map with --bones"));
        }
        let planning = ask.planning.ok_or_else(|| missing(InputRole::Planning))?;
        let Ask { beside, quiet, .. } = ask;
        let made = Made { planning: &planning, needed: &ask.needed, beside, command: &command_line(), quiet };
        let AutoBones { file, warnings } = AutoBones::of(made, progress)?;
        Ok(Self { file: Some(file), warnings })
    }
}
