//! The rows of a study's table: measured numbers, with the published ones below them.

use super::StageRecord;
use crate::config::{Published, StudyTable};
use std::collections::BTreeMap;

/// Headings of the number columns.
pub(super) const COLUMNS: [&str; 10] = [
    "J < 0 [%]",
    "J > 2 [%]",
    "J < 0.5 [%]",
    "mean J",
    "max J",
    "residual",
    "std",
    "residual [mm]",
    "rigid rms [mm]",
    "time",
];

/// A row: whose numbers, and the numbers in the order of [`COLUMNS`].
pub(super) struct StudyRow {
    pub(super) name: String,
    /// Printed elsewhere, not measured here.
    pub(super) published: bool,
    pub(super) values: [String; 10],
}

/// Rows of one table: each finished stage's, followed by what is published of it.
pub(super) fn rows(table: &StudyTable, records: &BTreeMap<String, StageRecord>) -> Vec<StudyRow> {
    let mut out = Vec::new();
    for stage in &table.stages {
        let Some(record) = records.get(&stage.id) else { continue };
        out.push(StudyRow { name: stage.name.clone(), published: false, values: measured(record) });
        out.extend(stage.published.iter().map(|p| StudyRow {
            name: p.patient.clone(),
            published: true,
            values: published(p),
        }));
    }
    out
}

fn fixed(value: f64, digits: usize) -> String {
    format!("{value:.digits$}")
}

fn measured(r: &StageRecord) -> [String; 10] {
    // The set of thesis Tab. 2: bone contact and sliding interfaces are part of the patient.
    let all = &r.jacobian.all;
    let optional = |v: Option<f64>| v.map_or(String::new(), |v| fixed(v, 2));
    [
        fixed(all.folded_percent, 2),
        fixed(all.above_2_percent, 2),
        fixed(all.below_half_percent, 2),
        fixed(all.mean, 3),
        fixed(all.max, 1),
        optional(r.residual.map(|v| v.0)),
        optional(r.residual.map(|v| v.1)),
        optional(r.residual_mm),
        format!("{:.1e}", r.rigid_rms_mm),
        format!("{:.1} s", r.seconds),
    ]
}

fn published(p: &Published) -> [String; 10] {
    let plain = |v: Option<f64>| v.map_or(String::new(), |v| format!("{v}"));
    [
        plain(p.folded),
        plain(p.above_2),
        plain(p.below_half),
        plain(p.mean),
        plain(p.max),
        plain(p.residual_mean),
        plain(p.residual_std),
        String::new(),
        String::new(),
        p.time.as_ref().map_or(String::new(), |t| format!("{t} min")),
    ]
}
