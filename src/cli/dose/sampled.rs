//! Doses through samples of a registration: how far a carried dose may be off.

use super::super::beside::map_beside;
use super::Mapping;
use super::args::{MAPS, SampledArgs};
use super::structures::BIN;
use crate::config::InputRole;
use crate::dose::{Decision, DoseLimit, Dvh, DvhBand, DvhPlaces, FigureBand, steep};
use crate::error::{Error, Result};
use crate::evaluate::{Direction, FieldPair};
use crate::io::samples::{self, SAMPLES, SamplesFile};
use crate::io::{self, Stored, WriteOptions};
use crate::pipeline::{DoseMethod, DoseSamples, DoseSpread};
use crate::provenance::Provenance;
use crate::report::dose::{BROKEN, DosePicture, DoseTable, KEPT, Levels, UNDECIDED, isodoses};
use crate::volume::Volume;
use rayon::prelude::*;
use serde::Serialize;
use std::path::{Path, PathBuf};

/// Figures that the page's table leaves out.
const LEFT_OUT: [&str; 2] = ["D98", "D50"];

/// Samples of one registration.
pub(super) struct RunSamples {
    folder: PathBuf,
    about: SamplesFile,
}

impl RunSamples {
    /// Reads what a folder says of its samples.
    fn read(folder: &Path, provenance: &mut Provenance) -> Result<Self> {
        let about = samples::about(folder)?;
        provenance.note(InputRole::Samples, &folder.join(SAMPLES))?;
        Ok(Self { folder: folder.to_owned(), about })
    }

    /// Refuses samples of another registration than the field's; `fields` are roles of the field that was read last.
    fn belongs(&self, provenance: &Provenance) -> Result<()> {
        let is_field = |role: InputRole| {
            matches!(role, InputRole::PlanningToFraction | InputRole::FractionToPlanning | InputRole::Fields)
        };
        let last = provenance.inputs.iter().rev().find(|input| is_field(input.role));
        let Some(field) = last else { return Ok(()) };
        self.about.require_of(&self.folder, &field.path, &field.sha256)
    }
}

/// Doses through samples, as they come.
pub(super) struct SampledDoses {
    samples: Vec<RunSamples>,
    sum: Option<DoseSamples>,
}

impl SampledDoses {
    /// Reads the samples of so many doses; nothing where none are asked for.
    ///
    /// # Errors
    /// [`Error::Usage`] when there are more or fewer, or the method does not interpolate; as [`samples::read`].
    pub(super) fn read(
        args: &SampledArgs,
        doses: usize,
        method: &DoseMethod,
        provenance: &mut Provenance,
    ) -> Result<Option<Self>> {
        if args.samples.is_empty() {
            return Ok(None);
        }
        if args.samples.len() != doses {
            let problem = format!("{doses} doses but {} folders of --samples", args.samples.len());
            return Err(Error::usage(problem, "give one for each dose, in the same order"));
        }
        if *method != DoseMethod::Interpolate {
            let problem = "--samples with --method energy-mass: samples are carried by interpolation";
            return Err(Error::usage(problem, "take --method interpolate"));
        }
        let read = |folder: &PathBuf| RunSamples::read(folder, provenance);
        let samples: Vec<RunSamples> = args.samples.iter().map(read).collect::<Result<_>>()?;
        args.limit.iter().try_for_each(|text| DoseLimit::parse(text).map(drop))?;
        Ok(Some(Self { samples, sum: None }))
    }

    /// Adds a dose with its weight, through the samples of its registration.
    pub(super) fn add(
        &mut self,
        n: usize,
        weight: f64,
        of: &Mapping<'_>,
        pair: &FieldPair,
        provenance: &Provenance,
    ) -> Result<()> {
        let own = self.samples.get(n).ok_or_else(|| Error::Internal("a dose has no samples".into()))?;
        own.belongs(provenance)?;
        // One registration's samples are in memory at a time.
        let (_, set) = samples::read(&own.folder)?;
        let sum = self.sum.get_or_insert_with(|| DoseSamples::zero(of.to, set.number()));
        sum.add(weight, of.dose, pair, of.direction, &set)
    }

    /// How far the dose may be off.
    pub(super) fn spread(
        &self,
        dose: &Volume<f32>,
        direction: Direction,
        places: Option<&DvhPlaces>,
        args: &SampledArgs,
    ) -> Result<Spread> {
        let sum = self.sum.as_ref().ok_or_else(|| Error::Internal("no dose was carried".into()))?;
        Spread::of(sum, dose, &self.samples, direction, places, args)
    }
}

