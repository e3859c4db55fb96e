//! `aventail figure`: one plane of a finished run, for papers and slides.

use super::args::QuietArgs;
use super::finished::Finished;
use super::terminal::progress;
use crate::error::{Error, Result};
use crate::io;
use crate::report::{FigureKind, PlaneKind, figure};
use crate::runtime::Runtime;
use clap::{Args, ValueEnum};
use std::path::PathBuf;

/// What `aventail figure --help` adds.
pub(super) const AFTER: &str = "\
The plane is drawn as in the report, from the run's files and inputs, which must be unchanged. An
.svg holds the scans as pixels, and lines, arrows and text as vectors; a .png holds only pixels.

Examples:
  aventail figure out --kind fusion --plane sagittal --at 3.5 --out fusion.svg
  aventail figure out --kind displacement --plane axial --out displacement.png";

/// Options of `figure`.
#[derive(Debug, Args)]
pub struct FigureArgs {
    /// The --out folder of a finished run of `aventail register`, `pose` or `demo`
    #[arg(value_name = "OUT")]
    pub run: PathBuf,
    /// What to draw: fusion lies in the fraction's frame, the others in that of planning
    #[arg(long, value_enum)]
    pub kind: FigureKindName,
    /// The plane
    #[arg(long, value_enum)]
    pub plane: PlaneName,
    /// Position of the plane: x of a sagittal, y of a coronal, z of an axial plane, LPS mm
    /// (default: the middle of the scan)
    #[arg(long, value_name = "MM", allow_hyphen_values = true)]
    pub at: Option<f64>,
    /// File to write: .svg or .png
    #[arg(long, value_name = "FILE")]
    pub out: PathBuf,
    /// Whether progress is shown.
    #[command(flatten)]
    pub shown: QuietArgs,
}

/// Names of the kinds.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum FigureKindName {
    /// Planning CT deformed (blue) and fraction CT (orange), outlines of bones
    Fusion,
    /// Displacement as arrows over the planning CT
    Displacement,
    /// Jacobian determinant: volume after / volume before
    Jacobian,
    /// Estimated error, mm: on posed CTs two thirds of errors were smaller
    Uncertainty,
}

/// Names of the planes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum PlaneName {
    /// Across the body
    Axial,
    /// From side to side
    Coronal,
    /// From front to back
    Sagittal,
}

/// Draws the figure; returns what was written.
///
/// # Errors
/// When the run cannot be read, the place lies outside, or the file cannot be written.
pub(super) fn run(args: &FigureArgs) -> Result<String> {
    let extension = args.out.extension().map(|e| e.to_string_lossy().to_ascii_lowercase());
    let svg = match extension.as_deref() {
        Some("svg") => true,
        Some("png") => false,
        _ => {
            return Err(Error::usage(
                format!("{}: the file name does not say the figure's format", args.out.display()),
                "give a file that ends in .svg or .png",
            ));
        }
    };
    Finished::only(&args.run)?;
    io::check_files(&[&args.run.join("report.json")], std::slice::from_ref(&args.out))?;
    io::check_place(&args.out)?;
    let runtime = Runtime::new(0, progress(args.shown.quiet))?;
    let Finished { case, outcome, .. } = Finished::read(&args.run, &runtime)?;
    let kind = match args.kind {
        FigureKindName::Fusion => FigureKind::Fusion,
        FigureKindName::Displacement => FigureKind::Displacement,
        FigureKindName::Jacobian => FigureKind::Jacobian,
        FigureKindName::Uncertainty => FigureKind::Uncertainty,
    };
    let plane = match args.plane {
        PlaneName::Axial => PlaneKind::Axial,
        PlaneName::Coronal => PlaneKind::Coronal,
        PlaneName::Sagittal => PlaneKind::Sagittal,
    };
    let made = runtime.stage("draw", || figure(&case, &outcome, kind, plane, args.at))?;
    let bytes = if svg { made.svg()? } else { made.png()? };
    io::write_file(&args.out, |out| out.write_all(&bytes))?;
    Ok(format!("The figure: {}", args.out.display()))
}
