//! `study.csv`: one line per row of every table.

use super::StageRecord;
use super::rows::{COLUMNS, rows};
use crate::config::StudyPlan;
use crate::error::Result;
use crate::io::{Sheet, write_file};
use std::collections::BTreeMap;
use std::path::Path;

pub(super) fn write(path: &Path, plan: &StudyPlan, records: &BTreeMap<String, StageRecord>) -> Result<()> {
    write_file(path, |out| {
        let mut table = Sheet::default();
        table.write_record(["table", "stage", "origin"].into_iter().chain(COLUMNS))?;
        for t in &plan.tables {
            for row in rows(t, records) {
                let origin = if row.published { "published" } else { "measured" };
                let start = [t.title.as_str(), row.name.as_str(), origin];
                table.write_record(start.into_iter().chain(row.values.iter().map(String::as_str)))?;
            }
        }
        out.write_all(&table.into_bytes()?)
    })
}
