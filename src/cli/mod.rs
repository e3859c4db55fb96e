//! Rank 12: arguments and terminal. One file per verb.

pub mod args;
pub mod bench;
mod beside;
pub mod clinic;
mod contours;
pub mod curve;
mod demo;
pub mod dose;
pub mod evaluate;
pub mod figure;
mod finished;
mod inputs;
mod inspect;
pub mod labels;
pub mod library;
mod links;
pub mod man;
mod organs;
mod phantom;
pub mod pose;
mod program;
mod record;
pub mod register;
pub mod samples;
pub mod skeleton;
pub mod slicer;
pub mod study;
pub mod summary;
pub mod terminal;
mod verbs;
mod version;
pub mod view;
pub mod warp;

pub use program::main;
use terminal::command_line;
pub use verbs::{Cli, Verb};

use crate::error::Result;
use crate::io::{Planned, RunFolder};
use clap::CommandFactory;
use std::path::Path;

/// Takes hold of the folder of a run that will read `inputs`; see [`RunFolder::open`].
pub(crate) fn run_folder(folder: &Path, planned: &Planned, inputs: &[&Path]) -> Result<RunFolder> {
    RunFolder::open(folder, planned, inputs, &command_line())
}

/// What a run will write whose first file tells of the others.
pub(crate) fn planned(reports: &[&str], names: &[&str]) -> Planned {
    let own = |list: &[&str]| list.iter().map(|n| (*n).to_owned()).collect();
    Planned { reports: own(reports), names: own(names) }
}

/// Runs a parsed command line; returns what belongs on standard output.
///
/// # Errors
/// What the verb reports; [`crate::error::Error::exit_code`] is the process's exit code.
pub fn run(cli: &Cli) -> Result<String> {
    match &cli.verb {
        Verb::Register(args) => register::run(args),
        Verb::Pose(args) => pose::run(args),
        Verb::Library(args) => library::run(args),
        Verb::Demo(args) => demo::run(args),
        Verb::Phantom(args) => phantom::run(args),
        Verb::Warp(args) => warp::run(args),
        Verb::Skeleton(args) => skeleton::run(args),
        Verb::Labels(verb) => labels::run(verb),
        Verb::Study(args) => study::run(args),
        Verb::Summary(args) => summary::run(args),
        Verb::Evaluate(args) => evaluate::run(args),
        Verb::Samples(args) => samples::run(args),
        Verb::Dose(verb) => dose::run(verb),
        Verb::Figure(args) => figure::run(args),
        Verb::View(args) => view::run(args),
        Verb::Bench(args) => bench::run(args),
        Verb::Curve(args) => curve::run(args),
        Verb::Slicer(verb) => slicer::run(verb),
        Verb::Inspect(args) => inspect::run(&args.files, args.told.json, args.anonymous),
        Verb::Man(args) => man::run(args, Cli::command()),
        Verb::Completions { shell } => {
            let mut out = Vec::new();
            clap_complete::generate(*shell, &mut Cli::command(), "aventail", &mut out);
            Ok(String::from_utf8_lossy(&out).into_owned())
        }
    }
}
