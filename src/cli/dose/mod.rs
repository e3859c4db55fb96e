//! `aventail dose`: map, accumulate, compare, and read dose-volume histograms.

mod args;

pub use args::{AccumulateArgs, CompareArgs, DoseVerb, DvhArgs, Frame, MapArgs, MethodArgs, MethodName};

use super::evaluate::{DirectionName, Ledger, pair};
use super::register::progress;
use super::{command_line, planned, run_folder};
use crate::dose::{DensityTable, Dvh, EnergyMassOptions, accumulate, difference, distance_to_difference, dvh};
use crate::error::{Error, Result};
use crate::evaluate::Direction;
use crate::geometry::Grid;
use crate::io::{self, Stored, WriteOptions, write_json};
use crate::pipeline::{DoseMethod, DoseReport, InputFile, map_dose};
use crate::report::dose::{DoseDvh, dvh_table, write_dvh};
use crate::runtime::Runtime;
use crate::volume::contour::{Contours, Structure};
use crate::volume::{LabelMap, Volume};
use serde::Serialize;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};

/// Runs a verb of `dose`.
///
/// # Errors
/// Of every kind; see [`Error`].
pub(super) fn run(verb: &DoseVerb) -> Result<String> {
    match verb {
        DoseVerb::Map(args) => map(args),
        DoseVerb::Accumulate(args) => sum(args),
        DoseVerb::Dvh(args) => histograms(args),
        DoseVerb::Compare(args) => compare(args),
    }
}

/// What is written beside a mapped or accumulated dose.
#[derive(Serialize)]
struct Sidecar<'a> {
    version: &'a str,
    command: String,
    inputs: Vec<InputFile>,
    weights: Vec<f64>,
    parts: Vec<DoseReport>,
    warnings: Vec<crate::warning::Warning>,
}

fn map(args: &MapArgs) -> Result<String> {
    let method = method(&args.how)?;
    let fields = [&args.planning_to_fraction, &args.fraction_to_planning, &args.ct, &args.how.density];
    let files = fields.into_iter().flatten().chain([&args.dose, &args.grid]);
    check_out(&args.out, &files.map(PathBuf::as_path).collect::<Vec<_>>())?;
    let runtime = Runtime::new(args.how.threads, progress(args.how.json))?;
    let mut ledger = Ledger::default();
    let (dose, to, ct) = runtime.stage("read", || {
        let dose = read_dose(&mut ledger, &args.dose)?;
        let grid = ledger.take("grid", io::read_image(&args.grid)?).grid().clone();
        let ct = args.ct.as_ref().map(|p| Ok::<_, Error>(ledger.take("ct", io::read_image(p)?))).transpose()?;
        Ok::<_, Error>((dose, grid, ct))
    })?;
    let direction = match args.to {
        Frame::Fraction => Direction::PlanningToFraction,
        Frame::Planning => Direction::FractionToPlanning,
    };
    let fields = (args.planning_to_fraction.as_deref(), args.fraction_to_planning.as_deref());
    let (mapped, report) = carry(&dose, fields, direction, &to, &method, ct.as_ref(), &mut ledger, &runtime)?;
    finish(&args.out, &mapped, vec![1.0], vec![report], ledger, args.how.json)
}

fn sum(args: &AccumulateArgs) -> Result<String> {
    let method = method(&args.how)?;
    let n = args.dose.len();
    let counts = [("--fields", args.fields.len()), ("--weights", args.weights.len()), ("--ct", args.ct.len())];
    for (option, count) in counts {
        if count != n && (count > 0 || option == "--fields") {
            return Err(Error::usage(
                format!("{n} doses but {count} values of {option}"),
                format!("give one value of {option} for each dose, in the same order"),
            ));
        }
    }
    let weights = if args.weights.is_empty() { vec![1.0; n] } else { args.weights.clone() };
    if let Some(w) = weights.iter().find(|w| !(w.is_finite() && **w >= 0.0)) {
        return Err(Error::usage(format!("--weights {w} is negative or not finite"), "give numbers of fractions"));
    }
    let files = args.dose.iter().chain(&args.fields).chain(&args.ct).chain(&args.how.density).chain([&args.grid]);
    check_out(&args.out, &files.map(PathBuf::as_path).collect::<Vec<_>>())?;
    let runtime = Runtime::new(args.how.threads, progress(args.how.json))?;
    let mut ledger = Ledger::default();
    let to = ledger.take("grid", io::read_image(&args.grid)?).grid().clone();
    let mut total: Option<Volume<f32>> = None;
    let mut reports = Vec::new();
    for (k, path) in args.dose.iter().enumerate() {
        let dose = read_dose(&mut ledger, path)?;
        let ct = args.ct.get(k).map(|p| Ok::<_, Error>(ledger.take("ct", io::read_image(p)?))).transpose()?;
        let field = Some(args.fields[k].as_path());
        let fields = match args.direction {
            DirectionName::PlanningToFraction => (field, None),
            DirectionName::FractionToPlanning => (None, field),
        };
        let back = Direction::FractionToPlanning;
        let (mapped, report) = carry(&dose, fields, back, &to, &method, ct.as_ref(), &mut ledger, &runtime)?;
        total = Some(match &total {
            None => accumulate(&[(weights[k], &mapped)])?,
            Some(so_far) => accumulate(&[(1.0, so_far), (weights[k], &mapped)])?,
        });
        reports.push(report);
    }
    let total = total.ok_or_else(|| Error::usage("no dose is given", "add --dose FILE for each fraction"))?;
    finish(&args.out, &total, weights, reports, ledger, args.how.json)
}

