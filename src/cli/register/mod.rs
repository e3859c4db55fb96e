//! `aventail register`: load, run, write.

mod args;
mod index;

pub(super) use args::HELP;
pub use args::{FitName, LandmarkUseName, ModalityName, RegisterArgs};

use super::args::{PresetName, RunArgs, SpeedName};
use super::inputs::{config_file, either, needed, planning_side};
use super::run_folder;
use super::terminal::{command_line, progress};
use crate::config::{Config, ConfigFile, InputRole, Modality, Preset, RecordedInput};
use crate::error::{Error, Result};
use crate::evaluate::couch::CouchOptions;
use crate::fit::LandmarkUse;
use crate::io::{self, RunFolder, auto::AUTO};
use crate::progress::Progress;
use crate::report::{self, Clinic, Report};
use crate::runtime::Runtime;
use crate::sampling::SamplingOptions;
use crate::session::{
    Beside, BonesBy, DrawnSamples, FractionSources, Registered, Request, Session, Source, within_memory,
};
use crate::volume::region::RegionOptions;
use crate::warning::counted;
use index::Index;
use serde::Serialize;
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

/// Registers the fractions that the arguments name and writes the results; returns the table (or JSON) for the terminal.
///
/// # Errors
/// Of every kind; see [`Error`].
pub fn run(args: &RegisterArgs) -> Result<String> {
    run_shown(args, progress)
}

/// As [`run`], with another way to show progress; it is told whether to be quiet.
pub(super) fn run_shown(args: &RegisterArgs, show: impl Fn(bool) -> Box<dyn Progress>) -> Result<String> {
    let (mut request, names) = asked(args)?;
    let samples = sampling(args)?;
    let runtime = Runtime::new(args.run.work.threads, show(args.run.shown.quiet || args.estimate))?;
    let command = request.command.clone();
    if args.out.is_none() && request.wants_bones() {
        let problem = "labels that are \"auto\" are made first and kept beside --out, which is not given";
        return Err(Error::usage(problem, "add --out DIR, or give labels"));
    }
    let beside = BonesBy { beside: args.folder(), command: &command, quiet: args.run.shown.quiet };
    request.make_bones(beside, &runtime)?;
    if args.estimate {
        request.settle()?;
        let memory_bytes = request.expected_memory()?;
        return Estimate { memory_bytes, threads: runtime.threads() }.told(args.run.told.json);
    }
    let folder_of = |name: &str| if names.len() > 1 { args.folder().join(name) } else { args.folder().to_owned() };
    let folders: Vec<PathBuf> = names.iter().map(|name| folder_of(name)).collect();
    let (mut index, held) = hold(args, &request, &folders)?;
    let expected = request.expected_memory()?;
    runtime.progress().note(&format!("about {:.1} GB of memory will be needed", expected as f64 / 1e9));
    within_memory(expected, args.max_memory)?;
    let mut waiting = folders.iter().zip(held);
    let mut texts = Vec::new();
    Session::open(request, &runtime)?.register_all(&runtime, |registered| {
        index.iter_mut().filter(|_| texts.is_empty()).try_for_each(Index::begin)?;
        let (out, folder) = waiting.next().ok_or_else(|| Error::Internal("no folder is held".into()))?;
        let mut registered = registered;
        // The registration is saved where its samples cannot be drawn, too.
        let drawn = samples.as_ref().map(|options| registered.draw_samples(options, &runtime));
        let shown = drawn.as_ref().and_then(|drawn| drawn.as_ref().ok()).map(DrawnSamples::shown);
        let beside = Beside { view: !args.run.no_view, files: &[], samples: shown };
        let (text, report) = told(&mut registered, folder, out, beside, &args.run, &runtime)?;
        texts.push(text);
        drawn.transpose()?.map_or(Ok(()), |drawn| registered.save_samples(&drawn, &report, out, &runtime))
    })?;
    all_told(texts, &names, index, args.run.told.json)
}

