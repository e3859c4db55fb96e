//! `aventail study`: the model's stages side by side on one case, with the same bone motion; or the concept figures.

use super::args::{QuietArgs, ThreadArgs};
use super::inputs::config_file;
use super::terminal::progress;
use super::{planned, record, run_folder};
use crate::concepts;
use crate::config::{Config, InputRole, RecordedInput, StudyPlan};
use crate::error::{Error, Result};
use crate::fit::FitResult;
use crate::geometry::Rigid;
use crate::io::checksum::sha256;
use crate::pipeline::{Case, carry_again};
use crate::progress::Progress;
use crate::provenance::InputFile;
use crate::report::{Report, StageRecord, finished_stage, stage_files, write_concepts, write_stage, write_study};
use crate::runtime::Runtime;
use crate::session::{FractionSources, PlanningSources, Source};
use clap::Args;
use nalgebra::{Translation3, UnitQuaternion};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

pub(super) const HELP: &str = "\
A case is the folder of a finished `register` or `pose`. Each stage (a variant of the soft-tissue
model) starts from the bone motion found there. The result of each stage is kept: a study that was
stopped continues where it was.

--concepts runs the chain mail on 2-D scenes, one element thick, and draws the figures of the
thesis's chapter 5: transfer functions (Fig. 13), processing order (14, 15), rotation (17, 18),
several initiators (19, 20), structures (23 to 25).

Example:
  aventail register --planning planning_ct.nii.gz --bones bones.nii.gz --fraction fraction_ct.nii.gz --out run
  aventail study --case run --out study     # study/study.html, study.md, study.csv; study.json has checksums
  aventail study --concepts --out concepts";

/// Options of `study`.
#[derive(Debug, Args)]
pub struct StudyArgs {
    /// Folder of a finished `register` or `pose` run
    #[arg(long, value_name = "DIR", required_unless_present = "concepts", conflicts_with = "concepts")]
    pub case: Option<PathBuf>,
    /// Draw the concept figures of the thesis instead
    #[arg(long)]
    pub concepts: bool,
    /// Folder for the results; made if missing
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// Plan (TOML) of the stages to run, instead of the thesis's; data/study.toml of the sources is
    /// an example
    #[arg(long, value_name = "FILE", requires = "case")]
    pub plan: Option<PathBuf>,
    /// Threads.
    #[command(flatten)]
    pub work: ThreadArgs,
    /// Whether progress is shown.
    #[command(flatten)]
    pub shown: QuietArgs,
}

/// Runs every stage of the plan that is not finished yet and writes the tables, or the concept figures; returns them as
/// text.
///
/// # Errors
/// When the case is no finished run, a file cannot be read or written, or the plan's settings are not legal.
pub fn run(args: &StudyArgs) -> Result<String> {
    match &args.case {
        Some(case) => tables(args, case),
        None => concept_figures(args),
    }
}

/// Files of a study that hold all its stages.
const TABLES: [&str; 3] = ["study.md", "study.csv", "study.html"];

fn concept_figures(args: &StudyArgs) -> Result<String> {
    let mut folder = run_folder(&args.out, &planned(&["concepts.json"], &[]), &[])?;
    let runtime = Runtime::new(args.work.threads, progress(args.shown.quiet))?;
    let figures = runtime.stage("concept figures", || concepts::figures(runtime.progress()))?;
    folder.begin()?;
    let names = runtime.stage("write", || write_concepts(&args.out, &figures))?;
    record::write(&folder, &args.out, "concepts.json", Vec::new())?;
    folder.finish();
    let lines = figures.iter().zip(&names).map(|(f, name)| format!("{name}: {}. {}", f.title, f.caption));
    Ok(lines.collect::<Vec<_>>().join("\n"))
}

fn tables(args: &StudyArgs, case: &Path) -> Result<String> {
    let plan = args.plan.as_deref().map_or_else(StudyPlan::thesis, StudyPlan::read)?;
    let stages = plan.stages()?;
    let recorded = config_file(&case.join("report.json"));
    let recorded: Vec<RecordedInput> = recorded.map(|file| file.inputs).unwrap_or_default();
    let mut files: Vec<&Path> = args.plan.as_deref().into_iter().collect();
    files.extend(recorded.iter().map(|i| i.path.as_path()).filter(|p| p.exists()));
    let mut folder = run_folder(&args.out, &planned(&["study.json"], &TABLES), &files)?;
    let moved = StudiedMotion::load(case)?;
    // Stages that are finished stay, whatever becomes of the study.
    let ids: Vec<&str> = stages.iter().map(|(stage, _)| stage.id.as_str()).collect();
    let own: Vec<PathBuf> =
        TABLES.map(PathBuf::from).into_iter().chain(ids.iter().flat_map(|id| stage_files(id))).collect();
    folder.go_on(|name| own.iter().any(|o| o == name))?;
    let mut records = BTreeMap::new();
    for (n, (stage, config)) in stages.iter().enumerate() {
        let settings = config.value()?;
        let key = moved.key(&settings);
        if let Some(record) = finished_stage(&args.out, &stage.id, &key) {
            records.insert(stage.id.clone(), record);
            continue;
        }
        let label = format!("[{}/{}] {}", n + 1, stages.len(), stage.name);
        let runtime = Runtime::new(args.work.threads, Box::new(Labelled { inner: progress(args.shown.quiet), label }))?;
        let stage_run = StageRun { id: &stage.id, config, settings, key };
        let record = stage_run.carry(&moved, &args.out, &runtime)?;
        records.insert(stage.id.clone(), record);
        // After every stage, so that a study that is stopped has its tables so far.
        write_study(&args.out, &moved.title, &plan, &records)?;
    }
    let text = write_study(&args.out, &moved.title, &plan, &records)?;
    let mut inputs = vec![InputFile::read(InputRole::Case, &case.join("report.json"))?];
    inputs.extend(args.plan.as_deref().map(|plan| InputFile::read(InputRole::Plan, plan)).transpose()?);
    record::write_of(&own, &args.out, "study.json", inputs)?;
    folder.finish();
    Ok(format!("{text}\nThe page: {}", args.out.join("study.html").display()))
}

