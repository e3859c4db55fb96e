//! The page of a dose that was carried: isodoses before and after, each fraction's share, what is steep, histograms.

use super::args::PageArgs;
use super::pages::stem;
use super::sampled::Spread;
use super::structures::{BIN, Structures};
use crate::config::InputRole;
use crate::dose::{DvhPlaces, doubts, steep};
use crate::error::Result;
use crate::geometry::Grid;
use crate::io;
use crate::io::dicom::Role;
use crate::pipeline::DoseReport;
use crate::provenance::Provenance;
use crate::report::dose::{DoseDvh, DosePicture, DoseTable, Levels, banded_picture, dvh_picture, dvh_tables, isodoses};
use crate::volume::{Mask, Volume};
use crate::warning::Warning;
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

/// Fractions whose share is drawn.
pub(super) const MOST_DRAWN: usize = 6;
/// An image with less than this is a CT, HU.
const CT_HU: f32 = -500.0;
/// A dose below this share of the greatest is not counted.
const COUNTED: f64 = 0.1;

/// What is shown beside a carried dose, in its new frame.
pub(super) struct Scenery {
    ct: Option<Volume<f32>>,
    structures: Option<Structures>,
}

impl Scenery {
    /// Reads what the page needs; `grid` is the image whose grid the result has. Nothing where no page is wanted.
    pub(super) fn read(
        args: &PageArgs,
        path: &Path,
        grid: Volume<f32>,
        provenance: &mut Provenance,
    ) -> Result<Option<Self>> {
        if args.no_page {
            return Ok(None);
        }
        let ct = match &args.page_ct {
            Some(path) => Some(provenance.take_scan(InputRole::PageCt, io::read_image(path)?)),
            None => (grid.extremes()[0] < CT_HU).then_some(grid),
        };
        let near = [Role::Image.at(path)];
        let read = |path: &Path| Structures::read(provenance, path, args.labels.as_deref(), &near);
        let structures = args.structures.as_deref().map(read).transpose()?;
        Ok(Some(Self { ct, structures }))
    }

    /// Names of the structures.
    pub(super) fn names(&self) -> Vec<String> {
        self.structures.as_ref().map(Structures::names).unwrap_or_default()
    }

    /// The structures on the grid of doses; none without structures.
    pub(super) fn places(&self, grid: &Grid) -> Option<DvhPlaces> {
        self.structures.as_ref().map(|s| s.places(grid))
    }

    /// Histograms and figures of a dose, with bands where samples tell; nothing without structures.
    fn histograms(
        &self,
        name: &str,
        dose: &Volume<f32>,
        spread: Option<&Spread>,
        page: &mut PageContent,
    ) -> Result<()> {
        let Some(structures) = &self.structures else { return Ok(()) };
        let counted = match spread {
            Some(spread) => spread.histograms().0.to_vec(),
            None => structures.histograms(dose, &[], BIN),
        };
        page.warnings.extend(doubts(&counted));
        let all = [DoseDvh { name: name.into(), structures: counted, samples: None, warnings: Vec::new() }];
        let bands = spread.map_or(&[][..], |spread| spread.histograms().1);
        page.pictures.push(match bands {
            [] => dvh_picture(&all, &structures.colours())?,
            bands => banded_picture(&all[0], bands, &structures.colours())?,
        });
        page.tables.extend(dvh_tables(&all));
        Ok(())
    }
}

/// What the page of a carried dose says.
pub(super) struct PageContent {
    pub(super) title: String,
    pub(super) pictures: Vec<DosePicture>,
    pub(super) tables: Vec<DoseTable>,
    /// Beyond those that the doses came with.
    pub(super) warnings: Vec<Warning>,
}

/// One of several doses that were carried.
pub(super) struct CarriedPart {
    path: PathBuf,
    weight: f64,
    /// Of one fraction, Gy.
    greatest: f64,
    /// Of all voxels, times the weight, Gy.
    total: f64,
    /// Times the weight; kept of the first [`MOST_DRAWN`].
    pub(super) share: Option<Volume<f32>>,
}

impl CarriedPart {
    /// The dose of a file, carried, that counts `weight` times; `drawn` keeps its share for a picture.
    pub(super) fn new(path: &Path, weight: f64, mapped: &Volume<f32>, drawn: bool) -> Self {
        let total = weight * mapped.data().iter().map(|d| f64::from(*d)).sum::<f64>();
        let share = drawn.then(|| mapped.map(|d| (weight * f64::from(*d)) as f32));
        Self { path: path.to_owned(), weight, greatest: f64::from(mapped.extremes()[1]), total, share }
    }
}

/// Names of doses: those of their files, with their places and numbers in the list where they are not told apart else.
fn names(paths: &[&Path]) -> Vec<String> {
    let once = |names: &[String]| names.iter().collect::<BTreeSet<_>>().len() == names.len();
    let stems: Vec<String> = paths.iter().map(|path| stem(path)).collect();
    let places: Vec<String> = paths.iter().map(|path| path.display().to_string()).collect();
    match (once(&stems), once(&places)) {
        (true, _) => stems,
        (_, true) => places,
        _ => places.iter().enumerate().map(|(n, place)| format!("{}: {place}", n + 1)).collect(),
    }
}

