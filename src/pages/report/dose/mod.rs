//! Dose-volume histograms as CSV, picture, page and text; pages of doses.

mod intervals;
mod isodose;
mod page;

pub use intervals::{LimitDecision, SampledDose};
pub use isodose::{Levels, differences, isodoses};
pub use page::{DosePage, DosePicture, DoseTable};

use super::canvas::{Canvas, Rgb};
use super::chart::{Band, COLOURS, Curve, chart, chart_with_bands};
use super::colour::shaded;
use crate::dose::{Dvh, DvhBand};
use crate::error::{Error, Result};
use crate::io::{write_file, write_json};
use crate::warning::Warning;
use std::fmt::Write as _;
use std::path::Path;

/// Dose-volume histograms of one dose.
#[derive(Debug, Clone, PartialEq, serde::Serialize)]
pub struct DoseDvh {
    /// What the dose is called, for example its file's name.
    pub name: String,
    /// Each structure.
    pub structures: Vec<Dvh>,
    /// Intervals, where samples of a registration carried the structures to the dose.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub samples: Option<SampledDose>,
    /// What is worth knowing of the dose and of where the structures lie in it.
    pub warnings: Vec<Warning>,
}

/// Writes `dvh.csv` (cumulative curves), `dvh_figures.csv`, `dvh.png` and `dvh.json` into a folder that exists, and
/// `dvh_intervals.csv` where samples tell intervals; returns the picture. `colours`: those of the structures, in their order, where they have their own.
///
/// # Errors
/// [`Error::Write`] when a file cannot be written.
pub fn write_dvh(folder: &Path, doses: &[DoseDvh], colours: &[Option<[u8; 3]>]) -> Result<DosePicture> {
    let internal = |e: csv::Error| Error::Internal(format!("dose-volume histogram as CSV: {e}"));
    let curves = curves(doses).map_err(internal)?;
    write_file(folder.join("dvh.csv"), |out| out.write_all(&curves))?;
    let figures = figures(doses).map_err(internal)?;
    write_file(folder.join("dvh_figures.csv"), |out| out.write_all(&figures))?;
    if doses.iter().any(|dose| dose.samples.is_some()) {
        let intervals = intervals(doses).map_err(internal)?;
        write_file(folder.join("dvh_intervals.csv"), |out| out.write_all(&intervals))?;
    }
    write_json(folder.join("dvh.json"), doses)?;
    let picture = match doses {
        [DoseDvh { samples: Some(samples), .. }] => banded_picture(&doses[0], &samples.structures, colours)?,
        doses => dvh_picture(doses, colours)?,
    };
    write_file(folder.join("dvh.png"), |out| out.write_all(&picture.png))?;
    Ok(picture)
}

/// The curves of each dose and structure; `colours` as in [`write_dvh`].
///
/// # Errors
/// [`Error::Internal`] when the picture cannot be encoded.
pub fn dvh_picture(doses: &[DoseDvh], colours: &[Option<[u8; 3]>]) -> Result<DosePicture> {
    let mut png = Vec::new();
    plot(doses, colours).write_png(&mut png).map_err(|e| Error::Internal(format!("dvh.png: {e}")))?;
    let thick = if doses.len() > 1 { "; the first dose is thick" } else { "" };
    let caption = format!("Share of each structure's volume that receives at least this dose{thick}.");
    Ok(DosePicture { title: "Dose-volume histogram".into(), caption, png })
}

/// The curves of a dose with their bands, in which nine of ten samples lie; `colours` as in [`write_dvh`].
///
/// # Errors
/// [`Error::Internal`] when the picture cannot be encoded.
pub fn banded_picture(found: &DoseDvh, bands: &[DvhBand], colours: &[Option<[u8; 3]>]) -> Result<DosePicture> {
    let doses = std::slice::from_ref(found);
    let most =
        bands.iter().map(|b| b.high.iter().rposition(|v| *v > 0.0).unwrap_or(0) as f64 * b.bin).fold(1.0, f64::max);
    let band = |b: &DvhBand| {
        let n = found.structures.iter().position(|s| s.name == b.name).unwrap_or(0);
        let points = b.low.iter().zip(&b.high).enumerate();
        Band {
            colour: colour_of(n, colours),
            points: points.map(|(at, (low, high))| [at as f64 * b.bin, 100.0 * low, 100.0 * high]).collect(),
        }
    };
    let bands: Vec<Band> = bands.iter().map(band).collect();
    let canvas = chart_with_bands("dose, Gy", [0.0, 1.05 * most], &curves_of(doses, colours), &bands);
    let mut png = Vec::new();
    canvas.write_png(&mut png).map_err(|e| Error::Internal(format!("histogram with bands: {e}")))?;
    let caption = "Share of each structure's volume that receives at least this dose: the line of the registration that was found, and a \
                   band in which nine of ten samples of its error lie.";
    Ok(DosePicture { title: "Dose-volume histogram with 90 % bands".into(), caption: caption.into(), png })
}

