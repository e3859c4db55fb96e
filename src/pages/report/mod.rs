//! Rank 10: from an outcome to the files that people read.
//!
//! [`write()`] puts the evidence of a run into a folder: `report.html`, one page that a physicist reads top to bottom;
//! `report.json`, its numbers with everything needed to run again; `landmarks.csv`; `bone_transforms.json`; and the
//! pictures under `report/`. [`terminal_table`] is the short version for the screen.

mod canvas;
mod chart;
mod clinic;
mod cohort;
mod colour;
mod concepts;
mod csv;
mod curve;
pub mod dose;
pub mod evaluation;
#[cfg(test)]
mod example;
mod html;
mod identity;
mod library;
mod numbers;
mod outputs;
mod palette;
mod pictures;
mod plane;
mod plot;
mod restore;
mod samples;
mod save;
mod searched;
mod shape;
mod study;
mod svg;
mod table;
mod thumbnail;
mod transforms;
mod viewer;

pub use clinic::{Clinic, ClinicFiles, one_frame};
pub use cohort::{Cohort, Fractions, Member, Summary};
pub use concepts::write_concepts;
pub use csv::write_landmarks;
pub use curve::{CurveEntry, Peer, write_curve};
pub use html::{page, view_page};
pub use identity::Decided;
pub use library::{About, Gallery, Manifest, PostureRecord, RECORD, Rejected, Totals, library_page};
pub use numbers::{OutputFile, Report, Run};
pub use outputs::{Files, planned};
pub use pictures::{FigureKind, FigureOf, Picture, SAMPLES_SHOWN, ShownSamples, draw, figure};
pub use plane::Kind as PlaneKind;
pub use restore::{cut_to, restore};
pub use samples::{SAMPLES_PAGE, write_samples_page};
pub use save::{More, Saving, save};
pub use searched::{FittedPlace, SearchedPlace};
pub use study::{StageRecord, finished_stage, stage_files, write_stage, write_study};
pub use table::terminal_table;
pub use transforms::write_bone_transforms;
pub use viewer::{View, embed, embed_whole};

use crate::error::{Error, Result};
use crate::io::{relative_to, whole_path, write_file, write_json};
use crate::pipeline::{Case, Outcome};
use std::path::Path;

/// Writes the report of a run, with the pictures that [`draw`] made of it, the volumes that [`embed`] did, and its samples, into
/// `folder` and returns its numbers; the `report.json` comes last and has the checksums of all that is there.
///
/// # Errors
/// [`Error::Write`] when a file or folder cannot be written, [`Error::Internal`] when a picture cannot be encoded.
pub fn write(
    folder: &Path,
    case: &Case,
    outcome: &Outcome,
    run: &Run,
    mut pictures: Vec<Picture>,
    view: Option<View>,
    samples: Option<&ShownSamples>,
) -> Result<Report> {
    let pictures_folder = folder.join("report");
    std::fs::create_dir_all(&pictures_folder)
        .map_err(|e| Error::write(&pictures_folder, e.to_string(), "choose a folder that you may write to"))?;
    pictures.extend(pictures::material(&run.settings)?);
    pictures::write(&pictures_folder, &pictures)?;
    let mut report = Report::new(case, outcome, run);
    report.folder = whole_path(folder).unwrap_or_default().to_string_lossy().into_owned();
    report.inputs.iter_mut().for_each(|input| input.path = relative_to(folder, &input.path));
    let mut more: Vec<(String, &str)> =
        pictures.iter().map(|p| (format!("report/{}", p.file), "picture of the report")).collect();
    if let Some(landmarks) = &report.landmarks {
        write_landmarks(&folder.join("landmarks.csv"), landmarks)?;
        more.push(("landmarks.csv".into(), "residual of each landmark, LPS mm"));
    }
    let transforms = report.bones.iter().map(|b| (b.name.as_str(), &b.transform));
    write_bone_transforms(&folder.join("bone_transforms.json"), transforms)?;
    more.push(("bone_transforms.json".into(), "4x4 of each bone, planning to fraction, LPS mm"));
    let page = page(&report, &pictures, view.as_ref(), samples);
    write_file(folder.join("report.html"), |out| out.write_all(page.as_bytes()))?;
    more.push(("report.html".into(), "the report as a page"));
    for (name, what) in more {
        report.outputs.push(OutputFile::written(folder, &name, what)?);
    }
    write_json(folder.join("report.json"), &report)?;
    Ok(report)
}
