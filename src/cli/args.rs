//! The command line: verbs, options and their help.

use super::clinic::ClinicArgs;
use super::links::{LinkArg, frame};
use super::organs::OrganArgs;
use crate::field::FieldFormat;
use crate::io::points::Space;
use crate::runtime::MOST_THREADS;
use clap::builder::{OsStringValueParser, TypedValueParser};
use clap::{Args, Parser, Subcommand, ValueEnum};
use std::path::PathBuf;

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
4 the inputs do not fit the task or each other; 5 a result cannot be written; 6 the registration failed.

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
    /// Carry dose through a field, accumulate it, compare it, read dose-volume histograms
    #[command(subcommand)]
    Dose(super::dose::DoseVerb),
    /// Gather many runs into one table and one page: figures, what stands apart, each patient's course over the fractions
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
    /// Time the hot paths on a scene of clinical size, beside what the memory allows
    #[command(after_help = super::bench::HELP)]
    Bench(super::bench::BenchArgs),
    /// Draw error against run time over the settings that matter
    #[command(after_help = super::curve::HELP)]
    Curve(Box<super::curve::CurveArgs>),
    /// Be a module of 3D Slicer
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

const REGISTER: &str = "\
Writes to OUT:
  planning_to_fraction.*      push field on the planning grid: planning point x goes to x + u(x)
  fraction_to_planning.*      pull field on the fraction grid: fraction voxel y shows planning at y + v(y)
  planning_on_fraction.nii.gz planning CT on the fraction grid, int16 HU
  bones_on_fraction.nii.gz    bone labels on the fraction grid, names in the header
  bone_transforms.json        4x4 per bone, planning to fraction, LPS mm
  jacobian.nii.gz             V_deformed / V_initial on the planning grid; -1 folded
  body.nii.gz, computed.nii.gz, inside_planning.nii.gz
                              masks: patient; tissue whose motion was computed; fraction voxels that the planning scan covers
  uncertainty.nii.gz          how far the result may be trusted, mm, on the planning grid
  skin_contact.nii.gz         only where the moved patient lies on himself: fraction voxels
  regions.nii.gz              with `output.regions = true`: the bone that each voxel follows
  report.html, report.json, report/*.png, landmarks.csv, settings.toml

Examples:
  aventail register --planning planning_ct.nii.gz --bones bones.nii.gz --fraction fraction_ct.nii.gz --out out
  aventail register --planning planning_ct.nii.gz --bones bones.nii.gz --organs parotid_left.nii.gz --volume-change parotid_left=0.8 --fraction fraction_ct.nii.gz --out out
  aventail register --planning planning_ct.nii.gz --bones auto --fraction fraction_ct.nii.gz --out patient/monday
                                                              # labels by TotalSegmentator, kept in patient
  aventail register --config out/report.json --out again      # the same run once more
  aventail register --planning ct.nii.gz --bones bones.nii.gz --fraction monday.nii.gz --fraction friday.nii.gz --out week
                                                              # writes week/monday and week/friday
  aventail register --planning ct.nii.gz --bones bones.nii.gz --fraction day.nii.gz --roi mandible --out jaw";

/// Options of `register`.
#[derive(Debug, Args)]
pub struct RegisterArgs {
    /// Planning CT in HU (NIfTI, MetaImage or NRRD; the folder of a DICOM series, FOLDER#NUMBER of several)
    #[arg(long, value_name = "FILE", required_unless_present = "config")]
    pub planning: Option<PathBuf>,
    /// Bone labels on the planning grid, for example TotalSegmentator's multi-label file; or a DICOM structure set; or `auto`:
    /// runs TotalSegmentator, where it is installed, and keeps its labels beside OUT for the next fraction
    #[arg(long, value_name = "FILE|auto", required_unless_present = "config")]
    pub bones: Option<PathBuf>,
    /// Fraction CT in HU, a file or the folder of a DICOM series; any grid, origin and field of view. Repeat it for several fractions of one patient: what depends
    /// on planning alone is done once, and each fraction has a folder in OUT
    #[arg(long, value_name = "FILE", required_unless_present = "config")]
    pub fraction: Vec<PathBuf>,
    /// Folder for the results; made if missing
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// Names of the labels, {"labels": {"1": "skull", ...}}; not needed when the label file carries them. Of a structure set
    /// a TOML file of names that are not recognised: a table `bones` with lines as "Unterkiefer" = "mandible"
    #[arg(long, value_name = "FILE")]
    pub labels: Option<PathBuf>,
    /// Organs and their change of volume.
    #[command(flatten)]
    pub organs: OrganArgs,
    /// Changes to the skeleton that the labels give (see `aventail skeleton --out`)
    #[arg(long, value_name = "FILE")]
    pub skeleton: Option<PathBuf>,
    /// Landmarks known in both images (CSV); they only evaluate and never enter the fit. With several fractions one file
    /// for each, in their order
    #[arg(long, value_name = "FILE")]
    pub landmarks: Vec<PathBuf>,
    /// Landmarks on bones, three or more each (CSV with a column `bone`): they place the skeleton before the image does
    #[arg(long, value_name = "FILE")]
    pub bone_landmarks: Option<PathBuf>,
    /// Rigid motion of the whole patient from planning to the fraction, near which the fit begins instead of searching: a DICOM
    /// Spatial Registration, ITK .tfm, 4x4 .txt#lps or .txt#ras, .json#NAME
    #[arg(long, value_name = "FILE", conflicts_with = "bone_landmarks")]
    pub start: Option<PathBuf>,
    /// Whether bone landmarks start the fit to the image or replace it
    #[arg(long, value_enum)]
    pub bone_landmarks_use: Option<LandmarkUseName>,
    /// Only this part of the planning scan, with 50 mm around it: the name of a label, or a box in LPS mm. The results are
    /// cut to it (see `region` in docs/settings.md)
    #[arg(long, value_name = "NAME|X0,Y0,Z0,X1,Y1,Z1", allow_hyphen_values = true)]
    pub roi: Option<String>,
    /// Refuse to begin when the run is expected to need more memory than this
    #[arg(long, value_name = "GB")]
    pub max_memory: Option<f64>,
    /// Only tell what the run is expected to need, from headers and labels; with --json for schedulers. Nothing is written
    #[arg(long)]
    pub estimate: bool,
    /// Settings (TOML), or the report.json of an earlier run to repeat it
    #[arg(long, value_name = "FILE")]
    pub config: Option<PathBuf>,
    /// Options for planning systems.
    #[command(flatten)]
    pub clinic: ClinicArgs,
    /// Options of every run.
    #[command(flatten)]
    pub run: RunArgs,
}

/// What bone landmarks do.
#[derive(Debug, Clone, Copy, ValueEnum)]
pub enum LandmarkUseName {
    /// They place the skeleton; the image refines it
    Start,
    /// They place the skeleton; the image takes no part
    Replace,
}

/// Options of every run.
#[derive(Debug, Args, Clone)]
pub struct RunArgs {
    /// Settings to start from
    #[arg(long, value_enum)]
    pub preset: Option<PresetName>,
    /// Accuracy against run time; see `aventail curve`
    #[arg(long, value_enum, conflicts_with = "preset")]
    pub speed: Option<SpeedName>,
    /// Layout of the displacement fields
    #[arg(long = "dvf-format", alias = "field-format", value_enum, value_name = "FORMAT")]
    pub field_format: Option<FormatName>,
    /// Threads; 0 takes one per core. Results do not depend on it
    #[arg(long, value_name = "N", default_value_t = 0, value_parser = threads)]
    pub threads: usize,
    /// Leave the volumes out of report.html: its pictures stay, there is nothing to scroll through, and the file is smaller
    #[arg(long)]
    pub no_view: bool,
    /// Print the numbers of the report as JSON instead of the table
    #[arg(long)]
    pub json: bool,
    /// Show no progress
    #[arg(long, short)]
    pub quiet: bool,
}

/// Names of the presets.
#[derive(Debug, Clone, Copy, ValueEnum)]
pub enum PresetName {
    /// What measures best
    Default,
    /// The final model of Bartelheimer's thesis
    Thesis,
}

/// Points on the curve of error against run time.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum SpeedName {
    /// Coarser elements, no map of uncertainty (preset fast)
    Fast,
    /// What measures best for its time (preset default)
    Balanced,
    /// More comparisons of the images (preset accurate)
    Accurate,
}

const WARP: &str = "\
Frames are the worlds of scans: planning, fraction, or any names you choose. A field FROM:TO lies on the grid of FROM and
takes its points x to x + u(x) in TO. aventail's fields carry that in their header; say it of all others:
  ITK, ANTs, greedy, plastimatch, elastix, NiftyReg: fixed image A, moving image B  ->  A:B=FILE
Points and contours go forward; images, labels and dose are pulled back. Where the field points the other way it is inverted
numerically and the residual printed. Several --field are a chain, in order. Outside a field points stay where they are.

Examples:
  aventail warp --field out/planning_to_fraction.nii.gz --from planning --to fraction --input tumour.mrk.json --out moved.mrk.json
  aventail warp --field out/fraction_to_planning.nii.gz --from planning --to fraction --kind dose --input dose.nii.gz --out dose_day.nii.gz
  aventail warp --field planning:fraction=elastix.mha --from planning --to fraction --kind labels --input organs.nii.gz --grid fraction_ct.nii.gz --out organs_day.nii.gz
  aventail warp --field couch:planning=rigid.tfm --field out/planning_to_fraction.nii.gz --from couch --to fraction \\
                --grid couch_ct.nii.gz --out-field all.mha        # one field for the whole chain";

/// Options of `warp`.
#[derive(Debug, Args)]
pub struct WarpArgs {
    /// Displacement field or rigid transform (ITK .tfm, 4x4 .txt with --space, .json#NAME, DICOM registrations); repeat it for a
    /// chain
    #[arg(long, value_name = "[FROM:TO=]FILE", required = true, value_parser = OsStringValueParser::new().try_map(LinkArg::of))]
    pub field: Vec<LinkArg>,
    /// Frame that the input lies in
    #[arg(long, value_name = "FRAME", value_parser = frame)]
    pub from: String,
    /// Frame that the result lies in
    #[arg(long, value_name = "FRAME", value_parser = frame)]
    pub to: String,
    /// What to carry: image, label map or dose (.nii.gz, .mha, .nrrd, DICOM); points (.csv, .mrk.json, .fcsv, .txt); contours
    /// (.json, DICOM structure set); mesh (.obj, .stl)
    #[arg(long, value_name = "FILE", requires = "out", conflicts_with = "out_field")]
    pub input: Option<PathBuf>,
    /// The result
    #[arg(long, value_name = "FILE", requires = "input")]
    pub out: Option<PathBuf>,
    /// What the voxels of the input are; needed for volumes
    #[arg(long, value_enum)]
    pub kind: Option<VolumeKind>,
    /// Any image on the grid of the result, or the folder of a DICOM series; default: the grid of a field that lies there
    #[arg(long, value_name = "FILE")]
    pub grid: Option<PathBuf>,
    /// DICOM series of the scan that the result lies in: the result is DICOM of its patient, study and frame of reference.
    /// Structures and dose need --out *.dcm, an image a folder. A field (--out-field *.dcm) lies in the scan of --from
    #[arg(long, value_name = "SERIES")]
    pub dicom_like: Option<PathBuf>,
    /// For a field as DICOM also the series of the scan that it leads to, that of --to: a Deformable Spatial Registration
    /// names both
    #[arg(long, value_name = "SERIES", requires = "out_field", requires = "dicom_like")]
    pub dicom_to: Option<PathBuf>,
    /// Between voxels of an image or dose
    #[arg(long, value_enum)]
    pub interpolation: Option<InterpolationName>,
    /// Value of an image where nothing maps [default: -1000, air]
    #[arg(long, value_name = "VALUE", allow_hyphen_values = true)]
    pub outside: Option<f32>,
    /// Scale HU + 1000 of a CT by the tissue's volume before over after, so that no mass is made or lost: what is squeezed
    /// gets denser. Without it a CT keeps its HU, as tissue does that merely moves or exchanges fluid
    #[arg(long)]
    pub scale_by_jacobian: bool,
    /// Names of the labels, {"labels": {"1": "skull", ...}}; not needed when the label file carries them
    #[arg(long, value_name = "FILE")]
    pub labels: Option<PathBuf>,
    /// Coordinates of a 4x4 matrix, mesh or .fcsv that does not say it: ras for greedy, c3d, ITK-SNAP; lps for ITK, aventail.
    /// One matrix of several can say it as FILE#ras or FILE#lps
    #[arg(long, value_enum)]
    pub space: Option<SpaceName>,
    /// Write the chain as one field that takes points of --from to --to, instead of carrying an input
    #[arg(long, value_name = "FILE", required_unless_present = "input")]
    pub out_field: Option<PathBuf>,
    /// Layout of --out-field [default: by its extension]
    #[arg(long, value_enum, requires = "out_field", conflicts_with = "dicom_like", value_name = "FORMAT")]
    pub dvf_format: Option<FormatName>,
    /// Threads; 0 takes one per core. Results do not depend on it
    #[arg(long, value_name = "N", default_value_t = 0, value_parser = threads)]
    pub threads: usize,
    /// Print JSON
    #[arg(long)]
    pub json: bool,
    /// Show no progress
    #[arg(long, short)]
    pub quiet: bool,
}

/// What voxels are.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum VolumeKind {
    /// CT or any scalar image
    Image,
    /// Label map: each label has one vote, names are kept
    Labels,
    /// Dose: nowhere negative, 0 outside
    Dose,
}

/// Names of the interpolations.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum InterpolationName {
    /// Trilinear
    Linear,
    /// Cubic convolution
    Cubic,
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
    /// NIfTI, intent 1007, LPS: ITK, ANTs, greedy, plastimatch, transformix, old and new
    Nifti,
    /// MetaImage (.mha), LPS, not compressed: the same tools
    Mha,
    /// NRRD, LPS: the same tools and Slicer
    Nrrd,
    /// NIfTI, intent 1006, RAS: ITK 5.4, ANTs and greedy only; older ITK misreads it
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

/// Options of `skeleton`.
#[derive(Debug, Args)]
pub struct SkeletonArgs {
    /// Bone labels, for example TotalSegmentator's multi-label file; with --planning also a DICOM structure set, or `auto` as
    /// in `register`
    #[arg(long, value_name = "FILE|auto")]
    pub bones: PathBuf,
    /// Planning CT: a structure set is drawn on its grid, and `auto` labels it
    #[arg(long, value_name = "FILE")]
    pub planning: Option<PathBuf>,
    /// Names of the labels, {"labels": {"1": "skull", ...}}
    #[arg(long, value_name = "FILE")]
    pub labels: Option<PathBuf>,
    /// Changes to check against the built skeleton
    #[arg(long, value_name = "FILE")]
    pub skeleton: Option<PathBuf>,
    /// Write the skeleton as TOML, to be edited and given to `register --skeleton`
    #[arg(long, value_name = "FILE")]
    pub out: Option<PathBuf>,
    /// Print JSON
    #[arg(long)]
    pub json: bool,
}

/// A number of threads.
pub(super) fn threads(text: &str) -> Result<usize, String> {
    match text.parse() {
        Ok(n) if n <= MOST_THREADS => Ok(n),
        _ => Err(format!("give 0 to {MOST_THREADS}; 0 takes one per core")),
    }
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
