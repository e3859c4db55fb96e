//! 3D Slicer's markups: `.mrk.json` (since 4.11) and `.fcsv` (before). Both say whether they are LPS or RAS.
//!
//! Source: Slicer's markups schema 1.0.3 and `vtkMRMLMarkupsFiducialStorageNode`.

use super::super::sheet::require_length;
use super::{File, PointContent, PointFile, Space, digits};
use crate::error::{Error, Result};
use nalgebra::Point3;
use serde_json::{Value, json};

/// Kinds of markups that are their control points and nothing else.
const POINTWISE: [&str; 5] = ["Fiducial", "Line", "Angle", "Curve", "ClosedCurve"];

/// What an empty list holds.
static EMPTY: Value = Value::Null;

/// A markups document.
pub(super) struct Markups {
    document: Value,
    /// List, control point and space of each position.
    places: Vec<(usize, usize, Space)>,
}

pub(super) fn read_markups(file: &File<'_>) -> Result<PointFile> {
    let document: Value = serde_json::from_str(file.text()?)
        .map_err(|e| Error::read(file.path, format!("it is no JSON ({e})"), "save the markups again in Slicer"))?;
    let lists = document["markups"]
        .as_array()
        .ok_or_else(|| Error::read(file.path, "it has no list `markups`", "save the markups again in Slicer"))?;
    let (mut names, mut points, mut places) = (Vec::new(), Vec::new(), Vec::new());
    for (m, list) in lists.iter().enumerate() {
        let kind = list["type"].as_str().unwrap_or("Fiducial");
        if !POINTWISE.contains(&kind) {
            let problem = format!("a markup of type {kind} is more than its control points");
            return Err(file.refuse(problem, format!("give point lists or curves: {}", POINTWISE.join(", "))));
        }
        // A unit by name, or by code, coding scheme and name.
        let unit = &list["coordinateUnits"];
        let name = unit.as_array().map_or(unit, |code| code.first().unwrap_or(&EMPTY));
        if !unit.is_null() && name.as_str() != Some("mm") {
            return Err(file.refuse(format!("its coordinateUnits are {unit}, not mm"), "save the markups in mm"));
        }
        let word = match &list["coordinateSystem"] {
            Value::String(word) => Some(word.clone()),
            Value::Null => None,
            other => Some(other.to_string()),
        };
        // The schema's default is LPS.
        let own = word.map_or(Ok(Space::Lps), |w| {
            Space::of(&w)
                .ok_or_else(|| file.refuse(format!("coordinateSystem {w:?} is neither LPS nor RAS"), "correct it"))
        })?;
        let space = file.space(Some(own))?;
        for (c, control) in list["controlPoints"].as_array().into_iter().flatten().enumerate() {
            if control["positionStatus"].as_str().is_some_and(|s| s == "undefined" || s == "missing") {
                continue;
            }
            let position = control["position"].as_array().map(Vec::as_slice).unwrap_or_default();
            let numbers: Option<Vec<f64>> = position.iter().map(Value::as_f64).collect();
            let Some(&[x, y, z]) = numbers.as_deref() else {
                let problem =
                    format!("control point {} has position {}, not three numbers", c + 1, control["position"]);
                return Err(file.refuse(problem, "save the markups again in Slicer"));
            };
            points.push(space.convert(Point3::new(x, y, z)));
            let name = control["label"].as_str().filter(|l| !l.is_empty());
            names.push(name.map_or_else(|| points.len().to_string(), str::to_owned));
            places.push((m, c, space));
        }
    }
    // Each list keeps its own space; positions reach `write` as LPS.
    Ok(PointFile { names, points, space: Space::Lps, content: PointContent::Markups(Markups { document, places }) })
}

impl Markups {
    pub(super) fn write(&self, points: &[Point3<f64>]) -> Result<Vec<u8>, String> {
        let mut document = self.document.clone();
        for (&(m, c, space), p) in self.places.iter().zip(points) {
            let p = space.convert(*p);
            document["markups"][m]["controlPoints"][c]["position"] = json!([p.x, p.y, p.z]);
        }
        serde_json::to_vec_pretty(&document).map_err(|e| e.to_string())
    }
}

