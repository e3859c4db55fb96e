//! What lies beside labels that `auto` made: of which scan, by which commands.

use super::place::LabelsPlace;
use super::segmentator::{Segmentator, licence};
use crate::error::{Error, Result};
use crate::findings;
use crate::io::checksum::sha256_file;
use crate::warning::{Warning, counted};
use serde::{Deserialize, Serialize};

/// What no task finds in an MR.
const ABSENT_IN_MR: &str = "Its tasks for MR find no skull, mandible, hyoid, ribs or sternum: these move with the surrounding \
    tissue. ";

/// The record of labels.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(super) struct LabelsRecord {
    /// SHA-256 of the scan that was labelled.
    planning_sha256: String,
    /// Whether it was labelled as an MR.
    #[serde(default)]
    is_mr: bool,
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
        is_mr: bool,
        program: &Segmentator,
        commands: Vec<String>,
        bones: Vec<String>,
        failed: Vec<Failed>,
    ) -> Result<Self> {
        Ok(Self {
            planning_sha256: place.planning_sha256.clone(),
            labels_sha256: sha256_file(&place.labels)?,
            totalsegmentator: program.version.clone(),
            is_mr,
            licence: licence(is_mr),
            aventail: env!("CARGO_PKG_VERSION").into(),
            commands,
            bones,
            failed,
        })
    }

    /// The record of labels that are there; `None` where there are none.
    ///
    /// # Errors
    /// [`Error::Input`] when labels and record are not those of this scan, of another modality, or not of each other.
    pub(super) fn read(place: &LabelsPlace, is_mr: bool) -> Result<Option<Self>> {
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
            return refuse("it was made of another scan, says its record".into());
        }
        if record.is_mr != is_mr {
            let [own, said] = if record.is_mr { ["an MR", "a CT"] } else { ["a CT", "an MR"] };
            return refuse(format!("it was made as of {own}, and this run says {said}"));
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
                "{file}: {} labelled by TotalSegmentator {}, which nobody has looked at: see them in a viewer. {}{}",
                counted(self.bones.len(), "bone", "bones"),
                self.totalsegmentator,
                if self.is_mr { ABSENT_IN_MR } else { "" },
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
