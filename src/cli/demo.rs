//! `aventail demo`: the main job on the phantom, with no data at hand.

use super::args::RunArgs;
use super::inputs::{Flags, Inputs};
use super::phantom::write_landmarks;
use super::register::{Told, settings, write_run};
use super::run_folder;
use super::terminal::progress;
use crate::config::{Config, ConfigFile};
use crate::error::{Error, Result};
use crate::io::{self, Stored, WriteOptions};
use crate::phantom::{Phantom, PhantomOptions};
use crate::pipeline::{Case, Outcome, register};
use crate::report::{OutputFile, planned};
use crate::runtime::Runtime;
use clap::Args;
use std::path::{Path, PathBuf};

/// Options of `demo`.
#[derive(Debug, Args)]
pub struct DemoArgs {
    /// Folder for the results; made if missing
    #[arg(long, value_name = "DIR", default_value = "aventail-demo")]
    pub out: PathBuf,
    /// Options of every run.
    #[command(flatten)]
    pub run: RunArgs,
}

/// The folder of the phantom, and what lies there: name and meaning.
const FOLDER: &str = "phantom";
const FILES: [(&str, &str); 4] = [
    ("planning_ct.nii.gz", "the phantom's planning CT, an input"),
    ("bones.nii.gz", "the phantom's bone labels on the planning grid, an input"),
    ("fraction_ct.nii.gz", "the phantom's fraction CT, an input"),
    ("landmarks.csv", "points of the phantom known in both scans, an input"),
];

/// Makes the phantom, registers it and writes the report; returns the table for the terminal. The scans are written first
/// and read back, so that the run is that of `register` on these files.
///
/// # Errors
/// When the folder cannot be written.
pub fn run(args: &DemoArgs) -> Result<String> {
    let config = settings(&ConfigFile::default(), &args.run)?;
    let mut names = planned(&config);
    names.names.extend(FILES.map(|(name, _)| format!("{FOLDER}/{name}")));
    let mut folder = run_folder(&args.out, &names, &[])?;
    let runtime = Runtime::new(args.run.work.threads, progress(args.run.shown.quiet))?;
    let phantom = runtime.stage("make the phantom", || Phantom::new(&PhantomOptions::default()))?;
    folder.begin()?;
    let files = FILES.map(|(name, _)| args.out.join(FOLDER).join(name));
    runtime.stage("write the phantom", || write(phantom, &files))?;
    let case = read(files, &config, &runtime)?;
    let outcome = register(&case, &config, &runtime)?;
    let listed = |_: &Outcome| {
        let all = FILES.iter().map(|(name, what)| OutputFile::written(&args.out, &format!("{FOLDER}/{name}"), what));
        Ok((all.collect::<Result<_>>()?, Vec::new()))
    };
    write_run(&case, outcome, &config, &runtime, folder, &args.out, Told::of(&args.run).with(&listed))
}

/// Writes what is registered, side by side.
fn write(phantom: Phantom, [planning, bones, fraction, landmarks]: &[PathBuf; 4]) -> Result<()> {
    let folder = planning.parent().unwrap_or(Path::new("."));
    std::fs::create_dir_all(folder)
        .map_err(|e| Error::write(folder, e.to_string(), "choose a folder that you may write to"))?;
    let described = |text: &str| WriteOptions { description: text.into(), ..WriteOptions::default() };
    let image = |path, image, text| io::write_image(path, image, Stored::Int16, &described(text));
    let (scans, rest) = rayon::join(
        || {
            rayon::join(
                || image(planning, &phantom.planning, "aventail phantom, planning CT"),
                || image(fraction, &phantom.fraction, "aventail phantom, fraction CT"),
            )
        },
        || {
            io::write_labels(bones, &phantom.bones, &described("aventail phantom, bones"))?;
            io::write_file(landmarks, |out| write_landmarks(out, &phantom.landmarks))
        },
    );
    scans.0.and(scans.1).and(rest)
}

/// Reads the files as `register` does.
fn read([planning, bones, fraction, landmarks]: [PathBuf; 4], config: &Config, runtime: &Runtime) -> Result<Case> {
    let flags = Flags { planning: &Some(planning), bones: &Some(bones), ..Flags::default() };
    let inputs = Inputs::new(&flags, &[])?;
    let planning = inputs.load(&[], config, runtime)?;
    let fraction = runtime.stage("read the fraction", || inputs.fraction(&fraction, Some(&landmarks), &[]))?;
    Ok(Case { planning, fraction })
}
