//! The command line: its verbs, and what runs for each.

use super::register::{HELP as REGISTER, RegisterArgs};
use super::skeleton::SkeletonArgs;
use super::warp::{HELP as WARP, WarpArgs};
use clap::{Parser, Subcommand};

/// Deformable image registration for adaptive radiotherapy: bones move rigidly as a skeleton with
/// joints, and a chain-mail model of soft tissue carries their motion to every voxel.
#[derive(Debug, Parser)]
#[command(name = "aventail", version, long_version = super::version::long(), max_term_width = 110, arg_required_else_help = true, after_help = AFTER)]
pub struct Cli {
    /// What to do.
    #[command(subcommand)]
    pub verb: Verb,
}

const AFTER: &str = "\
Start with `aventail demo`: it makes a phantom, registers it and writes the full report.

Exit codes: 0 done, whatever the verdict (`fail` too); 1 internal error; 2 wrong command line or
settings; 3 a file cannot be read; 4 the inputs do not fit the task or each other; 5 a result cannot
be written; 6 the registration failed.

Research software, not a medical device.";

/// What aventail can do.
#[derive(Debug, Subcommand)]
pub enum Verb {
    /// Register a planning CT to a fraction CT
    #[command(after_help = REGISTER)]
    Register(Box<RegisterArgs>),
    /// Make an artificial CT in a posture that you choose, with its labels and fields
    #[command(after_help = super::pose::HELP)]
    Pose(Box<super::pose::PoseArgs>),
    /// Make artificial CTs in randomly drawn postures, with labels, contours, dose and true fields:
    /// for plan libraries, robust planning and data augmentation
    #[command(after_help = super::library::HELP)]
    Library(Box<super::library::LibraryArgs>),
    /// Run variants of the soft-tissue model on one case and write the tables of Bartelheimer's
    /// thesis for it
    #[command(after_help = super::study::HELP)]
    Study(super::study::StudyArgs),
    /// Make the phantom, register it and write the report; needs no input files
    Demo(super::demo::DemoArgs),
    /// Write a phantom with its true motion: two fractions, contours and dose; a breathing chest;
    /// or a test object
    #[command(after_help = super::phantom::HELP)]
    Phantom(super::phantom::PhantomArgs),
    /// Warp images, labels, dose, points, contours and meshes from one scan to another with any
    /// tool's field
    #[command(after_help = WARP)]
    Warp(Box<WarpArgs>),
    /// Build the joint tree from bone labels, check it and show it
    Skeleton(SkeletonArgs),
    /// Merge masks, label maps and structure sets into one label map with names
    #[command(subcommand)]
    Labels(super::labels::LabelsVerb),
    /// Measure a displacement field of aventail or another tool, or compare several
    #[command(after_help = super::evaluate::AFTER)]
    Evaluate(Box<super::evaluate::EvaluateArgs>),
    /// Draw random samples of a registration's error, to estimate its effect on a dose
    #[command(after_help = super::samples::AFTER)]
    Samples(super::samples::SamplesArgs),
    /// Map, accumulate and compare doses; compute dose-volume histograms
    #[command(subcommand)]
    Dose(Box<super::dose::DoseVerb>),
    /// Summarise many runs in one table and one page: values, outliers, each patient's course over
    /// the fractions
    #[command(after_help = super::summary::HELP)]
    Summary(super::summary::SummaryArgs),
    /// Show what files hold: geometry, orientation, labels, field direction; and whether they share a grid
    Inspect(super::inspect::InspectArgs),
    /// View a finished run at full resolution in this machine's browser
    #[command(after_help = super::view::AFTER)]
    View(super::view::ViewArgs),
    /// Draw one plane of a finished run for papers and slides: fusion, displacement, Jacobian or uncertainty, as SVG or PNG
    #[command(after_help = super::figure::AFTER)]
    Figure(super::figure::FigureArgs),
    /// Time the slowest steps on a scan of clinical size and compare them with the memory bandwidth
    #[command(after_help = super::bench::HELP)]
    Bench(super::bench::BenchArgs),
    /// Plot error against run time for the main settings
    #[command(after_help = super::curve::HELP)]
    Curve(Box<super::curve::CurveArgs>),
    /// Install aventail as a module of 3D Slicer
    #[command(subcommand, after_help = super::slicer::HELP)]
    Slicer(super::slicer::SlicerVerb),
    /// Write the help of every command as manual pages
    Man(super::man::ManArgs),
    /// Print a completion script for your shell
    Completions {
        /// Which shell
        shell: clap_complete::Shell,
    },
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::CommandFactory;

    #[test]
    fn the_command_line_is_consistent() {
        Cli::command().debug_assert();
    }
}
