//! `aventail dose`: map, accumulate, compare, and read dose-volume histograms.

mod args;
mod carried;
mod counted;
mod dvh;
mod finish;
mod out;
mod pages;
mod sampled;
mod structures;

pub use args::{
    AccumulateArgs, CompareArgs, DoseVerb, DvhArgs, Frame, MapArgs, MethodArgs, MethodName, PageArgs, SampledArgs,
};

use super::args::DirectionName;
use super::terminal::command_line;
use super::terminal::progress;
use super::{planned, record, run_folder};
use crate::config::InputRole;
use crate::dose::{
    DensityTable, DoseCounts, DoseDifference, EnergyMassOptions, accumulate, difference, distance_to_difference,
    question,
};
use crate::error::{Error, Result};
use crate::evaluate::Direction;
use crate::findings;
use crate::geometry::Grid;
use crate::io::dicom::{Framed, Role};
use crate::io::{self, Stored, WriteOptions, write_json};
use crate::pipeline::{DoseMethod, DoseReport, map_dose};
use crate::provenance::Provenance;
use crate::runtime::Runtime;
use crate::session::fields::{self, Known};
use crate::volume::Volume;
use crate::warning::Warning;
use carried::{CarriedPart, MOST_DRAWN, Scenery};
use counted::{ToldDose, read_to_carry, read_told, whole_plan};
use finish::{Carried, finish, listed};
use out::{GiveBack, check_out};
use sampled::SampledDoses;
use std::path::{Path, PathBuf};

/// Runs a verb of `dose`.
///
/// # Errors
/// Of every kind; see [`Error`].
pub(super) fn run(verb: &DoseVerb) -> Result<String> {
    match verb {
        DoseVerb::Map(args) => map(args),
        DoseVerb::Accumulate(args) => sum(args),
        DoseVerb::Dvh(args) => dvh::run(args),
        DoseVerb::Compare(args) => compare(args),
    }
}

fn map(args: &MapArgs) -> Result<String> {
    let method = method(&args.how)?;
    let fields = [&args.planning_to_fraction, &args.fraction_to_planning, &args.ct, &args.how.density];
    let files = fields.into_iter().flatten().chain([&args.dose, &args.grid]).chain(args.page.files());
    let samples = args.sampled.files();
    let files: Vec<&Path> = files.chain(&samples).map(PathBuf::as_path).collect();
    let back = GiveBack::new(args.dicom_like.as_deref(), &args.out, &args.grid, args.how.common.told.json)?;
    check_out(&args.out, back.like.is_some(), &files, args.sampled.maps())?;
    let runtime = Runtime::new(args.how.common.work.threads, progress(args.how.quiet()))?;
    let mut provenance = Provenance::default();
    let (dose, to, ct, scenery) = runtime.stage("read", || {
        let dose = read_to_carry(&mut provenance, &args.dose)?.dose;
        let grid = provenance.take(InputRole::Grid, io::read_scan(&args.grid)?);
        let to = grid.grid().clone();
        let ct =
            args.ct.as_ref().map(|p| Ok::<_, Error>(provenance.take(InputRole::Ct, io::read_image(p)?))).transpose()?;
        let scenery = Scenery::read(&args.page, &args.grid, grid, &mut provenance)?;
        Ok::<_, Error>((dose, to, ct, scenery))
    })?;
    let direction = match args.to {
        Frame::Fraction => Direction::PlanningToFraction,
        Frame::Planning => Direction::FractionToPlanning,
    };
    let one = Mapping {
        dose: &dose,
        dose_file: &args.dose,
        to: &to,
        to_file: Role::Image.at(args.dicom_like.as_ref().unwrap_or(&args.grid)),
        push: args.planning_to_fraction.as_deref(),
        pull: args.fraction_to_planning.as_deref(),
        option: None,
        direction,
        method: &method,
        ct: ct.as_ref(),
    };
    let names = scenery.as_ref().map(Scenery::names).unwrap_or_default();
    let mut through = SampledDoses::read(&args.sampled, 1, &method, &names, &mut provenance)?;
    let (mapped, report) = one.carry(through.as_mut().map(|t| (t, 0, 1.0)), &mut provenance, &runtime)?;
    let fields: Vec<&Path> = [one.push, one.pull].into_iter().flatten().collect();
    let places = || scenery.as_ref().and_then(|s| s.places(&to));
    let spread = |t: &SampledDoses| t.spread(&mapped, direction, places().as_ref(), &args.sampled);
    let spread = runtime.stage("compare samples", || through.as_ref().map(spread).transpose())?;
    let draw = |scenery: &Scenery| {
        let frame = if args.to == Frame::Fraction { "the fraction" } else { "planning" };
        carried::map(scenery, frame, &args.dose, &dose, ct.as_ref(), &mapped, (&report, spread.as_ref()))
    };
    let page = runtime.stage("draw", || scenery.as_ref().map(draw).transpose())?;
    let carried = Carried { dose: &mapped, weights: vec![1.0], parts: vec![report], sources: &[&args.dose], spread };
    finish(&back, carried, provenance, page, &fields)
}