/// The page of one dose (and the CT that it was computed on, if any) carried to `frame`.
pub(super) fn map(
    scenery: &Scenery,
    frame: &str,
    name: &Path,
    dose: &Volume<f32>,
    ct: Option<&Volume<f32>>,
    mapped: &Volume<f32>,
    (report, spread): (&DoseReport, Option<&Spread>),
) -> Result<PageContent> {
    let (levels, steep) = (Levels::of(dose), steep(mapped));
    let after = Levels { through: Levels::of(mapped).through, ..levels };
    let mut page = PageContent {
        title: format!("{} carried to {frame}", stem(name)),
        pictures: vec![
            isodoses("Before, where it was computed", dose, ct, &levels, None)?,
            isodoses(&format!("After, on {frame}"), mapped, scenery.ct.as_ref(), &after, Some(&steep))?,
        ],
        tables: spread.map(|spread| spread.told.tables()).unwrap_or_default(),
        warnings: Vec::new(),
    };
    page.pictures.extend(spread.map(|spread| spread.picture(mapped, scenery.ct.as_ref())).transpose()?);
    page.tables.push(steep_table(mapped, &steep, std::slice::from_ref(report)));
    scenery.histograms(&format!("{} on {frame}", stem(name)), mapped, spread, &mut page)?;
    Ok(page)
}

/// The page of a sum of `parts`.
pub(super) fn sum(
    scenery: &Scenery,
    total: &Volume<f32>,
    parts: &[CarriedPart],
    reports: &[DoseReport],
    spread: Option<&Spread>,
) -> Result<PageContent> {
    let (levels, steep) = (Levels::of(total), steep(total));
    let ct = scenery.ct.as_ref();
    let mut pictures = vec![isodoses("The sum", total, ct, &levels, Some(&steep))?];
    pictures.extend(spread.map(|spread| spread.picture(total, ct)).transpose()?);
    let names = names(&parts.iter().map(|part| part.path.as_path()).collect::<Vec<_>>());
    for (part, name) in parts.iter().zip(&names) {
        let Some(share) = &part.share else { continue };
        pictures.push(isodoses(&format!("Share of {name}, times {}", part.weight), share, ct, &levels, None)?);
    }
    let whole = parts.iter().map(|p| p.total).sum::<f64>().max(f64::MIN_POSITIVE);
    let row = |((part, name), report): ((&CarriedPart, &String), &DoseReport)| {
        let numbers = [
            format!("{}", part.weight),
            format!("{:.2}", part.greatest),
            format!("{:.2}", part.weight * part.greatest),
            format!("{:.1}", 100.0 * part.total / whole),
            format!("{:.2}", report.outside.amount_percent),
        ];
        std::iter::once(name.clone()).chain(numbers).collect()
    };
    let drawn = parts.iter().filter(|p| p.share.is_some()).count();
    let left = if drawn < parts.len() { format!(" Pictures show the first {drawn}.") } else { String::new() };
    let shares = DoseTable {
        title: "Fractions".into(),
        note: format!("Each dose carried back to planning, and its share of the sum over all voxels.{left}"),
        head: ["", "weight", "greatest, Gy", "times weight, Gy", "of the sum, %", "dose outside the field, %"]
            .map(str::to_owned)
            .into(),
        rows: parts.iter().zip(&names).zip(reports).map(row).collect(),
    };
    let mut page = PageContent {
        title: format!("dose accumulated over {} doses", parts.len()),
        pictures,
        tables: spread.map(|spread| spread.told.tables()).unwrap_or_default(),
        warnings: Vec::new(),
    };
    page.tables.extend([shares, steep_table(total, &steep, reports)]);
    scenery.histograms("sum", total, spread, &mut page)?;
    Ok(page)
}

/// How much of a dose is steep, and where the field deserves doubt there.
fn steep_table(dose: &Volume<f32>, steep: &Mask, reports: &[DoseReport]) -> DoseTable {
    let most = f64::from(dose.extremes()[1].max(0.0));
    let ml = dose.grid().voxel_volume() / 1000.0;
    let counted = |l: &usize| f64::from(dose.data()[*l]) > COUNTED * most;
    let all = (0..dose.data().len()).filter(counted).count();
    let within = (0..dose.data().len()).filter(counted).filter(|l| steep.data()[*l]).count();
    let doubtful = reports.iter().map(|r| r.caution.ml).fold(0.0, f64::max);
    let change = reports.iter().map(|r| r.caution.greatest_gy).fold(0.0, f64::max);
    let row = vec![
        "volume".into(),
        format!("{:.1}", all as f64 * ml),
        format!("{:.1}", within as f64 * ml),
        format!("{:.0}", 100.0 * within as f64 / all.max(1) as f64),
        format!("{doubtful:.2}"),
        format!("{change:.2}"),
    ];
    DoseTable {
        title: "Steep dose".into(),
        note: format!(
            "Steep is what changes by more than 1 % of the greatest dose ({:.2} Gy) per mm: a millimetre of error of the field changes \
             the dose there by more than that, and no figure of this page can show it. Doubtful is steep dose where the field folds \
             or leaves the images, or where its inverse-consistency error changes the dose by more than 1 % of the greatest; of \
             several fractions the worst counts.",
            most / 100.0
        ),
        head: ["", "above 10 %, ml", "of it steep, ml", "%", "doubtful, ml", "greatest miss of the field, Gy"]
            .map(str::to_owned)
            .into(),
        rows: vec![row],
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn doses_are_told_apart() {
        let named = |paths: &[&str]| names(&paths.iter().map(Path::new).collect::<Vec<_>>());
        assert_eq!(named(&["day1/a.nii.gz", "day2/b.nii.gz"]), ["a", "b"]);
        assert_eq!(named(&["day1/dose.mha", "day2/dose.mha"]), ["day1/dose.mha", "day2/dose.mha"]);
        assert_eq!(named(&["data/dose.mha", "data/dose.mha"]), ["1: data/dose.mha", "2: data/dose.mha"]);
    }
}
