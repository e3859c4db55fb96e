//! `landmarks.csv`: the residual of each landmark.

use crate::error::Result;
use crate::evaluate::landmark::{LandmarkReport, LandmarkResidual};
use crate::io::{Sheet, write_file};
use nalgebra::Point3;
use std::path::Path;

const HEADER: [&str; 13] = [
    "name",
    "planning_x",
    "planning_y",
    "planning_z",
    "fraction_x",
    "fraction_y",
    "fraction_z",
    "mapped_x",
    "mapped_y",
    "mapped_z",
    "before_mm",
    "after_mm",
    "after_over_before",
];

/// Writes one line per landmark, LPS mm; what is unknown (outside the planning grid) stays empty.
///
/// # Errors
/// [`crate::error::Error::Write`] when the file cannot be written.
pub fn write_landmarks(path: &Path, report: &LandmarkReport) -> Result<()> {
    write_file(path, |out| {
        let mut table = Sheet::default();
        table.write_record(HEADER)?;
        report.each.iter().try_for_each(|r| table.write_record(cells(r)))?;
        out.write_all(&table.into_bytes()?)
    })
}

fn cells(r: &LandmarkResidual) -> [String; 13] {
    let number = |v: f64| format!("{v:.4}");
    let known = |v: Option<f64>| v.map_or(String::new(), number);
    let point = |p: Option<&Point3<f64>>| [0, 1, 2].map(|a| known(p.map(|p| p[a])));
    let [px, py, pz] = point(Some(&r.landmark.planning));
    let [fx, fy, fz] = point(Some(&r.landmark.fraction));
    let [mx, my, mz] = point(r.mapped.as_ref());
    let ratio = r.after.filter(|_| r.before > 0.0).map(|a| a / r.before);
    let name = r.landmark.name.clone();
    [name, px, py, pz, fx, fy, fz, mx, my, mz, number(r.before), known(r.after), known(ratio)]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::evaluate::landmark::Landmark;

    #[test]
    fn lines_by_hand() {
        let landmark = Landmark {
            name: "node, \"left\"".into(),
            planning: Point3::new(1.0, 2.0, 3.0),
            fraction: Point3::new(1.0, 2.0, 7.0),
        };
        let inside =
            LandmarkResidual { landmark, mapped: Some(Point3::new(1.0, 2.0, 6.0)), before: 4.0, after: Some(1.0) };
        assert_eq!(
            cells(&inside).join(";"),
            "node, \"left\";1.0000;2.0000;3.0000;1.0000;2.0000;7.0000;1.0000;2.0000;6.0000;4.0000;1.0000;0.2500"
        );
        let outside = LandmarkResidual { mapped: None, after: None, ..inside };
        assert!(cells(&outside).join(",").ends_with(",,,,4.0000,,"));
    }
}
