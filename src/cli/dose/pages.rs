//! The pages of `dose`.

use super::super::terminal::command_line;
use super::out::parent;
use super::{CompareArgs, DoseDifference};
use crate::config::InputRole;
use crate::dose::steep;
use crate::error::Result;
use crate::io;
use crate::provenance::Provenance;
use crate::report::dose::{
    DoseDvh, DosePage, DosePicture, DoseTable, Levels, SampledDose, differences, dvh_tables, isodoses,
};
use crate::volume::Volume;
use crate::warning::Warning;
use std::path::{Path, PathBuf};

/// The CTs of a comparison: the reference's and the dose's, where they are given.
pub(super) fn read_cts(args: &CompareArgs, provenance: &mut Provenance) -> Result<[Option<Volume<f32>>; 2]> {
    let mut read = |role: InputRole, path: &Option<PathBuf>| {
        path.as_ref().map(|p| Ok(provenance.take_scan(role, io::read_image(p)?))).transpose()
    };
    Ok([read(InputRole::Ct, &args.ct)?, read(InputRole::DoseCt, &args.dose_ct)?])
}

/// What a comparison has found.
pub(super) struct DosesCompared<'a> {
    pub(super) dose: &'a Volume<f32>,
    pub(super) reference: &'a Volume<f32>,
    /// Dose minus reference on the reference's grid.
    pub(super) difference: &'a Volume<f32>,
    pub(super) figures: &'a DoseDifference,
    pub(super) cts: &'a [Option<Volume<f32>>; 2],
}

/// Writes `compare.html`.
pub(super) fn write_compare(folder: &Path, found: &DosesCompared<'_>, provenance: &Provenance) -> Result<()> {
    let DosesCompared { dose, reference, difference, figures, cts: [ct, dose_ct] } = found;
    let (levels, steep) = (Levels::of(reference), steep(reference));
    let pictures = vec![
        isodoses("Reference", reference, ct.as_ref(), &levels, None)?,
        isodoses("Dose", dose, dose_ct.as_ref().or(ct.as_ref()), &levels, None)?,
        differences(difference, reference, ct.as_ref(), &steep)?,
    ];
    let line = |name: &str, s: &crate::stats::Summary| {
        let numbers = [s.mean, s.median, s.p95, s.min, s.max].map(|v| format!("{v:.3}"));
        std::iter::once(name.to_owned()).chain(numbers).collect()
    };
    let [in_steep, elsewhere] = [true, false].map(|which| mean_of(difference, reference, |l| steep.data()[l] == which));
    let text = |mean: Option<f64>| mean.map_or("\u{2013}".into(), |v| format!("{v:.3}"));
    let table = DoseTable {
        title: "Dose minus reference, Gy".into(),
        note: "Where both are known and either is above 10 % of the reference's maximum.".into(),
        head: ["", "mean", "median", "95 %", "least", "greatest"].map(str::to_owned).into(),
        rows: vec![line("signed", &figures.signed), line("magnitude", &figures.magnitude)],
    };
    let by_gradient = DoseTable {
        title: "Steep dose".into(),
        note: "Mean magnitude of the difference, Gy, where the reference changes by more than 1 % of its maximum per mm and elsewhere: a \
               difference that lies in steep dose alone is one of position."
            .into(),
        head: ["", "steep", "elsewhere"].map(str::to_owned).into(),
        rows: vec![vec!["mean magnitude".into(), text(in_steep), text(elsewhere)]],
    };
    let path = folder.join("compare.html");
    write(&path, "dose minus reference", provenance, &provenance.warnings, pictures, vec![table, by_gradient])
}

/// Mean magnitude of the difference where the reference counts and `which` holds, Gy.
fn mean_of(difference: &Volume<f32>, reference: &Volume<f32>, which: impl Fn(usize) -> bool) -> Option<f64> {
    let least = 0.1 * reference.extremes()[1].max(0.0);
    let counted = (0..reference.data().len()).filter(|l| reference.data()[*l] > least && which(*l));
    let (sum, n) = counted.fold((0.0, 0usize), |(sum, n), l| (sum + f64::from(difference.data()[l].abs()), n + 1));
    (n > 0).then(|| sum / n as f64)
}

/// Writes `dvh.html`.
pub(super) fn write_dvh(folder: &Path, doses: &[DoseDvh], picture: DosePicture, provenance: &Provenance) -> Result<()> {
    let names: Vec<&str> = doses.iter().map(|d| d.name.as_str()).collect();
    let title = format!("dose-volume histogram: {}", names.join(", "));
    let warnings: Vec<Warning> = doses.iter().flat_map(|d| d.warnings.clone()).collect();
    let intervals = doses.iter().flat_map(|d| d.samples.iter().flat_map(SampledDose::tables));
    let tables = intervals.chain(dvh_tables(doses)).collect();
    write(&folder.join("dvh.html"), &title, provenance, &warnings, vec![picture], tables)
}

/// Writes a page.
pub(super) fn write(
    path: &Path,
    title: &str,
    provenance: &Provenance,
    warnings: &[Warning],
    pictures: Vec<DosePicture>,
    tables: Vec<DoseTable>,
) -> Result<()> {
    let (inputs, command) = (provenance.seen_from(parent(path)), command_line());
    DosePage { title: title.into(), command, inputs: &inputs, warnings, pictures, tables }.write(path)
}

/// The name of a file up to its first dot.
pub(super) fn stem(path: &Path) -> String {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    name.split('.').next().unwrap_or_default().to_owned()
}
