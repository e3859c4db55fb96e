//! Arguments that verbs share.

use crate::evaluate::Direction;
use crate::field::FieldFormat;
use crate::io::points::Space;
use crate::runtime::MOST_THREADS;
use clap::{Args, ValueEnum};
use std::path::PathBuf;

/// Options of every run.
#[derive(Debug, Args, Clone, Default)]
pub struct RunArgs {
    /// Preset: the settings to start from
    #[arg(long, value_enum)]
    pub preset: Option<PresetName>,
    /// Trade accuracy for run time; see `aventail curve`
    #[arg(long, value_enum, conflicts_with = "preset")]
    pub speed: Option<SpeedName>,
    /// File format of the displacement fields
    #[arg(long = "dvf-format", alias = "field-format", value_enum, value_name = "FORMAT")]
    pub field_format: Option<FormatName>,
    /// Threads.
    #[command(flatten)]
    pub work: ThreadArgs,
    /// Leave the image volumes out of report.html: the file is smaller and keeps the pictures, but
    /// has no planes to scroll through
    #[arg(long)]
    pub no_view: bool,
    /// How the result is told.
    #[command(flatten)]
    pub told: JsonArgs,
    /// Whether progress is shown.
    #[command(flatten)]
    pub shown: QuietArgs,
}

/// How many threads work.
#[derive(Debug, Args, Clone, Copy, Default)]
pub struct ThreadArgs {
    /// Number of threads; 0 takes one per core. Results do not depend on it
    #[arg(long, value_name = "N", default_value_t = 0, value_parser = threads)]
    pub threads: usize,
}

/// How a result is told.
#[derive(Debug, Args, Clone, Copy, Default)]
pub struct JsonArgs {
    /// Print JSON instead of the table
    #[arg(long)]
    pub json: bool,
}

/// Whether progress is shown.
#[derive(Debug, Args, Clone, Copy, Default)]
pub struct QuietArgs {
    /// Show no progress
    #[arg(long, short)]
    pub quiet: bool,
}

/// Threads, progress, and how a result is told.
#[derive(Debug, Args, Clone, Copy, Default)]
pub struct CommonArgs {
    /// Threads.
    #[command(flatten)]
    pub work: ThreadArgs,
    /// How the result is told.
    #[command(flatten)]
    pub told: JsonArgs,
    /// Whether progress is shown.
    #[command(flatten)]
    pub shown: QuietArgs,
}

/// Planning CT, its bones and their names.
#[derive(Debug, Args, Clone)]
pub struct PlanningArgs {
    /// Planning CT in HU (`register`: or MR): a NIfTI, MetaImage or NRRD file, or the folder of a
    /// DICOM series; FOLDER#NUMBER chooses one of several series
    #[arg(long, value_name = "FILE", required_unless_present = "config")]
    pub planning: Option<PathBuf>,
    /// Bone labels: a label map on the planning grid (TotalSegmentator's multi-label file), DICOM
    /// structure set or segmentation. `auto` runs TotalSegmentator, which must be installed, and
    /// keeps its labels beside OUT for the next fraction
    #[arg(long, value_name = "FILE|auto", required_unless_present = "config")]
    pub bones: Option<PathBuf>,
    /// Names of the labels (JSON), {"labels": {"1": "skull", ...}}; not needed if the label file
    /// has them. For a structure set: a TOML file that translates names that are not recognised, in
    /// a table `bones` with lines such as "Unterkiefer" = "mandible"
    #[arg(long, value_name = "FILE")]
    pub labels: Option<PathBuf>,
    /// Changes to the skeleton that is built from the labels (TOML; see `aventail skeleton --out`)
    #[arg(long, value_name = "FILE")]
    pub skeleton: Option<PathBuf>,
}

/// Names of the presets.
#[derive(Debug, Clone, Copy, ValueEnum)]
pub enum PresetName {
    /// Recommended settings
    Default,
    /// The final model of Bartelheimer's thesis
    Thesis,
}

/// Points on the curve of error against run time.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum SpeedName {
    /// Coarser elements, no uncertainty map (preset fast)
    Fast,
    /// Recommended settings (preset default)
    Balanced,
}

/// Names of coordinate frames of files.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum SpaceName {
    /// Left, posterior, superior
    Lps,
    /// Right, anterior, superior
    Ras,
}

impl From<SpaceName> for Space {
    fn from(name: SpaceName) -> Self {
        match name {
            SpaceName::Lps => Self::Lps,
            SpaceName::Ras => Self::Ras,
        }
    }
}

/// Names of the field formats.
#[derive(Debug, Clone, Copy, ValueEnum)]
pub enum FormatName {
    /// NIfTI, intent 1007, LPS: read by ITK, ANTs, greedy, plastimatch and transformix, old and new
    /// versions
    Nifti,
    /// MetaImage (.mha), LPS, uncompressed: read by the same tools
    Mha,
    /// NRRD, LPS: read by the same tools and Slicer
    Nrrd,
    /// NIfTI, intent 1006, RAS: read by ITK 5.4, ANTs and greedy only; older ITK misreads it
    Dispvect,
    /// NiftyReg's displacement field, RAS
    NiftyregDisplacement,
    /// NiftyReg's deformation field, RAS positions
    NiftyregDeformation,
}

impl From<FormatName> for FieldFormat {
    fn from(name: FormatName) -> Self {
        match name {
            FormatName::Nifti => Self::Nifti,
            FormatName::Mha => Self::MetaImage,
            FormatName::Nrrd => Self::Nrrd,
            FormatName::Dispvect => Self::Dispvect,
            FormatName::NiftyregDisplacement => Self::NiftyregDisplacement,
            FormatName::NiftyregDeformation => Self::NiftyregDeformation,
        }
    }
}

/// A number of threads.
fn threads(text: &str) -> Result<usize, String> {
    match text.parse() {
        Ok(n) if n <= MOST_THREADS => Ok(n),
        _ => Err(format!("give 0 to {MOST_THREADS}; 0 takes one per core")),
    }
}

/// Names of directions.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum DirectionName {
    /// Field on the planning grid (fixed image = planning)
    PlanningToFraction,
    /// Field on the fraction grid (fixed image = fraction)
    FractionToPlanning,
}

impl From<DirectionName> for Direction {
    fn from(name: DirectionName) -> Self {
        match name {
            DirectionName::PlanningToFraction => Self::PlanningToFraction,
            DirectionName::FractionToPlanning => Self::FractionToPlanning,
        }
    }
}
