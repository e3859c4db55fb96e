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
  aventail slicer install ~/aventail-slicer      # then in Slicer: Edit, Application Settings, Modules, add that folder, restart

docs/slicer.md has every click.";

/// What `aventail slicer` can do.
#[derive(Debug, Subcommand)]
pub enum SlicerVerb {
    /// Make a folder that Slicer loads as a module: it calls this program where it lies now
    #[command(after_help = HELP)]
    Install(InstallArgs),
    /// What Slicer calls: --xml describes the module, else it registers what Slicer has written for it
    #[command(hide = true)]
    Register(Box<run::ModuleArgs>),
}

/// Options of `slicer install`.
#[derive(Debug, Args)]
pub struct InstallArgs {
    /// The folder; made if missing
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
