//! Inputs of a registration, from files and from memory.

use crate::arrays::{self, Given, Names};
use crate::clinic::GiveBack;
use aventail::chainmail::VolumeChange;
use aventail::config::{ConfigFile, InputRole, Preset};
use aventail::evaluate::landmark::Landmark;
use aventail::fit::BoneLandmark;
use aventail::geometry::{Grid, Rigid};
use aventail::io::auto::{AUTO, Ask, AutoBones};
use aventail::io::dicom::{About, Role, check_frames, is_dicom_path};
use aventail::io::{self, Loaded};
use aventail::pipeline::{FractionScan, InputFile, PlanningScan};
use aventail::volume::{LabelMap, Volume};
use aventail::warning::Warning;
use aventail::{Config, Error, Result, Runtime, skeleton};
use pyo3::prelude::*;
use std::path::{Path, PathBuf};

/// What reports and locks name as the command.
pub(crate) const COMMAND: &str = "aventail (Python)";

/// The files behind a case and what reading them found.
#[derive(Default)]
pub(crate) struct Ledger {
    inputs: Vec<InputFile>,
    warnings: Vec<Warning>,
}

impl Ledger {
    fn take<T>(&mut self, role: InputRole, file: Loaded<T>) -> T {
        let about = About::of(&file.path);
        self.inputs.push(InputFile { about, ..InputFile::new(role, file.path, file.sha256) });
        self.warnings.extend(file.warnings);
        file.value
    }

    fn named(&mut self, role: InputRole, path: &Path) -> Result<()> {
        self.inputs.push(InputFile::read(role, path)?);
        Ok(())
    }

    /// An image's values.
    pub(crate) fn image(&mut self, role: InputRole, given: Given<Volume<f32>>) -> Result<Volume<f32>> {
        match given {
            Given::Path(path) => Ok(self.take(role, io::read_image(path)?)),
            Given::Value(volume) => Ok(volume),
        }
    }

    /// Bone labels on the planning grid, every one with a name of its own.
    pub(crate) fn bones(
        &mut self,
        given: Given<Volume<u16>>,
        names: Option<Given<Names>>,
        (planning, grid): (Option<&Path>, &Grid),
    ) -> Result<LabelMap> {
        if let Some(path) = names.as_ref().and_then(Given::path) {
            self.named(InputRole::Labels, path)?;
        }
        match (given, names) {
            (Given::Path(path), names) if is_dicom_path(&path) => {
                if let Some(planning) = planning {
                    check_frames(Role::Structures.at(&path), Role::Image.at(planning))?;
                }
                let file = names.as_ref().and_then(Given::path);
                Ok(self.take(InputRole::Bones, io::read_bones(&path, file, grid)?))
            }
            (Given::Path(path), Some(Given::Value(names))) => {
                let volume = self.take(InputRole::Bones, io::read_label_map(&path, None)?).volume;
                checked(&path.display().to_string(), volume, names)
            }
            (Given::Path(path), names) => {
                let file = names.as_ref().and_then(Given::path);
                Ok(self.take(InputRole::Bones, io::read_labels(&path, file)?))
            }
            (Given::Value(volume), names) => checked("bones", volume, table(names)?),
        }
    }

    /// Structures, whose labels need names only where they have some; `argument` is their name in Python.
    pub(crate) fn structures(
        &mut self,
        role: InputRole,
        argument: &str,
        given: Given<Volume<u16>>,
        names: Option<Given<Names>>,
    ) -> Result<LabelMap> {
        let mut map = match given {
            Given::Path(path) => self.take(role, io::read_label_map(path, None)?),
            Given::Value(volume) => LabelMap { volume, names: Names::new() },
        };
        if names.is_some() {
            map.names = table(names)?;
        }
        map.one_number_a_name();
        io::check_labels(argument, &map)?;
        Ok(map)
    }
}

/// Labels with names, none left out and none twice.
fn checked(what: &str, volume: Volume<u16>, names: Names) -> Result<LabelMap> {
    let map = LabelMap { volume, names };
    io::check_labels(what, &map)?;
    Ok(map)
}

