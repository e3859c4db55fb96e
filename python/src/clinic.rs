//! What a registration gives back to a planning system.

use aventail::report::{Clinic, ClinicFiles};
use aventail::{Config, Error, Result, Runtime};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// What Python's keywords ask for.
pub(crate) struct GiveBack {
    files: Option<ClinicFiles>,
    /// The patient's identity is left out of report and DICOM.
    pub(crate) anonymous: bool,
}

impl GiveBack {
    /// Of the keywords; without `dicom` nothing but the report is written.
    pub(crate) fn new(dicom: bool, [structures, dose]: [Option<PathBuf>; 2], anonymous: bool) -> Self {
        Self { files: dicom.then_some(ClinicFiles { structures, dose, anonymous, same_frame: false }), anonymous }
    }

    /// Files that will be read.
    pub(crate) fn paths(&self) -> impl Iterator<Item = &Path> {
        self.files.iter().flat_map(ClinicFiles::paths)
    }

    /// Reads what the objects are made of, where DICOM is asked for; planning and fractions by their paths, where they have
    /// one.
    ///
    /// # Errors
    /// [`Error::Usage`] when a scan is in memory or the settings choose a region; else as [`Clinic::read`].
    pub(crate) fn read(
        &self,
        planning: Option<&Path>,
        fractions: &[Option<&Path>],
        config: &Config,
        runtime: &Runtime,
    ) -> Result<Option<Arc<Clinic>>> {
        let Some(files) = &self.files else { return Ok(None) };
        Clinic::check(config)?;
        let known = |path: Option<&Path>| path.map(Path::to_owned).ok_or_else(in_memory);
        let planning = known(planning)?;
        let fractions = fractions.iter().map(|path| known(*path)).collect::<Result<Vec<_>>>()?;
        let fractions: Vec<&Path> = fractions.iter().map(PathBuf::as_path).collect();
        let clinic = runtime.stage("read for DICOM", || Clinic::read(files, &planning, &fractions))?;
        Ok(Some(Arc::new(clinic)))
    }
}

fn in_memory() -> Error {
    let problem = "only DICOM can go back as DICOM, and a scan is given in memory";
    Error::usage(problem, "give the folders of both CT series, or leave dicom out")
}
