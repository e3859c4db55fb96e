//! `aventail library`: artificial CTs in sampled postures, with all that is true about them.

mod args;
mod fit;
mod make;
mod sources;
mod write;

pub(super) use args::HELP;
pub use args::LibraryArgs;
use args::{MANIFEST, PAGE, PLAN};
pub use fit::{Fitted, fit};

use super::inputs::config_file;
use super::register::settings;
use super::terminal::command_line;
use super::terminal::harmless;
use super::terminal::progress;
use crate::config::{Config, RecordedInput};
use crate::error::{Error, Result};
use crate::io::postures::write_postures;
use crate::io::{self, Planned, RunFolder, relative_to, write_file, write_json};
use crate::pipeline::Posing;
use crate::progress::Silent;
use crate::report::{About, Gallery, Manifest, OutputFile, PostureRecord, RECORD, Rejected, library_page};
use crate::runtime::Runtime;
use crate::warning::{Warning, counted};
use make::Maker;
use sources::{Sources, without_volumes};
use std::fmt::Write as _;
use std::path::Path;

/// Makes the library, or finds the modes of fitted postures; returns the table (or JSON) for the terminal.
///
/// # Errors
/// Of every kind but failed registration; see [`Error`].
pub fn run(args: &LibraryArgs) -> Result<String> {
    if !args.fit.is_empty() {
        return fit::run(args);
    }
    let runtime = Runtime::new(args.run.work.threads, progress(args.run.shown.quiet))?;
    let file = args.config.as_deref().map(config_file).transpose()?.unwrap_or_default();
    let config = settings(&file, &args.run)?;
    let made = make(args, config, &file.inputs, &runtime, &command_line())?;
    if args.run.told.json {
        return io::json(&made.manifest);
    }
    let text = table(&made.records, &made.rejected) + &told(&made.warnings);
    Ok(format!("{text}The page: {}", args.out.join(PAGE).display()))
}

/// A library that was made.
#[derive(Debug)]
pub struct Made {
    /// What `library.json` holds.
    pub manifest: Manifest,
    records: Vec<PostureRecord>,
    rejected: Vec<Rejected>,
    warnings: Vec<Warning>,
}

/// Makes the library that the arguments ask for, by settings that are complete; `recorded` are inputs of an earlier run, for
/// those that the arguments do not name, and `command` is what asked for it.
///
/// # Errors
/// As [`run`].
pub fn make(
    args: &LibraryArgs,
    config: Config,
    recorded: &[RecordedInput],
    runtime: &Runtime,
    command: &str,
) -> Result<Made> {
    if let Some(problem) = args.problem() {
        return Err(Error::usage(problem, "correct it"));
    }
    let sources = Sources::load(args, config, recorded, command, runtime)?;
    let total = sources.plan.postures.len() + args.sample.unwrap_or(0) as usize;
    if total == 0 {
        return Err(Error::usage(
            "no posture is asked for: --sample is missing, and no plan lists any",
            "add --sample N, or [[postures]] to the plan",
        ));
    }
    let names: Vec<String> = (1..=total).map(|n| format!("posture_{n:03}")).collect();
    let mut folder = RunFolder::open(&args.out, &planned(&names, &sources), &sources.files(), command)?;
    let base = sources.key(args)?;
    // What an earlier run with the same settings has made is looked at again when its turn comes.
    let kept: Vec<&String> = names.iter().filter(|name| started(&args.out, name, &base)).collect();
    folder.go_on(|file| kept.iter().any(|name| file.starts_with(name)))?;
    let Sources { planning, plan, config, carried, degrade, provenance, .. } = sources;
    let posing = Posing::new(planning.into(), args.margin, &config, runtime)?;
    let mut maker = Maker {
        posing: &posing,
        plan: &plan,
        config: &config,
        carried: &carried,
        degrade: degrade.as_ref(),
        args,
        base,
        runtime: Runtime::new(args.run.work.threads, Box::new(Silent))?,
        rejected: Vec::new(),
        draws: 0,
    };
    let body = maker.patient()?;
    let mut gallery = {
        let planning = posing.planning();
        Gallery::new(&planning.ct, &planning.bones, &body, posing.skeleton(), total)
    };
    let mut records = Vec::new();
    for (n, name) in names.iter().enumerate() {
        let made = maker.posture(n, name, &mut gallery);
        if made.is_err() {
            folder.take_back(Path::new(name));
        }
        let record = made?;
        runtime.progress().note(&line(&record, n, total));
        records.push(record);
    }
    let Maker { rejected, .. } = maker;
    let about = About {
        version: env!("CARGO_PKG_VERSION").into(),
        command: command.to_owned(),
        inputs: provenance
            .inputs
            .into_iter()
            .map(|i| crate::provenance::InputFile { path: relative_to(&args.out, &i.path), about: None, ..i })
            .collect(),
        settings: without_volumes(&config).value()?,
        degraded: degrade.as_ref().map(serde_json::to_value).transpose().map_err(|e| Error::Internal(e.to_string()))?,
        plan: PLAN.into(),
        sampled: args.sample.unwrap_or(0) as usize,
        seed: args.seed,
        dimensions: plan.dimensions(),
        rejected,
        warnings: [provenance.warnings.as_slice(), posing.warnings(), &carried.warnings].concat(),
    };
    let head = ["The plan of a library of postures, in full.".to_owned()];
    write_postures(args.out.join(PLAN), posing.skeleton(), &plan, &head)?;
    finish(&args.out, folder, &posing, records, &gallery, about)
}