/// The table of names.
fn table(names: Option<Given<Names>>) -> Result<Names> {
    match names {
        None => Ok(Names::new()),
        Some(Given::Value(names)) => Ok(names),
        Some(Given::Path(path)) => io::read_label_names(path),
    }
}

/// Landmarks as Python gives them: name, planning, fraction.
pub(crate) type Points = Vec<(String, [f64; 3], [f64; 3])>;

/// Landmarks on bones: bone, name, planning, fraction.
type BonePoints = Vec<(String, String, [f64; 3], [f64; 3])>;

/// Landmarks of a file or a table.
pub(crate) fn landmarks(given: Given<Points>) -> Result<Vec<Landmark>> {
    let own = |(name, planning, fraction): (String, [f64; 3], [f64; 3])| Landmark {
        name,
        planning: planning.into(),
        fraction: fraction.into(),
    };
    match given {
        Given::Path(path) => io::read_landmarks(path),
        Given::Value(points) => Ok(points.into_iter().map(own).collect()),
    }
}

/// A path or a table of points.
pub(crate) fn points<T: for<'a, 'py> FromPyObject<'a, 'py>>(any: &Bound<'_, PyAny>) -> PyResult<Given<T>> {
    match any.extract::<PathBuf>() {
        Ok(path) => Ok(Given::Path(path)),
        Err(_) => any.extract::<T>().map_err(Into::into).map(Given::Value),
    }
}

/// What a registration or a pose is given, still to be read.
pub(crate) struct Inputs {
    planning: Given<Volume<f32>>,
    bones: Given<Volume<u16>>,
    names: Option<Given<Names>>,
    landmarks: Option<Given<Points>>,
    bone_landmarks: Option<Given<BonePoints>>,
    skeleton: Option<PathBuf>,
    start: Option<[[f64; 4]; 4]>,
    organs: Option<PathBuf>,
    bones_folder: PathBuf,
    /// What is to be known of labels that were made.
    made: Vec<Warning>,
}

impl Inputs {
    /// Of Python's keywords.
    pub(crate) fn new(planning: &Bound<'_, PyAny>, bones: &Bound<'_, PyAny>, more: More<'_>) -> PyResult<Self> {
        Ok(Self {
            planning: arrays::image(planning)?,
            bones: arrays::labels(bones)?,
            names: more.labels.as_ref().map(arrays::names).transpose()?,
            landmarks: more.landmarks.as_ref().map(points).transpose()?,
            bone_landmarks: more.bone_landmarks.as_ref().map(points).transpose()?,
            skeleton: more.skeleton,
            start: more.start,
            organs: more.organs,
            bones_folder: more.bones_folder.unwrap_or_default(),
            made: Vec::new(),
        })
    }

    /// The planning CT's file.
    pub(crate) fn planning(&self) -> Option<&Path> {
        self.planning.path()
    }

    /// Has labels made by TotalSegmentator where bones are asked for as `auto`, or finds those that were made before; `needed`:
    /// other files that the run will read.
    ///
    /// # Errors
    /// [`Error::Usage`] when the labels have names beside their own, or the planning CT is no file; else as [`AutoBones::of`].
    pub(crate) fn make_bones(&mut self, needed: &[&Path], quiet: bool, runtime: &Runtime) -> Result<()> {
        if self.bones.path() != Some(Path::new(AUTO)) {
            return Ok(());
        }
        if self.names.is_some() {
            let problem = "bones are \"auto\" and labels are given: labels that are made have their names";
            return Err(Error::usage(problem, "leave labels out, or give a label map as bones"));
        }
        let Some(planning) = self.planning.path() else {
            let problem = "bones are \"auto\" and the planning CT is in memory: TotalSegmentator reads a file";
            return Err(Error::usage(problem, "give the path of the planning CT; Image.save writes one"));
        };
        let own = [
            self.landmarks.as_ref().and_then(Given::path),
            self.bone_landmarks.as_ref().and_then(Given::path),
            self.skeleton.as_deref(),
            self.organs.as_deref(),
        ];
        let needed: Vec<&Path> = needed.iter().copied().chain(own.into_iter().flatten()).collect();
        let beside = self.bones_folder.join("registration");
        let ask = Ask { planning, needed: &needed, beside: &beside, command: COMMAND, quiet };
        let made = runtime.stage("bones by TotalSegmentator", || AutoBones::of(ask, runtime.progress()))?;
        (self.bones, self.made) = (Given::Path(made.file), made.warnings);
        Ok(())
    }

