//! `study.md`: the tables as Markdown.

use super::StageRecord;
use super::rows::{COLUMNS, rows};
use crate::config::StudyPlan;
use std::collections::BTreeMap;
use std::fmt::Write;

pub(super) fn page(title: &str, plan: &StudyPlan, records: &BTreeMap<String, StageRecord>) -> String {
    let mut out = format!("# {title}\n");
    for table in &plan.tables {
        let line = |cells: &mut dyn Iterator<Item = String>| format!("| {} |", cells.collect::<Vec<_>>().join(" | "));
        let head = std::iter::once("stage").chain(COLUMNS).map(str::to_owned);
        let rule = std::iter::once("---").chain(COLUMNS.map(|_| "---:")).map(str::to_owned);
        let source = if table.source.is_empty() { String::new() } else { format!(" ({})", table.source) };
        let _ = writeln!(out, "\n## {}{source}\n", table.title);
        let _ = writeln!(out, "{}\n{}", line(&mut { head }), line(&mut { rule }));
        for row in rows(table, records) {
            let mark = |text: &str| match (row.published, text.is_empty()) {
                (true, false) => format!("*{text}*"),
                _ => text.to_owned(),
            };
            let mut cells = std::iter::once(mark(&row.name)).chain(row.values.iter().map(|v| mark(v)));
            let _ = writeln!(out, "{}", line(&mut cells));
        }
    }
    out
}