/// The figures of each dose and structure for a page.
pub fn dvh_tables(doses: &[DoseDvh]) -> Vec<DoseTable> {
    let head = ["structure", "ml", "mean", "D98", "D95", "D50", "D2", "D0.03cc", "greatest", "outside, ml"];
    let row = |s: &crate::dose::Dvh| {
        let text = |v: f64| if v.is_nan() { "\u{2013}".into() } else { format!("{v:.2}") };
        let figures = [s.mean, s.d98, s.d95, s.d50, s.d2, s.d003cc, s.max].map(text);
        let own = [s.name.clone(), format!("{:.2}", s.volume_ml)];
        own.into_iter().chain(figures).chain([format!("{:.2}", s.outside_ml)]).collect()
    };
    let table = |dose: &DoseDvh| DoseTable {
        title: format!("{}, Gy", dose.name),
        note: String::new(),
        head: head.map(str::to_owned).into(),
        rows: dose.structures.iter().map(row).collect(),
    };
    doses.iter().map(table).collect()
}

/// A structure's colour as a line on white: bright ones are darkened.
fn legible(colour: Rgb) -> Rgb {
    let light = colour.iter().map(|c| u32::from(*c)).sum::<u32>();
    if light > 540 { shaded(colour, 0.7) } else { colour }
}

/// One line per dose, structure and bin.
fn curves(doses: &[DoseDvh]) -> std::result::Result<Vec<u8>, csv::Error> {
    let mut table = crate::io::Sheet::default();
    table.write_record(["dose", "structure", "gy", "volume_percent"])?;
    for dose in doses {
        for s in &dose.structures {
            for (n, share) in s.cumulative.iter().enumerate() {
                let (gy, percent) = (n as f64 * s.bin, 100.0 * share);
                table.write_record([&dose.name, &s.name, &format!("{gy:.3}"), &format!("{percent:.4}")])?;
            }
        }
    }
    Ok(table.into_bytes()?)
}

/// One line per dose and structure.
fn figures(doses: &[DoseDvh]) -> std::result::Result<Vec<u8>, csv::Error> {
    let mut table = crate::io::Sheet::default();
    let at = doses.iter().flat_map(|d| &d.structures).next().map_or(&[][..], |s| &s.v);
    let names = ["dose", "structure", "volume_ml", "own_ml", "outside_ml", "mean_gy", "min_gy", "max_gy"];
    let more = ["d98_gy", "d95_gy", "d50_gy", "d2_gy", "d0.03cc_gy"];
    let heads = names.iter().chain(&more).map(|n| (*n).to_owned());
    table.write_record(heads.chain(at.iter().map(|v| format!("v{}gy_percent", v.gy))))?;
    for dose in doses {
        for s in &dose.structures {
            let doses = [s.mean, s.min, s.max, s.d98, s.d95, s.d50, s.d2, s.d003cc];
            let numbers = [s.volume_ml, s.own_ml, s.outside_ml].into_iter().chain(doses);
            // What is not known stays empty.
            let text = |v: f64| if v.is_nan() { String::new() } else { format!("{v:.4}") };
            let numbers = numbers.chain(s.v.iter().map(|v| v.percent)).map(text);
            table.write_record([dose.name.clone(), s.name.clone()].into_iter().chain(numbers))?;
        }
    }
    Ok(table.into_bytes()?)
}

/// One line per dose, structure and figure with its 90 % interval.
fn intervals(doses: &[DoseDvh]) -> std::result::Result<Vec<u8>, csv::Error> {
    let mut table = crate::io::Sheet::default();
    table.write_record(["dose", "structure", "figure", "unit", "value", "low", "high"])?;
    for (dose, samples) in doses.iter().filter_map(|d| Some((d, d.samples.as_ref()?))) {
        for line in samples.lines() {
            table.write_record(std::iter::once(dose.name.clone()).chain(line))?;
        }
    }
    Ok(table.into_bytes()?)
}

/// A curve for each structure; the first dose is thick.
fn plot(doses: &[DoseDvh], colours: &[Option<Rgb>]) -> Canvas {
    let all = || doses.iter().flat_map(|d| &d.structures);
    let most = all().map(|s| s.max).fold(1.0, f64::max);
    chart("dose, Gy", [0.0, 1.05 * most], &curves_of(doses, colours))
}

/// The colour of a structure by its place.
fn colour_of(n: usize, colours: &[Option<Rgb>]) -> Rgb {
    colours.get(n).copied().flatten().map_or(COLOURS[n % COLOURS.len()], legible)
}

