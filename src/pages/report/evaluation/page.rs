//! `evaluation.html`: one self-contained page. The verdict comes first; the reviewer's fields stay blank.

use super::super::html::paper::{more, printed};
use super::super::html::verdict::{identity, review, table as verdicts, verdict};
use super::super::html::{data_url, head, inputs, warnings};
use super::super::numbers::{threads, utc};
use super::super::viewer::policy;
use super::figures::{PARTS, figures, rows};
use super::pictures::BEFORE;
use super::text::{MarkRow, marks};
use super::{Assessed, EvaluationPicture, EvaluationReport};
use crate::config::InputRole;
use maud::{DOCTYPE, Markup, html};
use std::cmp::Reverse;

/// Fields, rules, and rows of pictures that a page of paper has room for.
const FIELDS_ON_PAPER: usize = 4;
/// As many have tables in two columns.
const FEW_FIELDS: usize = 2;
const RULES_ON_PAPER: usize = 18;
const ROWS_OF_A_SHEET: usize = 3;

/// The page; everything it needs is inside.
pub(super) fn page(report: &EvaluationReport, pictures: &[EvaluationPicture]) -> String {
    let names: Vec<&str> = report.fields.iter().map(|f| f.name.as_str()).collect();
    html! {
        (DOCTYPE)
        html lang="en" {
            (head(&format!("aventail evaluate: {}", names.join(", ")), "", &policy(false)))
            body {
                div.sheet {
                    header {
                        p.brand { "aventail \u{b7} evaluation of displacement fields" }
                        h1 { span.clip { (names.join(" \u{b7} ")) } }
                        p.note { (utc(report.created)) " by aventail " (report.version) }
                        dl.case { (scan(report, InputRole::Planning, "Planning")) (scan(report, InputRole::Fraction, "Fraction")) }
                        @if let Some(first) = report.fields.first() { p.note { "Measured in " (first.assessment.measured_in) "." } }
                    }
                    @for (n, field) in report.fields.iter().enumerate() {
                        div.screen[n >= FIELDS_ON_PAPER].brief[names.len() > 2] {
                            @if names.len() > 1 { h3 { span.clip { (field.name) } } }
                            (verdict(&field.assessment.verdicts, &missing(field)))
                        }
                    }
                    (more(names.len(), FIELDS_ON_PAPER, ["field", "fields"], "evaluation.json"))
                    (review())
                    (warnings(&report.warnings, "evaluation.json"))
                    h2 { "Verdicts" }
                    @match report.fields.as_slice() {
                        [only] => (verdicts(&only.assessment.verdicts, RULES_ON_PAPER)),
                        _ => (side_by_side(report, &names)),
                    }
                }
                h2.screen { "Pictures" }
                (gallery(pictures, names.len()))
                @for (part, heading) in PARTS {
                    (table(report, part, heading, &names))
                }
                div.end {
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
    }
    .into_string()
}

/// Pictures of one kind together, so that fields stand side by side; on paper three rows of them are a page, those of one
/// field are one.
fn gallery(pictures: &[EvaluationPicture], fields: usize) -> Markup {
    let mut all: Vec<&EvaluationPicture> = pictures.iter().collect();
    all.sort_by_key(|p| row_of(p));
    if fields < 2 {
        return html! { div.sheet { div.fill { div.pair.large.gallery { @for p in all { (figure(p, false)) } } } } };
    }
    let rows: Vec<&[&EvaluationPicture]> = all.chunk_by(|a, b| row_of(a) == row_of(b)).collect();
    let columns = |row: &[&EvaluationPicture]| row.iter().filter(|p| field_of(p) <= FIELDS_ON_PAPER).count().min(5);
    html! {
        @for sheet in rows.chunks(ROWS_OF_A_SHEET) {
            div.sheet {
                div.fill {
                    @for row in sheet {
                        div.pair.large.side style=(format!("--columns: {}", columns(row))) { @for p in *row { (figure(p, true)) } }
                    }
                }
            }
        }
    }
}

/// The row that a picture stands in.
fn row_of(p: &EvaluationPicture) -> usize {
    let kind = p.file.split_once('_').map_or("", |(_, kind)| kind);
    let rows: [&[&str]; 5] =
        [&["before", "shift"], &["after"], &["jacobian."], &["contours"], &["residuals", "jacobian_volume"]];
    rows.iter().position(|kinds| kinds.iter().any(|k| kind.starts_with(k))).unwrap_or(rows.len())
}

/// The field that a picture is of, from 1 on.
fn field_of(p: &EvaluationPicture) -> usize {
    p.file.split_once('_').and_then(|(n, _)| n.parse().ok()).unwrap_or(1)
}

/// A picture; of several fields, what belongs to none of them has a row of its own, so that the others stay side by side.
fn figure(p: &EvaluationPicture, several: bool) -> Markup {
    html! {
        figure.alone[several && p.file == BEFORE].screen[field_of(p) > FIELDS_ON_PAPER] {
            h3 { span.clip { (p.title) } }
            img alt=(p.title) src=(data_url(&p.png));
            figcaption { (p.caption) }
        }
    }
}

/// A scan among the inputs.
fn scan(report: &EvaluationReport, role: InputRole, name: &str) -> Markup {
    html! {
        @if let Some(input) = report.inputs.iter().find(|i| i.role == role) {
            div { dt class=(role.name()) { (name) } dd { (identity(input)) } }
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
        (a.agreement.is_some(), "agreement of the images (--planning, --fraction in HU)"),
    ];
    known.into_iter().filter(|(known, _)| !known).map(|(_, what)| what).collect()
}

/// The rules of several fields.
fn side_by_side(report: &EvaluationReport, names: &[&str]) -> Markup {
    let class = |value: &str| match value.rsplit(' ').next() {
        Some("fail") => "fail",
        Some("review") => "review",
        Some("pass") => "pass",
        _ => "unknown",
    };
    // What some field does not pass comes first, so that it is printed.
    let mut rows = marks(report);
    let worst =
        |row: &MarkRow| row.values.iter().map(|v| ["pass", "review", "fail"].iter().position(|m| *m == class(v))).max();
    rows.sort_by_key(|row| Reverse(worst(row)));
    let most = if names.len() > FEW_FIELDS { RULES_ON_PAPER * 2 / 3 } else { RULES_ON_PAPER };
    html! {
        table.fields {
            thead {
                tr {
                    th { "Figure" }
                    @for (n, name) in names.iter().enumerate() { th.n.screen[n >= FIELDS_ON_PAPER] { span.short { (name) } } }
                    th { "Limit" } th.screen { "Source" }
                }
            }
            tbody {
                @for (line, row) in rows.iter().enumerate() {
                    tr.screen[line >= most] {
                        td { span.short { (row.figure) } }
                        @for (n, v) in row.values.iter().enumerate() { td.(class(v)).n.screen[n >= FIELDS_ON_PAPER] { (v) } }
                        td { span.clip { (row.limit) } }
                        td.screen { (row.source) }
                    }
                }
            }
        }
        (more(rows.len(), most, ["rule", "rules"], "evaluation.md"))
    }
}

fn table(report: &EvaluationReport, part: &str, heading: &str, names: &[&str]) -> Markup {
    let rows = rows(report, part);
    let (items, most) = items(report, part);
    let on_paper = |item: &str| items.iter().any(|(name, shown)| *shown && name == item);
    html! {
        @if !rows.is_empty() {
            h2 { (heading) }
            div.rows[names.len() <= FEW_FIELDS] {
                table.fields {
                    thead {
                        tr {
                            th {} th {}
                            @for (n, name) in names.iter().enumerate() { th.n.screen[n >= FIELDS_ON_PAPER] { span.short { (name) } } }
                        }
                    }
                    tbody {
                        @for (n, row) in rows.iter().enumerate() {
                            tr.screen[!on_paper(&row.item)] {
                                td {
                                    @let again = n > 0 && rows[n - 1].item == row.item;
                                    // On paper a table may go on in the next column.
                                    span.paper[again] { span.short { (row.item) } }
                                }
                                td { (row.metric) }
                                @for (n, v) in row.values.iter().enumerate() { td.n.screen[n >= FIELDS_ON_PAPER] { (v) } }
                            }
                        }
                    }
                }
            }
            (more(items.len(), most, ["with a smaller error", "with smaller errors"], "evaluation.md"))
        }
    }
}

/// What the rows of a part are of, whether that is printed, and how many are: structures by Dice and folds, bones by
/// their departure from rigid motion, and everything of the other parts.
fn items(report: &EvaluationReport, part: &str) -> (Vec<(String, bool)>, usize) {
    let (most, metric, sign) = match part {
        "contours" => (7, "Dice", -1.0),
        "bones" => (14, "root mean square", 1.0),
        "structures" => (8, "folded cells", 1.0),
        _ => (usize::MAX, "", 0.0),
    };
    let mut items: Vec<(String, f64)> = Vec::new();
    for f in report.fields.iter().flat_map(|f| figures(&f.assessment)).filter(|f| f.part == part) {
        let at = items.iter().position(|(item, _)| *item == f.item).unwrap_or_else(|| {
            // What has no such figure sums the others up.
            items.push((f.item.clone(), f64::INFINITY));
            items.len() - 1
        });
        if f.metric == metric && !f.value.is_nan() {
            let known = items[at].1;
            items[at].1 = if known.is_infinite() { sign * f.value } else { known.max(sign * f.value) };
        }
    }
    let weights: Vec<f64> = items.iter().map(|item| item.1).collect();
    let shown = printed(&weights, most);
    (items.into_iter().map(|item| item.0).zip(shown).collect(), most)
}

fn provenance(report: &EvaluationReport) -> Markup {
    let seconds: f64 = report.stages.iter().map(|s| s.seconds).sum();
    html! {
        (inputs(&report.inputs, "evaluation.json"))
        h3 { "Command" }
        pre { span.clip { (report.command) } }
        p.note { (format!("{seconds:.1} s on {}: ", threads(report.threads))) (report.stages.iter().map(|s| format!("{} {:.1} s", s.stage, s.seconds)).collect::<Vec<_>>().join(", ")) }
    }
}
