//! A cohort as text: a table for programs, and what matters for the terminal.

use super::super::numbers::first_words;
use super::figures::{FigureOfRuns, KINDS};
use super::{Cohort, Member};
use crate::evaluate::uncertainty::in_mm;
use crate::evaluate::verdict::Mark;
use crate::io::Sheet;
use crate::warning::counted;
use std::collections::BTreeSet;
use std::fmt::Write as _;
use std::io;

/// One line per run; what a run does not have stays empty.
pub(super) fn csv(cohort: &Cohort) -> io::Result<Vec<u8>> {
    let mut table = Sheet::default();
    let ends = ["stand_apart", "warnings"];
    table.write_record(
        ["patient", "fraction", "date", "folder", "verdict"].into_iter().chain(KINDS.iter().map(|k| k.key)).chain(ends),
    )?;
    for m in &cohort.runs {
        let mut cells = vec![m.patient.clone(), m.fraction.clone(), m.date.clone(), m.folder.display().to_string()];
        cells.push(m.verdict.map_or("", Mark::name).to_owned());
        cells.extend(KINDS.iter().map(|kind| m.figure(kind.key).map_or(String::new(), |v| format!("{v:.6}"))));
        cells.extend([m.stand_apart.join(" "), m.warnings.join(" ")]);
        table.write_record(cells)?;
    }
    table.into_bytes()
}

/// A figure with its unit.
pub(super) fn value(kind: &FigureOfRuns, v: f64) -> String {
    let space = if kind.unit.is_empty() { "" } else { " " };
    format!("{}{space}{}", plain(kind, v), kind.unit)
}

/// A figure without its unit; what is infinite is an uncertainty above what is told.
pub(super) fn plain(kind: &FigureOfRuns, v: f64) -> String {
    in_mm(Some(v).filter(|v| v.is_finite()), kind.digits)
}

/// What of a run stands apart, beside the median of the cohort.
fn apart(cohort: &Cohort, m: &Member) -> String {
    let kinds = KINDS.iter().filter(|kind| m.stand_apart.contains(&kind.key));
    let told = kinds.filter_map(|kind| {
        let (v, median) = (m.figure(kind.key)?, cohort.medians.get(kind.key).copied().flatten()?);
        Some(format!("{} {} (median {})", kind.title, value(kind, v), plain(kind, median)))
    });
    told.collect::<Vec<_>>().join("; ")
}

/// Runs that a person looks at first: those that fail by their own report, then those to be reviewed, then those that are unlike the
/// others.
pub(super) fn stand_out(cohort: &Cohort) -> Vec<&Member> {
    let counts = |m: &&Member| m.verdict > Some(Mark::Pass) || !m.stand_apart.is_empty();
    let mut all: Vec<&Member> = cohort.runs.iter().filter(counts).collect();
    all.sort_by_key(|m| std::cmp::Reverse((m.verdict, m.stand_apart.len())));
    all
}

/// Reasons that are named.
const NAMED: usize = 3;
/// Letters of a reason, about.
const LETTERS: usize = 70;

/// Why one does: what stands apart, then what its own report says, on a page in a few words.
pub(super) fn why(cohort: &Cohort, m: &Member, few: bool) -> String {
    let mark = m.verdict.filter(|mark| *mark > Mark::Pass).map(|mark| mark.name().to_uppercase());
    let reasons = m.reasons.iter().take(NAMED).map(|reason| if few { shortened(reason) } else { reason.clone() });
    let reasons: Vec<String> = reasons.collect();
    let more = m.reasons.len().checked_sub(NAMED + 1).map_or(String::new(), |n| format!(" and {} more", n + 1));
    let against = mark.map(|mark| format!("{mark}: {}{more}", reasons.join("; ")));
    Some(apart(cohort, m)).filter(|text| !text.is_empty()).into_iter().chain(against).collect::<Vec<_>>().join("; ")
}

/// The first words of a reason.
fn shortened(text: &str) -> String {
    first_words(text, LETTERS).map_or_else(|| text.to_owned(), |head| format!("{head} ..."))
}

/// How many fail, are to be looked at and pass.
pub(super) fn of_verdicts<'a>(runs: impl Iterator<Item = &'a Member> + Clone) -> String {
    let of = |mark: Mark| runs.clone().filter(|m| m.verdict == Some(mark)).count();
    format!("{} fail, {} to review, {} pass", of(Mark::Fail), of(Mark::Review), of(Mark::Pass))
}

/// How many runs of how many patients.
pub(super) fn counts(cohort: &Cohort) -> String {
    let warned = cohort.runs.iter().filter(|m| m.codes(false).next().is_some()).count();
    let found: Vec<&Member> = cohort.runs.iter().filter(|m| m.codes(true).next().is_some()).collect();
    let odd = cohort.runs.iter().filter(|m| !m.stand_apart.is_empty()).count();
    let of = |mark: Mark| cohort.runs.iter().filter(|m| m.verdict == Some(mark)).count();
    let (failed, review) = (of(Mark::Fail), of(Mark::Review));
    let mut text = format!(
        "{} of {}; {failed} fail, {review} to review, {warned} with warnings of their own, {odd} with figures that stand apart",
        counted(cohort.runs.len(), "run", "runs"),
        counted(cohort.patients().count(), "patient", "patients"),
    );
    if !found.is_empty() {
        let codes: BTreeSet<&str> = found.iter().flat_map(|m| m.codes(true)).map(String::as_str).collect();
        let codes = codes.into_iter().collect::<Vec<_>>().join(", ");
        let _ = write!(text, "; the summary itself finds something of {}: {codes}", found.len());
    }
    if !cohort.unfinished.is_empty() {
        let _ = write!(text, "; {} unfinished", cohort.unfinished.len());
    }
    text
}

pub(super) fn terminal(cohort: &Cohort) -> String {
    let mut text = format!("  {}\n", counts(cohort));
    for kind in KINDS.iter().filter(|kind| kind.course) {
        let values = || cohort.runs.iter().filter_map(|m| m.figure(kind.key));
        let (low, high) = (values().min_by(f64::total_cmp), values().max_by(f64::total_cmp));
        if let (Some(low), Some(high), Some(Some(median))) = (low, high, cohort.medians.get(kind.key)) {
            let [low, median, high] = [low, *median, high].map(|v| value(kind, v));
            let _ = writeln!(text, "  {:<40} {median} median, {low} to {high}", kind.title);
        }
    }
    for m in stand_out(cohort) {
        let _ = writeln!(text, "  {}, {}: {}", m.patient, m.fraction, why(cohort, m, false));
    }
    for w in &cohort.warnings {
        let _ = writeln!(text, "  warning ({}): {}", w.code, w.message);
    }
    for limit in cohort.doses.iter().flat_map(super::CourseDose::doubtful) {
        let _ = writeln!(text, "  limit of {limit}");
    }
    for folder in &cohort.unfinished {
        let _ = writeln!(text, "  unfinished: {folder}");
    }
    text
}
