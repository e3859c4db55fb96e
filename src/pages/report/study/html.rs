//! `study.html`: the tables with each stage's pictures beside it, which lie in the folder `pictures`.

use super::super::html::head;
use super::super::viewer::policy_of_files;
use super::rows::{COLUMNS, rows};
use super::{SHOWN, StageRecord};
use crate::config::StudyPlan;
use maud::{DOCTYPE, html};
use std::collections::{BTreeMap, HashSet};

pub(super) fn page(title: &str, plan: &StudyPlan, records: &BTreeMap<String, StageRecord>) -> String {
    let mut shown = HashSet::new();
    html! {
        (DOCTYPE)
        html lang="en" {
            (head(&format!("aventail: {title}"), "", &policy_of_files()))
            body {
                header { p.brand { "aventail \u{b7} study of the model's stages" } h1 { (title) } }
                p.note {
                    "Every stage carries the same bone motion. J: volume of a cell after over before; folded cells count as J < 0, the other "
                    "figures are of positive cells; all tissue above -500 HU is counted, as in the thesis's Tab. 2. Residual: mean and standard deviation over "
                    "landmarks of the distance after over before. Published numbers in italics."
                }
                @for table in &plan.tables {
                    h2 { (table.title) @if !table.source.is_empty() { small { " " (table.source) } } }
                    table {
                        thead { tr { th { "Stage" } @for c in COLUMNS { th.n { (c) } } } }
                        tbody {
                            @for row in rows(table, records) {
                                @if row.published {
                                    tr { td { em { (row.name) } } @for v in &row.values { td.n { em { (v) } } } }
                                } @else {
                                    tr { td { b { (row.name) } } @for v in &row.values { td.n { (v) } } }
                                }
                            }
                        }
                    }
                    @for stage in &table.stages {
                        @if records.contains_key(&stage.id) && shown.insert(stage.id.as_str()) {
                            h3 { (stage.name) }
                            div.triple {
                                @for picture in SHOWN {
                                    a href={ "pictures/" (stage.id) "_" (picture) } {
                                        img loading="lazy" alt={ (stage.name) ", " (picture) } src={ "pictures/" (stage.id) "_" (picture) };
                                    }
                                }
                            }
                        }
                    }
                }
                footer { "aventail " (env!("CARGO_PKG_VERSION")) ". Research software, not a medical device." }
            }
        }
    }
    .into_string()
}