fn sum(args: &AccumulateArgs) -> Result<String> {
    let method = method(&args.how)?;
    let n = args.dose.len();
    let counts = [("--fields", args.fields.len()), ("--ct", args.ct.len())];
    for (option, count) in counts {
        if count != n && (count > 0 || option == "--fields") {
            return Err(Error::usage(
                format!("{n} doses but {count} values of {option}"),
                format!("give one value of {option} for each dose, in the same order"),
            ));
        }
    }
    let counts = DoseCounts::new(n, &args.weights, &args.fractions)?;
    let weights = counts.factors().to_vec();
    let files = args.dose.iter().chain(&args.fields).chain(&args.ct).chain(&args.how.density).chain([&args.grid]);
    let samples = args.sampled.files();
    let files: Vec<&Path> = files.chain(args.page.files()).chain(&samples).map(PathBuf::as_path).collect();
    let out = GiveBack::new(args.dicom_like.as_deref(), &args.out, &args.grid, args.how.common.told.json)?;
    check_out(&args.out, out.like.is_some(), &files, args.sampled.maps())?;
    let runtime = Runtime::new(args.how.common.work.threads, progress(args.how.quiet()))?;
    let mut provenance = Provenance::default();
    let grid = provenance.take(InputRole::Grid, io::read_scan(&args.grid)?);
    let to = grid.grid().clone();
    let scenery = Scenery::read(&args.page, &args.grid, grid, &mut provenance)?;
    let names = scenery.as_ref().map(Scenery::names).unwrap_or_default();
    let mut through = SampledDoses::read(&args.sampled, n, &method, &names, &mut provenance)?;
    let mut shares = Vec::new();
    let mut total: Option<Volume<f32>> = None;
    let mut reports = Vec::new();
    for (k, path) in args.dose.iter().enumerate() {
        let ToldDose { dose, of_whole_plan, .. } = read_to_carry(&mut provenance, path)?;
        if let Some(times) = counts.several(k) {
            provenance.warnings.extend(of_whole_plan.then(|| whole_plan(path, times)));
            provenance.warnings.extend(question(&path.display().to_string(), dose.extremes()[1], times));
        }
        let ct =
            args.ct.get(k).map(|p| Ok::<_, Error>(provenance.take(InputRole::Ct, io::read_image(p)?))).transpose()?;
        let field = Some(args.fields[k].as_path());
        let (push, pull) = match args.direction {
            DirectionName::PlanningToFraction => (field, None),
            DirectionName::FractionToPlanning => (None, field),
        };
        let one = Mapping {
            dose: &dose,
            dose_file: path,
            to: &to,
            to_file: Role::Image.at(args.dicom_like.as_ref().unwrap_or(&args.grid)),
            push,
            pull,
            option: Some(InputRole::Fields),
            direction: Direction::FractionToPlanning,
            method: &method,
            ct: ct.as_ref(),
        };
        let (mapped, report) = one.carry(through.as_mut().map(|t| (t, k, weights[k])), &mut provenance, &runtime)?;
        total = Some(match &total {
            None => accumulate(&[(weights[k], &mapped)])?,
            Some(so_far) => accumulate(&[(1.0, so_far), (weights[k], &mapped)])?,
        });
        if scenery.is_some() {
            shares.push(CarriedPart::new(path, weights[k], &mapped, k < MOST_DRAWN));
        }
        reports.push(report);
    }
    let total = total.ok_or_else(|| Error::usage("no dose is given", "add --dose FILE for each fraction"))?;
    let fields: Vec<&Path> = args.fields.iter().map(PathBuf::as_path).collect();
    let doses: Vec<&Path> = args.dose.iter().map(PathBuf::as_path).collect();
    let places = || scenery.as_ref().and_then(|s| s.places(&to));
    let spread = |t: &SampledDoses| t.spread(&total, Direction::FractionToPlanning, places().as_ref(), &args.sampled);
    let spread = runtime.stage("compare samples", || through.as_ref().map(spread).transpose())?;
    let draw = |scenery: &Scenery| carried::sum(scenery, &total, &shares, &reports, spread.as_ref());
    let page = runtime.stage("draw", || scenery.as_ref().map(draw).transpose())?;
    let carried = Carried { dose: &total, weights, parts: reports, sources: &doses, spread };
    finish(&out, carried, provenance, page, &fields)
}

