//! elastix's and transformix's input points: `point`, their number, then one position per line, LPS mm.

use super::{File, PointContent, PointFile, Space};
use crate::error::{Error, Result};
use nalgebra::Point3;
use std::fmt::Write as _;

pub(super) fn read(file: &File<'_>) -> Result<PointFile> {
    let mut words = file.text()?.split_whitespace();
    match words.next() {
        Some("point") => {}
        Some("index") => {
            return Err(
                file.refuse("its points are voxel indices", "give world coordinates: a file that begins with `point`")
            );
        }
        other => {
            let problem =
                format!("it begins with {:?}, not with `point`, as transformix's points do", other.unwrap_or(""));
            return Err(Error::read(
                file.path,
                problem,
                "give `point`, the number of points, and x y z (LPS mm) per line",
            ));
        }
    }
    let count = words.next().and_then(|w| w.parse::<usize>().ok());
    let numbers = words.map(|w| w.parse::<f64>().ok()).collect::<Option<Vec<f64>>>();
    let (count, numbers) = match (count, numbers) {
        (Some(count), Some(numbers)) if count.checked_mul(3) == Some(numbers.len()) => (count, numbers),
        (count, numbers) => {
            let problem =
                format!("line 2 promises {count:?} points, but {:?} numbers follow", numbers.map(|n| n.len()));
            return Err(Error::read(file.path, problem, "give three numbers per point"));
        }
    };
    let points = numbers.as_chunks::<3>().0.iter().map(|&p| Point3::from(p)).collect();
    let names = (1..=count).map(|n| n.to_string()).collect();
    Ok(PointFile { names, points, space: file.space(Some(Space::Lps))?, content: PointContent::Elastix })
}

pub(super) fn write(points: &[Point3<f64>]) -> Result<Vec<u8>, String> {
    let mut out = format!("point\n{}\n", points.len());
    for p in points {
        writeln!(out, "{:.7} {:.7} {:.7}", p.x, p.y, p.z).map_err(|e| e.to_string())?;
    }
    Ok(out.into_bytes())
}
