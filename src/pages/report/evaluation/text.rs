//! The evaluation as CSV, Markdown, and a table for the terminal.

use super::super::table::verdict;
use super::EvaluationReport;
use super::figures::{PARTS, figures, number, rows};
use crate::evaluate::verdict::measured;
use crate::io::Sheet;
use std::fmt::Write;

/// One line per figure: field, part, item, metric, value, unit; then the verdicts.
pub(super) fn csv(report: &EvaluationReport) -> Result<Vec<u8>, csv::Error> {
    let mut table = Sheet::default();
    table.write_record(["field", "part", "item", "metric", "value", "unit", "limit", "source", "verdict", "reason"])?;
    for field in &report.fields {
        for f in figures(&field.assessment) {
            // What is not known stays empty.
            let value = if f.value.is_finite() { f.value.to_string() } else { String::new() };
            table.write_record([&field.name, f.part, &f.item, f.metric, &value, f.unit, "", "", "", ""])?;
        }
        for v in &field.assessment.verdicts {
            let value = if v.value.is_finite() { v.value.to_string() } else { String::new() };
            table.write_record([
                &field.name,
                "verdicts",
                &v.name,
                "",
                &value,
                &v.unit,
                &v.limit,
                &v.source,
                v.verdict.name(),
                &v.reason,
            ])?;
        }
    }
    Ok(table.into_bytes()?)
}

/// The whole evaluation as Markdown tables, fields side by side.
pub(super) fn markdown(report: &EvaluationReport) -> String {
    let mut out = format!("# Evaluation by aventail {}\n\n", report.version);
    let mut line = |text: String| writeln!(out, "{text}").expect("writing to a string does not fail");
    line(format!("`{}`\n", report.command));
    for w in &report.warnings {
        line(format!("- warning ({}): {}", w.code, w.message));
    }
    if let Some(first) = report.fields.first() {
        line(format!("Measured in {}.\n", first.assessment.measured_in));
    }
    let heads: Vec<&str> = report.fields.iter().map(|f| f.name.as_str()).collect();
    for field in &report.fields {
        line(format!("**{}**: {}\n", field.name, verdict(&field.assessment.verdicts)));
    }
    line("## Verdicts\n".into());
    line(format!("| figure | {} | limit | source |", heads.join(" | ")));
    line(format!("|---|{}---|---|", "---|".repeat(heads.len())));
    for row in marks(report) {
        line(format!("| {} | {} | {} | {} |", row.figure, row.values.join(" | "), row.limit, row.source));
    }
    for (part, heading) in PARTS {
        let rows = rows(report, part);
        if !rows.is_empty() {
            line(format!("\n## {heading}\n"));
            line(format!("| | | {} |", heads.join(" | ")));
            line(format!("|---|---|{}", "---|".repeat(heads.len())));
            for row in rows {
                line(format!("| {} | {} | {} |", row.item, row.metric, row.values.join(" | ")));
            }
        }
    }
    out
}

/// A rule with each field's value and verdict.
pub(super) struct MarkRow {
    pub(super) figure: String,
    pub(super) values: Vec<String>,
    pub(super) limit: String,
    pub(super) source: String,
}

/// The rules, fields side by side.
pub(super) fn marks(report: &EvaluationReport) -> Vec<MarkRow> {
    let mut rows: Vec<MarkRow> = Vec::new();
    for (n, field) in report.fields.iter().enumerate() {
        for c in &field.assessment.verdicts {
            let at = rows.iter().position(|r| r.figure == c.name).unwrap_or_else(|| {
                rows.push(MarkRow {
                    figure: c.name.clone(),
                    values: vec!["\u{2013}".into(); report.fields.len()],
                    limit: c.limit.clone(),
                    source: c.source.clone(),
                });
                rows.len() - 1
            });
            let unit = if c.unit.is_empty() { String::new() } else { format!(" {}", c.unit) };
            rows[at].values[n] = format!("{}{unit}: {}", number(c.value, &c.unit), c.verdict.name());
        }
    }
    rows
}

/// The figures that matter, a block per field.
pub fn terminal_table(report: &EvaluationReport) -> String {
    let mut out = String::new();
    for w in &report.warnings {
        writeln!(out, "warning ({}): {}", w.code, w.message).expect("writing to a string does not fail");
    }
    for field in &report.fields {
        writeln!(out, "{}", field.name).expect("writing to a string does not fail");
        let verdicts = &field.assessment.verdicts;
        let shown = |mark: &str| measured(verdicts).filter(|c| c.verdict.name() == mark).count();
        writeln!(out, "  verdict {}", verdict(verdicts)).expect("writing to a string does not fail");
        for c in verdicts {
            let value = number(c.value, &c.unit);
            let unit = if c.unit.is_empty() { String::new() } else { format!(" {}", c.unit) };
            writeln!(out, "  {:<6} {:<52} {value}{unit}", c.verdict.name(), c.name)
                .expect("writing to a string does not fail");
        }
        let bones = &field.assessment.rigidity;
        if let Some(worst) = bones.iter().max_by(|a, b| a.rms_mm.total_cmp(&b.rms_mm)) {
            writeln!(
                out,
                "         bones depart from rigid motion by {} mm rms at worst ({})",
                number(worst.rms_mm, "mm"),
                worst.name
            )
            .expect("writing to a string does not fail");
        }
        if let Some(s) = &field.assessment.similarity {
            writeln!(out, "         CTs differ by {:.0} HU rms before, {:.0} after", s.before.rms_hu, s.after.rms_hu)
                .expect("writing to a string does not fail");
        }
        let (pass, review, fail) = (shown("pass"), shown("review"), shown("fail"));
        writeln!(out, "  {pass} pass, {review} to review, {fail} fail; a physicist decides")
            .expect("writing to a string does not fail");
    }
    out
}
