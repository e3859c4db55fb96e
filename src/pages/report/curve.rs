//! Error against run time as a picture, a table and numbers.

use super::canvas::Canvas;
use super::plot;
use crate::concepts::{Curves, Series};
use crate::error::{Error, Result};
use crate::io::{Sheet, write_file};
use crate::pipeline::CurvePoint;
use std::fmt::Write as _;
use std::path::Path;

/// One setting of a series.
#[derive(Debug, Clone, PartialEq)]
pub struct CurveEntry {
    /// What is varied; entries of one series are joined by a line.
    pub series: String,
    /// The setting.
    pub name: String,
    /// Whether it is the default.
    pub default: bool,
    /// How it did.
    pub point: CurvePoint,
}

/// Another tool on the same case.
#[derive(Debug, Clone, PartialEq)]
pub struct Peer {
    /// Its name.
    pub name: String,
    /// Wall time, s.
    pub seconds: f64,
    /// Mean error, mm.
    pub error_mm: f64,
}

/// Writes `curve.png`, `curve.csv` and `curve.md` into `folder`, which exists; returns the table.
///
/// # Errors
/// [`Error::Write`] when a file cannot be written.
pub fn write_curve(folder: &Path, title: &str, entries: &[CurveEntry], peers: &[Peer]) -> Result<String> {
    let mut png = Vec::new();
    picture(entries, peers).write_small_png(&mut png).map_err(|e| Error::Internal(format!("curve.png: {e}")))?;
    write_file(folder.join("curve.png"), |out| out.write_all(&png))?;
    write_file(folder.join("curve.csv"), |out| out.write_all(&numbers(entries, peers)?))?;
    let text = table(title, entries, peers);
    write_file(folder.join("curve.md"), |out| out.write_all(text.as_bytes()))?;
    Ok(text)
}

/// Error over time.
fn picture(entries: &[CurveEntry], peers: &[Peer]) -> Canvas {
    let series = series(entries, peers);
    let curves = Curves { x: "run time, s".into(), y: "mean error, mm".into(), series };
    plot::draw(&curves, 900, 620)
}

/// Lines over the time, a mark for the default and one for every peer.
fn series(entries: &[CurveEntry], peers: &[Peer]) -> Vec<Series> {
    let mut series: Vec<Series> = Vec::new();
    for e in entries {
        let at = [e.point.seconds, e.point.error_mm.mean];
        match series.iter_mut().find(|s| s.name == e.series) {
            Some(s) => s.points.push(at),
            None => {
                let colour = series.len() % plot::STANDS_OUT;
                series.push(Series { name: e.series.clone(), colour, points: vec![at], marks: true });
            }
        }
    }
    for s in &mut series {
        s.points.sort_by(|a, b| a[0].total_cmp(&b[0]));
    }
    if let Some(e) = entries.iter().find(|e| e.default) {
        let points = vec![[e.point.seconds, e.point.error_mm.mean]];
        series.push(Series { name: "default".into(), colour: plot::STANDS_OUT, points, marks: true });
    }
    for p in peers {
        let points = vec![[p.seconds, p.error_mm]];
        let colour = series.len() % plot::STANDS_OUT;
        series.push(Series { name: p.name.clone(), colour, points, marks: true });
    }
    series
}

fn numbers(entries: &[CurveEntry], peers: &[Peer]) -> std::io::Result<Vec<u8>> {
    let mut out = Sheet::default();
    out.write_record(["series", "setting", "default", "seconds", "processor_seconds", "mean_mm", "p95_mm", "folded"])?;
    for e in entries {
        let p = &e.point;
        out.write_record([
            e.series.clone(),
            e.name.clone(),
            e.default.to_string(),
            format!("{:.3}", p.seconds),
            p.processor_seconds.map_or(String::new(), |s| format!("{s:.2}")),
            format!("{:.4}", p.error_mm.mean),
            format!("{:.4}", p.error_mm.p95),
            p.folded.to_string(),
        ])?;
    }
    for p in peers {
        let (seconds, error) = (p.seconds.to_string(), p.error_mm.to_string());
        out.write_record(["peer", &p.name, "false", &seconds, "", &error, "", ""])?;
    }
    out.into_bytes()
}

fn table(title: &str, entries: &[CurveEntry], peers: &[Peer]) -> String {
    let mut text = format!(
        "# Error against run time: {title}\n\n\
         | varied | setting | s | processor s | mean mm | 95th percentile mm | folded |\n|---|---|---|---|---|---|---|\n"
    );
    let mut line = |cells: [String; 7]| {
        writeln!(text, "| {} |", cells.join(" | ")).expect("writing to a String cannot fail");
    };
    for e in entries {
        let p = &e.point;
        line([
            e.series.clone(),
            if e.default { format!("**{}** (default)", e.name) } else { e.name.clone() },
            format!("{:.1}", p.seconds),
            p.processor_seconds.map_or(String::new(), |s| format!("{s:.1}")),
            format!("{:.3}", p.error_mm.mean),
            format!("{:.2}", p.error_mm.p95),
            p.folded.to_string(),
        ]);
    }
    for p in peers {
        let none = String::new;
        let (seconds, error) = (format!("{:.1}", p.seconds), format!("{:.3}", p.error_mm));
        line(["peer".into(), p.name.clone(), seconds, none(), error, none(), none()]);
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::stats::Summary;

    fn entry(series: &str, name: &str, seconds: f64, mean: f64) -> CurveEntry {
        let error_mm = Summary { n: 10, mean, p95: 2.0 * mean, ..Summary::default() };
        let point = CurvePoint { seconds, processor_seconds: None, error_mm, folded: 3, stages: Vec::new() };
        CurveEntry { series: series.into(), name: name.into(), default: name == "3 mm", point }
    }

    #[test]
    fn all_files_hold_every_point() {
        let folder = tempfile::tempdir().unwrap();
        let entries = [entry("spacing", "6 mm", 8.0, 0.4), entry("spacing", "3 mm", 16.0, 0.3)];
        let peers = [Peer { name: "elastix".into(), seconds: 120.0, error_mm: 1.5 }];
        let text = write_curve(folder.path(), "a case", &entries, &peers).unwrap();
        let csv = std::fs::read_to_string(folder.path().join("curve.csv")).unwrap();
        assert_eq!(csv.lines().count(), 4);
        assert!(
            csv.contains("spacing,3 mm,true,16.000,,0.3000,0.6000,3") && csv.contains("peer,elastix,false,120,,1.5,,")
        );
        assert!(
            text.contains("| spacing | **3 mm** (default) | 16.0 |  | 0.300 | 0.60 | 3 |") && text.contains("elastix")
        );
        assert!(std::fs::metadata(folder.path().join("curve.png")).unwrap().len() > 1000);
    }

    #[test]
    fn no_two_lines_of_the_built_in_plan_look_alike() {
        // With the line for threads, and the default.
        let plan = crate::config::StudyPlan::curve().unwrap();
        let titles = plan.tables.iter().map(|t| t.title.as_str()).chain(["threads"]);
        let entries: Vec<_> =
            titles.zip(["3 mm", "6 mm"].into_iter().cycle()).map(|(t, n)| entry(t, n, 1.0, 1.0)).collect();
        let series = series(&entries, &[]);
        let colours: std::collections::BTreeSet<usize> = series.iter().map(|s| s.colour).collect();
        assert!(series.len() == entries.len() + 1 && colours.len() == series.len(), "{colours:?}");
        assert!(colours.iter().all(|c| *c <= plot::STANDS_OUT));
    }
}
