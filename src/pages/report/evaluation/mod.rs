//! From the assessment of one field or several to JSON, CSV, Markdown, and one self-contained page.

mod figures;
mod page;
mod pairs;
mod pictures;
mod text;

pub use figures::{Figure, figures};
pub use pairs::{Compared, draw_pair};
pub use text::terminal_table;

use super::csv::write_landmarks;
use super::numbers::OutputFile;
use crate::error::{Error, Result};
use crate::evaluate::verdict::{Mark, of_warnings, overall};
use crate::evaluate::{Assessment, Maps, Subject};
use crate::io::{relative_to, write_file, write_json};
use crate::provenance::InputFile;
use crate::runtime::StageTime;
use crate::warning::Warning;
use serde::{Deserialize, Serialize};
use std::path::Path;

/// One assessed field.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Assessed {
    /// What it is called, for example its file's name.
    pub name: String,
    /// The worst of its verdicts.
    pub verdict: Mark,
    /// What was measured.
    pub assessment: Assessment,
}

impl Assessed {
    /// A field and what was measured of it, judged by the worst of its verdicts.
    pub fn new(name: String, assessment: Assessment) -> Self {
        Self { name, verdict: overall(&assessment.verdicts), assessment }
    }

    /// Counts warnings in the verdict.
    pub fn warned(&mut self, warnings: &[Warning]) {
        self.assessment.verdicts.extend(of_warnings(warnings));
        self.verdict = overall(&self.assessment.verdicts);
    }
}

/// The numbers of an evaluation: one field, or several side by side. Lengths in mm.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct EvaluationReport {
    /// Version of aventail.
    pub version: String,
    /// When the report was made, seconds since 1970-01-01 UTC.
    pub created: u64,
    /// The command line.
    pub command: String,
    /// Input files with checksums.
    pub inputs: Vec<InputFile>,
    /// Each field.
    pub fields: Vec<Assessed>,
    /// Warnings.
    pub warnings: Vec<Warning>,
    /// Wall time of each stage.
    pub stages: Vec<StageTime>,
    /// Number of threads.
    pub threads: usize,
    /// Files that were written beside the report.
    #[serde(default)]
    pub outputs: Vec<OutputFile>,
}

/// What pictures of one field are drawn from.
pub struct Drawable<'a> {
    /// The field and the images.
    pub subject: Subject<'a>,
    /// What was made in measuring.
    pub maps: Maps,
}

/// One picture, encoded.
#[derive(Debug, Clone)]
pub struct EvaluationPicture {
    /// File name without folder.
    pub file: String,
    /// Its heading.
    pub title: String,
    /// How to read it.
    pub caption: String,
    /// The PNG file.
    pub png: Vec<u8>,
}

/// Draws the pictures of one field; `which` is its place among the fields of the report.
///
/// # Errors
/// [`Error::Internal`] when a picture cannot be encoded.
pub fn draw(which: usize, field: &Assessed, drawable: &Drawable<'_>) -> Result<Vec<EvaluationPicture>> {
    pictures::draw(which, field, drawable)
}

impl EvaluationReport {
    /// As JSON for machines; its code is made here, once.
    ///
    /// # Errors
    /// [`crate::error::Error::Internal`] when a value has no JSON.
    pub fn json(&self) -> Result<String> {
        crate::io::json(self)
    }
}

/// Writes the landmarks of each field, the pictures, `evaluation.csv`, `.md`, `.html` and last `evaluation.json`, which gets
/// the checksums of the others, into `folder`.
///
/// # Errors
/// [`Error::Write`] when a file or folder cannot be written.
pub fn write(folder: &Path, report: &mut EvaluationReport, pictures: &[EvaluationPicture]) -> Result<()> {
    let drawn = folder.join("pictures");
    std::fs::create_dir_all(&drawn)
        .map_err(|e| Error::write(&drawn, e.to_string(), "choose a folder that you may write to"))?;
    report.inputs.iter_mut().for_each(|input| input.path = relative_to(folder, &input.path));
    pictures.iter().try_for_each(|p| write_file(drawn.join(&p.file), |out| out.write_all(&p.png)))?;
    let mut written: Vec<(String, &str)> =
        pictures.iter().map(|p| (format!("pictures/{}", p.file), "picture of the report")).collect();
    for (n, field) in report.fields.iter().enumerate() {
        if let Some(landmarks) = &field.assessment.landmarks {
            let name =
                if report.fields.len() == 1 { "landmarks.csv".into() } else { format!("landmarks_{}.csv", n + 1) };
            write_landmarks(&folder.join(&name), landmarks)?;
            written.push((name, "residual of each landmark, LPS mm"));
        }
    }
    let table = text::csv(report).map_err(|e| Error::Internal(format!("evaluation as CSV: {e}")))?;
    write_file(folder.join("evaluation.csv"), |out| out.write_all(&table))?;
    write_file(folder.join("evaluation.md"), |out| out.write_all(text::markdown(report).as_bytes()))?;
    write_file(folder.join("evaluation.html"), |out| out.write_all(page::page(report, pictures).as_bytes()))?;
    for (extension, what) in [("csv", "the numbers as a table"), ("md", "the tables"), ("html", "the report as a page")]
    {
        written.push((format!("evaluation.{extension}"), what));
    }
    let written = written.iter().map(|(name, what)| OutputFile::written(folder, name, what));
    report.outputs = written.collect::<Result<_>>()?;
    write_json(folder.join("evaluation.json"), report)
}
