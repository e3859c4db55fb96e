//! Options of `register`, and its help.

use super::super::args::{PlanningArgs, RunArgs};
use super::super::clinic::ClinicArgs;
use super::super::organs::OrganArgs;
use clap::{Args, ValueEnum};
use std::path::{Path, PathBuf};

pub(in super::super) const HELP: &str = "\
Needs --planning, --bones and --fraction, unless --config names the report of an earlier run.

Writes to OUT:
  planning_to_fraction.*      push field on the planning grid: planning point x goes to x + u(x)
  fraction_to_planning.*      pull field on the fraction grid: fraction voxel y shows planning at
                              y + v(y)
  planning_on_fraction.nii.gz planning CT on the fraction grid, int16 HU
  bones_on_fraction.nii.gz    bone labels on the fraction grid, names in the header
  bone_transforms.json        4x4 per bone, planning to fraction, LPS mm
  bone_posterior.json         remaining uncertainty of the bones' poses, for `aventail samples`
  jacobian.nii.gz             volume after / before, planning grid; -1 folded, 1 outside tissue
  body.nii.gz, computed.nii.gz, inside_planning.nii.gz
                              masks: the patient; tissue whose motion was computed; fraction voxels
                              that the planning scan covers
  uncertainty.nii.gz          estimated error, mm, planning grid (docs/validation.md);
                              -1 outside the patient or unknown
  skin_contact.nii.gz         fraction voxels where skin passes through skin, if there are any
  regions.nii.gz              with `output.regions = true`: the bone that each voxel follows
  report.html, report.json, report/*.png, landmarks.csv, settings.toml

Examples:
  aventail register --planning planning_ct.nii.gz --bones bones.nii.gz \\
                    --fraction fraction_ct.nii.gz --out out
  # the same run once more
  aventail register --config out/report.json --out again
  # labels by TotalSegmentator, kept in patient
  aventail register --planning planning_ct.nii.gz --bones auto \\
                    --fraction fraction_ct.nii.gz --out patient/monday
  # writes week/monday, week/friday and week/index.html
  aventail register --planning ct.nii.gz --bones bones.nii.gz \\
                    --fraction monday.nii.gz --fraction friday.nii.gz --out week
  # a gland that has shrunk
  aventail register --planning ct.nii.gz --bones bones.nii.gz --fraction day.nii.gz \\
                    --organs parotid_left.nii.gz --volume-change parotid_left=0.8 --out out
  # the jaw and 50 mm around it
  aventail register --planning ct.nii.gz --bones bones.nii.gz --fraction day.nii.gz \\
                    --roi mandible --out jaw
  # labels of both scans first place the bones
  aventail register --planning ct.nii.gz --bones auto \\
                    --fraction day.nii.gz --fraction-bones auto --out day
  # soft tissue is pulled to the outlines of the day
  aventail register --planning ct --bones bones.nii.gz --fraction day \\
                    --guide RS.dcm --fraction-guide RS_day.dcm --guide-names bladder,rectum \\
                    --out day1";

/// Options of `register`.
#[derive(Debug, Args)]
pub struct RegisterArgs {
    /// Planning CT, its bones and their names.
    #[command(flatten)]
    pub side: PlanningArgs,
    /// Fraction image: a CT in HU or an MR, as a file or the folder of a DICOM series; grid, origin
    /// and field of view may differ from planning. Repeat the option for several fractions of one
    /// patient: work on the planning scan is done once, and each fraction gets a folder in OUT
    #[arg(long, value_name = "FILE", required_unless_present = "config")]
    pub fraction: Vec<PathBuf>,
    /// Modality of the fraction: CT (also cone-beam CT) in HU, or MR. DICOM series state theirs;
    /// other files are taken as CT
    #[arg(long, value_enum)]
    pub modality: Option<ModalityName>,
    /// Modality of the planning scan: CT in HU, or MR
    #[arg(long, value_enum)]
    pub planning_modality: Option<ModalityName>,
    /// Folder for the results; made if missing
    #[arg(long, value_name = "DIR", required_unless_present = "estimate")]
    pub out: Option<PathBuf>,
    /// Organs and their change of volume.
    #[command(flatten)]
    pub organs: OrganArgs,
    /// Landmarks known in both images (CSV): they measure the error and are never used for the
    /// registration. Repeat the option for each fraction, in their order
    #[arg(long, value_name = "FILE")]
    pub landmarks: Vec<PathBuf>,
    /// Landmarks on bones, at least three per bone (CSV with a column `bone`): they place the
    /// skeleton before it is fitted to the image
    #[arg(long, value_name = "FILE")]
    pub bone_landmarks: Option<PathBuf>,
    /// Bone labels of the fraction, with the same names as in planning (label map, structure set,
    /// or `auto` for TotalSegmentator). A bone labelled in both scans is first placed by its
    /// surface, then fitted to the image. Repeat the option for each fraction, in their order
    #[arg(long, value_name = "FILE|auto", conflicts_with = "bone_landmarks")]
    pub fraction_bones: Vec<PathBuf>,
    /// Names of the labels in --fraction-bones (JSON), if a label map has none
    #[arg(long, value_name = "FILE", requires = "fraction_bones")]
    pub fraction_labels: Option<PathBuf>,
    /// What decides the position of the bones: the image, or the labels of --fraction-bones alone
    #[arg(long, value_enum, requires = "fraction_bones", conflicts_with = "bone_landmarks_use")]
    pub fit: Option<FitName>,
    /// Guides: structures outlined in planning, as a label map with names or a DICOM structure set.
    /// Their surfaces are pulled to the outlines of the same names in --fraction-guide. Bones, and
    /// structures of one scan alone, are not used
    #[arg(long, value_name = "FILE")]
    pub guide: Option<PathBuf>,
    /// The same structures outlined in the fraction; repeat the option for each fraction, in their
    /// order
    #[arg(long, value_name = "FILE")]
    pub fraction_guide: Vec<PathBuf>,
    /// Use only these structures as guides; each must be outlined in both scans
    #[arg(long, value_name = "NAME,NAME", value_delimiter = ',')]
    pub guide_names: Vec<String>,
    /// Names of the labels in --guide and --fraction-guide (JSON), if a label map has none
    #[arg(long, value_name = "FILE")]
    pub guide_labels: Option<PathBuf>,
    /// Rigid registration, planning to fraction, near which the fit starts; where it explains
    /// little of the bones, all shifts are searched. A DICOM Spatial Registration, an ITK .tfm, a
    /// 4x4 matrix (.txt#lps or .txt#ras), or .json#NAME
    #[arg(long, value_name = "FILE", conflicts_with = "bone_landmarks")]
    pub start: Option<PathBuf>,
    /// Whether --bone-landmarks only start the fit to the image, or replace it
    #[arg(long, value_enum)]
    pub bone_landmarks_use: Option<LandmarkUseName>,
    /// Register only this part of the planning scan and 50 mm around it: the name of a label, or a
    /// box in LPS mm. The results are cropped to it (see `region` in docs/settings.md)
    #[arg(long, value_name = "NAME|X0,Y0,Z0,X1,Y1,Z1", allow_hyphen_values = true)]
    pub roi: Option<String>,
    /// Bones on which the couch shift (setup correction) is matched: spine (the vertebrae nearest
    /// the middle of what both scans show), names of bones, or the bones in a box (LPS mm, planning
    /// scan). The displacement fields do not depend on it
    #[arg(long = "match", value_name = "spine|NAME,NAME|X0,Y0,Z0,X1,Y1,Z1", allow_hyphen_values = true)]
    pub couch_match: Option<String>,
    /// Also write this many random samples of the registration's error to OUT/samples, for `dose
    /// map|accumulate --samples` (see `aventail samples`); the report shows the first three
    #[arg(long, value_name = "N")]
    pub samples: Option<usize>,
    /// Random seed of the samples
    #[arg(long, value_name = "N", requires = "samples", default_value_t = 0)]
    pub seed: u64,
    /// Do not start if the run is expected to need more memory than this
    #[arg(long, value_name = "GB")]
    pub max_memory: Option<f64>,
    /// Estimate the memory that the run will need, from headers and labels, and write nothing (with
    /// --json for schedulers)
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

impl RegisterArgs {
    /// The folder for the results; empty where only an estimate is asked for.
    pub(super) fn folder(&self) -> &Path {
        self.out.as_deref().unwrap_or(Path::new(""))
    }
}

/// What places bones that have labels in both scans.
#[derive(Debug, Clone, Copy, ValueEnum)]
pub enum FitName {
    /// The image; the labels give the starting position
    Image,
    /// The labels alone; bones without labels follow their joints
    Labels,
}

/// What makes an image.
#[derive(Debug, Clone, Copy, ValueEnum)]
pub enum ModalityName {
    /// CT or cone-beam CT, HU
    Ct,
    /// Magnetic resonance: magnitude images of any sequence and intensity scale
    Mr,
}

/// What bone landmarks do.
#[derive(Debug, Clone, Copy, ValueEnum)]
pub enum LandmarkUseName {
    /// They place the skeleton; the image refines it
    Start,
    /// They place the skeleton; the image takes no part
    Replace,
}