/// One dose and how it is to be carried.
struct Mapping<'a> {
    dose: &'a Volume<f32>,
    dose_file: &'a Path,
    /// The grid of the result, and the file that tells its frame.
    to: &'a Grid,
    to_file: Framed<'a>,
    /// The field, of which one direction is enough, and the option that names it where that is not the direction's own.
    push: Option<&'a Path>,
    pull: Option<&'a Path>,
    option: Option<InputRole>,
    direction: Direction,
    method: &'a DoseMethod,
    /// The CT that the dose was computed on.
    ct: Option<&'a Volume<f32>>,
}

impl<'a> Mapping<'a> {
    /// Reads the field and carries the dose, with a weight through the samples of its registration too.
    fn carry(
        &self,
        through: Option<(&mut SampledDoses, usize, f64)>,
        provenance: &mut Provenance,
        runtime: &Runtime,
    ) -> Result<(Volume<f32>, DoseReport)> {
        let &Self { dose, dose_file, to, to_file, direction, ct, .. } = self;
        // The missing direction is made where it is needed: on the target's grid, or on the dose's own for energy and mass.
        let frames = match direction {
            Direction::PlanningToFraction => ["planning", "fraction"],
            Direction::FractionToPlanning => ["fraction", "planning"],
        };
        let known = |frame, file: Framed<'a>, grid| Known {
            frame,
            name: file.path.display().to_string(),
            place: Some(file),
            grid,
        };
        let dose_there = known(frames[0], Role::Dose.at(dose_file), dose.grid());
        let mut all = vec![dose_there, known(frames[1], to_file, to)];
        all.extend(ct.map(|ct| Known { frame: frames[0], name: "--ct".into(), place: None, grid: ct.grid() }));
        let grids = match direction {
            Direction::PlanningToFraction => [Some(dose.grid()), Some(to)],
            Direction::FractionToPlanning => [Some(to), Some(dose.grid())],
        };
        let read = || fields::pair([self.push, self.pull].map(fields::file), self.option, grids, &all, provenance);
        let pair = runtime.stage("read and invert the field", read)?;
        if let Some((through, n, weight)) = through {
            runtime.stage("map dose through samples", || through.add(n, weight, self, &pair, provenance))?;
        }
        runtime.stage("map dose", || map_dose(dose, &pair, direction, to, self.method, ct))
    }
}

/// The method with its density table.
fn method(args: &MethodArgs) -> Result<DoseMethod> {
    if args.method == MethodName::Interpolate {
        return Ok(DoseMethod::Interpolate);
    }
    let density = match &args.density {
        Some(path) => io::read_density(path)?,
        None => DensityTable::default(),
    };
    Ok(DoseMethod::EnergyMass(EnergyMassOptions { parts: args.parts, density }))
}