/// What the arguments and a run that is done again ask for, and what each fraction is called.
fn asked(args: &RegisterArgs) -> Result<(Request, Vec<String>)> {
    let file = args.config.as_deref().map(config_file).transpose()?.unwrap_or_default();
    let config = config_of(args, &file)?;
    // What is missing is told in the order of the help.
    needed(&args.side.planning, InputRole::Planning, &file.inputs)?;
    let (fractions, folders) = fractions(args, &file)?;
    guides_of_both(args, &file, &fractions)?;
    let mut recorded = file.inputs.clone();
    let mut planning = planning_side(&args.side, &args.organs.organs, &mut recorded)?;
    let names = either(&args.guide_labels, InputRole::GuideLabels, &file.inputs).map(Source::File);
    let guide = either(&args.guide, InputRole::Guide, &file.inputs);
    planning.guides = guide.map(|guide| (Source::File(guide), names));
    let request = Request {
        planning,
        fractions,
        clinic: args.clinic.dicom.then(|| args.clinic.files()),
        anonymous: args.clinic.anonymous,
        same_frame: args.clinic.same_frame,
        recorded,
        config,
        command: command_line(),
    };
    Ok((request, folders))
}

/// Refuses structures that guide from one scan alone.
fn guides_of_both(args: &RegisterArgs, file: &ConfigFile, fractions: &[FractionSources]) -> Result<()> {
    let planning = either(&args.guide, InputRole::Guide, &file.inputs).is_some();
    let odd = fractions.iter().any(|one| one.guides.is_some() != planning);
    let named = !args.guide_names.is_empty() || args.guide_labels.is_some();
    let alone = named && !planning;
    if !odd && !alone {
        return Ok(());
    }
    let problem = "guides are given for one scan only; they need the structures of both";
    Err(Error::usage(problem, "give --guide and, for each --fraction, --fraction-guide"))
}

/// What the terminal is told of all fractions, whose index is written where there are several.
fn all_told(mut texts: Vec<String>, names: &[String], index: Option<Index>, json: bool) -> Result<String> {
    let names: Vec<&str> = names.iter().map(String::as_str).collect();
    let page = index.map(|index| index.write(&names)).transpose()?;
    Ok(match page {
        None => texts.swap_remove(0),
        Some(_) if json => format!("[\n{}\n]", texts.join(",\n")),
        Some(page) => {
            let named = names.iter().zip(&texts).map(|(name, text)| format!("{name}\n{text}"));
            format!("{}\n\nAll fractions: {}", named.collect::<Vec<_>>().join("\n\n"), page.display())
        }
    })
}

/// What a run is expected to need, for schedulers.
#[derive(Serialize)]
struct Estimate {
    /// Peak resident memory, bytes.
    memory_bytes: u64,
    /// Threads that it will use.
    threads: usize,
}

impl Estimate {
    fn told(&self, json: bool) -> Result<String> {
        if json {
            return io::json(self);
        }
        let threads = counted(self.threads, "thread", "threads");
        Ok(format!("about {:.1} GB of memory on {threads}", self.memory_bytes as f64 / 1e9))
    }
}

/// Takes hold of the folder of each fraction, and of the one above several, before anything is read.
fn hold(args: &RegisterArgs, request: &Request, folders: &[PathBuf]) -> Result<(Option<Index>, Vec<RunFolder>)> {
    let files = request.files();
    let files: Vec<&Path> = files.iter().map(PathBuf::as_path).chain(args.config.as_deref()).collect();
    let planned = Registered::planned(&request.config, request.clinic.is_some());
    let index = (folders.len() > 1).then(|| Index::hold(args.folder(), &files)).transpose()?;
    Ok((index, folders.iter().map(|folder| run_folder(folder, &planned, &files)).collect::<Result<_>>()?))
}

