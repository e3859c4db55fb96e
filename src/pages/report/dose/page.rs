//! The pages of `dose`: pictures, tables, warnings, and where a person signs.

use super::super::html::paper::more;
use super::super::html::verdict::{identity, review};
use super::super::html::{data_url, head, inputs, warnings};
use super::super::viewer::policy;
use crate::error::Result;
use crate::io::write_file;
use crate::provenance::InputFile;
use crate::warning::Warning;
use maud::{DOCTYPE, Markup, html};
use std::path::Path;

/// Inputs in the head, tables, and lines of all tables together that are printed.
const INPUTS_ON_PAPER: usize = 6;
const TABLES_ON_PAPER: usize = 6;
const LINES_ON_PAPER: usize = 72;

/// What a cell says of a limit; each has its colour.
pub const KEPT: &str = "kept";
/// The limit lies within the figure's interval.
pub const UNDECIDED: &str = "undecided";
/// It is not kept.
pub const BROKEN: &str = "not kept";

/// A picture of a page.
#[derive(Debug, Clone)]
pub struct DosePicture {
    /// Its heading.
    pub title: String,
    /// What it shows and how to read it.
    pub caption: String,
    /// The PNG file.
    pub png: Vec<u8>,
}

/// A table of a page: the first cell of each line is text, the others are numbers.
#[derive(Debug, Clone)]
pub struct DoseTable {
    /// Its heading.
    pub title: String,
    /// What is to be known of it.
    pub note: String,
    /// Heads of the columns.
    pub head: Vec<String>,
    /// Lines of as many cells.
    pub rows: Vec<Vec<String>>,
}

/// What a page of `dose` tells.
#[derive(Debug, Clone)]
pub struct DosePage<'a> {
    /// What was done, for example `dose compared`.
    pub title: String,
    /// The command line.
    pub command: String,
    /// Files that were read.
    pub inputs: &'a [InputFile],
    /// What the user should know.
    pub warnings: &'a [Warning],
    /// Pictures, two in a row.
    pub pictures: Vec<DosePicture>,
    /// Tables.
    pub tables: Vec<DoseTable>,
}

impl DosePage<'_> {
    /// Writes the page; everything it needs is inside.
    ///
    /// # Errors
    /// [`crate::Error::Write`] when the file cannot be written.
    pub fn write(&self, path: &Path) -> Result<()> {
        let page = self.page();
        write_file(path, |out| out.write_all(page.as_bytes()))
    }

    fn page(&self) -> String {
        html! {
            (DOCTYPE)
            html lang="en" {
                (head(&format!("aventail dose: {}", self.title), "", &policy(false)))
                body {
                    div.sheet {
                        header {
                            p.brand { "aventail \u{b7} dose" }
                            h1 { span.clip { (self.title) } }
                            dl.case {
                                @for (n, input) in self.inputs.iter().enumerate() {
                                    div.screen[n >= INPUTS_ON_PAPER] { dt { (input.role) } dd { (identity(input)) } }
                                }
                            }
                        }
                        (review())
                        (warnings(self.warnings, "the JSON file beside this page"))
                        div.fill {
                            div.large.pair[self.pictures.len() > 1].gallery[self.pictures.len() > 2] {
                                @for p in &self.pictures {
                                    figure { h3 { (p.title) } img alt=(p.title) src=(data_url(&p.png)); figcaption { (p.caption) } }
                                }
                            }
                        }
                    }
                    @for (n, table) in self.tables.iter().enumerate() {
                        div.screen[n >= TABLES_ON_PAPER] { (self.table(table)) }
                    }
                    (more(self.tables.len(), TABLES_ON_PAPER, ["table", "tables"], "the CSV file beside this page"))
                    div.end {
                        h2 { "Provenance" }
                        (inputs(self.inputs, "the JSON file beside this page"))
                        pre { span.clip { (self.command) } }
                        section.limits {
                            p {
                                "TG-132 gives no tolerance for carrying dose: a mapped dose is as good as the field, and in a steep dose a "
                                "millimetre of error is a large difference. Research software, not a medical device."
                            }
                        }
                        footer { "aventail " (env!("CARGO_PKG_VERSION")) ". Doses in Gy, positions in LPS mm." }
                    }
                }
            }
        }
        .into_string()
    }

    fn table(&self, table: &DoseTable) -> Markup {
        let most = LINES_ON_PAPER / self.tables.len().clamp(1, TABLES_ON_PAPER);
        let class = |n: usize| (n > 0).then_some("n");
        let class_of = |n: usize, cell: &str| match cell {
            KEPT => Some("n pass"),
            UNDECIDED => Some("n review"),
            BROKEN => Some("n fail"),
            _ => class(n),
        };
        html! {
            h2 { (table.title) }
            @if !table.note.is_empty() { p.note { (table.note) } }
            table {
                thead { tr { @for (n, cell) in table.head.iter().enumerate() { th class=[class(n)] { (cell) } } } }
                tbody {
                    @for (line, row) in table.rows.iter().enumerate() {
                        tr.screen[line >= most] {
                            @for (n, cell) in row.iter().enumerate() { td class=[class_of(n, cell)] { @if n == 0 { span.short { (cell) } } @else { (cell) } } }
                        }
                    }
                }
            }
            (more(table.rows.len(), most, ["line", "lines"], "the CSV file beside this page"))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::findings;

    #[test]
    fn names_are_escaped_and_nothing_is_fetched() {
        let warnings = [Warning::new(findings::DOSE_OUTSIDE, "<script>alert(1)</script>")];
        let row = vec!["<b>cord".to_owned(), "1.0".into()];
        let table = DoseTable { title: "Doses".into(), note: String::new(), head: row.clone(), rows: vec![row] };
        let page = DosePage {
            title: "a & b".into(),
            command: "aventail dose".into(),
            inputs: &[],
            warnings: &warnings,
            pictures: vec![DosePicture { title: "isodoses".into(), caption: "<i>".into(), png: vec![1, 2, 3] }],
            tables: vec![table],
        };
        let text = page.page();
        for outside in ["<script", "<b>cord", "<i>", "http:", "https:"] {
            assert!(!text.contains(outside), "{outside}");
        }
        assert!(
            text.contains("&lt;b&gt;cord") && text.contains("default-src 'none'") && text.contains("class=\"sign\"")
        );
    }
}
