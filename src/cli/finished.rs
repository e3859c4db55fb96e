//! A finished run as it was, out of its folder and its inputs.

use super::inputs::{Flags, FractionSide, Inputs, PlanningSide, config_file};
use crate::config::{ConfigFile, RecordedInput};
use crate::error::{Error, Result};
use crate::io::inspect::check_folder;
use crate::pipeline::{Case, Outcome};
use crate::report::{Report, cut_to, restore};
use crate::runtime::Runtime;
use std::path::Path;

/// What to do where a folder holds no whole registration.
const REMEDY: &str = "give the --out folder of a finished run of aventail register";

/// A run with its inputs, on the grids of its results.
pub(super) struct Finished {
    pub(super) case: Case,
    pub(super) outcome: Outcome,
}

impl Finished {
    /// Reads the run in a folder. Its files and its inputs must be those that its report tells of, by their checksums.
    ///
    /// # Errors
    /// [`Error::Input`] where the folder holds no finished run or files have changed; [`Error::Read`] where one is missing.
    pub(super) fn read(folder: &Path, runtime: &Runtime) -> Result<Self> {
        for check in runtime.stage("check the run", || check_folder(folder))? {
            check.require()?;
        }
        let path = folder.join("report.json");
        let report = Report::read(&path, REMEDY)?;
        let file = config_file(&path)?;
        let fraction = file.inputs.iter().find(|i| i.role == "fraction").ok_or_else(|| {
            let problem =
                "its report names no files of planning and fraction CT: a posture, or a phantom that was never a file";
            Error::read(&path, problem, "register files: `aventail phantom` writes the phantom as such")
        })?;
        let side = Self::side(&file, fraction, runtime)?;
        unchanged(&side.case, &file)?;
        let case = Case {
            planning: cut_to(side.case.planning, &report.planning_grid)?,
            bones: crate::volume::LabelMap {
                volume: cut_to(side.case.bones.volume, &report.planning_grid)?,
                names: side.case.bones.names,
            },
            fraction: cut_to(side.case.fraction, &report.fraction_grid)?,
            ..side.case
        };
        let outcome = runtime.stage("read the results", || restore(folder, &report, &case))?;
        Ok(Self { case, outcome })
    }

    /// The inputs of the run.
    fn side(file: &ConfigFile, fraction: &RecordedInput, runtime: &Runtime) -> Result<PlanningSide> {
        let config = file.resolve(None)?;
        let none = None;
        let flags = Flags {
            planning: &none,
            bones: &none,
            labels: &none,
            organs: &none,
            skeleton: &none,
            landmarks: &none,
            bone_landmarks: &none,
            start: &none,
        };
        let inputs = Inputs::new(&flags, &file.inputs)?;
        let mut side = PlanningSide::new(inputs.load(&file.inputs, &config, runtime)?);
        let read = runtime.stage("read the fraction", || FractionSide::read(&fraction.path, None))?;
        side.take(read, &file.inputs);
        Ok(side)
    }
}

/// Refuses inputs that are not those of the run.
fn unchanged(case: &Case, file: &ConfigFile) -> Result<()> {
    let other = |input: &&crate::pipeline::InputFile| {
        file.inputs.iter().any(|then| then.role == input.role && then.sha256 != input.sha256)
    };
    match case.inputs.iter().find(other) {
        None => Ok(()),
        Some(input) => {
            let problem = format!("it is not the file that the run has read as its {} (by its checksum)", input.role);
            let remedy = "put the file back where it was, or register again";
            Err(Error::refused("run-changed", input.path.display().to_string(), problem, remedy))
        }
    }
}
