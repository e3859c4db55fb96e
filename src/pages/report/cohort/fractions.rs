//! The index of a run of several fractions: one line for each, with a small picture and the way to its report.

use super::super::html::verdict::identity;
use super::super::html::{data_url, head};
use super::super::numbers::{Report, utc};
use super::super::thumbnail::thumbnail;
use super::super::viewer::policy;
use super::Member;
use super::figures::{FigureOfRuns, KINDS};
use super::page::{STYLE, course, number, report_link};
use super::text::of_verdicts;
use crate::config::InputRole;
use crate::error::Result;
use crate::evaluate::verdict::Mark;
use crate::io::write_file;
use crate::provenance::InputFile;
use maud::{DOCTYPE, Markup, html};
use serde::Serialize;
use std::path::Path;

/// The bone that moves most apart from the couch shift.
#[derive(Debug, Clone, PartialEq, Serialize)]
struct FractionMoved {
    bone: String,
    mm: f64,
}

/// One fraction of a run.
#[derive(Debug, Clone, PartialEq, Serialize)]
struct FractionRow {
    #[serde(flatten)]
    run: Member,
    /// File or series of its image.
    image: String,
    moves_most: Option<FractionMoved>,
    /// Number of its warnings.
    warned: usize,
    /// A small picture of what its registration made.
    #[serde(skip)]
    picture: Option<Vec<u8>>,
}

/// The fractions of one run, in its order.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Fractions {
    /// Version of aventail.
    pub version: String,
    /// When it was made, seconds since 1970-01-01 UTC.
    pub created: u64,
    /// The command line.
    pub command: String,
    fractions: Vec<FractionRow>,
    #[serde(skip)]
    planning: Option<InputFile>,
}

/// What to do where a report is missing.
const REMEDY: &str = "register the fractions again";
/// Figures that the index tells besides verdict, greatest motion and warnings.
const SHOWN: [&str; 5] =
    ["landmarks_mean_mm", "landmarks_worst_mm", "folded_percent", "uncertainty_p95_mm", "couch_shift_mm"];
/// Fewer fractions have no course.
const FEWEST: usize = 3;
/// Styles beside those of the summary.
const OWN: &str = "
table.index { font-size: 14px; }
table.index td { vertical-align: top; padding-top: 8px; padding-bottom: 8px; }
table.index img { width: 120px; display: block; border-radius: 4px; }
table.index .why { font-size: 12.5px; color: var(--soft); max-width: 300px; overflow-wrap: anywhere; }
table.index a { font-weight: 650; }
@media screen and (max-width: 820px) {
  table.index, table.index tbody { display: block; overflow: visible; }
  table.index thead { display: none; }
  table.index tr { display: grid; grid-template-columns: 120px minmax(0, 1fr); gap: 2px 14px; padding: 12px 0; border-bottom: 1px solid var(--line); }
  table.index td { display: block; border: 0; padding: 0; text-align: left; white-space: normal; }
  table.index td:first-child { grid-row: 1 / 9; }
  table.index td[data-what]::before { content: attr(data-what) ': '; color: var(--soft); font-size: 12.5px; }
}
@media print {
  table.index { font-size: 8.5px; }
  table.index td { padding-top: 3px; padding-bottom: 3px; }
  table.index img { width: 30mm; }
  table.index .why { font-size: 7.5px; }
}
";

impl Fractions {
    /// Reads the reports of the fractions in these folders of `out`.
    ///
    /// # Errors
    /// [`crate::error::Error::Read`] when a report cannot be read.
    pub fn read(out: &Path, names: &[&str], created: u64, command: String) -> Result<Self> {
        let mut planning = None;
        let mut fractions = Vec::new();
        for name in names {
            let folder = out.join(name);
            let report = Report::read(&folder.join("report.json"), REMEDY)?;
            let image = report.inputs.iter().find(|i| i.role == InputRole::Fraction);
            planning = planning.or_else(|| report.inputs.iter().find(|i| i.role == InputRole::Planning).cloned());
            fractions.push(FractionRow {
                image: image.map_or(String::new(), |i| ending(&i.path)),
                moves_most: report.moves_most().map(|(bone, mm)| FractionMoved { bone: bone.name.clone(), mm }),
                warned: report.warnings.len(),
                picture: std::fs::read(folder.join("report/fusion_after.png")).ok().and_then(|png| thumbnail(&png)),
                run: Member::new(String::new(), (*name).to_owned(), name.into(), &report),
            });
        }
        Ok(Self { version: env!("CARGO_PKG_VERSION").into(), created, command, fractions, planning })
    }

    /// Writes `index.html` into `out`.
    ///
    /// # Errors
    /// [`crate::error::Error::Write`] when it cannot be written.
    pub fn write(&self, out: &Path) -> Result<()> {
        write_file(out.join("index.html"), |file| file.write_all(self.page().as_bytes()))
    }

