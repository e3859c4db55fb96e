//! A fraction, from files or memory, and what is known of planning and this fraction.

use super::modality::of_scan;
use super::planning::{BonesBy, labelled, made_bones};
use super::source::{LabelSources, OF_FRACTION, Source, image, landmarks, outlines};
use super::start;
use crate::config::{InputRole, Modality, RecordedInput};
use crate::error::{Error, Result};
use crate::evaluate::landmark::Landmark;
use crate::fit::BoneLandmark;
use crate::geometry::Rigid;
use crate::io::{self, auto::AUTO};
use crate::pipeline::FractionScan;
use crate::provenance::{InputFile, Provenance};
use crate::runtime::Runtime;
use crate::volume::Volume;
use crate::warning::Warning;
use std::path::{Path, PathBuf};

/// What a fraction is read from.
#[derive(Debug, Clone)]
pub struct FractionSources {
    /// What progress calls it, where it is one of several; empty otherwise.
    pub name: String,
    /// Fraction CT, HU.
    pub ct: Source<Volume<f32>>,
    /// Evaluation landmarks.
    pub landmarks: Option<Source<Vec<Landmark>>>,
    /// Labels of bones in the fraction, a structure set, or the path `auto`, with their names.
    pub bones: Option<LabelSources>,
    /// Structures outlined in the fraction, for those of planning that guide.
    pub guides: Option<LabelSources>,
    /// Landmarks on bones.
    pub bone_landmarks: Option<Source<Vec<BoneLandmark>>>,
    /// Motion of all bones together, near which the fit begins; of a file also `FILE#ENTRY`.
    pub start: Option<Source<Rigid>>,
    /// The file of a start that has been read.
    start_file: Option<InputFile>,
    /// What is to be known of labels that were made.
    made: Vec<Warning>,
}

impl FractionSources {
    /// Of a CT alone.
    pub fn new(ct: Source<Volume<f32>>) -> Self {
        let (landmarks, bone_landmarks, bones) = (None, None, None);
        Self {
            name: String::new(),
            ct,
            landmarks,
            bones,
            guides: None,
            bone_landmarks,
            start: None,
            start_file: None,
            made: Vec::new(),
        }
    }

    /// All files, in the order in which they are asked for.
    pub fn files(&self) -> impl Iterator<Item = PathBuf> {
        let marks = self.landmarks.as_ref().and_then(Source::path);
        let files = [self.ct.path(), marks, self.bone_landmarks.as_ref().and_then(Source::path)].into_iter().flatten();
        let start = self.start.as_ref().and_then(Source::path).map(|path| start::split(path).0);
        let labels = self
            .bones
            .as_ref()
            .filter(|_| !self.wants_bones())
            .map(|(bones, names)| [bones.path(), names.as_ref().and_then(Source::path)]);
        let guides = self.guides.as_ref().and_then(|(guides, _)| guides.path()).map(Path::to_owned);
        let start = labels.into_iter().flatten().flatten().map(Path::to_owned).chain(guides).chain(start);
        files.map(Path::to_owned).chain(start)
    }

    /// Reads what is small, so that a fault in it is told before anything long begins; the start then is in memory.
    ///
    /// # Errors
    /// As reading each file; as the fit's start when a registration belongs to other scans.
    pub fn settle(&mut self, planning: Option<&Path>) -> Result<()> {
        if let Some(path) = self.landmarks.as_ref().and_then(Source::path) {
            io::read_landmarks(path)?;
        }
        if let Some(path) = self.bone_landmarks.as_ref().and_then(Source::path) {
            io::read_bone_landmarks(path)?;
        }
        let Some(path) = self.start.as_ref().and_then(Source::path).map(Path::to_owned) else { return Ok(()) };
        self.start = Some(Source::Memory(start::read(&path, planning, self.ct.path())?));
        let (file, entry) = start::split(&path);
        let entry = entry.map(str::to_owned);
        self.start_file = Some(InputFile { entry, ..InputFile::read(InputRole::Start, &file)? });
        Ok(())
    }

    /// Whether the fraction's bones are to be found by TotalSegmentator.
    pub(super) fn wants_bones(&self) -> bool {
        self.bones.as_ref().is_some_and(|(bones, _)| bones.path() == Some(Path::new(AUTO)))
    }

    /// Makes the fraction's labels by TotalSegmentator, where they are `auto`, or takes those that were made of it before.
    ///
    /// # Errors
    /// As [`super::PlanningSources::make_bones`].
    pub fn make_bones(&mut self, told: Modality, by: BonesBy<'_>, runtime: &Runtime) -> Result<()> {
        if !self.wants_bones() {
            return Ok(());
        }
        let made = made_bones(
            "the fraction's bones",
            (self.ct.path(), of_scan(&self.ct, told, "--modality")?),
            self.bones.as_ref().is_some_and(|b| b.1.is_some()),
            &[],
            by,
            runtime,
        )?;
        self.bones = Some((Source::File(made.file), None));
        self.made = made.warnings;
        Ok(())
    }

    /// Reads all of it, its start being settled; warns of files that are not those of the `recorded` run.
    ///
    /// # Errors
    /// As reading each file.
    pub fn read(self, recorded: &[RecordedInput]) -> Result<(FractionScan, Provenance)> {
        let start = match self.start {
            None => None,
            Some(Source::Memory(start)) => Some(start),
            Some(Source::File(_)) => return Err(Error::Internal("a start is settled before it is used".into())),
        };
        let mut provenance = Provenance { warnings: self.made, ..Provenance::default() };
        let place = self.ct.path().map(Path::to_owned);
        let ct = image(InputRole::Fraction, self.ct, &mut provenance)?;
        let of_fraction = [InputRole::FractionBones, InputRole::FractionLabels];
        let labels = |(bones, names)| {
            labelled(of_fraction[0], bones, names, (place.as_deref(), Some(ct.grid().clone())), &mut provenance)
        };
        let names = self.bones.as_ref().and_then(|(_, names)| names.as_ref()?.path()).map(Path::to_owned);
        let bones = self.bones.map(labels).transpose()?;
        names.map_or(Ok(()), |names| provenance.note(of_fraction[1], &names))?;
        let own = |given| outlines(OF_FRACTION, given, place.as_deref(), &mut provenance);
        let guides = self.guides.map(own).transpose()?.unwrap_or_default();
        let points = self.landmarks.map(|marks| landmarks(marks, &mut provenance)).transpose()?;
        let on_bones = self.bone_landmarks.map(|marks| bone_landmarks(marks, &mut provenance)).transpose()?;
        provenance.inputs.extend(self.start_file);
        provenance.compare(recorded);
        let scan = FractionScan {
            ct,
            landmarks: points.unwrap_or_default(),
            bone_landmarks: on_bones.unwrap_or_default(),
            bones,
            start,
            guides,
        };
        Ok((scan, provenance))
    }
}

/// Landmarks on bones.
pub(super) fn bone_landmarks(
    source: Source<Vec<BoneLandmark>>,
    provenance: &mut Provenance,
) -> Result<Vec<BoneLandmark>> {
    source.value(InputRole::BoneLandmarks, provenance, |path| io::read_bone_landmarks(path))
}
