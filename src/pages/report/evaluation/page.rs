//! `evaluation.html`: one self-contained page. The verdict comes first; the reviewer's fields stay blank.

use super::super::html::verdict::{identity, review, table as verdicts, verdict};
use super::super::html::{data_url, head};
use super::super::numbers::utc;
use super::super::viewer::policy;
use super::figures::{PARTS, rows};
use super::pictures::BEFORE;
use super::text::marks;
use super::{Assessed, EvaluationPicture, EvaluationReport};
use maud::{DOCTYPE, Markup, html};

/// The page; everything it needs is inside.
pub(super) fn page(report: &EvaluationReport, pictures: &[EvaluationPicture]) -> String {
    let names: Vec<&str> = report.fields.iter().map(|f| f.name.as_str()).collect();
    html! {
        (DOCTYPE)
        html lang="en" {
            (head(&format!("aventail evaluate: {}", names.join(", ")), "", &policy(false)))
            body {
                header {
                    p.brand { "aventail \u{b7} evaluation of displacement fields" }
                    h1 { (names.join(" \u{b7} ")) }
                    p.note { (utc(report.created)) " by aventail " (report.version) }
                    dl.case { (scan(report, "planning", "Planning")) (scan(report, "fraction", "Fraction")) }
                    @if let Some(first) = report.fields.first() { p.note { "Measured in " (first.assessment.measured_in) "." } }
                }
                @for field in &report.fields {
                    @if report.fields.len() > 1 { h3 { (field.name) } }
                    (verdict(&field.assessment.verdicts, &missing(field)))
                }
                (review())
                @if !report.warnings.is_empty() {
                    ul.warnings { @for w in &report.warnings { li { code { (w.code) } (w.message) } } }
                }
                h2 { "Verdicts" }
                @match report.fields.as_slice() {
                    [only] => (verdicts(&only.assessment.verdicts)),
                    _ => (side_by_side(report, &names)),
                }
                h2 { "Pictures" }
                div.pair.large.flow { @for p in by_kind(pictures) { (figure(p, names.len() > 1)) } }
                @for (part, heading) in PARTS {
                    (table(report, part, heading, &names))
                }
                h2 { "Provenance" }
                (provenance(report))
                section.limits {
                    h2 { "Limits" }
                    p {
                        "A figure speaks for the place where it was measured. Agreement of images or contours does not prove that tissue "
                        "inside was followed; a field free of folds is regular, not right. TG-132 gives no tolerance for carrying dose. "
                        "Research software, not a medical device."
                    }
                }
                footer { "Lengths in mm, LPS world frame. Formulas and sources: docs/metrics.md." }
            }
        }
    }
    .into_string()
}

/// Pictures of one kind together, so that fields stand side by side.
fn by_kind(pictures: &[EvaluationPicture]) -> Vec<&EvaluationPicture> {
    let kind = |p: &EvaluationPicture| p.file.split_once('_').map_or(String::new(), |(_, kind)| kind.to_owned());
    let kinds: Vec<String> = pictures.iter().map(kind).collect();
    let mut all: Vec<&EvaluationPicture> = pictures.iter().collect();
    all.sort_by_key(|p| kinds.iter().position(|k| *k == kind(p)));
    all
}

/// A picture; of several fields, what belongs to none of them has a row of its own, so that the others stay side by side.
fn figure(p: &EvaluationPicture, several: bool) -> Markup {
    html! {
        figure.alone[several && p.file == BEFORE] {
            h3 { (p.title) }
            img alt=(p.title) src=(data_url(&p.png));
            figcaption { (p.caption) }
        }
    }
}

/// A scan among the inputs.
fn scan(report: &EvaluationReport, role: &str, name: &str) -> Markup {
    html! {
        @if let Some(input) = report.inputs.iter().find(|i| i.role == role) {
            div { dt class=(role) { (name) } dd { (identity(input)) } }
        }
    }
}

/// What the rules could judge and was not measured of a field.
fn missing(field: &Assessed) -> Vec<&'static str> {
    let a = &field.assessment;
    let known = [
        (a.landmarks.as_ref().is_some_and(|l| l.after.n > 0), "target registration error (--landmarks)"),
        (!a.contours.is_empty(), "agreement of contours (--labels-planning, --labels-fraction)"),
        (!a.rigidity.is_empty(), "rigidity of bones (--bones)"),
    ];
    known.into_iter().filter(|(known, _)| !known).map(|(_, what)| what).collect()
}

/// The rules of several fields.
fn side_by_side(report: &EvaluationReport, names: &[&str]) -> Markup {
    let class = |value: &str| match value.rsplit(' ').next() {
        Some("fail") => "n fail",
        Some("review") => "n review",
        Some("pass") => "n pass",
        _ => "n",
    };
    html! {
        table {
            thead { tr { th { "Figure" } @for n in names { th.n { (n) } } th { "Limit" } th { "Source" } } }
            tbody {
                @for row in marks(report) {
                    tr {
                        td { (row.figure) }
                        @for v in &row.values { td class=(class(v)) { (v) } }
                        td { (row.limit) }
                        td { (row.source) }
                    }
                }
            }
        }
    }
}

fn table(report: &EvaluationReport, part: &str, heading: &str, names: &[&str]) -> Markup {
    let rows = rows(report, part);
    html! {
        @if !rows.is_empty() {
            h2 { (heading) }
            div.rows[names.len() == 1] {
                table {
                    thead { tr { th {} th {} @for n in names { th.n { (n) } } } }
                    tbody {
                        @for (n, row) in rows.iter().enumerate() {
                            tr {
                                td {
                                    // On paper a table may go on in the next column.
                                    span.paper[n > 0 && rows[n - 1].item == row.item] { (row.item) }
                                }
                                td { (row.metric) }
                                @for v in &row.values { td.n { (v) } }
                            }
                        }
                    }
                }
            }
        }
    }
}

fn provenance(report: &EvaluationReport) -> Markup {
    let seconds: f64 = report.stages.iter().map(|s| s.seconds).sum();
    html! {
        table {
            thead { tr { th { "Input" } th { "File" } th { "SHA-256" } } }
            tbody {
                @for input in &report.inputs {
                    tr { td { (input.role) } td.wide { (input.path.display()) } td.mono { (input.sha256) } }
                }
            }
        }
        h3 { "Command" }
        pre { (report.command) }
        p.note { (format!("{seconds:.1} s on {} threads: ", report.threads)) (report.stages.iter().map(|s| format!("{} {:.1} s", s.stage, s.seconds)).collect::<Vec<_>>().join(", ")) }
    }
}