fn curves_of(doses: &[DoseDvh], colours: &[Option<Rgb>]) -> Vec<Curve> {
    doses
        .iter()
        .enumerate()
        .flat_map(|(d, dose)| {
            let known = |(_, s): &(usize, &Dvh)| !s.cumulative.is_empty();
            dose.structures.iter().enumerate().filter(known).map(move |(n, s)| Curve {
                name: if doses.len() == 1 { s.name.clone() } else { format!("{}, {}", s.name, dose.name) },
                colour: colour_of(n, colours),
                width: if d == 0 { 5.0 } else { 2.5 },
                points: s.cumulative.iter().enumerate().map(|(b, v)| [b as f64 * s.bin, 100.0 * v]).collect(),
            })
        })
        .collect()
}

/// The figures of each dose and structure for the terminal.
pub fn dvh_table(doses: &[DoseDvh]) -> String {
    let mut out = String::new();
    for dose in doses {
        let head = ["structure", "ml", "Dmean", "Dmax", "D95", "D50", "D2", "D0.03cc"];
        write!(out, "{}, Gy\n  {:<24}", dose.name, head[0]).expect("writing to a string does not fail");
        head[1..].iter().for_each(|h| write!(out, "{h:>9}").expect("writing to a string does not fail"));
        for s in &dose.structures {
            write!(out, "\n  {:<24}", s.name).expect("writing to a string does not fail");
            write!(out, "{:>9.3}", s.volume_ml).expect("writing to a string does not fail");
            for v in [s.mean, s.max, s.d95, s.d50, s.d2, s.d003cc] {
                // What is not known has no figure.
                let text = if v.is_nan() { "-".into() } else { format!("{v:.2}") };
                write!(out, "{text:>9}").expect("writing to a string does not fail");
            }
            for v in s.v.iter().filter(|v| !v.percent.is_nan()) {
                write!(out, "  V{} {:.1} %", v.gy, v.percent).expect("writing to a string does not fail");
            }
            if s.outside_ml > 0.0 {
                write!(out, "  ({:.2} ml outside the dose grid)", s.outside_ml)
                    .expect("writing to a string does not fail");
            }
        }
        out.push('\n');
        out += &dose.samples.as_ref().map(SampledDose::text).unwrap_or_default();
        for w in &dose.warnings {
            writeln!(out, "  warning ({}): {}", w.code, w.message).expect("writing to a string does not fail");
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dose::Share;
    use crate::findings;

    fn one() -> DoseDvh {
        let s = Dvh {
            name: "cord, left".into(),
            volume_ml: 2.0,
            mean: 10.0,
            max: 20.0,
            cumulative: vec![1.0, 0.5],
            bin: 10.0,
            v: vec![Share { gy: 20.0, percent: 12.5 }],
            ..Dvh::default()
        };
        DoseDvh { name: "plan".into(), structures: vec![s], samples: None, warnings: Vec::new() }
    }

    #[test]
    fn what_is_not_known_has_no_figure() {
        let mut dose = one();
        let unknown =
            Dvh { name: "beyond".into(), volume_ml: 0.012, mean: f64::NAN, cumulative: vec![], ..Dvh::default() };
        dose.structures = vec![unknown];
        dose.warnings = vec![Warning::new(findings::STRUCTURE_OUTSIDE_DOSE, "beyond")];
        let dose = [dose];
        let text = String::from_utf8(figures(&dose).unwrap()).unwrap();
        assert!(text.contains("plan,beyond,0.0120,0.0000,0.0000,,0.0000"), "{text}");
        assert!(dvh_table(&dose).contains("warning (structure-outside-dose)") && plot(&dose, &[]).height() > 600);
        assert!(serde_json::to_string(&dose).unwrap().contains("\"mean\":null"));
    }

    #[test]
    fn tables_hold_the_figures() {
        let text = String::from_utf8(curves(&[one()]).unwrap()).unwrap();
        assert!(text.contains("plan,\"cord, left\",10.000,50.0000"), "{text}");
        let text = String::from_utf8(figures(&[one()]).unwrap()).unwrap();
        assert!(
            text.starts_with("dose,structure,volume_ml")
                && text.contains("v20gy_percent")
                && text.trim().ends_with("12.5000"),
            "{text}"
        );
        assert!(dvh_table(&[one()]).contains("V20 12.5 %"));
        assert!(plot(&[one()], &[]).height() > 600);
        let tables = dvh_tables(&[one()]);
        assert_eq!((tables[0].title.as_str(), tables[0].rows[0][2].as_str()), ("plan, Gy", "10.00"));
        // White is no line on white.
        assert_eq!((legible([255; 3]), legible([200, 0, 0])), ([179; 3], [200, 0, 0]));
        let own = plot(&[one()], &[Some([200, 0, 0])]);
        let red = (0..own.width()).flat_map(|x| (0..own.height()).map(move |y| (x, y)));
        assert!(red.filter(|&(x, y)| own.pixel(x, y) == [200, 0, 0]).count() > 500);
    }
}