/// What the samples tell, for the file beside the dose.
#[derive(Serialize)]
pub(super) struct SampledDose {
    /// How many samples.
    number: usize,
    /// Seed of each registration's samples.
    seeds: Vec<u64>,
    /// Deviation of each component over the map of uncertainty, of each registration.
    scales: Vec<f64>,
    /// Direction of the dose.
    direction: Direction,
    /// Greatest standard deviation, Gy.
    greatest_sd_gy: f64,
    /// Mean standard deviation where the dose is steep (more than 1 % of its maximum per mm), Gy.
    steep_sd_gy: f64,
    /// Each structure's figures with their intervals, and its curve's band.
    structures: Vec<DvhBand>,
    /// What limits say.
    limits: Vec<LimitDecision>,
}

/// A limit with what it says.
#[derive(Serialize)]
struct LimitDecision {
    #[serde(flatten)]
    limit: DoseLimit,
    /// The figure, Gy or percent, with its interval.
    found: f64,
    low: f64,
    high: f64,
    decision: Decision,
}

/// What is said of a limit.
fn word(decision: Decision) -> &'static str {
    match decision {
        Decision::Kept => KEPT,
        Decision::Undecided => UNDECIDED,
        Decision::Broken => BROKEN,
    }
}

/// A dose with how far it may be off.
pub(super) struct Spread {
    pub(super) told: SampledDose,
    /// Histograms of the registration that was found.
    found: Vec<Dvh>,
    maps: DoseSpread,
}

impl Spread {
    /// Of doses through the samples of one or several registrations, beside `dose` through what was found.
    pub(super) fn of(
        all: &DoseSamples,
        dose: &Volume<f32>,
        from: &[RunSamples],
        direction: Direction,
        places: Option<&DvhPlaces>,
        args: &SampledArgs,
    ) -> Result<Self> {
        let maps = all.spread()?;
        let limits: Vec<DoseLimit> = args.limit.iter().map(|text| DoseLimit::parse(text)).collect::<Result<_>>()?;
        let mut at = args.at.clone();
        at.extend(limits.iter().filter_map(DoseLimit::volume_above).filter(|gy| !args.at.contains(gy)));
        let found = places.map(|places| places.histograms(dose, &at, BIN)).unwrap_or_default();
        let structures = match places {
            None => Vec::new(),
            Some(places) => {
                let each = |n: usize| Ok(places.histograms(&all.sample(n)?, &at, BIN));
                let each: Vec<_> = (0..all.number()).into_par_iter().map(each).collect::<Result<_>>()?;
                crate::dose::bands(&found, &each)
            }
        };
        let decided = |limit: DoseLimit| {
            let figure = limit.figure(&structures).ok_or_else(|| {
                let problem = format!("limit on {} of {:?}: there is no such figure", limit.figure, limit.structure);
                let names: Vec<&str> = structures.iter().map(|s| s.name.as_str()).collect();
                let figures = "mean, D98, D95, D50, D2, D0.03cc, V and a dose";
                Error::usage(problem, format!("structures: {}; figures: {figures}", names.join(", ")))
            })?;
            let (decision, found) = (limit.decide(figure), figure.value);
            Ok(LimitDecision { found, low: figure.low, high: figure.high, decision, limit })
        };
        let limits = limits.into_iter().map(decided).collect::<Result<_>>()?;
        let steep = steep(dose);
        let of_steep =
            maps.sd.data().iter().zip(steep.data()).filter(|(_, steep)| **steep).map(|(sd, _)| f64::from(*sd));
        let (sum, n) = of_steep.fold((0.0, 0usize), |(sum, n), sd| (sum + sd, n + 1));
        let told = SampledDose {
            number: all.number(),
            seeds: from.iter().map(|s| s.about.options.seed).collect(),
            scales: from.iter().map(|s| s.about.options.scale).collect(),
            direction,
            greatest_sd_gy: f64::from(maps.sd.extremes()[1]),
            steep_sd_gy: sum / n.max(1) as f64,
            structures,
            limits,
        };
        Ok(Self { told, found, maps })
    }

    /// Writes the maps beside the dose; returns their paths.
    pub(super) fn write(&self, out: &Path) -> Result<Vec<PathBuf>> {
        let told = &self.told;
        let all = [&self.maps.sd, &self.maps.p05, &self.maps.p95];
        let words = ["standard deviation of the dose", "5th percentile of the dose", "95th percentile of the dose"];
        let mut written = Vec::new();
        for ((name, map), what) in MAPS.iter().zip(all).zip(words) {
            let seed = told.seeds.first().copied().unwrap_or_default();
            let description = format!("aventail: {what}, Gy, {} samples, seed {seed}", told.number);
            let path = map_beside(out, name);
            io::write_image(&path, map, Stored::Float32, &WriteOptions { description, ..WriteOptions::default() })?;
            written.push(path);
        }
        Ok(written)
    }