/// The settings of file and flags.
fn config_of(args: &RegisterArgs, file: &ConfigFile) -> Result<Config> {
    let mut config = settings(file, &args.run)?;
    if let Some(r#use) = args.bone_landmarks_use {
        config.fit.bone_landmarks = match r#use {
            LandmarkUseName::Start => LandmarkUse::Start,
            LandmarkUseName::Replace => LandmarkUse::Replace,
        };
    }
    if let Some(FitName::Labels) = args.fit {
        config.fit.bone_landmarks = LandmarkUse::Replace;
    }
    let modality = |name| match name {
        ModalityName::Ct => Modality::Ct,
        ModalityName::Mr => Modality::Mr,
    };
    config.fraction.modality = args.modality.map_or(config.fraction.modality, modality);
    config.planning.modality = args.planning_modality.map_or(config.planning.modality, modality);
    args.organs.apply(&mut config)?;
    if !args.guide_names.is_empty() {
        config.refine.guide.names = args.guide_names.iter().map(|name| name.trim().to_owned()).collect();
    }
    if let Some(text) = &args.roi {
        let corners = corners(text).map_err(|problem| {
            Error::usage(format!("--roi {text}: {problem}"), "give a label's name or x0,y0,z0,x1,y1,z1")
        })?;
        let label = corners.is_none().then(|| text.clone());
        config.region = RegionOptions { label, box_mm: corners, ..config.region };
        if let Some(problem) = config.region.problem() {
            return Err(Error::usage(format!("--roi {text}: {problem}"), "give a label's name or x0,y0,z0,x1,y1,z1"));
        }
    }
    if let Some(text) = &args.couch_match {
        config.couch = couch_of(text)?;
    }
    if args.clinic.dicom {
        Clinic::check(&config)?;
    }
    Ok(config)
}

/// Six numbers as a box; nothing where the text is a name.
fn corners(text: &str) -> std::result::Result<Option<[f64; 6]>, String> {
    let numbers: Option<Vec<f64>> = text.split(',').map(|t| t.trim().parse().ok()).collect();
    match numbers.map(<[f64; 6]>::try_from) {
        None => Ok(None),
        Some(Ok(corners)) => Ok(Some(corners)),
        Some(Err(other)) => Err(match other.len() {
            1 => "1 number is no box".to_owned(),
            n => format!("{n} numbers are no box: 6 are needed"),
        }),
    }
}

/// What the couch shift is matched on.
fn couch_of(text: &str) -> Result<CouchOptions> {
    const REMEDY: &str = "give spine, names of bones (skull,vertebrae_C1) or x0,y0,z0,x1,y1,z1 in LPS mm";
    let wrong = |problem: String| Error::usage(format!("--match {text}: {problem}"), REMEDY);
    let box_mm = corners(text).map_err(wrong)?;
    let names = || text.split(',').map(|name| name.trim().to_owned()).collect::<Vec<_>>();
    let bones = if box_mm.is_some() || text == "spine" { Vec::new() } else { names() };
    if bones.iter().any(String::is_empty) {
        return Err(wrong("a name is empty".into()));
    }
    let couch = CouchOptions { bones, box_mm };
    couch.problem().map_or(Ok(couch), |problem| Err(wrong(problem)))
}

/// The fractions that the arguments name, else the one of the recorded run; and their names, which are those of their folders.
fn fractions(args: &RegisterArgs, file: &ConfigFile) -> Result<(Vec<FractionSources>, Vec<String>)> {
    let files = match args.fraction.as_slice() {
        [] => vec![needed(&None, InputRole::Fraction, &file.inputs)?],
        files => files.to_vec(),
    };
    let each = |given: &[PathBuf], role, what| one_each(given, role, what, &file.inputs, files.len());
    let landmarks = each(&args.landmarks, InputRole::Landmarks, "files of landmarks")?;
    let labelled = each(&args.fraction_bones, InputRole::FractionBones, "label maps of fractions")?;
    let guides = each(&args.fraction_guide, InputRole::FractionGuide, "files of guides")?;
    let guide_names = either(&args.guide_labels, InputRole::GuideLabels, &file.inputs);
    let several = files.len() > 1;
    if several && (args.bone_landmarks.is_some() || args.start.is_some()) {
        return Err(Error::usage(
            "--bone-landmarks and --start belong to one fraction, and several are given",
            "register the fractions one by one",
        ));
    }
    let stem = |path: &PathBuf| {
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        name.split('.').next().unwrap_or_default().to_owned()
    };
    let mut names: Vec<String> = files.iter().map(stem).collect();
    let distinct: BTreeSet<&String> = names.iter().collect();
    if distinct.len() < names.len() || names.iter().any(String::is_empty) {
        names = (1..=files.len()).map(|n| n.to_string()).collect();
    }
    let given = either(&args.fraction_labels, InputRole::FractionLabels, &file.inputs);
    let names_of = |labels: &Path| given.clone().filter(|_| labels != Path::new(AUTO));
    let recorded_start = || file.inputs.iter().find(|i| i.role == InputRole::Start).map(|i| i.given());
    let one = |(n, (file, name)): (usize, (PathBuf, &String))| {
        let (landmarks, labels) = (landmarks[n].clone(), labelled[n].clone());
        let mut one = FractionSources::new(Source::File(file));
        one.landmarks = landmarks.map(Source::File);
        let names = |labels: &PathBuf| names_of(labels).map(Source::File);
        one.bones = labels.map(|labels| (Source::File(labels.clone()), names(&labels)));
        let of_guides = || guide_names.clone().map(Source::File);
        one.guides = guides[n].clone().map(|guides| (Source::File(guides), of_guides()));
        one.name = if several { name.clone() } else { String::new() };
        one
    };
    let mut all: Vec<FractionSources> = files.into_iter().zip(&names).enumerate().map(one).collect();
    if let [only] = all.as_mut_slice() {
        let marks = either(&args.bone_landmarks, InputRole::BoneLandmarks, &file.inputs);
        only.bone_landmarks = marks.map(Source::File);
        only.start = args.start.clone().or_else(recorded_start).map(Source::File);
    }
    Ok((all, names))
}

