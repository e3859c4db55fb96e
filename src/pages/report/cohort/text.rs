//! A cohort as text: a table for programs, and what matters for the terminal.

use super::figures::{FigureOfRuns, KINDS};
use super::{Cohort, Member};
use crate::evaluate::verdict::Mark;
use crate::io::Sheet;
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
    format!("{v:.*}{space}{}", kind.digits, kind.unit)
}

/// What of a run stands apart, beside the median of the cohort.
fn apart(cohort: &Cohort, m: &Member) -> String {
    let kinds = KINDS.iter().filter(|kind| m.stand_apart.contains(&kind.key));
    let told = kinds.filter_map(|kind| {
        let (v, median) = (m.figure(kind.key)?, cohort.medians.get(kind.key).copied().flatten()?);
        Some(format!("{} {} (median {median:.*})", kind.title, value(kind, v), kind.digits))
    });
    told.collect::<Vec<_>>().join("; ")
}

/// Whether a person looks at a run first: it fails by its own report, or is unlike the others.
pub(super) fn stands_out(m: &Member) -> bool {
    m.verdict == Some(Mark::Fail) || !m.stand_apart.is_empty()
}

/// Why one does.
pub(super) fn why(cohort: &Cohort, m: &Member) -> String {
    let failed = m.reasons.iter().filter(|_| m.verdict == Some(Mark::Fail)).map(|reason| format!("FAIL: {reason}"));
    failed.chain(Some(apart(cohort, m)).filter(|text| !text.is_empty())).collect::<Vec<_>>().join("; ")
}

/// How many fail, are to be looked at and pass.
pub(super) fn of_verdicts<'a>(runs: impl Iterator<Item = &'a Member> + Clone) -> String {
    let of = |mark: Mark| runs.clone().filter(|m| m.verdict == Some(mark)).count();
    format!("{} fail, {} to review, {} pass", of(Mark::Fail), of(Mark::Review), of(Mark::Pass))
}

/// How many runs of how many patients.
pub(super) fn counts(cohort: &Cohort) -> String {
    let plural = |n: usize, what: &str| format!("{n} {what}{}", if n == 1 { "" } else { "s" });
    let warned = cohort.runs.iter().filter(|m| !m.warnings.is_empty()).count();
    let odd = cohort.runs.iter().filter(|m| !m.stand_apart.is_empty()).count();
    let of = |mark: Mark| cohort.runs.iter().filter(|m| m.verdict == Some(mark)).count();
    let (failed, review) = (of(Mark::Fail), of(Mark::Review));
    let mut text = format!(
        "{} of {}; {failed} fail, {review} to review, {warned} with warnings, {odd} with figures that stand apart",
        plural(cohort.runs.len(), "run"),
        plural(cohort.patients().count(), "patient"),
    );
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
            let _ = writeln!(text, "  {:<28} {median} median, {low} to {high}", kind.title);
        }
    }
    for m in cohort.runs.iter().filter(|m| stands_out(m)) {
        let _ = writeln!(text, "  {}, {}: {}", m.patient, m.fraction, why(cohort, m));
    }
    for w in &cohort.warnings {
        let _ = writeln!(text, "  warning ({}): {}", w.code, w.message);
    }
    for folder in &cohort.unfinished {
        let _ = writeln!(text, "  unfinished: {folder}");
    }
    text
}
