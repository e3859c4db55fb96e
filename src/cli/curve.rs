//! `aventail curve`: error against run time over the settings that matter.

use super::args::{QuietArgs, ThreadArgs};
use super::terminal::progress;
use super::{planned, record, run_folder};
use crate::config::{Config, InputRole, StudyPlan};
use crate::error::{Error, Result};
use crate::phantom::{Phantom, PhantomOptions, phantom_case};
use crate::pipeline::{Case, CurvePoint, FractionScan, measure};
use crate::provenance::Provenance;
use crate::report::{CurveEntry, Peer, write_curve};
use crate::runtime::Runtime;
use crate::session::{FractionSources, PlanningSources, Source};
use clap::Args;
use serde::Deserialize;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

pub(super) const HELP: &str = "\
Registers the case with each setting of the plan in turn, and with the default on fewer threads;
the time is that of the registration, without reading and writing files. The error is the mean
landmark error. Without landmarks, give a third scan of the patient with --around: the error is the
miss of the way around, planning to fraction to third scan against planning to third scan, at 20 000
points of soft tissue. Errors that all ways have in common do not show in it: bones without images
agree best, and miss what tissue does by itself. Without a case of your own it is measured on the phantom, at 20 000 points of soft
tissue whose motion is known. Writes curve.png, curve.csv and curve.md;
curve.json has their checksums for `aventail inspect`.

--peers takes a table with the columns name, seconds, error_mm: other tools' results on the same
case, which are drawn in the same plot.

Examples:
  aventail curve --out curve
  aventail curve --planning planning_ct.nii.gz --bones bones.nii.gz --fraction fraction_ct.nii.gz \\
    --landmarks landmarks.csv --out curve
  aventail curve --planning ct_1.nii.gz --bones bones_1.nii.gz --fraction ct_2.nii.gz \\
    --around ct_3.nii.gz --out curve";

/// Options of `curve`.
#[derive(Debug, Args)]
pub struct CurveArgs {
    /// Planning CT; without it the phantom is registered
    #[arg(long, value_name = "FILE", requires_all = ["bones", "fraction", "known"])]
    pub planning: Option<PathBuf>,
    /// Bone labels on the planning grid
    #[arg(long, value_name = "FILE", requires = "planning")]
    pub bones: Option<PathBuf>,
    /// Names of the labels (JSON)
    #[arg(long, value_name = "FILE", requires = "planning")]
    pub labels: Option<PathBuf>,
    /// Fraction CT
    #[arg(long, value_name = "FILE", requires = "planning")]
    pub fraction: Option<PathBuf>,
    /// Points known in both scans (CSV), on which the error is measured
    #[arg(long, value_name = "FILE", requires = "planning", group = "known")]
    pub landmarks: Option<PathBuf>,
    /// Third scan of the patient, when no points are known: the way around it is the error
    #[arg(long, value_name = "FILE", requires = "planning", group = "known")]
    pub around: Option<PathBuf>,
    /// Plan (TOML) of the settings to run; default: data/curve.toml of the sources, which is built
    /// in
    #[arg(long, value_name = "FILE")]
    pub plan: Option<PathBuf>,
    /// Other tools' results on the same case (CSV: name, seconds, error_mm)
    #[arg(long, value_name = "FILE")]
    pub peers: Option<PathBuf>,
    /// Folder for the results; made if missing
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// Threads.
    #[command(flatten)]
    pub work: ThreadArgs,
    /// Whether progress is shown.
    #[command(flatten)]
    pub shown: QuietArgs,
}

