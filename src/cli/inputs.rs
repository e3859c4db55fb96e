//! Input files of a run: from the flags, else from the report that is run again.

use super::args::PlanningArgs;
use crate::config::{ConfigFile, InputRole, RecordedInput};
use crate::error::{Error, Result};
use crate::io::{self, auto::AUTO};
use crate::session::{PlanningSources, Source};
use std::path::{Path, PathBuf};

/// The flag's file, else the recorded one of the same role.
pub(super) fn either(own: &Option<PathBuf>, role: InputRole, recorded: &[RecordedInput]) -> Option<PathBuf> {
    own.clone().or_else(|| recorded.iter().find(|i| i.role == role).map(|i| i.path.clone()))
}

/// As [`either`], for a file that must be named.
pub(super) fn needed(own: &Option<PathBuf>, role: InputRole, recorded: &[RecordedInput]) -> Result<PathBuf> {
    either(own, role, recorded).ok_or_else(|| {
        let remedy = format!("add --{role} FILE; a TOML of settings names no inputs");
        Error::usage(format!("no {role} file is given"), remedy)
    })
}

/// Reads `--config`; the inputs of a report as this process finds them.
pub(super) fn config_file(path: &Path) -> Result<ConfigFile> {
    let mut file = ConfigFile::read(path)?;
    let (folder, written_into) = (path.parent().unwrap_or(Path::new("")), file.folder.clone());
    for input in &mut file.inputs {
        input.path = io::recorded_file(folder, &input.path, written_into.as_deref());
    }
    Ok(file)
}

/// The planning side that the flags name, else the run that is done again. With `--bones auto` its bones no longer count.
///
/// # Errors
/// [`Error::Usage`] when neither names a planning CT or bones.
pub(super) fn planning_side(
    side: &PlanningArgs,
    organs: &Option<PathBuf>,
    recorded: &mut Vec<RecordedInput>,
) -> Result<PlanningSources> {
    if side.bones.as_deref() == Some(Path::new(AUTO)) {
        recorded.retain(|i| i.role != InputRole::Bones && i.role != InputRole::Labels);
    }
    let file = |own: &Option<PathBuf>, role: InputRole| Ok(Source::File(needed(own, role, recorded)?));
    let ct = file(&side.planning, InputRole::Planning)?;
    let mut sources = PlanningSources::new(ct, Source::File(needed(&side.bones, InputRole::Bones, recorded)?));
    sources.names = either(&side.labels, InputRole::Labels, recorded).map(Source::File);
    sources.organs = either(organs, InputRole::Organs, recorded);
    sources.skeleton = either(&side.skeleton, InputRole::Skeleton, recorded);
    Ok(sources)
}