/// Writes page and manifest.
fn finish(
    out: &Path,
    folder: RunFolder,
    posing: &Posing,
    records: Vec<PostureRecord>,
    gallery: &Gallery,
    about: About,
) -> Result<Made> {
    let name = out.file_name().map_or_else(|| "library".into(), |n| n.to_string_lossy());
    let page = library_page(&name, &records, gallery, &about)?;
    write_file(out.join(PAGE), |w| w.write_all(page.as_bytes()))?;
    let own = records
        .iter()
        .map(|r| OutputFile::written(out, &format!("{}/{RECORD}", r.name), "what is known of the posture"));
    let mut more: Vec<OutputFile> = own.collect::<Result<_>>()?;
    more.push(OutputFile::written(out, PLAN, "the plan in full, for --plan")?);
    more.push(OutputFile::written(out, PAGE, "the spread of the library as a page")?);
    let (rejected, warnings) = (about.rejected.clone(), about.warnings.clone());
    let manifest = Manifest::new(&records, &posing.planning().bones.names, about, more);
    write_json(out.join(MANIFEST), &manifest)?;
    folder.finish();
    Ok(Made { manifest, records, rejected, warnings })
}

/// A few warnings for the terminal; the page has all.
fn told(warnings: &[Warning]) -> String {
    let few = warnings.iter().take(SHOWN).map(|w| format!("  warning ({}): {}\n", w.code, harmless(&w.message)));
    let more = warnings.len().saturating_sub(SHOWN);
    let rest = (more > 0).then(|| {
        let more = counted(more, "more warning of the planning side is", "more warnings of the planning side are");
        format!("  {more} on the page\n")
    });
    few.chain(rest).collect()
}

/// Warnings that the terminal shows.
const SHOWN: usize = 4;

/// Whether a posture of an earlier run with these settings lies there.
fn started(out: &Path, name: &str, base: &str) -> bool {
    let text = std::fs::read(out.join(name).join(RECORD)).unwrap_or_default();
    serde_json::from_slice::<PostureRecord>(&text).is_ok_and(|r| r.key.starts_with(base))
}

/// Everything that may be written.
fn planned(names: &[String], sources: &Sources) -> Planned {
    let format = sources.config.output.field_format.extension();
    let fields = ["planning_to_fraction", "fraction_to_planning"].map(|f| format!("{f}.{format}"));
    let others = ["ct.nii.gz", "image.nii.gz", "labels.nii.gz", "dose.nii.gz", "contours.json"];
    let more = ["pose.toml", "bone_transforms.json", RECORD];
    let files: Vec<String> = others.into_iter().chain(more).map(String::from).chain(fields).collect();
    let of = |name: &String| files.iter().map(|f| format!("{name}/{f}")).collect::<Vec<_>>();
    Planned {
        reports: vec![MANIFEST.into(), PAGE.into()],
        names: names.iter().flat_map(of).chain([PLAN.to_owned()]).collect(),
    }
}

/// What is said of a posture when it is done.
fn line(record: &PostureRecord, n: usize, total: usize) -> String {
    let (bone, mm) = record.greatest().unwrap_or(("", 0.0));
    let odd = if record.plausible { String::new() } else { format!("; implausible: {}", record.why.join("; ")) };
    format!("{} of {total}: {bone} by {mm:.1} mm, {:.1} s{odd}", n + 1, record.seconds)
}

/// The figures for the terminal.
fn table(records: &[PostureRecord], rejected: &[Rejected]) -> String {
    let mut out = String::from(
        "posture       neck flexion  lateral  axial  jaw   couch left   back     up  most moved bone            folded\n",
    );
    for r in records {
        let ([x, y, z], [a, b, c]) = ([r.totals.couch[3], r.totals.couch[4], r.totals.couch[5]], r.totals.neck_deg);
        let (bone, mm) = r.greatest().unwrap_or(("", 0.0));
        let moved = format!("{bone} {mm:.1} mm");
        let odd = if r.plausible { "" } else { "  implausible" };
        writeln!(
            out,
            "{:13} {a:12.1} {b:8.1} {c:6.1} {:4.1} {x:12.1} {y:6.1} {z:6.1}  {moved:25} {:7}{odd}",
            r.name, r.totals.jaw_deg, r.jacobian.folded
        )
        .expect("writing to a String cannot fail");
    }
    for r in records.iter().filter(|r| !r.plausible) {
        writeln!(out, "  {} is implausible: {}", r.name, harmless(&r.why.join("; "))).expect("a String takes text");
    }
    if !rejected.is_empty() {
        writeln!(out, "  {} draws were implausible and not kept", rejected.len()).expect("a String takes text");
    }
    out
}
