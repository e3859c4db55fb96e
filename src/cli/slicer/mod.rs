//! `aventail slicer`: the program as a module of 3D Slicer, by its convention for command-line modules.

mod describe;
mod install;
mod progress;
mod run;

use crate::error::Result;
use clap::{Args, Subcommand};
use std::path::PathBuf;

pub(super) const HELP: &str = "\
Example:
  aventail slicer install ~/aventail-slicer

Then in Slicer: Edit, Application Settings, Modules; add the folder to Additional module paths;
restart. docs/slicer.md explains every step.";

/// What `aventail slicer` can do.
#[derive(Debug, Subcommand)]
pub enum SlicerVerb {
    /// Write a folder that Slicer loads as a module; the module calls this program at its present path
    #[command(after_help = HELP)]
    Install(InstallArgs),
    /// Called by Slicer: --xml describes the module; otherwise registers the files that Slicer wrote
    #[command(hide = true)]
    Register(Box<run::ModuleArgs>),
}

/// Options of `slicer install`.
#[derive(Debug, Args)]
pub struct InstallArgs {
    /// Folder for the module; made if missing
    #[arg(value_name = "DIR")]
    pub folder: PathBuf,
}

/// Runs one of them.
///
/// # Errors
/// As writing a file, or as `register`.
pub fn run(verb: &SlicerVerb) -> Result<String> {
    match verb {
        SlicerVerb::Install(args) => install::run(&args.folder),
        SlicerVerb::Register(args) => run::run(args),
    }
}
