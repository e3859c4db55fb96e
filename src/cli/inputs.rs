//! Input files of a run: from the flags, else from the report that is run again.

use super::headers::judge_names;
use super::{organs, start};
use crate::config::{Config, ConfigFile, InputRole, RecordedInput};
use crate::error::{Error, Result};
use crate::evaluate::landmark::Landmark;
use crate::findings;
use crate::fit::BoneLandmark;
use crate::io::dicom::{About, Role, check_frames, is_dicom_path};
use crate::io::{self, Loaded};
use crate::pipeline::{FractionScan, InputFile, PlanningScan};
use crate::runtime::Runtime;
use crate::volume::LabelMap;
use crate::warning::Warning;
use std::path::{Path, PathBuf};

/// Where the inputs of the planning side lie.
pub(super) struct Inputs {
    planning: PathBuf,
    bones: PathBuf,
    labels: Option<PathBuf>,
    organs: Option<PathBuf>,
    skeleton: Option<PathBuf>,
    landmarks: Option<PathBuf>,
    bone_landmarks: Option<PathBuf>,
    start: Option<PathBuf>,
    /// The same without the name of its entry.
    start_file: Option<PathBuf>,
}

/// The flags that name inputs; a role without a flag is `None`.
pub(super) struct Flags<'a> {
    pub planning: &'a Option<PathBuf>,
    pub bones: &'a Option<PathBuf>,
    pub labels: &'a Option<PathBuf>,
    pub organs: &'a Option<PathBuf>,
    pub skeleton: &'a Option<PathBuf>,
    pub landmarks: &'a Option<PathBuf>,
    pub bone_landmarks: &'a Option<PathBuf>,
    pub start: &'a Option<PathBuf>,
}

static NO_FILE: Option<PathBuf> = None;

impl Default for Flags<'_> {
    /// No file is named.
    fn default() -> Self {
        let none = &NO_FILE;
        Self {
            planning: none,
            bones: none,
            labels: none,
            organs: none,
            skeleton: none,
            landmarks: none,
            bone_landmarks: none,
            start: none,
        }
    }
}

