//! Input files of a run: from the flags, else from the report that is run again.

use super::headers::judge_names;
use super::{organs, start};
use crate::config::{Config, ConfigFile, RecordedInput};
use crate::error::{Error, Result};
use crate::evaluate::landmark::Landmark;
use crate::geometry::Grid;
use crate::io::dicom::{About, Role, check_frames, is_dicom_path};
use crate::io::{self, Loaded, checksum::sha256_file};
use crate::pipeline::{Case, InputFile};
use crate::runtime::Runtime;
use crate::volume::{LabelMap, Volume};
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
pub(super) fn either(own: &Option<PathBuf>, role: &str, recorded: &[RecordedInput]) -> Option<PathBuf> {
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
        let needed = |own: &Option<PathBuf>, role: &str| either(own, role, recorded).ok_or_else(|| missing(role));
        Ok(Self {
            planning: needed(flags.planning, "planning")?,
            bones: needed(flags.bones, "bones")?,
            labels: either(flags.labels, "labels", recorded),
            organs: either(flags.organs, "organs", recorded),
            skeleton: either(flags.skeleton, "skeleton", recorded),
            landmarks: either(flags.landmarks, "landmarks", recorded),
            bone_landmarks: either(flags.bone_landmarks, "bone-landmarks", recorded),
            start_file: either(flags.start, "start", recorded).map(|path| start::split(&path).0),
            start: either(flags.start, "start", recorded),
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
        check_frames((&self.bones, Role::Structures), (&self.planning, Role::Image))?;
        io::read_bones(&self.bones, names, &io::read_grid(&self.planning)?.0)
    }

    /// Reads the files; those that a report recorded are checked against its checksums, and the settings against the labels. The case has an empty image in
    /// place of a fraction.
    pub(super) fn load(&self, recorded: &[RecordedInput], config: &Config, runtime: &Runtime) -> Result<Case> {
        runtime.stage("read", || {
            let mut bones = self.read_bones()?;
            if let Some(path) = &self.organs {
                if is_dicom_path(path) {
                    check_frames((path, Role::Structures), (&self.planning, Role::Image))?;
                }
                let odd = organs::add(&mut bones.value, path, config)?;
                bones.warnings.extend(odd);
            }
            judge_names(&bones.value, config)?;
            let landmarks = self.landmarks.as_deref().map(io::read_landmarks).transpose()?.unwrap_or_default();
            let bone_landmarks =
                self.bone_landmarks.as_deref().map(io::read_bone_landmarks).transpose()?.unwrap_or_default();
            let skeleton = match &self.skeleton {
                Some(path) => Some(io::skeleton::load_override(path, crate::skeleton::build(&bones.value)?.skeleton)?),
                None => None,
            };
            let planning = io::read_image(&self.planning)?;
            let mut inputs = vec![read("planning", &planning), read("bones", &bones)];
            for (role, path) in [
                ("labels", &self.labels),
                ("organs", &self.organs),
                ("skeleton", &self.skeleton),
                ("landmarks", &self.landmarks),
                ("bone-landmarks", &self.bone_landmarks),
                ("start", &self.start_file),
            ] {
                inputs.extend(path.as_deref().map(|p| named(role, p)).transpose()?);
            }
            let mut warnings: Vec<Warning> = [planning.warnings, bones.warnings].concat();
            warnings.extend(changed(&inputs, recorded));
            let nothing = Volume::filled(Grid::axis_aligned([1; 3], [1.0; 3], [0.0; 3])?, 0.0);
            Ok(Case {
                planning: planning.value,
                bones: bones.value,
                fraction: nothing,
                landmarks,
                bone_landmarks,
                start: None,
                skeleton,
                warnings,
                inputs,
            })
        })
    }
}

/// That a file is missing which the task needs.
pub(super) fn missing(role: &str) -> Error {
    Error::usage(format!("no {role} file is given"), format!("add --{role} FILE; a TOML of settings names no inputs"))
}

/// The planning side of a case, to which one fraction after the other is added.
pub(super) struct PlanningSide {
    pub(super) case: Case,
    warnings: Vec<Warning>,
    inputs: Vec<InputFile>,
    /// Whether reports leave the patient's identity out.
    anonymous: bool,
}

impl PlanningSide {
    /// Of a case without a fraction.
    pub(super) fn new(case: Case) -> Self {
        Self { warnings: case.warnings.clone(), inputs: case.inputs.clone(), anonymous: false, case }
    }

    /// With the patient's identity in reports, or without.
    pub(super) fn anonymous(self, anonymous: bool) -> Self {
        Self { anonymous, ..self }
    }

    /// Takes a fraction, and landmarks of planning and this fraction, in place of those before.
    pub(super) fn take(&mut self, fraction: FractionSide, recorded: &[RecordedInput]) {
        let found = changed(&fraction.inputs, recorded);
        // Behind planning CT and bones.
        self.case.inputs.clone_from(&self.inputs);
        let at = self.case.inputs.len().min(2);
        self.case.inputs.splice(at..at, fraction.inputs);
        if self.anonymous {
            self.case.inputs.iter_mut().for_each(|i| i.about = i.about.take().map(About::anonymous));
        }
        self.case.warnings = [self.warnings.as_slice(), &fraction.image.warnings, &found].concat();
        self.case.fraction = fraction.image.value;
        if let Some(landmarks) = fraction.landmarks {
            self.case.landmarks = landmarks;
        }
    }
}

/// What is read for one fraction.
pub(super) struct FractionSide {
    image: Loaded<Volume<f32>>,
    landmarks: Option<Vec<Landmark>>,
    inputs: Vec<InputFile>,
}

impl FractionSide {
    /// Reads a fraction, and landmarks of planning and this fraction.
    ///
    /// # Errors
    /// When a file cannot be read or used.
    pub(super) fn read(fraction: &Path, landmarks: Option<&Path>) -> Result<Self> {
        let image = io::read_image(fraction)?;
        let mut inputs = vec![read("fraction", &image)];
        inputs.extend(landmarks.map(|path| named("landmarks", path)).transpose()?);
        Ok(Self { image, landmarks: landmarks.map(io::read_landmarks).transpose()?, inputs })
    }
}

fn read<T>(role: &str, file: &Loaded<T>) -> InputFile {
    let about = About::of(&file.path);
    InputFile { role: role.into(), path: file.path.clone(), sha256: file.sha256.clone(), about }
}

/// A further input with its checksum.
pub(super) fn named(role: &str, path: &Path) -> Result<InputFile> {
    Ok(InputFile { role: role.into(), path: path.to_owned(), sha256: sha256_file(path)?, about: None })
}

/// The inputs that are no longer what they were when the report was made, with what it recorded.
pub(super) fn other_than<'a>(
    inputs: &'a [InputFile],
    recorded: &'a [RecordedInput],
) -> impl Iterator<Item = (&'a InputFile, &'a RecordedInput)> {
    let was = |i: &InputFile| recorded.iter().find(|r| r.role == i.role && r.sha256 != i.sha256);
    inputs.iter().filter_map(move |i| Some((i, was(i)?)))
}

/// A warning for each of them.
pub(super) fn changed(inputs: &[InputFile], recorded: &[RecordedInput]) -> Vec<Warning> {
    let warn = |(input, then): (&InputFile, &RecordedInput)| {
        Warning::new(
            "input-changed",
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
