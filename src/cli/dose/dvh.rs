//! `aventail dose dvh`: histograms of structures that lie in the dose's frame, or that a registration carries there.

use super::super::terminal::progress;
use super::super::{planned, record, run_folder};
use super::args::DvhArgs;
use super::counted::{read_to_carry, read_told};
use super::sampled::SampledDoses;
use super::structures::Structures;
use super::{Mapping, pages};
use crate::dose::{Dvh, doubts};
use crate::error::{Error, Result};
use crate::evaluate::Direction;
use crate::geometry::Grid;
use crate::io;
use crate::io::dicom::{Framed, Role};
use crate::pipeline::DoseMethod;
use crate::provenance::Provenance;
use crate::report::dose::{DoseDvh, SampledDose, dvh_table, write_dvh};
use crate::runtime::Runtime;
use crate::volume::Volume;
use nalgebra::{Matrix3, Point3, Vector3};
use std::path::{Path, PathBuf};

/// Files that it may write.
const FILES: [&str; 6] = ["dvh.json", "dvh.csv", "dvh_figures.csv", "dvh_intervals.csv", "dvh.png", "dvh.html"];
/// Voxels around the structures onto which a dose is carried.
const AROUND: f64 = 2.0;

/// Reads structures and doses, and writes the histograms.
pub(super) fn run(args: &DvhArgs) -> Result<String> {
    if !(args.bin.is_finite() && args.bin >= 1e-3) {
        return Err(Error::usage(format!("--bin {} Gy is too small", args.bin), "give at least 0.001 Gy"));
    }
    let sampled = args.sampled();
    let samples = sampled.files();
    let files = args.dose.iter().chain([&args.structures]).chain(&args.labels).chain(&samples);
    let files = files.chain(args.fields().into_iter().flatten()).map(PathBuf::as_path);
    let mut folder = run_folder(&args.out, &planned(&["dvh_run.json"], &FILES), &files.collect::<Vec<_>>())?;
    let carried = args.fields().iter().any(Option::is_some);
    if args.samples.is_some() && !carried {
        let problem =
            "--samples without a field: they tell how far structures of planning may be off in a dose of the fraction";
        return Err(Error::usage(problem, "add --planning-to-fraction FILE, the field of the run that they lie in"));
    }
    let told = args.common.told.json;
    let runtime = Runtime::new(args.common.work.threads, progress(args.common.shown.quiet || told))?;
    let mut provenance = Provenance::default();
    let doses: Vec<Framed<'_>> = args.dose.iter().map(|dose| Role::Dose.at(dose)).collect();
    let near = if carried { &[][..] } else { &doses };
    let structures = Structures::read(&mut provenance, &args.structures, args.labels.as_deref(), near)?;
    let common = std::mem::take(&mut provenance.warnings);
    let mut doses = Vec::new();
    for path in &args.dose {
        let read = if carried { read_to_carry } else { read_told };
        let dose = read(&mut provenance, path)?.dose;
        let (found, samples) = if carried {
            carry(args, (path, &dose), &structures, &mut provenance, &runtime)?
        } else {
            (structures.histograms(&dose, &args.at, args.bin), None)
        };
        let mut warnings = if doses.is_empty() { common.clone() } else { Vec::new() };
        warnings.append(&mut provenance.warnings);
        warnings.extend(doubts(&found));
        doses.push(DoseDvh { name: pages::stem(path), structures: found, samples, warnings });
    }
    folder.begin()?;
    let picture = write_dvh(&args.out, &doses, &structures.colours())?;
    pages::write_dvh(&args.out, &doses, picture, &provenance)?;
    record::write(&folder, &args.out, "dvh_run.json", provenance.inputs)?;
    folder.finish();
    if told {
        return io::json(&doses);
    }
    Ok(format!("{}The curves: {}", dvh_table(&doses), args.out.join("dvh.html").display()))
}

/// Histograms of structures of planning in a dose of the fraction: the dose is carried back to where they lie, by the registration
/// and through its samples, where there are any.
fn carry(
    args: &DvhArgs,
    (path, dose): (&Path, &Volume<f32>),
    structures: &Structures,
    provenance: &mut Provenance,
    runtime: &Runtime,
) -> Result<(Vec<Dvh>, Option<SampledDose>)> {
    let name = || args.structures.display().to_string();
    let to = structures.around().map(|around| lattice(&around, dose.grid())).transpose()?;
    let nothing = || Error::input(name(), "it holds no structure", "give structures of planning");
    let to = to.ok_or_else(nothing)?;
    let method = DoseMethod::Interpolate;
    let [push, pull] = args.fields().map(|field| field.map(PathBuf::as_path));
    let one = Mapping {
        dose,
        dose_file: path,
        to: &to,
        to_file: Role::Structures.at(&args.structures),
        push,
        pull,
        option: None,
        direction: Direction::FractionToPlanning,
        method: &method,
        ct: None,
    };
    let mut through = SampledDoses::read(&args.sampled(), 1, &method, &structures.names(), provenance)?;
    let (mapped, report) = one.carry(through.as_mut().map(|t| (t, 0, 1.0)), provenance, runtime)?;
    provenance.warnings.extend(report.warnings);
    let places = structures.places(&to);
    let found = places.histograms(&mapped, &args.at, args.bin);
    let Some(through) = through else { return Ok((found, None)) };
    let spread = || through.spread(&mapped, one.direction, Some(&places), &args.sampled());
    let spread = runtime.stage("compare samples", spread)?;
    Ok((found, Some(spread.told)))
}

/// A lattice along LPS around a box, as fine as a dose's.
fn lattice(around: &[Point3<f64>; 2], dose: &Grid) -> Result<Grid> {
    let spacing = dose.spacing();
    let [low, high] = around;
    let more = Vector3::from(spacing) * AROUND;
    let size = high - low + more * 2.0;
    let count = [0, 1, 2].map(|a| (size[a] / spacing[a]).ceil() as usize + 1);
    Grid::new(count, spacing, low - more, Matrix3::identity())
}
