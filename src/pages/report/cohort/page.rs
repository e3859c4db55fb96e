//! `summary.html`: what stands apart first, then every run, then each patient's course.

use super::super::html::head;
use super::super::numbers::utc;
use super::super::viewer::policy;
use super::doses;
use super::figures::{FigureOfRuns, KINDS};
use super::text::{counts, plain, stand_out, value, why};
use super::{Cohort, Member};
use crate::evaluate::verdict::Mark;
use maud::{DOCTYPE, Markup, html};

/// Styles beside the common ones.
pub(super) const STYLE: &str = "
body { max-width: 1400px; }
.odd { color: var(--warn); font-weight: 700; }
table.runs th { white-space: normal; }
.left { text-align: left; }
.scrolled { overflow-x: auto; }
table.runs tr.first td { border-top: 1.5px solid var(--line); }
svg.course { width: 132px; height: 34px; display: block; }
svg.course polyline { fill: none; stroke: var(--bar); stroke-width: 1.6; }
svg.course circle { fill: var(--after); }
svg.course circle.apart { fill: #d97706; }
svg.course line { stroke: var(--line); stroke-width: 1; }
@page { size: landscape; }
@media print {
  .scrolled { overflow: visible; }
  table.runs th, table.runs td { padding-right: 4px; font-size: 7px; line-height: 1.4; }
}
";

/// Width and height of a course, and the room around it.
const SIZE: [f64; 2] = [132.0, 34.0];
const RIM: f64 = 5.0;

/// The page; everything it needs is inside but the reports, to which it links.
pub(super) fn page(cohort: &Cohort) -> String {
    let shown: Vec<&FigureOfRuns> =
        KINDS.iter().filter(|k| cohort.runs.iter().any(|m| m.figure(k.key).is_some())).collect();
    html! {
        (DOCTYPE)
        html lang="en" {
            (head("aventail: summary of runs", STYLE, &policy(false)))
            body {
                header {
                    p.brand { "aventail \u{b7} summary of runs" }
                    h1 { (counts(cohort)) }
                    p.note { (utc(cohort.created)) " by aventail " (cohort.version) }
                }
                h2 { "Look at these first" }
                (first(cohort))
                h2 { "Runs" }
                p.note {
                    "A figure stands apart where it is worse than the cohort's median by more than 3.5 modified z-scores "
                    "(Iglewicz and Hoaglin 1993: median absolute deviations) and by an amount that matters. It says that a run is unlike the others, "
                    "not that it is wrong; in a cohort that is wrong throughout, none stands apart."
                }
                (runs(cohort, &shown))
                h2 { "Courses over the fractions" }
                p.note { "One scale for all patients in each column; the line is the cohort's median, orange what stands apart." }
                (courses(cohort, &shown))
                (doses::section(&cohort.doses))
                section.limits {
                    h2 { "Limits" }
                    p { "Research software, not a medical device. No figure here replaces a look at the run's own report." }
                }
                footer { "Lengths in mm. Formulas: docs/metrics.md." }
            }
        }
    }
    .into_string()
}

pub(super) fn report_link(m: &Member) -> String {
    // A link has `/` on every system.
    format!("{}/report.html", m.folder.display())
}

/// What stands apart, and what is not finished.
fn first(cohort: &Cohort) -> Markup {
    let odd = stand_out(cohort);
    let open: Vec<String> = cohort.doses.iter().flat_map(doses::CourseDose::doubtful).collect();
    html! {
        @if odd.is_empty() { p { "Every finished run passes its own rules, and no figure of any run stands apart." } }
        @if !odd.is_empty() || !cohort.unfinished.is_empty() || !cohort.warnings.is_empty() || !open.is_empty() {
            ul.warnings {
                @for w in &cohort.warnings { li { code { (w.code) } (w.message) } }
                @for m in odd {
                    li { a href=(report_link(m)) { b { (m.patient) ", " (m.fraction) } } ": " (why(cohort, m, true)) }
                }
                @for limit in &open { li { (limit) } }
                @for folder in &cohort.unfinished { li { code { "unfinished" } (folder) } }
            }
        }
    }
}

fn runs(cohort: &Cohort, shown: &[&FigureOfRuns]) -> Markup {
    // Said once: they tell one run from another as little as the planning CT does.
    let mut common: Vec<&String> = cohort.runs.first().iter().flat_map(|m| &m.warnings).collect();
    common.retain(|w| cohort.runs.len() > 1 && cohort.runs.iter().all(|m| m.warnings.contains(w)));
    let of_all = |by_summary: bool| -> Vec<&String> {
        let own = cohort.runs.first().into_iter().flat_map(|m| m.codes(by_summary));
        own.filter(|code| common.contains(code)).collect()
    };
    html! {
        @for (said, codes) in [("Every run warns of ", of_all(false)), ("The summary finds of every run ", of_all(true))] {
            @if !codes.is_empty() {
                p.note { (said) @for (n, w) in codes.iter().enumerate() { @if n > 0 { ", " } code { (w) } } "." }
            }
        }
        div.scrolled { table.runs {
            thead {
                tr {
                    th { "Patient" } th { "Fraction" } th { "Verdict" }
                    @for k in shown { th.n { (k.title) @if !k.unit.is_empty() { br; (k.unit) } } }
                    th { "Warnings, and what the summary finds" }
                }
            }
            tbody {
                tr {
                    td { em { "median" } } td {} td {}
                    @for k in shown { td.n { em { (number(k, cohort.medians.get(k.key).copied().flatten())) } } }
                    td {}
                }
                @for patient in cohort.patients() {
                    @for (n, m) in patient.iter().enumerate() {
                        tr.first[n == 0] {
                            td.n.left { @if n == 0 { b { (m.patient) } } }
                            td { a href=(report_link(m)) { (m.fraction) } @if !m.date.is_empty() { br; small { (m.date) } } }
                            td.odd[m.verdict > Some(Mark::Pass)] { (m.verdict.map_or("", Mark::name)) }
                            @for k in shown {
                                td.n.odd[m.stand_apart.contains(&k.key)] { (number(k, m.figure(k.key))) }
                            }
                            td.mono { (m.warnings.iter().filter(|w| !common.contains(w)).cloned().collect::<Vec<_>>().join(", ")) }
                        }
                    }
                }
            }
        } }
    }
}

pub(super) fn number(kind: &FigureOfRuns, v: Option<f64>) -> String {
    v.map_or("\u{2013}".into(), |v| plain(kind, v))
}

/// A small picture of each figure that has a course, patient by patient.
fn courses(cohort: &Cohort, shown: &[&FigureOfRuns]) -> Markup {
    let shown: Vec<&FigureOfRuns> = shown.iter().copied().filter(|k| k.course).collect();
    let all: Vec<&Member> = cohort.runs.iter().collect();
    html! {
        table {
            thead { tr { th { "Patient" } th.n { "Fractions" } @for k in &shown { th { (k.title) } } } }
            tbody {
                @for patient in cohort.patients() {
                    tr {
                        td { b { (patient[0].patient) } }
                        td.n { (patient.len()) }
                        @for k in &shown { td { (course(&all, patient, k, cohort.medians.get(k.key).copied().flatten())) } }
                    }
                }
            }
        }
    }
}

/// The figure of one patient's runs on the scale of `all` runs, with a line at their median where it is given.
pub(super) fn course<'a>(
    all: &[&'a Member],
    patient: impl IntoIterator<Item = &'a Member>,
    kind: &FigureOfRuns,
    median: Option<f64>,
) -> Markup {
    let patient: Vec<&Member> = patient.into_iter().collect();
    let all = || all.iter().filter_map(|m| m.figure(kind.key));
    let (low, high) = all().filter(|v| v.is_finite()).fold((f64::MAX, f64::MIN), |(a, b), v| (a.min(v), b.max(v)));
    // Differences that matter to nobody are no slopes.
    let high = high.max(low + kind.least);
    let last = patient.len().saturating_sub(1).max(1) as f64;
    let x = |n: usize| RIM + (SIZE[0] - 2.0 * RIM) * if patient.len() == 1 { 0.5 } else { n as f64 / last };
    let y = |v: f64| SIZE[1] - RIM - (SIZE[1] - 2.0 * RIM) * (v.min(high) - low) / (high - low).max(1e-12);
    let points: Vec<(f64, f64, &Member)> =
        patient.iter().enumerate().filter_map(|(n, m)| Some((x(n), y(m.figure(kind.key)?), *m))).collect();
    let line = points.iter().map(|(x, y, _)| format!("{x:.1},{y:.1}")).collect::<Vec<_>>().join(" ");
    let said = patient.iter().filter_map(|m| m.figure(kind.key)).map(|v| value(kind, v)).collect::<Vec<_>>();
    html! {
        @if !points.is_empty() {
            svg.course viewBox=(format!("0 0 {} {}", SIZE[0], SIZE[1])) role="img" aria-label=(said.join(", ")) {
                title { (said.join(", ")) }
                @if let Some(median) = median {
                    line x1="0" x2=(SIZE[0]) y1=(format!("{:.1}", y(median))) y2=(format!("{:.1}", y(median))) {}
                }
                polyline points=(line) {}
                @for (x, y, m) in &points {
                    circle.apart[m.stand_apart.contains(&kind.key)] cx=(format!("{x:.1}")) cy=(format!("{y:.1}")) r="2.6" {}
                }
            }
        }
    }
}
