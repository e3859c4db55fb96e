//! The command line: its verbs, and what runs for each.

use super::register::{HELP as REGISTER, RegisterArgs};
use super::skeleton::SkeletonArgs;
use super::warp::{HELP as WARP, WarpArgs};
use clap::{Parser, Subcommand};

/// Deformable image registration for adaptive radiotherapy: bones move rigidly as a skeleton, a chain mail of soft
/// tissue carries their motion to every voxel.
#[derive(Debug, Parser)]
#[command(name = "aventail", version, long_version = super::version::long(), max_term_width = 110, arg_required_else_help = true, after_help = AFTER)]
pub struct Cli {
    /// What to do.
    #[command(subcommand)]
    pub verb: Verb,
}

const AFTER: &str = "\
Start with `aventail demo`: it registers a phantom that it makes itself and writes the full report.

Exit codes: 0 done; 1 internal error; 2 wrong command line or settings; 3 a file cannot be read;
4 the inputs do not fit the task or each other; 5 a result cannot be written;
6 the registration failed.

Research software, not a medical device.";

/// What aventail can do.
#[derive(Debug, Subcommand)]
pub enum Verb {
    /// Register a planning CT to a fraction CT
    #[command(after_help = REGISTER)]
    Register(Box<RegisterArgs>),
    /// Move the skeleton by hand: an artificial CT in another posture, with its labels and fields
    #[command(after_help = super::pose::HELP)]
    Pose(Box<super::pose::PoseArgs>),
    /// Make artificial CTs in sampled postures, with labels, contours, dose and true fields: for plan libraries, robust planning
    /// and augmentation
    #[command(after_help = super::library::HELP)]
    Library(Box<super::library::LibraryArgs>),
    /// Run the model's stages side by side on one case and write the thesis's tables for it
    #[command(after_help = super::study::HELP)]
    Study(super::study::StudyArgs),
    /// Make the phantom, register it, and write the report: needs no data
    Demo(super::demo::DemoArgs),
    /// Write a phantom as files, with its truth: two fractions, contours, dose; a breathing chest;
    /// or a test object
    #[command(after_help = super::phantom::HELP)]
    Phantom(super::phantom::PhantomArgs),
    /// Carry images, labels, dose, points, contours and meshes from one scan to another with any tool's field
    #[command(after_help = WARP)]
    Warp(Box<WarpArgs>),
    /// Build the joint tree from bone labels, check it and show it
    Skeleton(SkeletonArgs),
    /// Make one named label map of masks, label maps and structure sets
    #[command(subcommand)]
    Labels(super::labels::LabelsVerb),
    /// Measure any displacement field, ours or another tool's, or several side by side
    #[command(after_help = super::evaluate::AFTER)]
    Evaluate(Box<super::evaluate::EvaluateArgs>),
    /// Draw samples of a finished registration's error, to see what it means for a dose
    #[command(after_help = super::samples::AFTER)]
    Samples(super::samples::SamplesArgs),
    /// Carry dose through a field, accumulate it, compare it, read dose-volume histograms
    #[command(subcommand)]
    Dose(Box<super::dose::DoseVerb>),
    /// Summarise many runs in one table and one page: figures, outliers, each patient's course over the fractions
    #[command(after_help = super::summary::HELP)]
    Summary(super::summary::SummaryArgs),
    /// Show what files hold: geometry, orientation, labels, field direction; and whether they share a grid
    Inspect(super::inspect::InspectArgs),
    /// Look through a finished run at full resolution, in the browser of this machine
    #[command(after_help = super::view::AFTER)]
    View(super::view::ViewArgs),
    /// Draw one plane of a finished run for papers and slides: fusion, displacement, Jacobian or uncertainty, as SVG or PNG
    #[command(after_help = super::figure::AFTER)]
    Figure(super::figure::FigureArgs),
    /// Time the slowest steps on a scan of clinical size and compare them with the memory's bandwidth
    #[command(after_help = super::bench::HELP)]
    Bench(super::bench::BenchArgs),
    /// Plot error against run time for the main settings
    #[command(after_help = super::curve::HELP)]
    Curve(Box<super::curve::CurveArgs>),
    /// Run as a 3D Slicer module
    #[command(subcommand, after_help = super::slicer::HELP)]
    Slicer(super::slicer::SlicerVerb),
    /// Write the help of every verb as manual pages
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
