//! Mass density by CT number, from CSV.

use super::sheet::require_length;
use super::text::read_text;
use crate::dose::DensityTable;
use crate::error::{Error, Result};
use csv::{ReaderBuilder, Trim};
use std::path::Path;

/// Reads a density table: CSV with HU and g/cm^3 in the first two columns, a heading line if the first field is no number.
///
/// # Errors
/// [`Error::Read`] when the file cannot be read, [`Error::Input`] when a line holds no two numbers or the table is none.
pub fn read_density(path: impl AsRef<Path>) -> Result<DensityTable> {
    let path = path.as_ref();
    let text = read_text(path)?;
    let refuse = |problem: String| {
        Error::input(path.display().to_string(), problem, "give lines of HU and g/cm^3, for example -1000,0.0012")
    };
    let mut points = Vec::new();
    let mut reader =
        ReaderBuilder::new().has_headers(false).flexible(true).trim(Trim::All).from_reader(text.as_bytes());
    let mut cells = None;
    for (n, record) in reader.records().enumerate() {
        let record = record.map_err(|e| refuse(format!("line {}: {e}", n + 1)))?;
        require_length(path, n as u64 + 1, record.len(), *cells.get_or_insert(record.len()))?;
        let number = |column: usize| record.get(column).and_then(|t| t.parse::<f64>().ok());
        match (number(0), number(1)) {
            (Some(hu), Some(density)) => points.push([hu, density]),
            (None, _) if n == 0 => {}
            _ => return Err(refuse(format!("line {} holds no two numbers", n + 1))),
        }
    }
    DensityTable::new(points).map_err(|e| refuse(e.to_string()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn headings_are_skipped_and_bad_lines_named() {
        let dir = tempfile::tempdir().unwrap();
        let read = |text: &str| {
            let path = dir.path().join("density.csv");
            std::fs::write(&path, text).unwrap();
            read_density(&path)
        };
        let table = read("HU,density\n-1000, 0.001\n0,1\n").unwrap();
        assert!((table.density(-500.0) - 0.5005).abs() < 1e-9);
        assert!(read("0,1\nx,2\n").unwrap_err().to_string().contains("line 2"));
        assert!(read("0,1\n1,0,2\n").unwrap_err().to_string().contains("line 2 has 3 cells"));
        assert!((read("\u{feff}-1000,0.001\n0,1\n").unwrap().density(-500.0) - 0.5005).abs() < 1e-9);
        assert!(read("0,1\n").unwrap_err().to_string().contains("1 points"));
    }
}
