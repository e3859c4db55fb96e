//! `aventail register`: load, run, write.

use super::args::{PresetName, RegisterArgs, RunArgs};
use super::terminal::Terminal;
use crate::config::{Config, ConfigFile, Preset, RecordedInput};
use crate::error::{Error, Result};
use crate::io::{self, Stored, WriteOptions, checksum::sha256_file};
use crate::pipeline::{Case, InputFile, Outcome, register};
use crate::progress::{Progress, Silent};
use crate::report::{self, OutputFile, Run};
use crate::runtime::Runtime;
use crate::warning::Warning;
use std::path::{Path, PathBuf};

/// Registers the case that the arguments name and writes the results; returns the table (or JSON) for the terminal.
///
/// # Errors
/// Of every kind; see [`Error`].
pub fn run(args: &RegisterArgs) -> Result<String> {
    let file = args.config.as_deref().map(ConfigFile::read).transpose()?.unwrap_or_default();
    let config = settings(&file, &args.run)?;
    let paths = Paths::new(args, &file.inputs)?;
    open_folder(&args.out)?;
    let runtime = Runtime::new(args.run.threads, progress(args.run.quiet))?;
    let case = load(&paths, &file.inputs, &runtime)?;
    finish(&case, &config, &runtime, &args.out, args.run.json)
}

/// Runs the pipeline on a case and writes everything into `out`; shared with `demo`.
pub(super) fn finish(case: &Case, config: &Config, runtime: &Runtime, out: &Path, json: bool) -> Result<String> {
    let outcome = register(case, config, runtime)?;
    let outputs = runtime.stage("write", || write_outputs(out, &outcome, config))?;
    let run = Run {
        command: std::env::args().collect::<Vec<_>>().join(" "),
        settings: serde_json::to_value(config).map_err(|e| Error::Internal(e.to_string()))?,
        threads: runtime.threads(),
        outputs,
    };
    let outcome = Outcome { stages: runtime.times(), ..outcome };
    let report = runtime.stage("report", || report::write(out, case, &outcome, &run))?;
    if json {
        return serde_json::to_string_pretty(&report).map_err(|e| Error::Internal(e.to_string()));
    }
    Ok(format!("{}\nThe report: {}", report::terminal_table(&report), out.join("report.html").display()))
}

/// Progress on the terminal, or none.
pub(super) fn progress(quiet: bool) -> Box<dyn Progress> {
    if quiet { Box::new(Silent) } else { Box::new(Terminal::new()) }
}

/// The complete settings from file and flags.
pub(super) fn settings(file: &ConfigFile, args: &RunArgs) -> Result<Config> {
    let preset = args.preset.map(|p| match p {
        PresetName::Default => Preset::Default,
        PresetName::Thesis => Preset::Thesis,
    });
    let mut config = file.resolve(preset)?;
    if let Some(format) = args.field_format {
        config.output.field_format = format.into();
    }
    Ok(config)
}

/// Makes the folder and proves that it can be written to, before anything long begins.
pub(super) fn open_folder(folder: &Path) -> Result<()> {
    let refuse = |e: std::io::Error| Error::write(folder, e.to_string(), "choose a folder that you may write to");
    std::fs::create_dir_all(folder).map_err(refuse)?;
    let probe = folder.join(".aventail-probe");
    std::fs::write(&probe, []).map_err(refuse)?;
    std::fs::remove_file(&probe).map_err(refuse)
}

/// Where the inputs lie: from the flags, else from the report that is run again.
struct Paths {
    planning: PathBuf,
    bones: PathBuf,
    fraction: PathBuf,
    labels: Option<PathBuf>,
    skeleton: Option<PathBuf>,
    landmarks: Option<PathBuf>,
}

impl Paths {
    fn new(args: &RegisterArgs, recorded: &[RecordedInput]) -> Result<Self> {
        let optional = |own: &Option<PathBuf>, role: &str| {
            own.clone().or_else(|| recorded.iter().find(|i| i.role == role).map(|i| i.path.clone()))
        };
        let needed = |own: &Option<PathBuf>, role: &str| {
            optional(own, role).ok_or_else(|| {
                Error::usage(
                    format!("no {role} file is given"),
                    format!("add --{role} FILE; a TOML of settings names no inputs"),
                )
            })
        };
        Ok(Self {
            planning: needed(&args.planning, "planning")?,
            bones: needed(&args.bones, "bones")?,
            fraction: needed(&args.fraction, "fraction")?,
            labels: optional(&args.labels, "labels"),
            skeleton: optional(&args.skeleton, "skeleton"),
            landmarks: optional(&args.landmarks, "landmarks"),
        })
    }
}