/// Reads the field and carries one dose.
#[expect(clippy::too_many_arguments, reason = "the inputs of one mapping, used by map and accumulate alike")]
fn carry(
    dose: &Volume<f32>,
    (push, pull): (Option<&Path>, Option<&Path>),
    direction: Direction,
    to: &Grid,
    method: &DoseMethod,
    ct: Option<&Volume<f32>>,
    ledger: &mut Ledger,
    runtime: &Runtime,
) -> Result<(Volume<f32>, DoseReport)> {
    // The missing direction is made where it is needed: on the target's grid, or on the dose's own for energy and mass.
    let (planning, fraction) = match direction {
        Direction::PlanningToFraction => (dose.grid(), to),
        Direction::FractionToPlanning => (to, dose.grid()),
    };
    let pair =
        runtime.stage("read and invert the field", || pair(push, pull, Some(planning), Some(fraction), ledger))?;
    runtime.stage("map dose", || map_dose(dose, &pair, direction, to, method, ct))
}

/// Writes a dose and what is to be said about it.
fn finish(
    out: &Path,
    dose: &Volume<f32>,
    weights: Vec<f64>,
    parts: Vec<DoseReport>,
    ledger: Ledger,
    json: bool,
) -> Result<String> {
    let options = WriteOptions { description: "aventail: dose, Gy".into(), ..WriteOptions::default() };
    // What tells of an earlier dose goes before that dose does.
    if let Err(e) = std::fs::remove_file(beside(out))
        && e.kind() != std::io::ErrorKind::NotFound
    {
        return Err(Error::write(beside(out), e.to_string(), "remove it, or give another --out"));
    }
    io::write_image(out, dose, Stored::Float32, &options)?;
    let text = table(&parts);
    let command = command_line();
    let (inputs, warnings) = (ledger.seen_from(parent(out)), ledger.warnings);
    let sidecar = Sidecar { version: env!("CARGO_PKG_VERSION"), command, inputs, weights, parts, warnings };
    write_json(beside(out), &sidecar)?;
    if json {
        return io::json(&sidecar);
    }
    Ok(format!("{text}The dose: {}", out.display()))
}

/// The figures of each part for the terminal.
fn table(parts: &[DoseReport]) -> String {
    let mut text = String::new();
    for (n, part) in parts.iter().enumerate() {
        let mut line = |t: String| writeln!(text, "  {t}").expect("writing to a String cannot fail");
        line(format!("dose {}: {}", n + 1, part.direction.name()));
        if let Some(b) = &part.balance {
            line(format!(
                "energy: {:.6e} J in, {:.6e} J mapped, {:.3e} J outside the target grid; relative error {:.1e}",
                b.source_j, b.mapped_j, b.outside_j, b.relative_error
            ));
            line(format!("mass: {:.1} g in, {:.1} g mapped", b.source_g, b.mapped_g));
        }
        if let Some(i) = &part.inversion {
            let r = &i.residual_mm;
            line(format!(
                "field inverted: residual {:.1e} mm mean, {:.1e} mm worst, {} voxels unconverged",
                r.mean, r.max, i.unconverged
            ));
        }
        for w in &part.warnings {
            line(format!("warning ({}): {}", w.code, w.message));
        }
    }
    text
}

/// The sidecar's path: the dose's with its extensions replaced.
fn beside(out: &Path) -> PathBuf {
    let name = out.file_name().unwrap_or_default().to_string_lossy();
    let stem = [".nii.gz", ".nii", ".mha", ".nrrd"].iter().find_map(|e| name.strip_suffix(e)).unwrap_or(&name);
    out.with_file_name(format!("{stem}.json"))
}

/// Refuses a path that cannot be written before anything long begins.
fn check_out(out: &Path, inputs: &[&Path]) -> Result<()> {
    crate::field::FieldFormat::of(out)?;
    io::check_files(inputs, &[out.to_owned(), beside(out)])?;
    io::open_folder(parent(out))
}