    /// Reads the files of the planning side, and what is known of it and a fraction or a posture; `named`: organs that the
    /// settings name, for structure sets.
    pub(crate) fn read(self, named: &[String]) -> Result<(PlanningScan, Marks)> {
        let mut ledger = Ledger::default();
        let planning_file = self.planning.path().map(Path::to_owned);
        let ct = ledger.image(InputRole::Planning, self.planning)?;
        let mut bones = ledger.bones(self.bones, self.names, (planning_file.as_deref(), ct.grid()))?;
        if let Some(path) = &self.organs {
            if let (true, Some(planning)) = (is_dicom_path(path), &planning_file) {
                check_frames(Role::Structures.at(path), Role::Image.at(planning))?;
            }
            ledger.warnings.extend(io::add_organs(&mut bones, path, named)?);
            ledger.named(InputRole::Organs, path)?;
        }
        let skeleton = match &self.skeleton {
            Some(path) => {
                ledger.named(InputRole::Skeleton, path)?;
                Some(io::skeleton::load_override(path, skeleton::build(&bones)?.skeleton)?)
            }
            None => None,
        };
        let Ledger { inputs, mut warnings } = ledger;
        warnings.extend(self.made);
        let planning = PlanningScan { ct, bones, skeleton, warnings, inputs };
        let marks = Marks::read(self.landmarks, self.bone_landmarks, self.start)?;
        Ok((planning, marks))
    }
}

/// What is known of planning and a fraction or a posture, beside the scans.
pub(crate) struct Marks {
    pub(crate) landmarks: Vec<Landmark>,
    pub(crate) bone_landmarks: Vec<BoneLandmark>,
    start: Option<Rigid>,
    /// The files behind it.
    pub(crate) inputs: Vec<InputFile>,
}

impl Marks {
    fn read(
        points: Option<Given<Points>>,
        bone_points: Option<Given<BonePoints>>,
        start: Option<[[f64; 4]; 4]>,
    ) -> Result<Self> {
        let mut ledger = Ledger::default();
        let files = [
            (InputRole::Landmarks, points.as_ref().and_then(Given::path)),
            (InputRole::BoneLandmarks, bone_points.as_ref().and_then(Given::path)),
        ];
        for (role, path) in files {
            path.map_or(Ok(()), |path| ledger.named(role, path))?;
        }
        Ok(Self {
            landmarks: points.map(landmarks).transpose()?.unwrap_or_default(),
            bone_landmarks: bone_points.map(on_bones).transpose()?.unwrap_or_default(),
            start: start.map(|rows| arrays::rigid("start", &rows)).transpose()?,
            inputs: ledger.inputs,
        })
    }

    /// A fraction with them.
    pub(crate) fn with(self, fraction: Given<Volume<f32>>) -> Result<FractionScan> {
        let mut ledger = Ledger::default();
        let ct = ledger.image(InputRole::Fraction, fraction)?;
        let Self { landmarks, bone_landmarks, start, inputs } = self;
        let inputs = [ledger.inputs, inputs].concat();
        Ok(FractionScan { ct, landmarks, bone_landmarks, start, warnings: ledger.warnings, inputs })
    }
}

/// One of several fractions, still to be read, with its landmarks.
pub(crate) struct FractionInputs {
    image: Given<Volume<f32>>,
    landmarks: Option<Given<Points>>,
}

impl FractionInputs {
    /// Of Python's keywords.
    pub(crate) fn new(image: &Bound<'_, PyAny>, landmarks: Option<&Bound<'_, PyAny>>) -> PyResult<Self> {
        Ok(Self { image: arrays::image(image)?, landmarks: landmarks.map(points).transpose()? })
    }

