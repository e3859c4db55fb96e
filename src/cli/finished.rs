//! A finished run as it was, out of its folder and its inputs.

use super::inputs::config_file;
use crate::config::{ConfigFile, InputRole, RecordedInput};
use crate::error::{Error, Result};
use crate::findings;
use crate::io::inspect::check_folder;
use crate::pipeline::{Case, FractionScan, Outcome, PlanningScan};
use crate::provenance::{InputFile, Provenance};
use crate::report::{Report, cut_to, restore};
use crate::runtime::Runtime;
use crate::session::{FractionSources, PlanningSources, Source};
use crate::volume::LabelMap;
use std::path::{Path, PathBuf};

/// What to do where a folder holds no whole registration.
const REMEDY: &str = "give the --out folder of a finished run of aventail register, pose or demo";

/// A run with its inputs, on the grids of its results.
pub(super) struct Finished {
    pub(super) case: Case,
    pub(super) outcome: Outcome,
    pub(super) provenance: Provenance,
    /// The structure set that it carried, as its report tells.
    pub(super) structures: Option<RecordedInput>,
}

impl Finished {
    /// Reads the run in a folder. Its files and its inputs must be those that its report tells of, by their checksums.
    ///
    /// # Errors
    /// [`Error::Input`] where the folder holds no finished run or files have changed; [`Error::Read`] where one is missing.
    pub(super) fn read(folder: &Path, runtime: &Runtime) -> Result<Self> {
        Self::only(folder)?;
        for check in runtime.stage("check the run", || check_folder(folder))? {
            check.require()?;
        }
        let path = folder.join("report.json");
        let report = Report::read(&path, REMEDY)?;
        let file = config_file(&path)?;
        if file.inputs.iter().all(|input| input.role != InputRole::Planning) {
            let problem = "its report names no file of a planning CT: it is of a phantom that was never a file";
            return Err(Error::read(
                &path,
                problem,
                "run aventail demo again, which leaves its scans beside its results",
            ));
        }
        let sources = PlanningSources::recorded(&file.inputs);
        let sources = sources.ok_or_else(|| Error::read(&path, "its report names no file of bones", REMEDY))?;
        let planning_file = sources.ct.path().map(Path::to_owned);
        let (planning, mut provenance) = sources.read(&[], &file.resolve(None)?, runtime)?;
        unchanged(&provenance.inputs, &file)?;
        let fraction = Self::fraction(planning_file.as_deref(), &file, runtime)?;
        let bones = planning.bones;
        let planning = PlanningScan {
            ct: cut_to(planning.ct, &report.planning_grid)?,
            bones: LabelMap { volume: cut_to(bones.volume, &report.planning_grid)?, names: bones.names },
            ..planning
        };
        let outcome = runtime.stage("read the results", || restore(folder, &report, &planning))?;
        let fraction = match fraction {
            Some((scan, of_fraction)) => {
                provenance.extend(of_fraction);
                FractionScan { ct: cut_to(scan.ct, &report.fraction_grid)?, ..scan }
            }
            // A made posture has no fraction CT: its own artificial one takes that place.
            None => FractionScan::new(outcome.planning_on_fraction.clone()),
        };
        let structures = file.inputs.into_iter().find(|input| input.role == InputRole::Structures);
        let case = Case { planning: planning.into(), fraction };
        Ok(Self { case, outcome, provenance, structures })
    }

    /// The fraction of the run; a made posture has none.
    fn fraction(
        planning: Option<&Path>,
        file: &ConfigFile,
        runtime: &Runtime,
    ) -> Result<Option<(FractionScan, Provenance)>> {
        let named = |role: InputRole| file.inputs.iter().find(|i| i.role == role);
        let path = |role: InputRole| named(role).map(|i| i.path.clone());
        let Some(fraction) = path(InputRole::Fraction) else {
            // The marks of a made posture are files of their own.
            let marks = [InputRole::Landmarks, InputRole::BoneLandmarks].into_iter();
            let marks = marks.filter_map(|role| Some(InputFile::read(role, &path(role)?)));
            unchanged(&marks.collect::<Result<Vec<_>>>()?, file)?;
            return Ok(None);
        };
        let mut one = FractionSources::new(Source::File(fraction));
        one.landmarks = path(InputRole::Landmarks).map(Source::File);
        one.bone_landmarks = path(InputRole::BoneLandmarks).map(Source::File);
        let names = path(InputRole::FractionLabels).map(Source::File);
        one.bones = path(InputRole::FractionBones).map(|labels| (Source::File(labels), names));
        let names = path(InputRole::GuideLabels).map(Source::File);
        one.guides = path(InputRole::FractionGuide).map(|guides| (Source::File(guides), names));
        one.start = named(InputRole::Start).map(|i| Source::File(i.given()));
        one.settle(planning)?;
        let (scan, provenance) = runtime.stage("read the fraction", || one.read(&[]))?;
        unchanged(&provenance.inputs, file)?;
        Ok(Some((scan, provenance)))
    }

    /// Refuses the folder of several fractions, naming the folder of each.
    ///
    /// # Errors
    /// [`Error::Read`] then, and when the folder cannot be read.
    pub(super) fn only(folder: &Path) -> Result<()> {
        let is_run = |f: &Path| f.join("report.json").is_file();
        let entries = std::fs::read_dir(folder).map_err(|e| Error::read(folder, e.to_string(), REMEDY))?;
        let mut runs: Vec<PathBuf> = entries.flatten().map(|e| e.path()).filter(|p| is_run(p)).collect();
        if is_run(folder) || runs.is_empty() {
            return Ok(());
        }
        runs.sort();
        let names: Vec<String> = runs.iter().map(|p| p.display().to_string()).collect();
        let problem = format!("it holds {} runs, one folder each", runs.len());
        let index = Some(folder.join("index.html")).filter(|page| page.is_file());
        let index = index.map_or(String::new(), |page| format!("; {} shows them side by side", page.display()));
        Err(Error::read(folder, problem, format!("give one of them: {}{index}", names.join(", "))))
    }
}

/// Refuses inputs that are not those of the run.
fn unchanged(inputs: &[InputFile], file: &ConfigFile) -> Result<()> {
    match inputs.iter().find(|input| input.recorded_otherwise(&file.inputs).is_some()) {
        None => Ok(()),
        Some(input) => {
            let problem = format!("it is not the file that the run has read as its {} (by its checksum)", input.role);
            let remedy = "put the file back where it was, or register again";
            Err(Error::refused(findings::RUN_CHANGED, input.path.display().to_string(), problem, remedy))
        }
    }
}