/// Reads a dose and refuses what is none in Gy.
fn read_dose(provenance: &mut Provenance, path: &Path) -> Result<Volume<f32>> {
    Ok(read_told(provenance, path)?.dose)
}

fn compare(args: &CompareArgs) -> Result<String> {
    let maps = ["dose_difference.nii.gz", "distance_to_dose_difference.nii.gz", "compare.html"];
    let files = [&args.dose, &args.reference].into_iter().chain(&args.ct).chain(&args.dose_ct).map(PathBuf::as_path);
    let mut folder = run_folder(&args.out, &planned(&["compare.json"], &maps), &files.collect::<Vec<_>>())?;
    let mut provenance = Provenance::default();
    let (dose, reference) = (read_dose(&mut provenance, &args.dose)?, read_dose(&mut provenance, &args.reference)?);
    provenance.inputs.iter_mut().skip(1).for_each(|input| input.role = InputRole::Reference);
    let cts = pages::read_cts(args, &mut provenance)?;
    let most = f64::from(reference.extremes()[1].max(0.0));
    let tolerance = args.tolerance.unwrap_or(0.03 * most);
    if !(tolerance.is_finite() && tolerance > 0.0 && args.limit > 0.0 && args.limit <= 100.0) {
        return Err(Error::usage(
            format!("tolerance {tolerance} Gy, limit {} mm: out of range", args.limit),
            "give a tolerance above 0 Gy and a limit above 0 and up to 100 mm",
        ));
    }
    folder.begin()?;
    let (map, figures) = difference(&dose, &reference)?;
    provenance.warnings.extend(not_covered(&figures));
    let distance = distance_to_difference(&reference, tolerance, args.limit);
    let options = |text: &str| WriteOptions { description: text.into(), ..WriteOptions::default() };
    let path = args.out.join("dose_difference.nii.gz");
    io::write_image(path, &map, Stored::Float32, &options("aventail: dose minus reference, Gy"))?;
    let path = args.out.join("distance_to_dose_difference.nii.gz");
    io::write_image(path, &distance, Stored::Float32, &options("aventail: distance to dose difference, mm"))?;
    let (dose, reference) = (&dose, &reference);
    let found = pages::DosesCompared { dose, reference, difference: &map, figures: &figures, cts: &cts };
    pages::write_compare(&args.out, &found, &provenance)?;
    let json = serde_json::json!({
        "version": env!("CARGO_PKG_VERSION"), "command": command_line(),
        "inputs": provenance.seen_from(&args.out), "outputs": record::outputs(&args.out, &folder.written())?,
        "difference_gy": figures, "tolerance_gy": tolerance, "limit_mm": args.limit,
        "warnings": provenance.warnings,
    });
    write_json(args.out.join("compare.json"), &json)?;
    folder.finish();
    if args.told.json {
        return io::json(&json);
    }
    Ok(format!(
        "{}  dose minus reference, where both are known and either is above 10 % of the maximum: mean {:.3} Gy; magnitude mean {:.3}, 95 % {:.3}, greatest {:.3} Gy\nThe page: {}",
        listed(&provenance.warnings),
        figures.signed.mean,
        figures.magnitude.mean,
        figures.magnitude.p95,
        figures.magnitude.max,
        args.out.join("compare.html").display()
    ))
}

/// A word about what one of two doses does not cover.
fn not_covered(figures: &DoseDifference) -> Vec<Warning> {
    let mut all = Vec::new();
    let sides = [
        (figures.reference_outside, "reference", "the dose's", "; the map of differences is 0 there"),
        (figures.dose_outside, "dose", "the reference's", ""),
    ];
    for (outside, whose, grid, more) in sides {
        if outside.amount_percent > WORTH {
            let message = format!(
                "{:.1} % of the {whose}'s volume and {:.1} % of its dose lie outside {grid} grid and are left out of the \
                 figures{more}",
                outside.volume_percent, outside.amount_percent
            );
            all.push(Warning::new(findings::DOSE_OUTSIDE, message));
        }
    }
    all
}

/// Less of a dose outside another is not worth a word, percent.
const WORTH: f64 = 0.05;
