//! Doses through samples of a registration: how far a carried dose may be off.

use super::super::beside::named;
use super::Mapping;
use super::args::{MAPS, SampledArgs};
use super::out::GiveBack;
use super::structures::BIN;
use crate::config::InputRole;
use crate::dose::{DoseLimit, Dvh, DvhBand, DvhPlaces, steep};
use crate::error::{Error, Result};
use crate::evaluate::{Direction, FieldPair};
use crate::io::dicom::CarriedDose;
use crate::io::samples::{self, SAMPLES, SamplesFile};
use crate::io::{self, Stored, WriteOptions};
use crate::pipeline::{DoseMethod, DoseSamples, DoseSpread};
use crate::provenance::Provenance;
use crate::report::dose::{DosePicture, Levels, LimitDecision, SampledDose, isodoses};
use crate::volume::Volume;
use rayon::prelude::*;
use std::path::{Path, PathBuf};

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
    /// Reads the samples of so many doses; nothing where none are asked for. `structures` are the names of those that limits may
    /// be on.
    ///
    /// # Errors
    /// [`Error::Usage`] when there are more or fewer, the method does not interpolate, or a limit is on nothing; as
    /// [`samples::read`].
    pub(super) fn read(
        args: &SampledArgs,
        doses: usize,
        method: &DoseMethod,
        structures: &[String],
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
        same_seed(&samples)?;
        args.limit.iter().try_for_each(|text| DoseLimit::parse(text)?.require(structures))?;
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

/// Refuses samples of several registrations with unlike seeds: what these have in common would count as if it were not.
fn same_seed(samples: &[RunSamples]) -> Result<()> {
    let [first, rest @ ..] = samples else { return Ok(()) };
    let seed = |s: &RunSamples| s.about.options.seed;
    let Some(other) = rest.iter().find(|s| seed(s) != seed(first)) else { return Ok(()) };
    let problem = format!(
        "{} was drawn with seed {} and {} with seed {}: errors that the fractions share would not add up",
        first.folder.display(),
        seed(first),
        other.folder.display(),
        seed(other)
    );
    Err(Error::usage(problem, "draw the samples of all fractions with one --seed"))
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
                Error::usage(problem, format!("structures with a known dose: {}", names.join(", ")))
            })?;
            let (decision, found) = (limit.decide(figure), figure.value);
            Ok(LimitDecision { low: figure.low, high: figure.high, found, decision, limit })
        };
        let limits = limits.into_iter().map(decided).collect::<Result<_>>()?;
        let steep = steep(dose);
        let there = |map: &Volume<f32>, of: fn(f64) -> f64| {
            map.data()
                .iter()
                .zip(steep.data())
                .filter(|(_, steep)| **steep)
                .map(|(v, _)| of(f64::from(*v)))
                .sum::<f64>()
        };
        let (n, variance) = (steep.data().iter().filter(|s| **s).count(), there(&maps.sd, |sd| sd * sd));
        let common = maps.common.as_ref().filter(|_| variance > 0.0).map(|common| there(common, |v| v));
        let told = SampledDose {
            number: all.number(),
            seeds: from.iter().map(|s| s.about.options.seed).collect(),
            scales: from.iter().map(|s| s.about.options.scale).collect(),
            direction,
            greatest_sd_gy: f64::from(maps.sd.extremes()[1]),
            steep_sd_gy: there(&maps.sd, |sd| sd) / n.max(1) as f64,
            common_percent: common.map(|common| (100.0 * common / variance).clamp(0.0, 100.0)),
            structures,
            limits,
        };
        Ok(Self { told, found, maps })
    }

    /// Writes the maps beside the dose, as RT Doses where it is one; returns their paths.
    pub(super) fn write(&self, back: &GiveBack<'_>, sources: &[&Path], fields: &[&Path]) -> Result<Vec<PathBuf>> {
        let told = &self.told;
        let all = [
            (&self.maps.sd, CarriedDose::Deviation, "standard deviation of the dose"),
            (&self.maps.p05, CarriedDose::Percentile(5), "5th percentile of the dose"),
            (&self.maps.p95, CarriedDose::Percentile(95), "95th percentile of the dose"),
        ];
        let seed = told.seeds.first().copied().unwrap_or_default();
        let mut written = Vec::new();
        for (word, (map, what, words)) in MAPS.iter().zip(all) {
            let path = named(back.out, word);
            match &back.like {
                // What was to be said of the dose's plan was said with it.
                Some(like) => drop(like.dose(&path, map, what, [sources, fields])?),
                None => {
                    let description = format!("aventail: {words}, Gy, {} samples, seed {seed}", told.number);
                    let options = WriteOptions { description, ..WriteOptions::default() };
                    io::write_image(&path, map, Stored::Float32, &options)?;
                }
            }
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
}
