//! What lies beside labels that `auto` made: of which planning CT, by which commands.

use super::place::LabelsPlace;
use super::segmentator::{LICENCE, Segmentator};
use crate::error::{Error, Result};
use crate::findings;
use crate::io::checksum::sha256_file;
use crate::warning::Warning;
use serde::{Deserialize, Serialize};

/// The record of labels.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(super) struct LabelsRecord {
    /// SHA-256 of the planning CT that was labelled.
    planning_sha256: String,
    /// SHA-256 of the label map as it was written.
    labels_sha256: String,
    /// TotalSegmentator's version, as it says.
    totalsegmentator: String,
    /// Its licence, and that of its weights.
    licence: String,
    /// aventail's version.
    aventail: String,
    /// What was run.
    commands: Vec<String>,
    /// Bones that were found.
    bones: Vec<String>,
    /// Further tasks that failed.
    failed: Vec<Failed>,
}

/// A task that failed.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(super) struct Failed {
    /// Its name.
    pub task: String,
    /// The bone that has no label.
    pub bone: String,
    /// What was wrong.
    pub problem: String,
}

impl LabelsRecord {
    /// Of labels that were just written.
    pub(super) fn new(
        place: &LabelsPlace,
        program: &Segmentator,
        commands: Vec<String>,
        bones: Vec<String>,
        failed: Vec<Failed>,
    ) -> Result<Self> {
        Ok(Self {
            planning_sha256: place.planning_sha256.clone(),
            labels_sha256: sha256_file(&place.labels)?,
            totalsegmentator: program.version.clone(),
            licence: LICENCE.into(),
            aventail: env!("CARGO_PKG_VERSION").into(),
            commands,
            bones,
            failed,
        })
    }

    /// The record of labels that are there; `None` where there are none.
    ///
    /// # Errors
    /// [`Error::Input`] when labels and record are not those of this planning CT, or not of each other.
    pub(super) fn read(place: &LabelsPlace) -> Result<Option<Self>> {
        if !place.labels.exists() && !place.record.exists() {
            return Ok(None);
        }
        let refuse = |problem: String| {
            let remedy = format!(
                "if {} is right, for example corrected by hand, give it as the file of bones; otherwise remove it and {}, and it is made anew",
                place.labels.display(),
                place.record.display()
            );
            Err(Error::refused(findings::BONES_AUTO_CHANGED, place.labels.display().to_string(), problem, remedy))
        };
        if !place.labels.exists() {
            return refuse(format!("it is gone, and its record {} is there", place.record.display()));
        }
        let text = match std::fs::read(&place.record) {
            Ok(text) => text,
            Err(e) => return refuse(format!("its record {} cannot be read: {e}", place.record.display())),
        };
        let record: Self = match serde_json::from_slice(&text) {
            Ok(record) => record,
            Err(e) => return refuse(format!("its record {} cannot be used: {e}", place.record.display())),
        };
        if record.planning_sha256 != place.planning_sha256 {
            return refuse("it was made of another planning CT, says its record".into());
        }
        if record.labels_sha256 != sha256_file(&place.labels)? {
            return refuse("it is not what was written: its SHA-256 is not that of its record".into());
        }
        Ok(Some(record))
    }

    /// What is to be known of the labels, now and whenever they are used.
    pub(super) fn warnings(&self, place: &LabelsPlace) -> Vec<Warning> {
        let file = place.labels.display();
        let made = Warning::new(
            findings::BONES_AUTO,
            format!(
                "{file}: {} bones labelled by TotalSegmentator {}, which nobody has looked at: see them in a viewer. {}",
                self.bones.len(),
                self.totalsegmentator,
                self.licence
            ),
        );
        let partial = self.failed.iter().map(|f| {
            let message = format!(
                "{file}: the {} has no label and moves with the surrounding tissue, because task {} failed ({}); remove {file} and {} to \
                 have all made anew",
                f.bone,
                f.task,
                f.problem.lines().next().unwrap_or_default(),
                place.record.display()
            );
            Warning::new(findings::BONES_AUTO_PARTIAL, message)
        });
        std::iter::once(made).chain(partial).collect()
    }
}
