//! `landmarks.csv`: the residual of each landmark.

use crate::error::Result;
use crate::evaluate::landmark::{LandmarkReport, LandmarkResidual};
use crate::io::write_file;
use nalgebra::Point3;
use std::borrow::Cow;
use std::path::Path;

const HEADER: &str = "name,planning_x,planning_y,planning_z,fraction_x,fraction_y,fraction_z,mapped_x,mapped_y,mapped_z,\
                      before_mm,after_mm,after_over_before";

/// Writes one line per landmark, LPS mm; what is unknown (outside the planning grid) stays empty.
///
/// # Errors
/// [`crate::error::Error::Write`] when the file cannot be written.
pub fn write_landmarks(path: &Path, report: &LandmarkReport) -> Result<()> {
    write_file(path, |out| {
        writeln!(out, "{HEADER}")?;
        report.each.iter().try_for_each(|r| writeln!(out, "{}", line(r)))
    })
}

fn line(r: &LandmarkResidual) -> String {
    let known = |v: Option<f64>| v.map_or(String::new(), |v| format!("{v:.4}"));
    let point = |p: &Point3<f64>| format!("{:.4},{:.4},{:.4}", p.x, p.y, p.z);
    let mapped = r.mapped.as_ref().map_or(",,".to_owned(), point);
    let ratio = r.after.filter(|_| r.before > 0.0).map(|a| a / r.before);
    let name = quoted(&r.landmark.name);
    let (planning, fraction) = (point(&r.landmark.planning), point(&r.landmark.fraction));
    format!("{name},{planning},{fraction},{mapped},{:.4},{},{}", r.before, known(r.after), known(ratio))
}

/// A field as RFC 4180 wants it.
fn quoted(field: &str) -> Cow<'_, str> {
    if field.contains([',', '"', '\n', '\r']) {
        format!("\"{}\"", field.replace('"', "\"\"")).into()
    } else {
        field.into()
    }
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
            line(&inside),
            "\"node, \"\"left\"\"\",1.0000,2.0000,3.0000,1.0000,2.0000,7.0000,1.0000,2.0000,6.0000,4.0000,1.0000,0.2500"
        );
        let outside = LandmarkResidual { mapped: None, after: None, ..inside };
        assert!(line(&outside).ends_with(",,,,4.0000,,"));
        assert_eq!(line(&outside).matches(',').count() - 1, HEADER.matches(',').count());
    }
}