    /// The image's file.
    pub(crate) fn path(&self) -> Option<&Path> {
        self.image.path()
    }

    /// All of its files.
    pub(crate) fn paths(&self) -> impl Iterator<Item = &Path> {
        [self.image.path(), self.landmarks.as_ref().and_then(Given::path)].into_iter().flatten()
    }

    /// Reads the files.
    pub(crate) fn read(self) -> Result<FractionScan> {
        Marks::read(self.landmarks, None, None)?.with(self.image)
    }
}

/// Landmarks on bones, of a file or a table.
fn on_bones(given: Given<BonePoints>) -> Result<Vec<BoneLandmark>> {
    match given {
        Given::Path(path) => io::read_bone_landmarks(path),
        Given::Value(points) => {
            let own = |(bone, name, planning, fraction): (String, String, [f64; 3], [f64; 3])| BoneLandmark {
                bone,
                name,
                planning: planning.into(),
                fraction: fraction.into(),
            };
            Ok(points.into_iter().map(own).collect())
        }
    }
}

/// Inputs beside the images.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub(crate) struct More<'py> {
    labels: Option<Bound<'py, PyAny>>,
    landmarks: Option<Bound<'py, PyAny>>,
    bone_landmarks: Option<Bound<'py, PyAny>>,
    skeleton: Option<PathBuf>,
    start: Option<[[f64; 4]; 4]>,
    organs: Option<PathBuf>,
    volume_change: Vec<(String, f64)>,
    bones_folder: Option<PathBuf>,
    dicom: bool,
    structures: Option<PathBuf>,
    dose: Option<PathBuf>,
    anonymous: bool,
}

impl More<'_> {
    /// What goes back to a planning system.
    pub(crate) fn give_back(&self) -> GiveBack {
        GiveBack::new(self.dicom, [self.structures.clone(), self.dose.clone()], self.anonymous)
    }

    /// Lays the changes of organs' volumes over those of the settings.
    ///
    /// # Errors
    /// [`Error::Usage`] when a factor makes no sense or the settings cannot use it.
    pub(crate) fn apply(&self, config: &mut Config) -> Result<()> {
        let change = |(organ, factor): &(String, f64)| VolumeChange { organ: organ.clone(), factor: *factor };
        let changes: Vec<VolumeChange> = self.volume_change.iter().map(change).collect();
        let problem = config.change_volumes(&changes);
        problem.map_or(Ok(()), |p| Err(Error::usage(p, "correct volume_change, or the settings it goes with")))
    }
}

/// How a run is set up.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub(crate) struct Settings {
    /// The settings as JSON, nested as the TOML.
    json: Option<String>,
    /// A TOML file of them, or the report.json of a run.
    file: Option<PathBuf>,
    /// What they start from.
    preset: Option<String>,
}

impl Settings {
    /// Complete settings.
    pub(crate) fn config(&self) -> Result<Config> {
        let file = match (&self.json, &self.file) {
            (Some(text), _) => ConfigFile::of(serde_json::from_str(text).map_err(|e| {
                Error::usage(format!("the settings are no JSON: {e}"), "give numbers, texts, lists and dicts only")
            })?)?,
            (None, Some(path)) => ConfigFile::read(path)?,
            (None, None) => ConfigFile::default(),
        };
        let preset = |name: &String| {
            serde_json::from_value::<Preset>(name.as_str().into()).map_err(|_| {
                let remedy =
                    "take default, fast, accurate or thesis, a dict of settings, or the path of a file of them";
                Error::usage(format!("{name:?} is no preset"), remedy)
            })
        };
        file.resolve(self.preset.as_ref().map(preset).transpose()?)
    }
}

/// Transforms of bones by name.
pub(crate) fn transforms(all: Vec<(String, [[f64; 4]; 4])>) -> Result<std::collections::BTreeMap<String, Rigid>> {
    all.into_iter().map(|(name, rows)| Ok((name.clone(), arrays::rigid(&name, &rows)?))).collect()
}
