//! Points as CSV, LPS mm: columns `x`, `y`, `z` and whatever else; or landmarks with `FRAME_x`, `FRAME_y`, `FRAME_z`.

use super::super::sheet::{Sheet, plain_cell, require_length};
use super::{File, PointContent, PointFile, Space, digits};
use crate::error::{Error, Result};
use csv::{ReaderBuilder, StringRecord, Trim};
use nalgebra::Point3;

/// A CSV table without its positions.
pub(super) struct Table {
    header: StringRecord,
    records: Vec<StringRecord>,
    /// Columns of x, y, z; `None` for landmarks, of which only name and position are written.
    columns: Option<[usize; 3]>,
}

pub(super) fn read(file: &File<'_>, frame: &str) -> Result<PointFile> {
    let unreadable = |e: csv::Error| {
        Error::read(file.path, format!("it is no CSV text ({e})"), "export it as comma-separated UTF-8 text")
    };
    let mut reader = ReaderBuilder::new().flexible(true).trim(Trim::All).from_reader(file.text()?.as_bytes());
    let header = reader.headers().map_err(unreadable)?.clone();
    let find = |name: &str| header.iter().position(|h| h.eq_ignore_ascii_case(name));
    let three =
        |prefix: &str| Some([find(&format!("{prefix}x"))?, find(&format!("{prefix}y"))?, find(&format!("{prefix}z"))?]);
    let own = three("");
    let columns = own.or_else(|| three(&format!("{frame}_"))).ok_or_else(|| {
        let shown = header.iter().collect::<Vec<_>>().join(",");
        file.refuse(
            format!("line 1 names no columns x, y, z and no {frame}_x, {frame}_y, {frame}_z: {shown}"),
            "start the file with the line name,x,y,z (LPS mm)",
        )
    })?;
    let name = find("name").or_else(|| find("label"));
    let (mut names, mut points, mut records) = (Vec::new(), Vec::new(), Vec::new());
    for record in reader.records() {
        let record = record.map_err(unreadable)?;
        if record.iter().all(str::is_empty) {
            continue;
        }
        let line = record.position().map_or(0, |p| p.line() as usize);
        require_length(file.path, line as u64, record.len(), header.len())?;
        let [x, y, z] = columns.map(|c| file.number(record.get(c), line));
        points.push(Point3::new(x?, y?, z?));
        let given = name.and_then(|c| record.get(c)).filter(|n| !n.is_empty());
        names.push(given.map_or_else(|| points.len().to_string(), |n| plain_cell(n).to_owned()));
        records.push(record);
    }
    let space = file.space(Some(Space::Lps))?;
    Ok(PointFile { names, points, space, content: PointContent::Table(Table { header, records, columns: own }) })
}

impl Table {
    pub(super) fn write(&self, names: &[String], points: &[Point3<f64>]) -> Result<Vec<u8>, String> {
        let mut out = Sheet::default();
        let failed = |e: std::io::Error| e.to_string();
        match self.columns {
            Some(columns) => {
                out.write_record(&self.header).map_err(failed)?;
                for (record, point) in self.records.iter().zip(points) {
                    let cells = record.iter().enumerate().map(|(n, cell)| match columns.iter().position(|c| *c == n) {
                        Some(axis) => digits(point[axis]),
                        None => plain_cell(cell).to_owned(),
                    });
                    out.write_record(cells).map_err(failed)?;
                }
            }
            None => {
                out.write_record(["name", "x", "y", "z"]).map_err(failed)?;
                for (name, p) in names.iter().zip(points) {
                    out.write_record([name.clone(), digits(p.x), digits(p.y), digits(p.z)]).map_err(failed)?;
                }
            }
        }
        out.into_bytes().map_err(|e| e.to_string())
    }
}
