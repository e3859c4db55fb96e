//! `aventail register`: load, run, write.

use super::args::{LandmarkUseName, PresetName, RegisterArgs, RunArgs};
use super::inputs::{Flags, Inputs};
use super::terminal::Terminal;
use crate::config::{Config, ConfigFile, Preset};
use crate::error::{Error, Result};
use crate::fit::LandmarkUse;
use crate::io::{self, Stored, WriteOptions};
use crate::pipeline::{Case, Outcome, register};
use crate::progress::{Progress, Silent};
use crate::report::{self, OutputFile, Run};
use crate::runtime::Runtime;
use std::path::Path;

/// Registers the case that the arguments name and writes the results; returns the table (or JSON) for the terminal.
///
/// # Errors
/// Of every kind; see [`Error`].
pub fn run(args: &RegisterArgs) -> Result<String> {
    let file = args.config.as_deref().map(ConfigFile::read).transpose()?.unwrap_or_default();
    let mut config = settings(&file, &args.run)?;
    if let Some(r#use) = args.bone_landmarks_use {
        config.fit.bone_landmarks = match r#use {
            LandmarkUseName::Start => LandmarkUse::Start,
            LandmarkUseName::Replace => LandmarkUse::Replace,
        };
    }
    args.organs.apply(&mut config)?;
    let flags = Flags {
        planning: &args.planning,
        bones: &args.bones,
        fraction: Some(&args.fraction),
        labels: &args.labels,
        organs: &args.organs.organs,
        skeleton: &args.skeleton,
        landmarks: &args.landmarks,
        bone_landmarks: &args.bone_landmarks,
    };
    let inputs = Inputs::new(&flags, &file.inputs)?;
    open_folder(&args.out)?;
    let runtime = Runtime::new(args.run.threads, progress(args.run.quiet))?;
    let case = inputs.load(&file.inputs, &runtime)?;
    finish(&case, &config, &runtime, &args.out, args.run.json)
}

/// Registers a case and writes everything into `out`; shared with `demo`.
pub(super) fn finish(case: &Case, config: &Config, runtime: &Runtime, out: &Path, json: bool) -> Result<String> {
    let outcome = register(case, config, runtime)?;
    write_run(case, outcome, config, runtime, out, json)
}

/// Writes an outcome with its report into `out`; shared with `pose`.
pub(super) fn write_run(
    case: &Case,
    outcome: Outcome,
    config: &Config,
    runtime: &Runtime,
    out: &Path,
    json: bool,
) -> Result<String> {
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
    if let Some(skin) = &outcome.skin_contact {
        let what = "fraction voxels where the moved patient lies on himself: skin passes through skin";
        io::write_mask(add("skin_contact.nii.gz".into(), what), skin, &options(what))?;
    }
    if let Some((map, _)) = &outcome.uncertainty {
        let path = add(
            "uncertainty.nii.gz".into(),
            "how far the result may be trusted, on the planning grid, mm; 0 outside the patient",
        );
        io::write_image(path, map, Stored::Float32, &options("uncertainty, mm, one standard deviation"))?;
    }
    if let Some(regions) = &outcome.regions {
        let what = "regions of influence on the planning grid: label of the bone that each voxel follows";
        io::write_labels(add("regions.nii.gz".into(), what), regions, &options("regions of influence"))?;
    }
    let path = add("settings.toml".into(), "the settings of this run, for --config");
    let text = toml::to_string_pretty(config).map_err(|e| Error::Internal(format!("settings as TOML: {e}")))?;
    io::write_file(path, |w| w.write_all(text.as_bytes()))?;
    Ok(files)
}
