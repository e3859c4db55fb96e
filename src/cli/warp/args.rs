//! Options of `warp`, and its help.

use super::super::args::{CommonArgs, FormatName, SpaceName};
use super::super::links::{LinkArg, frame};
use clap::builder::{OsStringValueParser, TypedValueParser};
use clap::{Args, ValueEnum};
use std::path::{Path, PathBuf};

pub(in super::super) const HELP: &str = "\
A frame is the coordinate system of a scan: planning, fraction, or any name that you choose. A field
FROM:TO lies on the grid of FROM and takes its points x to x + u(x) in TO. The header of aventail's
fields names both; name them yourself for all other fields:
  ITK, ANTs, greedy, plastimatch, elastix, NiftyReg: fixed image A, moving image B  ->  A:B=FILE
Points and contours are pushed forward; images, labels and dose are resampled (pulled back). A field
of the other direction is inverted numerically, and the residual is printed. Several --field are
applied as a chain, in their order. Points outside a field stay where they are.

Examples:
  aventail warp --field out/planning_to_fraction.nii.gz --from planning --to fraction \\
                --input tumour.mrk.json --out moved.mrk.json
  aventail warp --field out/fraction_to_planning.nii.gz --from planning --to fraction \\
                --kind dose --input dose.nii.gz --out dose_day.nii.gz
  aventail warp --field planning:fraction=elastix.mha --from planning --to fraction \\
                --kind labels --input organs.nii.gz --grid fraction_ct.nii.gz \\
                --out organs_day.nii.gz
  # one field for the whole chain
  aventail warp --field couch:planning=rigid.tfm --field out/planning_to_fraction.nii.gz \\
                --from couch --to fraction --grid couch_ct.nii.gz --out-field all.mha";

/// The file that is carried, and the one that is written.
#[derive(Clone, Copy)]
pub(super) struct Files<'a> {
    pub(super) input: &'a Path,
    pub(super) out: &'a Path,
}

/// Options of `warp`.
#[derive(Debug, Args)]
pub struct WarpArgs {
    /// Displacement field or rigid transform (ITK .tfm, 4x4 .txt with --space, .json#NAME, DICOM
    /// registrations); repeat the option for a chain
    #[arg(long, value_name = "[FROM:TO=]FILE", required = true, value_parser = OsStringValueParser::new().try_map(LinkArg::of))]
    pub field: Vec<LinkArg>,
    /// Frame that the input lies in
    #[arg(long, value_name = "FRAME", value_parser = frame)]
    pub from: String,
    /// Frame that the result lies in
    #[arg(long, value_name = "FRAME", value_parser = frame)]
    pub to: String,
    /// What to warp: image, label map or dose (.nii.gz, .mha, .nrrd, DICOM); points (.csv,
    /// .mrk.json, .fcsv, .txt); contours (.json, DICOM structure set); mesh (.obj, .stl)
    #[arg(long, value_name = "FILE", requires = "out", conflicts_with = "out_field")]
    pub input: Option<PathBuf>,
    /// File of the result
    #[arg(long, value_name = "FILE", requires = "input")]
    pub out: Option<PathBuf>,
    /// Type of the input's voxels; required for volumes
    #[arg(long, value_enum)]
    pub kind: Option<VolumeKind>,
    /// Image, or folder of a DICOM series, that gives the result its grid; default: the grid of a
    /// field in the same frame
    #[arg(long, value_name = "FILE")]
    pub grid: Option<PathBuf>,
    /// Write DICOM in the frame of this series, with its patient and study: the scan in which the
    /// result lies, for a field (--out-field *.dcm) the scan of --from. For structures, labels
    /// (written as a segmentation) and dose --out is *.dcm, for an image a folder
    #[arg(long, value_name = "SERIES")]
    pub dicom_like: Option<PathBuf>,
    /// For a field as DICOM: the series of the scan of --to, to which the Deformable Spatial
    /// Registration also refers
    #[arg(long, value_name = "SERIES", requires = "out_field", requires = "dicom_like")]
    pub dicom_to: Option<PathBuf>,
    /// Interpolation of an image or dose
    #[arg(long, value_enum)]
    pub interpolation: Option<InterpolationName>,
    /// Value of image voxels that the input does not reach [default: -1000, air]
    #[arg(long, value_name = "VALUE", allow_hyphen_values = true)]
    pub outside: Option<f32>,
    /// Scale HU + 1000 of a CT by volume before / volume after, to conserve mass: compressed tissue
    /// becomes denser. Without this option a CT keeps its HU
    #[arg(long)]
    pub scale_by_jacobian: bool,
    /// Names of the labels (JSON), {"labels": {"1": "skull", ...}}; not needed if the label file
    /// has them
    #[arg(long, value_name = "FILE")]
    pub labels: Option<PathBuf>,
    /// Folder of samples of the registration (`aventail samples`), from planning to fraction only.
    /// For labels it also writes OUT_share_NAME, the share of samples with the label at each voxel;
    /// for contours also the contours that 5, 50 and 95 % of the samples reach
    #[arg(long, value_name = "DIR", requires = "input")]
    pub samples: Option<PathBuf>,
    /// Coordinate system of a 4x4 matrix, mesh or .fcsv that does not state it: ras for greedy,
    /// c3d, ITK-SNAP; lps for ITK, aventail. If several matrices differ, write it behind the file:
    /// FILE#ras or FILE#lps
    #[arg(long, value_enum)]
    pub space: Option<SpaceName>,
    /// Instead of warping an input, write the chain as one field that takes points of --from to
    /// --to
    #[arg(long, value_name = "FILE", required_unless_present = "input")]
    pub out_field: Option<PathBuf>,
    /// File format of --out-field [default: by its extension]
    #[arg(long, value_enum, requires = "out_field", conflicts_with = "dicom_like", value_name = "FORMAT")]
    pub dvf_format: Option<FormatName>,
    /// Threads, progress, and how the result is told.
    #[command(flatten)]
    pub common: CommonArgs,
}

/// What voxels are.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum VolumeKind {
    /// CT or any scalar image
    Image,
    /// Label map: each voxel gets the label with the largest interpolated share; names are kept
    Labels,
    /// Dose: never negative, 0 outside
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