/// Measures every setting and writes the curve; returns the table.
///
/// # Errors
/// When a file cannot be read or written, or the plan's settings are not legal.
pub fn run(args: &CurveArgs) -> Result<String> {
    let plan = args.plan.as_deref().map_or_else(StudyPlan::curve, StudyPlan::read)?;
    let stages = plan.stages()?;
    let peers = args.peers.as_deref().map(read_peers).transpose()?.unwrap_or_default();
    let files = [&args.planning, &args.bones, &args.labels, &args.fraction, &args.landmarks, &args.around];
    let files = files.into_iter().chain([&args.plan, &args.peers]);
    let files: Vec<&Path> = files.filter_map(|p| p.as_deref()).collect();
    let mut folder = run_folder(&args.out, &planned(&["curve.json"], &["curve.md", "curve.csv", "curve.png"]), &files)?;
    let runtime = Runtime::new(args.work.threads, progress(args.shown.quiet))?;
    let (title, case, mut provenance) = load(args, &runtime)?;
    let third = args.around.as_deref().map(third).transpose()?;
    let mut points = BTreeMap::new();
    for (n, (stage, config)) in stages.iter().enumerate() {
        runtime.progress().note(&format!("[{}/{}] {}", n + 1, stages.len(), stage.id));
        points.insert(stage.id.as_str(), measure(&case, third.as_ref(), config, &runtime)?);
    }
    let mut entries = Vec::new();
    for table in &plan.tables {
        for stage in &table.stages {
            if let Some(point) = points.get(stage.id.as_str()) {
                entries.push(CurveEntry {
                    series: table.title.clone(),
                    name: stage.name.clone(),
                    default: stage.settings.is_empty(),
                    point: point.clone(),
                });
            }
        }
    }
    if let Some((stage, config)) = stages.iter().find(|(stage, _)| stage.settings.is_empty()) {
        entries.extend(by_threads(args, (&case, third.as_ref()), config, &points[stage.id.as_str()], &runtime)?);
    }
    folder.begin()?;
    let text = write_curve(&args.out, &title, &entries, &peers)?;
    for (role, path) in
        [(InputRole::Around, &args.around), (InputRole::Plan, &args.plan), (InputRole::Peers, &args.peers)]
    {
        path.as_deref().map_or(Ok(()), |path| provenance.note(role, path))?;
    }
    record::write(&folder, &args.out, "curve.json", provenance.inputs)?;
    folder.finish();
    Ok(format!("{text}\nThe picture: {}", args.out.join("curve.png").display()))
}

/// The default with 1, 2, 4 and so on threads up to those of `runtime`, with which it is measured already.
fn by_threads(
    args: &CurveArgs,
    (case, third): (&Case, Option<&FractionScan>),
    config: &Config,
    all: &CurvePoint,
    runtime: &Runtime,
) -> Result<Vec<CurveEntry>> {
    let most = runtime.threads();
    let entry = |threads: usize, point: CurvePoint| CurveEntry {
        series: "threads".into(),
        name: threads.to_string(),
        default: threads == most,
        point,
    };
    let mut entries = Vec::new();
    for threads in (0..).map(|n| 1 << n).take_while(|threads| *threads < most) {
        runtime.progress().note(&format!("threads: {threads}"));
        let runtime = Runtime::new(threads, progress(args.shown.quiet))?;
        entries.push(entry(threads, measure(case, third, config, &runtime)?));
    }
    if !entries.is_empty() {
        entries.push(entry(most, all.clone()));
    }
    Ok(entries)
}

/// The user's case, or the phantom, with its name and its files.
fn load(args: &CurveArgs, runtime: &Runtime) -> Result<(String, Case, Provenance)> {
    let (Some(fraction), Some(planning), Some(bones)) = (&args.fraction, &args.planning, &args.bones) else {
        let phantom = runtime.stage("make the phantom", || Phantom::new(&PhantomOptions::default()))?;
        return Ok(("the phantom".into(), phantom_case(phantom), Provenance::default()));
    };
    let mut side = PlanningSources::new(Source::File(planning.clone()), Source::File(bones.clone()));
    side.names = args.labels.clone().map(Source::File);
    let (scan, mut provenance) = side.read(&[], &Config::default(), runtime)?;
    let mut one = FractionSources::new(Source::File(fraction.clone()));
    one.landmarks = args.landmarks.clone().map(Source::File);
    let (scan_of_fraction, of_fraction) = runtime.stage("read the fraction", || one.read(&[]))?;
    provenance.extend(of_fraction);
    let title = match &args.around {
        None => fraction.display().to_string(),
        Some(third) => format!("{}, way around by {}", third.display(), fraction.display()),
    };
    Ok((title, Case { planning: scan.into(), fraction: scan_of_fraction }, provenance))
}

/// The third scan of the patient.
fn third(path: &Path) -> Result<FractionScan> {
    Ok(FractionSources::new(Source::File(path.to_owned())).read(&[])?.0)
}

/// A row of the table of peers.
#[derive(Deserialize)]
struct PeerRow {
    name: String,
    seconds: f64,
    error_mm: f64,
}

fn read_peers(path: &Path) -> Result<Vec<Peer>> {
    let remedy = "give a CSV table with the columns name, seconds, error_mm";
    let mut reader = csv::Reader::from_path(path).map_err(|e| Error::read(path, e.to_string(), remedy))?;
    let rows: Vec<PeerRow> = reader
        .deserialize()
        .collect::<std::result::Result<_, _>>()
        .map_err(|e: csv::Error| Error::read(path, e.to_string(), remedy))?;
    if let Some(bad) = rows.iter().find(|r| !(r.seconds.is_finite() && r.error_mm.is_finite())) {
        return Err(Error::read(path, format!("{}: its numbers are not finite", bad.name), remedy));
    }
    Ok(rows.into_iter().map(|r| Peer { name: r.name, seconds: r.seconds, error_mm: r.error_mm }).collect())
}
