//! `auto`: labels that TotalSegmentator, installed by the user, makes of a CT or an MR, kept for the next run.

mod make;
mod place;
mod record;
mod segmentator;

use super::check_files;
use crate::error::Result;
use crate::progress::Progress;
use crate::warning::Warning;
use place::LabelsPlace;
use record::LabelsRecord;
use std::path::{Path, PathBuf};

/// What stands for these labels where a file of bones is asked for; a file of this name is `./auto`.
pub const AUTO: &str = "auto";

/// How a run asks for labels.
#[derive(Debug, Clone, Copy)]
pub struct Ask<'a> {
    /// The scan, a file or the folder of a DICOM series.
    pub planning: &'a Path,
    /// Whether it is an MR, for which other tasks are run.
    pub is_mr: bool,
    /// Other files that the run will read: known to be there before minutes are spent.
    pub needed: &'a [&'a Path],
    /// The result beside which the labels are kept, so that all fractions of a patient find them.
    pub beside: &'a Path,
    /// What is run, for whoever finds the folder in use.
    pub command: &'a str,
    /// Keeps what TotalSegmentator says from standard error.
    pub quiet: bool,
}

/// Labels that were made.
#[derive(Debug, Clone)]
pub struct AutoBones {
    /// The label map, on the scan's grid, with names.
    pub file: PathBuf,
    /// What is to be known of it, now and whenever it is used.
    pub warnings: Vec<Warning>,
}

impl AutoBones {
    /// The label map that TotalSegmentator makes now, or made of the same scan before.
    ///
    /// # Errors
    /// [`Error::Usage`](crate::error::Error::Usage) when TotalSegmentator is not on the path;
    /// [`Error::Read`](crate::error::Error::Read) when a file is missing or TotalSegmentator fails;
    /// [`Error::Input`](crate::error::Error::Input) when labels are no longer those that were made;
    /// [`Error::Write`](crate::error::Error::Write) when the labels cannot be kept.
    pub fn of(ask: Ask<'_>, progress: &dyn Progress) -> Result<Self> {
        let files: Vec<&Path> = std::iter::once(ask.planning).chain(ask.needed.iter().copied()).collect();
        check_files(&files, &[])?;
        let place = LabelsPlace::of(ask.beside, ask.planning)?;
        let record = match LabelsRecord::read(&place, ask.is_mr)? {
            Some(record) => {
                progress.note(&format!("bones: {}, made of this scan before", place.labels.display()));
                record
            }
            None => make::make(ask, &place, progress)?,
        };
        Ok(Self { warnings: record.warnings(&place), file: place.labels })
    }
}
