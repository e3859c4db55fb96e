//! Inputs of a registration, from files and from memory.

use crate::arrays::{self, Given};
use aventail::chainmail::VolumeChange;
use aventail::config::{ConfigFile, Preset};
use aventail::evaluate::landmark::Landmark;
use aventail::fit::BoneLandmark;
use aventail::geometry::Rigid;
use aventail::report::ClinicFiles;
use aventail::session::{BonesBy, FractionSources, LabelSources, PlanningSources, Request};
use aventail::{Config, Error, Result};
use pyo3::prelude::*;
use std::path::{Path, PathBuf};

/// What reports and locks name as the command.
pub(crate) const COMMAND: &str = "aventail (Python)";

/// Landmarks as Python gives them: name, planning, fraction.
type Points = Vec<(String, [f64; 3], [f64; 3])>;

/// Landmarks on bones: bone, name, planning, fraction.
type BonePoints = Vec<(String, String, [f64; 3], [f64; 3])>;

/// Landmarks: a path or a table.
pub(crate) fn landmarks(any: &Bound<'_, PyAny>) -> PyResult<Given<Vec<Landmark>>> {
    let own = |(name, planning, fraction): (String, [f64; 3], [f64; 3])| Landmark {
        name,
        planning: planning.into(),
        fraction: fraction.into(),
    };
    arrays::given(any, |table| Ok(table.extract::<Points>()?.into_iter().map(own).collect()))
}

/// Landmarks on bones: a path or a table.
fn on_bones(any: &Bound<'_, PyAny>) -> PyResult<Given<Vec<BoneLandmark>>> {
    let own = |(bone, name, planning, fraction): (String, String, [f64; 3], [f64; 3])| BoneLandmark {
        bone,
        name,
        planning: planning.into(),
        fraction: fraction.into(),
    };
    arrays::given(any, |table| Ok(table.extract::<BonePoints>()?.into_iter().map(own).collect()))
}

/// A label map and the names of its labels.
pub(crate) type Labelled<'py> = (Bound<'py, PyAny>, Option<Bound<'py, PyAny>>);

/// A label map with its names.
fn labelled((labels, names): &Labelled<'_>) -> PyResult<LabelSources> {
    Ok((arrays::labels(labels)?, names.as_ref().map(arrays::names).transpose()?))
}

/// A fraction with its landmarks, the labels of its bones, and the structures that guide to it.
pub(crate) fn fraction(
    image: &Bound<'_, PyAny>,
    marks: Option<&Bound<'_, PyAny>>,
    bones: Option<&Labelled<'_>>,
    guides: Option<&Labelled<'_>>,
) -> PyResult<FractionSources> {
    let mut one = FractionSources::new(arrays::image(image)?);
    one.landmarks = marks.map(landmarks).transpose()?;
    one.bones = bones.map(labelled).transpose()?;
    one.guides = guides.map(labelled).transpose()?;
    Ok(one)
}

/// Landmarks of both kinds.
type Marks = (Option<Given<Vec<Landmark>>>, Option<Given<Vec<BoneLandmark>>>);

/// Who asks for bones that TotalSegmentator is to find.
pub(crate) fn asks(beside: &Path, quiet: bool) -> BonesBy<'_> {
    BonesBy { beside, command: COMMAND, quiet }
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
    guide: Option<Labelled<'py>>,
    dicom: bool,
    structures: Option<PathBuf>,
    dose: Option<PathBuf>,
    anonymous: bool,
    same_frame: bool,
}

impl More<'_> {
    /// The planning side with them.
    pub(crate) fn planning(&self, ct: &Bound<'_, PyAny>, bones: &Bound<'_, PyAny>) -> PyResult<PlanningSources> {
        let mut side = PlanningSources::new(arrays::image(ct)?, arrays::labels(bones)?);
        side.names = self.labels.as_ref().map(arrays::names).transpose()?;
        side.guides = self.guide.as_ref().map(labelled).transpose()?;
        (side.organs, side.skeleton) = (self.organs.clone(), self.skeleton.clone());
        Ok(side)
    }

    /// Evaluation landmarks and landmarks on bones.
    pub(crate) fn marks(&self) -> PyResult<Marks> {
        Ok((
            self.landmarks.as_ref().map(landmarks).transpose()?,
            self.bone_landmarks.as_ref().map(on_bones).transpose()?,
        ))
    }

    /// The motion of all bones together that a fit begins with.
    pub(crate) fn start(&self) -> Result<Option<Rigid>> {
        self.start.map(|rows| arrays::rigid("start", &rows)).transpose()
    }

    /// Where labels that are made are kept.
    pub(crate) fn beside(&self) -> PathBuf {
        self.bones_folder.clone().unwrap_or_default().join("registration")
    }

    /// What is to be registered with them.
    pub(crate) fn request(
        &self,
        planning: PlanningSources,
        fractions: Vec<FractionSources>,
        config: Config,
    ) -> Request {
        let files = || ClinicFiles {
            structures: self.structures.clone(),
            dose: self.dose.clone(),
            anonymous: self.anonymous,
            same_frame: self.same_frame,
        };
        Request {
            planning,
            fractions,
            clinic: self.dicom.then(files),
            anonymous: self.anonymous,
            same_frame: self.same_frame,
            recorded: Vec::new(),
            config,
            command: COMMAND.into(),
        }
    }

    /// The settings with the changes of organs' volumes laid over.
    ///
    /// # Errors
    /// [`Error::Usage`] when a factor makes no sense or the settings cannot use it.
    pub(crate) fn settled(&self, settings: &Settings) -> Result<Config> {
        let mut config = settings.config()?;
        let change = |(organ, factor): &(String, f64)| VolumeChange { organ: organ.clone(), factor: *factor };
        let changes: Vec<VolumeChange> = self.volume_change.iter().map(change).collect();
        let problem = config.change_volumes(&changes);
        problem.map_or(Ok(config), |p| Err(Error::usage(p, "correct volume_change, or the settings it goes with")))
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
                let remedy = "take default, fast or thesis, a dict of settings, or the path of a file of them";
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
