//! A fraction, from files or memory, and what is known of planning and this fraction.

use super::source::{Source, image, landmarks};
use super::start;
use crate::config::{InputRole, RecordedInput};
use crate::error::{Error, Result};
use crate::evaluate::landmark::Landmark;
use crate::fit::BoneLandmark;
use crate::geometry::Rigid;
use crate::io;
use crate::pipeline::FractionScan;
use crate::provenance::{InputFile, Provenance};
use crate::volume::Volume;
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
    /// Landmarks on bones.
    pub bone_landmarks: Option<Source<Vec<BoneLandmark>>>,
    /// Motion of all bones together, near which the fit begins; of a file also `FILE#ENTRY`.
    pub start: Option<Source<Rigid>>,
    /// The file of a start that has been read.
    start_file: Option<InputFile>,
}

impl FractionSources {
    /// Of a CT alone.
    pub fn new(ct: Source<Volume<f32>>) -> Self {
        Self { name: String::new(), ct, landmarks: None, bone_landmarks: None, start: None, start_file: None }
    }

    /// All files, in the order in which they are asked for.
    pub fn files(&self) -> impl Iterator<Item = PathBuf> {
        let marks = self.landmarks.as_ref().and_then(Source::path);
        let files = [self.ct.path(), marks, self.bone_landmarks.as_ref().and_then(Source::path)].into_iter().flatten();
        let start = self.start.as_ref().and_then(Source::path).map(|path| start::split(path).0);
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
        let Some(path) = self.start.as_ref().and_then(Source::path).map(Path::to_owned) else { return Ok(()) };
        self.start = Some(Source::Memory(start::read(&path, planning, self.ct.path())?));
        let (file, entry) = start::split(&path);
        let entry = entry.map(str::to_owned);
        self.start_file = Some(InputFile { entry, ..InputFile::read(InputRole::Start, &file)? });
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
        let mut provenance = Provenance::default();
        let ct = image(InputRole::Fraction, self.ct, &mut provenance)?;
        let points = self.landmarks.map(|marks| landmarks(marks, &mut provenance)).transpose()?;
        let on_bones = self.bone_landmarks.map(|marks| bone_landmarks(marks, &mut provenance)).transpose()?;
        provenance.inputs.extend(self.start_file);
        provenance.compare(recorded);
        let scan = FractionScan {
            ct,
            landmarks: points.unwrap_or_default(),
            bone_landmarks: on_bones.unwrap_or_default(),
            start,
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
