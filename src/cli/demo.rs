//! `aventail demo`: the main job on the phantom, with no data at hand.

use super::args::RunArgs;
use super::register::{Told, finish, settings};
use super::run_folder;
use super::terminal::progress;
use crate::config::ConfigFile;
use crate::error::Result;
use crate::phantom::{Phantom, PhantomOptions};
use crate::pipeline::Case;
use crate::report::planned;
use crate::runtime::Runtime;
use clap::Args;
use std::path::PathBuf;

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

/// Makes the phantom, registers it and writes the report; returns the table for the terminal.
///
/// # Errors
/// When the folder cannot be written.
pub fn run(args: &DemoArgs) -> Result<String> {
    let config = settings(&ConfigFile::default(), &args.run)?;
    let folder = run_folder(&args.out, &planned(&config), &[])?;
    let runtime = Runtime::new(args.run.threads, progress(args.run.quiet))?;
    let phantom = runtime.stage("make the phantom", || Phantom::new(&PhantomOptions::default()))?;
    let case = Case::from(phantom);
    finish(&case, &config, &runtime, (folder, &args.out), Told::of(&args.run))
}