/// What is given once for each of so many fractions; for one also what a run that is done again has recorded.
fn one_each(
    given: &[PathBuf],
    role: InputRole,
    what: &str,
    recorded: &[RecordedInput],
    fractions: usize,
) -> Result<Vec<Option<PathBuf>>> {
    match given {
        [] if fractions == 1 => Ok(vec![either(&None, role, recorded)]),
        [] => Ok(vec![None; fractions]),
        some if some.len() == fractions => Ok(some.iter().cloned().map(Some).collect()),
        some => Err(Error::usage(
            format!("{} {what} are given for {fractions} fractions", some.len()),
            format!("give --{role} once for each --fraction, in their order, or not at all"),
        )),
    }
}

/// Saves a result into `out` and tells of it; shared with `pose` and `demo`. `files` lie there already.
pub(super) fn saved(
    mut registered: Registered,
    folder: RunFolder,
    out: &Path,
    run: &RunArgs,
    files: &[(String, &str)],
    runtime: &Runtime,
) -> Result<String> {
    let beside = Beside { view: !run.no_view, files, samples: None };
    Ok(told(&mut registered, folder, out, beside, run, runtime)?.0)
}

/// As [`saved`], with the report.
fn told(
    registered: &mut Registered,
    folder: RunFolder,
    out: &Path,
    beside: Beside<'_>,
    run: &RunArgs,
    runtime: &Runtime,
) -> Result<(String, Report)> {
    let report = registered.save(folder, out, beside, runtime)?;
    let text = match run.told.json {
        true => report.json()?,
        false => format!("{}\nThe report: {}", report::terminal_table(&report), out.join("report.html").display()),
    };
    Ok((text, report))
}

/// The samples that are asked for; refused before anything is read.
fn sampling(args: &RegisterArgs) -> Result<Option<SamplingOptions>> {
    let Some(number) = args.samples else { return Ok(None) };
    let options = SamplingOptions { number, seed: args.seed, ..SamplingOptions::default() };
    options.problem().map_or(Ok(Some(options)), |problem| Err(Error::usage(problem, "correct --samples")))
}

/// The complete settings from file and flags.
pub(super) fn settings(file: &ConfigFile, args: &RunArgs) -> Result<Config> {
    let preset = args.preset.map(|p| match p {
        PresetName::Default => Preset::Default,
        PresetName::Thesis => Preset::Thesis,
    });
    let speed = args.speed.map(|s| match s {
        SpeedName::Fast => Preset::Fast,
        SpeedName::Balanced => Preset::Default,
    });
    let mut config = file.resolve(preset.or(speed))?;
    if let Some(format) = args.field_format {
        config.output.field_format = format.into();
    }
    Ok(config)
}
