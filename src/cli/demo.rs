//! `aventail demo`: the main job on the phantom, with no data at hand.

use super::args::RunArgs;
use super::phantom::write_landmarks;
use super::register::{saved, settings};
use super::run_folder;
use super::terminal::{command_line, progress};
use crate::config::ConfigFile;
use crate::error::{Error, Result};
use crate::io::{self, Stored, WriteOptions};
use crate::phantom::{Phantom, PhantomOptions};
use crate::report::planned;
use crate::runtime::Runtime;
use crate::session::{FractionSources, PlanningSources, Request, Session, Source};
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
    let [planning, bones, fraction, landmarks] = files;
    let mut fraction = FractionSources::new(Source::File(fraction));
    fraction.landmarks = Some(Source::File(landmarks));
    let request = Request {
        planning: PlanningSources::new(Source::File(planning), Source::File(bones)),
        fractions: vec![fraction],
        clinic: None,
        anonymous: false,
        same_frame: false,
        recorded: Vec::new(),
        config,
        command: command_line(),
    };
    let registered = Session::open(request, &runtime)?.register(&runtime)?;
    let listed = FILES.map(|(name, what)| (format!("{FOLDER}/{name}"), what));
    saved(registered, folder, &args.out, &args.run, &listed, &runtime)
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