/// The flag's file, else the recorded one of the same role.
pub(super) fn either(own: &Option<PathBuf>, role: InputRole, recorded: &[RecordedInput]) -> Option<PathBuf> {
    own.clone().or_else(|| recorded.iter().find(|i| i.role == role).map(|i| i.path.clone()))
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

impl Inputs {
    pub(super) fn new(flags: &Flags<'_>, recorded: &[RecordedInput]) -> Result<Self> {
        let needed = |own: &Option<PathBuf>, role: InputRole| either(own, role, recorded).ok_or_else(|| missing(role));
        let recorded_start = || recorded.iter().find(|i| i.role == InputRole::Start).map(RecordedInput::given);
        let start = flags.start.clone().or_else(recorded_start);
        Ok(Self {
            planning: needed(flags.planning, InputRole::Planning)?,
            bones: needed(flags.bones, InputRole::Bones)?,
            labels: either(flags.labels, InputRole::Labels, recorded),
            organs: either(flags.organs, InputRole::Organs, recorded),
            skeleton: either(flags.skeleton, InputRole::Skeleton, recorded),
            landmarks: either(flags.landmarks, InputRole::Landmarks, recorded),
            bone_landmarks: either(flags.bone_landmarks, InputRole::BoneLandmarks, recorded),
            start_file: start.as_deref().map(|path| start::split(path).0),
            start,
        })
    }

    /// All files, in the order in which they are asked for.
    pub(super) fn files(&self) -> Vec<&Path> {
        let more =
            [&self.labels, &self.organs, &self.skeleton, &self.landmarks, &self.bone_landmarks, &self.start_file];
        let more = more.into_iter().filter_map(|p| p.as_deref());
        [self.planning.as_path(), &self.bones].into_iter().chain(more).collect()
    }

    pub(super) fn planning(&self) -> &Path {
        &self.planning
    }

    pub(super) fn bones(&self) -> &Path {
        &self.bones
    }

    pub(super) fn landmarks(&self) -> Option<&Path> {
        self.landmarks.as_deref()
    }

    /// The motion that the fit begins with, `FILE#NAME` too.
    pub(super) fn start(&self) -> Option<&Path> {
        self.start.as_deref()
    }

    /// Whether there are landmarks on bones.
    pub(super) fn has_bone_landmarks(&self) -> bool {
        self.bone_landmarks.is_some()
    }

    /// Labels before the CT's values: names are judged by them. A structure set is drawn on the CT's grid.
    fn read_bones(&self) -> Result<Loaded<LabelMap>> {
        let names = self.labels.as_deref();
        if !is_dicom_path(&self.bones) {
            return io::read_labels(&self.bones, names);
        }
        check_frames(Role::Structures.at(&self.bones), Role::Image.at(&self.planning))?;
        io::read_bones(&self.bones, names, &io::read_grid(&self.planning)?.0)
    }

    /// Reads the files of the planning side; those that a report recorded are checked against its checksums, and the settings
    /// against the labels.
    pub(super) fn load(&self, recorded: &[RecordedInput], config: &Config, runtime: &Runtime) -> Result<PlanningScan> {
        runtime.stage("read", || {
            let mut bones = self.read_bones()?;
            if let Some(path) = &self.organs {
                if is_dicom_path(path) {
                    check_frames(Role::Structures.at(path), Role::Image.at(&self.planning))?;
                }
                let odd = organs::add(&mut bones.value, path, config)?;
                bones.warnings.extend(odd);
            }
            judge_names(&bones.value, config)?;
            let skeleton = match &self.skeleton {
                Some(path) => Some(io::skeleton::load_override(path, crate::skeleton::build(&bones.value)?.skeleton)?),
                None => None,
            };
            let planning = io::read_image(&self.planning)?;
            let mut inputs = vec![read(InputRole::Planning, &planning), read(InputRole::Bones, &bones)];
            for (role, path) in [
                (InputRole::Labels, &self.labels),
                (InputRole::Organs, &self.organs),
                (InputRole::Skeleton, &self.skeleton),
            ] {
                inputs.extend(path.as_deref().map(|p| InputFile::read(role, p)).transpose()?);
            }
            let found = changed(&inputs, recorded);
            let warnings = [planning.warnings, bones.warnings, found].concat();
            Ok(PlanningScan { ct: planning.value, bones: bones.value, skeleton, warnings, inputs })
        })
    }

    /// Reads what is known of planning and a fraction, or a posture, beside the scans.
    ///
    /// # Errors
    /// When a file cannot be read or used.
    pub(super) fn marks(&self) -> Result<Marks> {
        self.marks_of(self.landmarks.as_deref())
    }

    /// With the landmarks of one of several fractions.
    fn marks_of(&self, landmarks: Option<&Path>) -> Result<Marks> {
        let bones = self.bone_landmarks.as_deref();
        let files = [(InputRole::Landmarks, landmarks), (InputRole::BoneLandmarks, bones)];
        let inputs = files.into_iter().filter_map(|(role, path)| Some(InputFile::read(role, path?)));
        let start = self.start.as_deref().map(start::split).map(|(file, entry)| {
            Ok(InputFile { entry: entry.map(str::to_owned), ..InputFile::read(InputRole::Start, &file)? })
        });
        let inputs = inputs.chain(start);
        Ok(Marks {
            landmarks: landmarks.map(io::read_landmarks).transpose()?.unwrap_or_default(),
            bone_landmarks: bones.map(io::read_bone_landmarks).transpose()?.unwrap_or_default(),
            inputs: inputs.collect::<Result<_>>()?,
        })
    }

    /// Reads a fraction with the landmarks of planning and this fraction; files that a report recorded are checked against its
    /// checksums. The motion that its fit begins with is left to be set.
    ///
    /// # Errors
    /// When a file cannot be read or used.
    pub(super) fn fraction(
        &self,
        file: &Path,
        landmarks: Option<&Path>,
        recorded: &[RecordedInput],
    ) -> Result<FractionScan> {
        let image = io::read_image(file)?;
        let Marks { landmarks, bone_landmarks, inputs } = self.marks_of(landmarks)?;
        let inputs = [vec![read(InputRole::Fraction, &image)], inputs].concat();
        let warnings = [image.warnings, changed(&inputs, recorded)].concat();
        Ok(FractionScan { ct: image.value, landmarks, bone_landmarks, start: None, warnings, inputs })
    }
}

/// What is known of planning and a fraction, or a posture, beside the scans.
pub(super) struct Marks {
    pub(super) landmarks: Vec<Landmark>,
    pub(super) bone_landmarks: Vec<BoneLandmark>,
    /// The files behind it.
    pub(super) inputs: Vec<InputFile>,
}

/// That a file is missing which the task needs.
pub(super) fn missing(role: InputRole) -> Error {
    Error::usage(format!("no {role} file is given"), format!("add --{role} FILE; a TOML of settings names no inputs"))
}

fn read<T>(role: InputRole, file: &Loaded<T>) -> InputFile {
    let about = About::of(&file.path);
    InputFile { about, ..InputFile::new(role, file.path.clone(), file.sha256.clone()) }
}

/// The inputs that are no longer what they were when the report was made, with what it recorded.
pub(super) fn other_than<'a>(
    inputs: impl IntoIterator<Item = &'a InputFile>,
    recorded: &'a [RecordedInput],
) -> impl Iterator<Item = (&'a InputFile, &'a RecordedInput)> {
    let was = |i: &InputFile| recorded.iter().find(|r| r.role == i.role && r.sha256 != i.sha256);
    inputs.into_iter().filter_map(move |i| Some((i, was(i)?)))
}

/// A warning for each of them.
pub(super) fn changed(inputs: &[InputFile], recorded: &[RecordedInput]) -> Vec<Warning> {
    let warn = |(input, then): (&InputFile, &RecordedInput)| {
        Warning::new(
            findings::INPUT_CHANGED,
            format!(
                "{} is not the file of the recorded run (SHA-256 {}..., then {}...)",
                input.path.display(),
                &input.sha256[..12],
                then.sha256.get(..12).unwrap_or(&then.sha256)
            ),
        )
    };
    other_than(inputs, recorded).map(warn).collect()
}