    fn page(&self) -> String {
        let runs: Vec<&Member> = self.fractions.iter().map(|f| &f.run).collect();
        let kinds: Vec<&FigureOfRuns> = SHOWN
            .iter()
            .filter_map(|key| KINDS.iter().find(|k| k.key == *key))
            .filter(|k| runs.iter().any(|m| m.figure(k.key).is_some()))
            .collect();
        html! {
            (DOCTYPE)
            html lang="en" {
                (head("aventail: fractions", &format!("{STYLE}{OWN}"), &policy(false)))
                body {
                    header {
                        p.brand { "aventail \u{b7} deformable registration of several fractions" }
                        h1 { (runs.len()) " fractions: " (of_verdicts(runs.iter().copied())) }
                        dl.case {
                            @if let Some(planning) = &self.planning { div { dt.planning { "Planning" } dd { (identity(planning)) } } }
                            div { dt { "Made" } dd { (utc(self.created)) span.note { " by aventail " (self.version) } } }
                        }
                    }
                    (self.table(&kinds))
                    @if runs.len() >= FEWEST {
                        h2 { "Courses over the fractions" }
                        (courses(&runs, &kinds))
                    }
                    section.limits {
                        p { "Each fraction's own report has its verdict with all reasons, its pictures, and where a person signs. Research software, not a medical device." }
                    }
                    footer { "Lengths in mm." }
                }
            }
        }
        .into_string()
    }

    fn table(&self, kinds: &[&FigureOfRuns]) -> Markup {
        html! {
            table.index {
                thead {
                    tr {
                        th { "After registration" } th { "Fraction" } th { "Verdict" }
                        @for k in kinds { th.n { (k.title) @if !k.unit.is_empty() { br; (k.unit) } } }
                        th { "Moves most: its centre, apart from the couch shift" } th.n { "Warnings" }
                    }
                }
                tbody { @for f in &self.fractions { (line(f, kinds)) } }
            }
        }
    }
}

/// The last two parts of a path: files of several fractions often have one name.
fn ending(path: &Path) -> String {
    let parts: Vec<_> = path.iter().map(|part| part.to_string_lossy()).collect();
    parts[parts.len().saturating_sub(2)..].join("/")
}

/// The line of one fraction.
fn line(f: &FractionRow, kinds: &[&FigureOfRuns]) -> Markup {
    let mark = f.run.verdict.map_or("", Mark::name);
    html! {
        tr {
            td { @if let Some(png) = &f.picture { img alt=(format!("{} after registration", f.run.fraction)) src=(data_url(png)); } }
            td {
                a href=(report_link(&f.run)) { (f.run.fraction) }
                div.why { (f.image) @if !f.run.date.is_empty() { ", " (f.run.date) } }
            }
            td {
                b.(mark) { (mark) }
                @if f.run.verdict > Some(Mark::Pass) {
                    @for reason in f.run.reasons.iter().take(2) { div.why { span.clip { (reason) } } }
                }
            }
            @for k in kinds {
                td.n data-what=(k.title) { (number(k, f.run.figure(k.key))) span.note { " " (k.unit) } }
            }
            td data-what="Moves most" {
                @match &f.moves_most { Some(m) => { (m.bone) ", " (format!("{:.1} mm", m.mm)) } None => { "\u{2013}" } }
            }
            td.n data-what="Warnings" { (f.warned) }
        }
    }
}

/// The course of each figure over the fractions.
fn courses(runs: &[&Member], kinds: &[&FigureOfRuns]) -> Markup {
    html! {
        table {
            thead { tr { @for k in kinds { th { (k.title) } } } }
            tbody { tr { @for k in kinds { td { (course(runs, runs.iter().copied(), k, None)) } } } }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::super::example;
    use super::*;

    #[test]
    fn each_fraction_has_its_line_and_the_way_to_its_report() {
        let dir = tempfile::tempdir().unwrap();
        let (case, outcome, run) = example::small();
        let mut report = Report::new(&case, &outcome, &run);
        for (name, mark) in [("b", Mark::Pass), ("a<b>", Mark::Fail), ("c", Mark::Review)] {
            report.verdict = Some(mark);
            std::fs::create_dir(dir.path().join(name)).unwrap();
            crate::io::write_json(dir.path().join(name).join("report.json"), &report).unwrap();
        }
        let all = Fractions::read(dir.path(), &["b", "a<b>", "c"], 0, "aventail register".into()).unwrap();
        let page = all.page();
        let at = |what: &str| page.find(what).unwrap_or_else(|| panic!("{what} is not in it"));
        assert!(at("href=\"b/report.html\"") < at("href=\"a&lt;b&gt;/report.html\"") && !page.contains("<b>/"));
        assert!(page.contains("case/fraction.nii.gz"));
        assert!(page.contains("3 fractions: 1 fail, 1 to review, 1 pass") && page.contains("skull, "), "{page}");
        assert_eq!(page.matches("<svg").count(), 4, "no uncertainty was asked for");
        assert!(!page.contains("http:") && !page.contains("<script") && page.contains("default-src 'none'"));
        let json = serde_json::to_value(&all).unwrap();
        assert_eq!(
            (json["fractions"][1]["verdict"].as_str(), json["fractions"][2]["warned"].as_u64()),
            (Some("fail"), Some(1))
        );
        assert!(Fractions::read(dir.path(), &["d"], 0, String::new()).is_err());
    }
}
