//! Doses over a course with their intervals, as `dose accumulate` with samples has written them.

use crate::config::InputRole;
use crate::error::{Error, Result};
use crate::io::{read_json, relative_to, whole_path};
use crate::provenance::InputFile;
use maud::{Markup, html};
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// Figures that the page shows as columns where structures have them; all are in `summary.json`.
const LEFT_OUT: [&str; 2] = ["D98", "D50"];

/// A figure of a structure with its 90 % interval; not known where the structure lies outside the dose.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
struct CourseFigure {
    figure: String,
    unit: String,
    value: Option<f64>,
    low: Option<f64>,
    high: Option<f64>,
}

/// A structure's figures.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
struct CourseStructure {
    name: String,
    figures: Vec<CourseFigure>,
}

/// A limit and what it says.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
struct CourseLimit {
    structure: String,
    figure: String,
    at_most: bool,
    value: f64,
    found: f64,
    low: f64,
    high: f64,
    decision: String,
}

/// What samples tell of a dose.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
struct CourseSamples {
    number: usize,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    common_percent: Option<f64>,
    structures: Vec<CourseStructure>,
    limits: Vec<CourseLimit>,
}

/// The file beside a dose.
#[derive(Deserialize)]
struct Beside {
    #[serde(default)]
    weights: Vec<f64>,
    samples: Option<CourseSamples>,
}

/// A patient's dose over so many fractions, with intervals.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct CourseDose {
    /// Whose: the name of the folder that the dose lies in.
    pub patient: String,
    /// The file, as seen from the folder of the summary.
    #[serde(serialize_with = "crate::io::path_as_text")]
    pub file: PathBuf,
    /// How many doses were added up.
    pub doses: usize,
    #[serde(flatten)]
    samples: CourseSamples,
}

impl CourseDose {
    /// Reads the file beside a dose.
    ///
    /// # Errors
    /// [`Error::Read`] when it is none; [`Error::Input`] when the dose was carried without samples.
    pub(super) fn read(path: &Path, seen_from: &Path) -> Result<(Self, InputFile)> {
        let remedy = "give the JSON file that `aventail dose accumulate` with samples wrote beside a dose";
        let beside: Beside = read_json(path, remedy)?;
        let without =
            || Error::input(path.display().to_string(), "it has no results of samples of the registration", remedy);
        let samples = beside.samples.ok_or_else(without)?;
        let whole = whole_path(path).map_err(|e| Error::read(path, e.to_string(), "check the path"))?;
        let patient = whole.parent().and_then(Path::file_name).unwrap_or_default().to_string_lossy().into_owned();
        let mut input = InputFile::read(InputRole::Dose, path)?;
        input.path = relative_to(seen_from, &input.path);
        let file = relative_to(seen_from, path);
        Ok((Self { patient, file, doses: beside.weights.len(), samples }, input))
    }

    /// Limits that are not kept for sure, as text: those that are not kept first.
    pub(super) fn doubtful(&self) -> Vec<String> {
        let mut open: Vec<&CourseLimit> = self.samples.limits.iter().filter(|l| l.decision != "kept").collect();
        open.sort_by_key(|l| l.decision != "broken");
        open.into_iter().map(|l| format!("{}: {} {}: {}", self.patient, l.structure, l.text(), l.said())).collect()
    }
}

impl CourseLimit {
    fn text(&self) -> String {
        format!("{} {} {}", self.figure, if self.at_most { "\u{2264}" } else { "\u{2265}" }, self.value)
    }

    fn word(&self) -> &'static str {
        match self.decision.as_str() {
            "kept" => "kept",
            "undecided" => "undecided",
            _ => "not kept",
        }
    }

    fn said(&self) -> String {
        format!("{} ({:.2}, {:.2} to {:.2})", self.word(), self.found, self.low, self.high)
    }
}

impl CourseFigure {
    fn cell(&self) -> String {
        match (self.value, self.low, self.high) {
            (Some(value), Some(low), Some(high)) => format!("{value:.2} ({low:.2}\u{2013}{high:.2})"),
            _ => "\u{2013}".into(),
        }
    }
}

/// The doses as a section of the page; nothing without doses.
pub(super) fn section(doses: &[CourseDose]) -> Markup {
    let structures = doses.iter().flat_map(|d| &d.samples.structures);
    let mut heads: Vec<(&str, &str)> = Vec::new();
    for f in structures.flat_map(|s| &s.figures).filter(|f| !LEFT_OUT.contains(&f.figure.as_str())) {
        if !heads.iter().any(|(figure, _)| *figure == f.figure) {
            heads.push((&f.figure, &f.unit));
        }
    }
    let limits = || doses.iter().flat_map(|d| d.samples.limits.iter().map(move |l| (d, l)));
    html! {
        @if !doses.is_empty() {
            h2 { "Dose over the course" }
            p.note {
                "Each figure of the accumulated dose, and in brackets its 90 % interval over samples of the registrations' errors. "
                "Common is the share of the variance in steep dose that is the same in all fractions: more fractions "
                "do not average it out. Outlines and doses are taken for right."
            }
            div.scrolled { table.runs {
                thead { tr {
                    th { "Patient" } th.n { "Doses" } th.n { "Common, %" } th { "Structure" }
                    @for (figure, unit) in &heads { th.n { (figure) br; (unit) } }
                } }
                tbody {
                    @for d in doses {
                        @for (n, s) in d.samples.structures.iter().enumerate() {
                            tr.first[n == 0] {
                                td { @if n == 0 { b { (d.patient) } } }
                                td.n { @if n == 0 { (d.doses) } }
                                td.n { @if n == 0 { (d.samples.common_percent.map_or("\u{2013}".into(), |p| format!("{p:.0}"))) } }
                                td { (s.name) }
                                @for (figure, _) in &heads {
                                    td.n { (s.figures.iter().find(|f| f.figure == *figure).map_or("\u{2013}".into(), CourseFigure::cell)) }
                                }
                            }
                        }
                    }
                }
            } }
            @if limits().next().is_some() {
                table.runs {
                    thead { tr { th { "Patient" } th { "Structure" } th { "Limit" } th { "Found" } th { "Decision" } } }
                    tbody {
                        @for (d, l) in limits() {
                            tr {
                                td { b { (d.patient) } }
                                td { (l.structure) }
                                td { (l.text()) }
                                td.n { (format!("{:.2} ({:.2}\u{2013}{:.2})", l.found, l.low, l.high)) }
                                td.odd[l.decision != "kept"] { (l.word()) }
                            }
                        }
                    }
                }
            }
        }
    }
}