/// The folder of a file.
fn parent(file: &Path) -> &Path {
    file.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."))
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

/// A dose beyond this is not in Gy.
const MOST_GY: f32 = 500.0;

/// Reads a dose and refuses what is none in Gy.
fn read_dose(ledger: &mut Ledger, path: &Path) -> Result<Volume<f32>> {
    let dose = ledger.take("dose", io::read_image(path)?);
    match dose.data().iter().position(|d| !(0.0..=MOST_GY).contains(d)) {
        None => Ok(dose),
        Some(first) => Err(Error::input(
            path.display().to_string(),
            format!("the dose is {} Gy at voxel {:?}", dose.data()[first], dose.grid().voxel(first)),
            format!("give a dose from 0 to {MOST_GY} Gy: not cGy, not a difference of doses, no CT"),
        )),
    }
}

/// Structures as labels, or as contours, which may overlap.
enum Structures {
    Labels(Box<LabelMap>),
    Contours(Contours),
}

impl Structures {
    fn read(ledger: &mut Ledger, args: &DvhArgs) -> Result<Self> {
        if args.structures.extension().is_some_and(|e| e.eq_ignore_ascii_case("json")) {
            return Ok(Self::Contours(io::read_contours(&args.structures)?.0));
        }
        Ok(Self::Labels(Box::new(ledger.labels("structures", &args.structures, args.labels.as_deref())?)))
    }

    /// Each structure's histogram; contours are sampled on the dose's own grid.
    fn histograms(&self, dose: &Volume<f32>, args: &DvhArgs) -> Vec<Dvh> {
        match self {
            Self::Labels(map) => dvh(dose, map, &args.at, args.bin),
            Self::Contours(all) => {
                let [.., height] = dose.grid().spacing();
                let spacing = all.spacing(height);
                let one = |s: &Structure| {
                    let inside = all.solid(s, spacing).mask(dose.grid());
                    let map = LabelMap { volume: inside.map(|&i| u16::from(i)), names: [(1, s.name.clone())].into() };
                    dvh(dose, &map, &args.at, args.bin)
                };
                all.structures.iter().flat_map(one).collect()
            }
        }
    }
}

fn histograms(args: &DvhArgs) -> Result<String> {
    if !(args.bin.is_finite() && args.bin >= 1e-3) {
        return Err(Error::usage(format!("--bin {} Gy is too small", args.bin), "give at least 0.001 Gy"));
    }
    let files = args.dose.iter().chain([&args.structures]).chain(&args.labels).map(PathBuf::as_path);
    let names = planned(&["dvh.json"], &["dvh.csv", "dvh_figures.csv", "dvh.png"]);
    let mut folder = run_folder(&args.out, &names, &files.collect::<Vec<_>>())?;
    let mut ledger = Ledger::default();
    let structures = Structures::read(&mut ledger, args)?;
    let mut doses = Vec::new();
    for path in &args.dose {
        let dose = read_dose(&mut ledger, path)?;
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        let name = name.split('.').next().unwrap_or_default().to_owned();
        doses.push(DoseDvh { name, structures: structures.histograms(&dose, args) });
    }
    folder.begin()?;
    write_dvh(&args.out, &doses)?;
    folder.finish();
    if args.json {
        return io::json(&doses);
    }
    Ok(format!("{}The curves: {}", dvh_table(&doses), args.out.join("dvh.png").display()))
}

fn compare(args: &CompareArgs) -> Result<String> {
    let names = planned(&["compare.json"], &["dose_difference.nii.gz", "distance_to_dose_difference.nii.gz"]);
    let mut folder = run_folder(&args.out, &names, &[&args.dose, &args.reference])?;
    let mut ledger = Ledger::default();
    let (dose, reference) = (read_dose(&mut ledger, &args.dose)?, read_dose(&mut ledger, &args.reference)?);
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
    let distance = distance_to_difference(&reference, tolerance, args.limit);
    let options = |text: &str| WriteOptions { description: text.into(), ..WriteOptions::default() };
    let path = args.out.join("dose_difference.nii.gz");
    io::write_image(path, &map, Stored::Float32, &options("aventail: dose minus reference, Gy"))?;
    let path = args.out.join("distance_to_dose_difference.nii.gz");
    io::write_image(path, &distance, Stored::Float32, &options("aventail: distance to dose difference, mm"))?;
    let json = serde_json::json!({
        "inputs": ledger.seen_from(&args.out), "difference_gy": figures, "tolerance_gy": tolerance, "limit_mm": args.limit,
    });
    write_json(args.out.join("compare.json"), &json)?;
    folder.finish();
    if args.json {
        return io::json(&json);
    }
    Ok(format!(
        "  dose minus reference, where either is above 10 % of the maximum: mean {:.3} Gy; magnitude mean {:.3}, 95 % {:.3}, greatest {:.3} Gy\nThe maps: {}",
        figures.signed.mean,
        figures.magnitude.mean,
        figures.magnitude.p95,
        figures.magnitude.max,
        args.out.display()
    ))
}