/// Reads the inputs; those that a report recorded are checked against its checksums.
fn load(paths: &Paths, recorded: &[RecordedInput], runtime: &Runtime) -> Result<Case> {
    runtime.stage("read", || {
        let planning = io::read_image(&paths.planning)?;
        let bones = io::read_labels(&paths.bones, paths.labels.as_deref())?;
        let fraction = io::read_image(&paths.fraction)?;
        let landmarks = paths.landmarks.as_deref().map(io::read_landmarks).transpose()?.unwrap_or_default();
        let skeleton = match &paths.skeleton {
            Some(path) => Some(io::skeleton::load_override(path, crate::skeleton::build(&bones.value)?.skeleton)?),
            None => None,
        };
        let mut inputs = vec![
            InputFile { role: "planning".into(), path: paths.planning.clone(), sha256: planning.sha256 },
            InputFile { role: "bones".into(), path: paths.bones.clone(), sha256: bones.sha256 },
            InputFile { role: "fraction".into(), path: paths.fraction.clone(), sha256: fraction.sha256 },
        ];
        for (role, path) in [("labels", &paths.labels), ("skeleton", &paths.skeleton), ("landmarks", &paths.landmarks)]
        {
            if let Some(path) = path {
                inputs.push(InputFile { role: role.into(), path: path.clone(), sha256: sha256_file(path)? });
            }
        }
        let mut warnings: Vec<Warning> = [planning.warnings, bones.warnings, fraction.warnings].concat();
        for input in &inputs {
            if let Some(r) = recorded.iter().find(|r| r.role == input.role && r.sha256 != input.sha256) {
                warnings.push(Warning::new(
                    "input-changed",
                    format!(
                        "{} is not the file of the recorded run (SHA-256 {}..., then {}...)",
                        input.path.display(),
                        &input.sha256[..12],
                        r.sha256.get(..12).unwrap_or(&r.sha256)
                    ),
                ));
            }
        }
        Ok(Case {
            planning: planning.value,
            bones: bones.value,
            fraction: fraction.value,
            landmarks,
            skeleton,
            warnings,
            inputs,
        })
    })
}

/// Writes fields, images and masks; returns what was written.
fn write_outputs(out: &Path, outcome: &Outcome, config: &Config) -> Result<Vec<OutputFile>> {
    let level = config.output.gzip_level;
    let options = |description: &str| WriteOptions { gzip_level: level, description: description.into() };
    let field = |stem: &str| format!("{stem}.{}", config.output.field_format.extension());
    let mut files = Vec::new();
    let mut add = |name: String, what: &str| {
        files.push(OutputFile { name: name.clone(), what: what.into() });
        out.join(name)
    };
    io::write_push(
        add(field("planning_to_fraction"), "push field on the planning grid, LPS mm: planning x goes to x + u(x)"),
        &outcome.push,
        config.output.field_format,
        level,
    )?;
    io::write_pull(
        add(
            field("fraction_to_planning"),
            "pull field on the fraction grid, LPS mm: fraction y shows planning at y + v(y)",
        ),
        &outcome.pull,
        config.output.field_format,
        level,
    )?;
    let path = add("planning_on_fraction.nii.gz".into(), "planning CT on the fraction grid, int16 HU");
    io::write_image(path, &outcome.planning_on_fraction, Stored::Int16, &options("planning CT on the fraction grid"))?;
    let path =
        add("bones_on_fraction.nii.gz".into(), "bone labels on the fraction grid, names in the header extension");
    io::write_labels(path, &outcome.bones_on_fraction, &options("bone labels on the fraction grid"))?;
    let path =
        add("jacobian.nii.gz".into(), "V_deformed / V_initial on the planning grid; -1 folded, 1 outside tissue");
    io::write_image(path, &outcome.jacobian, Stored::Float32, &options("Jacobian of planning to fraction"))?;
    for (name, mask, what) in [
        ("body.nii.gz", &outcome.body, "patient in the planning CT, cavities filled"),
        (
            "computed.nii.gz",
            &outcome.push.computed,
            "planning voxels whose motion was computed; elsewhere the field is a smooth extension",
        ),
        (
            "inside_planning.nii.gz",
            &outcome.pull.inside,
            "fraction voxels whose pre-image lies inside the planning scan",
        ),
    ] {
        io::write_mask(add(name.into(), what), mask, &options(what))?;
    }
    let path = add("settings.toml".into(), "the settings of this run, for --config");
    let text = toml::to_string_pretty(config).map_err(|e| Error::Internal(format!("settings as TOML: {e}")))?;
    io::write_file(path, |w| w.write_all(text.as_bytes()))?;
    Ok(files)
}
