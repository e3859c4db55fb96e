//! Landmarks known in both images, from CSV; those on bones name their bone too.

use super::sheet::{plain_cell, require_length};
use super::text::read_text;
use crate::error::{Error, Result};
use crate::evaluate::landmark::Landmark;
use crate::fit::BoneLandmark;
use csv::{ReaderBuilder, StringRecord, Trim};
use nalgebra::Point3;
use std::path::Path;

/// The columns that count, in any order and among others.
const COLUMNS: [&str; 7] = ["name", "planning_x", "planning_y", "planning_z", "fraction_x", "fraction_y", "fraction_z"];

/// Reads landmarks from a CSV file with the columns `name`, `planning_x`, ..., `fraction_z`, LPS mm.
///
/// Columns may come in any order and among others; blank lines and CRLF are fine, names may be quoted.
///
/// # Errors
/// [`Error::Read`] when the file cannot be read or is not CSV text; [`Error::Input`], naming the line, when a column is
/// missing or a value is no finite number, or when there is no landmark.
pub fn read_landmarks(path: impl AsRef<Path>) -> Result<Vec<Landmark>> {
    Ok(read(path.as_ref(), false)?.into_iter().map(|(_, landmark)| landmark).collect())
}

/// Reads landmarks on bones: as [`read_landmarks`], with a further column `bone`.
///
/// # Errors
/// As [`read_landmarks`]; a landmark without a bone is refused too.
pub fn read_bone_landmarks(path: impl AsRef<Path>) -> Result<Vec<BoneLandmark>> {
    let on_bone =
        |(bone, l): (String, Landmark)| BoneLandmark { bone, name: l.name, planning: l.planning, fraction: l.fraction };
    Ok(read(path.as_ref(), true)?.into_iter().map(on_bone).collect())
}

/// Each landmark with what its column `bone` says (empty unless `on_bones`).
fn read(path: &Path, on_bones: bool) -> Result<Vec<(String, Landmark)>> {
    let text = read_text(path)?;
    let bytes = text.as_bytes();
    let mut reader = ReaderBuilder::new().flexible(true).trim(Trim::All).from_reader(bytes);
    let unreadable = |e: csv::Error| {
        Error::read(path, format!("it is no CSV text ({e})"), "export it as comma-separated UTF-8 text")
    };
    let header = &reader.headers().map_err(unreadable)?.clone();
    let columns = COLUMNS.map(|name| column(path, header, name));
    let bone = on_bones.then(|| column(path, header, "bone")).transpose()?;
    let columns: Vec<usize> = columns.into_iter().collect::<Result<_>>()?;
    let mut landmarks = Vec::new();
    for record in reader.records() {
        let record = record.map_err(unreadable)?;
        if record.iter().all(str::is_empty) {
            continue;
        }
        let line = line(bytes, &record);
        require_length(path, line, record.len(), header.len())?;
        let bone = bone.map_or("", |b| record.get(b).unwrap_or_default());
        if on_bones && bone.is_empty() {
            return Err(Error::input(
                path.display().to_string(),
                format!("line {line}: the landmark names no bone"),
                "write the bone's name into the column bone, for example vertebrae_C5",
            ));
        }
        landmarks.push((bone.to_owned(), landmark(path, &columns, &record, line)?));
    }
    if landmarks.is_empty() {
        return Err(Error::input(
            path.display().to_string(),
            "it holds no landmark",
            "add a line per landmark, or leave the file out",
        ));
    }
    Ok(landmarks)
}

/// Position of a column.
fn column(path: &Path, header: &StringRecord, name: &str) -> Result<usize> {
    header.iter().position(|h| h.eq_ignore_ascii_case(name)).ok_or_else(|| {
        let cells = header.iter().collect::<Vec<_>>().join(",");
        let other = if cells.contains(';') { Some("semicolons") } else { cells.contains('\t').then_some("tabs") };
        let problem = match other.filter(|_| header.len() == 1) {
            Some(other) => format!(
                "line 1 has {other} and no commas: columns are separated by commas, decimals by points: {cells}"
            ),
            None => format!("line 1 names no column {name}: {cells}"),
        };
        let first = if name == "bone" { "bone," } else { "" };
        let remedy = format!("start the file with the line {first}{}", COLUMNS.join(","));
        Error::input(path.display().to_string(), problem, remedy)
    })
}

/// Line of a record. Its position is that of the blank lines before it.
fn line(bytes: &[u8], record: &StringRecord) -> u64 {
    record.position().map_or(0, |p| {
        let before = bytes.get(p.byte() as usize..).unwrap_or_default().iter().take_while(|b| b.is_ascii_whitespace());
        p.line() + before.filter(|b| **b == b'\n').count() as u64
    })
}