/// An `.fcsv` file: its lines, with the positions cut out.
pub(super) struct Fiducials {
    lines: Vec<MarkupLine>,
    columns: [usize; 3],
}

enum MarkupLine {
    Comment(String),
    Point(Vec<String>),
}

pub(super) fn read_fiducials(file: &File<'_>) -> Result<PointFile> {
    let (mut own, mut columns, mut label, mut width) = (None, [1usize, 2, 3], Some(11), None);
    let (mut names, mut points, mut lines) = (Vec::new(), Vec::new(), Vec::new());
    for (n, text) in file.text()?.lines().enumerate() {
        if let Some(comment) = text.strip_prefix('#') {
            if let Some((key, value)) = comment.split_once('=') {
                match key.trim() {
                    "CoordinateSystem" => {
                        own = Some(Space::of(value).ok_or_else(|| {
                            let problem =
                                format!("line {}: CoordinateSystem {} is neither LPS nor RAS", n + 1, value.trim());
                            file.refuse(problem, "give 1 or LPS, or 0 or RAS")
                        })?);
                    }
                    "columns" => {
                        let listed: Vec<&str> = value.split(',').map(str::trim).collect();
                        let find = |name: &str| listed.iter().position(|l| *l == name);
                        let [x, y, z] = ["x", "y", "z"].map(|name| {
                            find(name)
                                .ok_or_else(|| file.refuse(format!("line {}: no column {name}", n + 1), "list x, y, z"))
                        });
                        (columns, label, width) = ([x?, y?, z?], find("label"), Some(listed.len()));
                    }
                    _ => {}
                }
            }
            lines.push(MarkupLine::Comment(text.into()));
        } else if text.trim().is_empty() {
            lines.push(MarkupLine::Comment(String::new()));
        } else {
            if let Some(width) = width {
                let cells =
                    cells_of(text).ok_or_else(|| file.refuse(format!("line {}: no CSV", n + 1), "correct it"))?;
                require_length(file.path, n as u64 + 1, cells, width)?;
            }
            let cells: Vec<String> = text.split(',').map(str::to_owned).collect();
            let [x, y, z] = columns.map(|c| file.number(cells.get(c).map(String::as_str), n + 1));
            points.push(Point3::new(x?, y?, z?));
            let name = label.and_then(|c| cells.get(c)).filter(|l| !l.is_empty());
            names.push(name.cloned().unwrap_or_else(|| points.len().to_string()));
            lines.push(MarkupLine::Point(cells));
        }
    }
    let space = file.space(own)?;
    let points = points.into_iter().map(|p| space.convert(p)).collect();
    Ok(PointFile { names, points, space, content: PointContent::Fiducials(Fiducials { lines, columns }) })
}

/// How many cells a line has; commas within quotation marks part none.
fn cells_of(line: &str) -> Option<usize> {
    let mut reader = csv::ReaderBuilder::new().has_headers(false).from_reader(line.as_bytes());
    reader.records().next()?.ok().map(|r| r.len())
}

impl Fiducials {
    pub(super) fn write(&self, points: &[Point3<f64>]) -> Result<Vec<u8>, String> {
        let mut points = points.iter();
        let mut out = String::new();
        for line in &self.lines {
            match line {
                MarkupLine::Comment(text) => out.push_str(text),
                MarkupLine::Point(cells) => {
                    let p = points.next().ok_or("a position is missing")?;
                    let cells = cells.iter().enumerate().map(|(n, cell)| {
                        self.columns.iter().position(|c| *c == n).map_or_else(|| cell.clone(), |a| digits(p[a]))
                    });
                    out.push_str(&cells.collect::<Vec<_>>().join(","));
                }
            }
            out.push('\n');
        }
        Ok(out.into_bytes())
    }
}