    /// The picture of the deviation, in planes through the greatest of `dose`.
    pub(super) fn picture(&self, dose: &Volume<f32>, ct: Option<&Volume<f32>>) -> Result<DosePicture> {
        let told = &self.told;
        let levels = Levels { most: told.greatest_sd_gy, through: Levels::of(dose).through };
        let title = format!("Standard deviation of the dose over {} samples", told.number);
        let caption = format!(
            "Lines of equal standard deviation, in shares of the greatest, {:.2} Gy; planes at {:.0}, {:.0}, {:.0} (LPS mm).",
            told.greatest_sd_gy, levels.through.x, levels.through.y, levels.through.z
        );
        Ok(DosePicture { caption, ..isodoses(&title, &self.maps.sd, ct, &levels, None)? })
    }

    /// The histograms of the registration that was found, and each structure's band.
    pub(super) fn histograms(&self) -> (&[Dvh], &[DvhBand]) {
        (&self.found, &self.told.structures)
    }

    /// The tables of limits and intervals, where there are structures.
    pub(super) fn tables(&self) -> Vec<DoseTable> {
        let limits = (!self.told.limits.is_empty()).then(|| self.limits());
        let intervals = (!self.told.structures.is_empty()).then(|| self.intervals());
        limits.into_iter().chain(intervals).collect()
    }

    /// A structure a line: each figure with its interval.
    fn intervals(&self) -> DoseTable {
        // As many as the page is wide; all are in the JSON file.
        fn shown(s: &DvhBand) -> Vec<&FigureBand> {
            s.figures.iter().filter(|f| !LEFT_OUT.contains(&f.figure.as_str())).collect()
        }
        let row = |s: &DvhBand| {
            let cell = |f: &FigureBand| format!("{:.2} ({:.2}\u{2013}{:.2})", f.value, f.low, f.high);
            std::iter::once(s.name.clone()).chain(shown(s).into_iter().map(cell)).collect()
        };
        let first = self.told.structures.first().map(shown).unwrap_or_default();
        let heads = first.iter().map(|f| format!("{}, {}", f.figure, f.unit));
        DoseTable {
            title: "Figures with their 90 % intervals".into(),
            note: format!(
                "Each figure of the registration that was found, and between which values it lies in nine of ten of {} samples of the \
                 registration's error; D98 and D50 are in the JSON file beside this page. Outlines and dose are taken for right.",
                self.told.number
            ),
            head: std::iter::once("structure".to_owned()).chain(heads).collect(),
            rows: self.told.structures.iter().map(row).collect(),
        }
    }

    /// What the limits say.
    fn limits(&self) -> DoseTable {
        let row = |d: &LimitDecision| {
            let word = word(d.decision);
            let figure = format!("{:.2} ({:.2} to {:.2})", d.found, d.low, d.high);
            vec![d.limit.structure.clone(), d.limit.text(), figure, word.into()]
        };
        DoseTable {
            title: "Limits".into(),
            note: "Undecided: the limit lies within the figure's 90 % interval.".into(),
            head: ["structure", "limit", "found", "decision"].map(str::to_owned).into(),
            rows: self.told.limits.iter().map(row).collect(),
        }
    }

    /// For the terminal.
    pub(super) fn text(&self) -> String {
        let told = &self.told;
        let mut text = format!(
            "  over {} samples the dose deviates by {:.2} Gy at most (one standard deviation), {:.2} Gy on the mean where it is steep\n",
            told.number, told.greatest_sd_gy, told.steep_sd_gy
        );
        for s in &told.structures {
            let named = |f: &&FigureBand| ["mean", "D95", "D0.03cc"].contains(&f.figure.as_str());
            let cell = |f: &FigureBand| format!("{} {:.2} ({:.2} to {:.2})", f.figure, f.value, f.low, f.high);
            let cells: Vec<String> = s.figures.iter().filter(named).map(cell).collect();
            text += &format!("  {}: {} Gy\n", s.name, cells.join(", "));
        }
        for d in &told.limits {
            let word = word(d.decision);
            text += &format!(
                "  limit {} {}: {word} ({:.2}, {:.2} to {:.2})\n",
                d.limit.structure,
                d.limit.text(),
                d.found,
                d.low,
                d.high
            );
        }
        text
    }
}