fn landmark(path: &Path, columns: &[usize], record: &StringRecord, line: u64) -> Result<Landmark> {
    let refuse = |problem: String| {
        Error::input(
            path.display().to_string(),
            format!("line {line}: {problem}"),
            "give LPS coordinates in mm with a decimal point",
        )
    };
    let name = plain_cell(record.get(columns[0]).unwrap_or_default());
    if name.is_empty() {
        return Err(refuse("the landmark has no name".into()));
    }
    let number = |column: usize| {
        let text = record.get(columns[column]).unwrap_or_default();
        let value = text.parse::<f64>().ok().filter(|v| v.is_finite());
        value.ok_or_else(|| refuse(format!("{} = {text:?} is no finite number", COLUMNS[column])))
    };
    Ok(Landmark {
        name: name.to_owned(),
        planning: Point3::new(number(1)?, number(2)?, number(3)?),
        fraction: Point3::new(number(4)?, number(5)?, number(6)?),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str) -> Result<Vec<Landmark>> {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("marks.csv");
        std::fs::write(&path, text).unwrap();
        read_landmarks(&path)
    }

    #[test]
    fn any_order_extra_columns_blank_lines_crlf_and_quotes() {
        let text = "\u{feff}note, fraction_z,fraction_y,fraction_x,Planning_X,planning_y,planning_z,name\r\n\
            seen, 6,5,4,1,2,-3.5e0,\"C2, tip \"\"dens\"\"\"\r\n\r\n,,,,,,,\r\n,9,8,7,1,1,1,chin\r\n";
        let marks = read(text).unwrap();
        assert_eq!(marks.len(), 2);
        assert_eq!(marks[0].name, "C2, tip \"dens\"");
        assert_eq!(marks[0].planning, Point3::new(1.0, 2.0, -3.5));
        assert_eq!(marks[0].fraction, Point3::new(4.0, 5.0, 6.0));
        assert_eq!(marks[1].fraction, Point3::new(7.0, 8.0, 9.0));
    }

    #[test]
    fn landmarks_on_bones_name_their_bone() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("marks.csv");
        let head = "bone,name,planning_x,planning_y,planning_z,fraction_x,fraction_y,fraction_z\n";
        let read = |rows: &str| {
            std::fs::write(&path, format!("{head}{rows}")).unwrap();
            read_bone_landmarks(&path)
        };
        let marks = read("skull,nasion,1,2,3,4,5,6\n").unwrap();
        assert_eq!((marks[0].bone.as_str(), marks[0].fraction), ("skull", Point3::new(4.0, 5.0, 6.0)));
        assert!(read(",nasion,1,2,3,4,5,6\n").unwrap_err().to_string().contains("line 2: the landmark names no bone"));
        std::fs::write(&path, "name,planning_x\n").unwrap();
        assert!(read_bone_landmarks(&path).unwrap_err().to_string().contains("no column"));
    }

    #[test]
    fn errors_name_the_line() {
        let head = "name,planning_x,planning_y,planning_z,fraction_x,fraction_y,fraction_z\n";
        let bad = [
            ("a,1,2,3,4,5,6\n\nb,1,2,x,4,5,6\n", "line 4: planning_z = \"x\""),
            ("a,1,2,3,4,5\n", "line 2 has 6 cells, the first line 7"),
            ("a,1,2,3,4,5,6,7\n", "line 2 has 8 cells"),
            ("a,1,2,3,4,5,\n", "line 2: fraction_z = \"\""),
            ("a,1,2,3,4,5,inf\n", "line 2: fraction_z = \"inf\""),
            (",1,2,3,4,5,6\n", "line 2: the landmark has no name"),
            ("", "no landmark"),
        ];
        for (rows, expected) in bad {
            let text = read(&format!("{head}{rows}")).unwrap_err().to_string();
            assert!(text.contains(expected) && text.contains("marks.csv"), "{text}");
        }
        let contours = format!("{{\"contours\":[{}0]}}", "1,2,".repeat(9999));
        let text = read(&contours).unwrap_err().to_string();
        assert!(text.contains("no column name") && text.len() < 1500, "{text}");
        for between in [";", "\t"] {
            let text = format!("{head}a;1,5;2;3;4;5;6\n").replace(',', between);
            let text = read(&text).unwrap_err().to_string();
            assert!(text.contains("no commas: columns are separated by commas, decimals by points"), "{text}");
        }
        let text = read("name,x,y,z\na,1,2,3\n").unwrap_err().to_string();
        assert!(text.contains("no column planning_x"), "{text}");
    }
}