/// A stage of the plan that is not finished yet.
struct StageRun<'a> {
    id: &'a str,
    config: &'a Config,
    /// The same as JSON.
    settings: serde_json::Value,
    /// Checksum of what its result depends on.
    key: String,
}

impl StageRun<'_> {
    /// Carries the motion by the stage's settings and writes what came of it.
    fn carry(self, moved: &StudiedMotion, out: &Path, runtime: &Runtime) -> Result<StageRecord> {
        let outcome = carry_again(&moved.case, &moved.fit, moved.seen, self.config, runtime)?;
        let record = StageRecord::new(&outcome, self.settings, self.key, runtime);
        runtime.stage("draw", || write_stage(out, self.id, &moved.case, &outcome, &record))?;
        Ok(record)
    }
}

/// A case whose bones' motion is known from a finished run.
struct StudiedMotion {
    title: String,
    case: Case,
    /// Whether its fraction is a scan.
    seen: bool,
    /// Checksums of its files.
    sha256: Vec<String>,
    fit: FitResult,
    /// Checksum of what the motion is.
    motion: String,
}

impl StudiedMotion {
    /// Reads a folder that `register` or `pose` has written, and the files that it was made from.
    fn load(folder: &Path) -> Result<Self> {
        let path = folder.join("report.json");
        let remedy = "give the --out folder of a finished `aventail register` or `aventail pose`";
        let report = Report::read(&path, remedy)?;
        let recorded = config_file(&path)?;
        let settings = recorded.resolve(None)?;
        let inputs = recorded.inputs;
        let Some(side) = PlanningSources::recorded(&inputs) else {
            return Err(Error::input(
                path.display().to_string(),
                "it does not name the files of its planning CT and bones: the images were made by the run itself",
                "write the phantom with `aventail phantom`, register its files, and study that run",
            ));
        };
        let (planning, _) = side.read(&[], &settings, &Runtime::silent()?)?;
        let file = |role: InputRole| inputs.iter().find(|i| i.role == role).map(|i| i.path.clone());
        let seen = file(InputRole::Fraction);
        // A made posture has no fraction CT: its own artificial one takes that place.
        let fraction = seen.clone().unwrap_or_else(|| folder.join("planning_on_fraction.nii.gz"));
        let mut fraction = FractionSources::new(Source::File(fraction));
        fraction.landmarks = file(InputRole::Landmarks).map(Source::File);
        let (fraction, _) = fraction.read(&[])?;
        let transforms: Vec<Rigid> = report.bones.iter().map(|b| b.transform).collect();
        let motion = serde_json::to_vec(&report.bones).map_err(|e| Error::Internal(e.to_string()))?;
        Ok(Self {
            title: format!("Study of {}", folder.display()),
            case: Case { planning: planning.into(), fraction },
            seen: seen.is_some(),
            sha256: report.inputs.into_iter().map(|i| i.sha256).collect(),
            fit: FitResult {
                transforms,
                pose: report.pose,
                bones: report.bones,
                common: Rigid::from_parts(Translation3::from(report.common_shift), UnitQuaternion::identity()),
                common_share: 1.0,
                open: None,
                warnings: Vec::new(),
            },
            motion: sha256(&motion),
        })
    }

    /// What a stage with these settings depends on, as a checksum.
    fn key(&self, settings: &serde_json::Value) -> String {
        let all = serde_json::json!([env!("CARGO_PKG_VERSION"), settings, self.sha256, self.motion]);
        sha256(all.to_string().as_bytes())
    }
}

/// Progress that says which stage of the study is at work.
struct Labelled {
    inner: Box<dyn Progress>,
    label: String,
}

impl Progress for Labelled {
    fn stage(&self, name: &str) {
        self.inner.stage(&format!("{}: {name}", self.label));
    }
    fn step(&self, done: usize, total: usize, label: &str) {
        self.inner.step(done, total, label);
    }
    fn finish(&self, seconds: f64) {
        self.inner.finish(seconds);
    }
}
