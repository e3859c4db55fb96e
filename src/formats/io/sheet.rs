//! CSV tables that are safe to open: a text that a spreadsheet would run as a formula is written with an apostrophe before it.

use crate::error::{Error, Result};
use crate::findings;
use csv::Writer;
use std::borrow::Cow;
use std::io;
use std::path::Path;

/// Starts of cells that spreadsheets take for formulas or that hide one.
const STARTS: [char; 6] = ['=', '+', '-', '@', '\t', '\r'];

/// A CSV table on its way into a file. Every table of the program is written through it.
pub struct Sheet(Writer<Vec<u8>>);

impl Default for Sheet {
    fn default() -> Self {
        // Rows may differ in length where a table that was read is written back.
        Self(csv::WriterBuilder::new().flexible(true).from_writer(Vec::new()))
    }
}

impl Sheet {
    /// Adds a row. Numbers stay as they are, other texts that look like formulas get an apostrophe.
    ///
    /// # Errors
    /// None that can happen: the table is in memory.
    pub fn write_record<T: AsRef<str>>(&mut self, cells: impl IntoIterator<Item = T>) -> io::Result<()> {
        for cell in cells {
            self.0.write_field(defused(cell.as_ref()).as_bytes())?;
        }
        Ok(self.0.write_record(None::<&[u8]>)?)
    }

    /// The table as bytes.
    ///
    /// # Errors
    /// As [`Sheet::write_record`].
    pub fn into_bytes(self) -> io::Result<Vec<u8>> {
        self.0.into_inner().map_err(csv::IntoInnerError::into_error)
    }
}

/// A cell that no spreadsheet runs.
fn defused(cell: &str) -> Cow<'_, str> {
    if cell.starts_with(STARTS) && cell.parse::<f64>().is_err() { format!("'{cell}").into() } else { cell.into() }
}

/// Refuses a row that has another number of cells than the header: its values may belong to other columns.
pub(super) fn require_length(path: &Path, line: u64, cells: usize, expected: usize) -> Result<()> {
    if cells == expected {
        return Ok(());
    }
    Err(Error::refused(
        findings::ROW_LENGTH,
        path.display().to_string(),
        format!("line {line} has {cells} cells, the first line {expected}"),
        "give every line as many cells, with quotation marks around texts that hold commas; decimals need a point",
    ))
}

/// A cell as it was before [`Sheet::write_record`] put an apostrophe before it.
pub fn plain_cell(cell: &str) -> &str {
    cell.strip_prefix('\'').filter(|rest| rest.starts_with(STARTS)).unwrap_or(cell)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn formulas_are_defused_and_numbers_are_not() {
        let mut sheet = Sheet::default();
        let row = ["=HYPERLINK(\"x\")", "+1", "-2.5e3", "-inf", "@sum", "\tx", "\rx", "-a", "plain", "", "it's"];
        sheet.write_record(row).unwrap();
        sheet.write_record(["one"]).unwrap();
        let text = String::from_utf8(sheet.into_bytes().unwrap()).unwrap();
        let first = text.split_once("\none").unwrap().0;
        assert_eq!(first, "\"'=HYPERLINK(\"\"x\"\")\",+1,-2.5e3,-inf,'@sum,'\tx,\"'\rx\",'-a,plain,,it's");
        assert!(row.iter().all(|cell| plain_cell(&defused(cell)) == *cell));
    }
}
