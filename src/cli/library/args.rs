//! Options of `library`, and its help.

use super::super::args::RunArgs;
use crate::chainmail::VolumeChange;
use crate::postures::{MOST_DRAWS, VolumeRange};
use clap::Args;
use std::path::PathBuf;

/// The file that tells what a library holds.
pub(super) const MANIFEST: &str = "library.json";
/// Its page.
pub(super) const PAGE: &str = "library.html";
/// The plan in full.
pub(super) const PLAN: &str = "postures.toml";

pub(in crate::cli) const HELP: &str = "\
Without --plan, postures vary as usual between fractions: the couch by 1.9 mm and 0.75 degrees,
the neck by a few degrees shared by its levels, and also jaw, hyoid and shoulders
(docs/library.md has the numbers and their sources). A plan changes that:

  scale = 1.5                        # all standard deviations times 1.5
  [couch]
  shift_sd_mm = [2.0, 2.0, 3.0]      # left, back, up; also rotation_sd_deg
  [neck]
  flexion_sd_deg = 4.0               # of the whole neck; also lateral, axial; rest_sd_deg: of each
                                     # level, in addition to its share
  [bones.mandible]
  flexion_sd_deg = 3.0               # also lateral, axial; shift_sd_mm
  flexion_deg = [0.0, 15.0]          # allowed range, within that of `aventail skeleton`
  [volumes]
  parotid_left = [0.7, 1.0]          # as --volume-change
  [[postures]]                       # made before any is drawn; as a pose file, with a name
  name = \"chin up\"
  bones.skull.flexion_deg = -8.0

Writes to OUT:
  library.json    MONAI's datalist: `training` has the plausible postures, `implausible` the others
  library.html    the spread on one page
  postures.toml   the plan in full, for --plan
  posture_001/    ct.nii.gz, labels.nii.gz, pose.toml, bone_transforms.json, posture.json;
                  planning_to_fraction.* and fraction_to_planning.* (the exact motion of this CT);
                  with --structures contours.json, with --dose dose.nii.gz, with --cbct or --noise
                  image.nii.gz: ct.nii.gz with the artefacts or the noise

A run that was stopped continues when it is started again with the same settings. --fit finds the
principal modes of motion in a patient's own fractions and writes them as a plan.

Examples:
  aventail library --planning planning_ct.nii.gz --bones bones.nii.gz --sample 20 --out library
  aventail library --planning planning_ct.nii.gz --bones bones.nii.gz --plan postures.toml --sample 45 --seed 7 --reject \\
                   --structures contours.json --dose dose.nii.gz --cbct --no-fields --out library
  aventail library --fit week/monday week/wednesday week/friday --out modes      # of `aventail register`
  aventail library --planning planning_ct.nii.gz --bones bones.nii.gz --plan modes/postures.toml --sample 20 --out own";

/// Options of `library`.
#[derive(Debug, Args)]
pub struct LibraryArgs {
    /// Planning CT in HU (NIfTI, MetaImage or NRRD; the folder of a DICOM series)
    #[arg(long, value_name = "FILE", required_unless_present_any = ["config", "fit"])]
    pub planning: Option<PathBuf>,
    /// Bone labels on the planning grid; a DICOM structure set; or `auto`, as in `register`
    #[arg(long, value_name = "FILE|auto", required_unless_present_any = ["config", "fit"])]
    pub bones: Option<PathBuf>,
    /// Plan (TOML): what varies and by how much, and postures to include
    #[arg(long, value_name = "FILE")]
    pub plan: Option<PathBuf>,
    /// Number of postures to draw at random
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=MOST_SAMPLES))]
    pub sample: Option<u32>,
    /// Random seed: the same seed gives the same postures, however many are drawn
    #[arg(long, value_name = "S", default_value_t = 1)]
    pub seed: u32,
    /// Replace implausible postures by new draws: bones that overlap or come apart, folds, skin
    /// that passes through skin
    #[arg(long, requires = "sample")]
    pub reject: bool,
    /// Folder for the results; made if missing
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// Find the principal modes of motion in these finished `register` runs of one planning CT and
    /// write them as a plan
    #[arg(long, value_name = "DIR", num_args = 1.., conflicts_with_all = ["planning", "bones", "plan", "sample", "config"])]
    pub fit: Vec<PathBuf>,
    /// Grow the artificial CTs beyond the planning grid by this much on all sides, mm
    #[arg(long, value_name = "MM", default_value_t = 0.0, value_parser = super::super::pose::parse_margin)]
    pub margin: f64,
    /// Names of the labels, {"labels": {"1": "skull", ...}}
    #[arg(long, value_name = "FILE")]
    pub labels: Option<PathBuf>,
    /// Organ labels on the planning grid: a label map with names, or a mask whose file name is the
    /// organ's name
    #[arg(long, value_name = "FILE")]
    pub organs: Option<PathBuf>,
    /// Volume of an organ divided by that in planning, drawn uniformly between two factors, for
    /// example parotid_left=0.7..1.0; repeat the option for several organs
    #[arg(long, value_name = "ORGAN=LOW..HIGH", value_parser = parse_range)]
    pub volume_change: Vec<VolumeRange>,
    /// Changes to the skeleton that is built from the labels (TOML; see `aventail skeleton --out`)
    #[arg(long, value_name = "FILE")]
    pub skeleton: Option<PathBuf>,
    /// Planning contours to map to each posture (.json, DICOM structure set)
    #[arg(long, value_name = "FILE")]
    pub structures: Option<PathBuf>,
    /// Planned dose to map to each posture, Gy
    #[arg(long, value_name = "FILE")]
    pub dose: Option<PathBuf>,
    /// Write no displacement fields: they are most of a library's size
    #[arg(long)]
    pub no_fields: bool,
    /// Also write a simulated cone-beam CT of each posture; FILE (TOML, as `aventail phantom
    /// --cbct` writes it) changes its settings
    #[arg(long, value_name = "FILE", num_args = 0..=1, conflicts_with = "noise")]
    pub cbct: Option<Option<PathBuf>>,
    /// Also write each CT with white noise of this standard deviation, HU
    #[arg(long, value_name = "HU", allow_negative_numbers = true, value_parser = parse_noise)]
    pub noise: Option<f64>,
    /// Settings (TOML), or the library.json of an earlier run to take its settings and inputs
    #[arg(long, value_name = "FILE")]
    pub config: Option<PathBuf>,
    /// Options of every run.
    #[command(flatten)]
    pub run: RunArgs,
}

/// No library is larger: draws that are not kept need room in the sequence.
const MOST_SAMPLES: i64 = MOST_DRAWS as i64 / 8;

fn parse_range(text: &str) -> Result<VolumeRange, String> {
    let example = "ORGAN=LOW..HIGH is needed, for example parotid_left=0.7..1.0";
    let (organ, range) = text.split_once('=').ok_or(example)?;
    let (low, high) = range.split_once("..").ok_or(example)?;
    let number = |t: &str| t.trim().parse::<f64>().map_err(|_| format!("`{t}` is no number"));
    let range = VolumeRange { organ: organ.to_owned(), range: [number(low)?, number(high)?] };
    problem(&range).map_or(Ok(range), Err)
}

/// What is wrong with a range of volumes, if anything.
pub(super) fn problem(range: &VolumeRange) -> Option<String> {
    let [low, high] = range.range;
    let ends = [low, high].map(|factor| VolumeChange { organ: range.organ.clone(), factor }.problem());
    let reversed = (low > high).then(|| format!("{}: {low} is greater than {high}", range.organ));
    ends.into_iter().flatten().next().or(reversed)
}

fn parse_noise(text: &str) -> Result<f64, String> {
    let value: f64 = text.parse().map_err(|_| format!("`{text}` is no number"))?;
    if is_noise(value) { Ok(value) } else { Err("give a standard deviation above 0 and up to 1000 HU".into()) }
}

fn is_noise(hu: f64) -> bool {
    hu > 0.0 && hu <= 1000.0
}

impl LibraryArgs {
    /// What is wrong with the numbers, if anything: they may come from elsewhere than a command line.
    pub(super) fn problem(&self) -> Option<String> {
        let sample = self.sample.filter(|n| !(1..=MOST_SAMPLES).contains(&i64::from(*n)));
        let sample = sample.map(|n| format!("{n} postures: 1 to {MOST_SAMPLES} can be drawn"));
        let noise = self.noise.filter(|hu| !is_noise(*hu));
        let noise = noise.map(|hu| format!("noise of {hu} HU: more than 0 and up to 1000 can be added"));
        let margin = (!(0.0..=500.0).contains(&self.margin)).then(|| format!("a margin of {} mm", self.margin));
        sample.or(noise).or(margin)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ranges_are_read_and_refused() {
        let read = parse_range("parotid_left=0.7..1.0").unwrap();
        assert_eq!((read.organ.as_str(), read.range), ("parotid_left", [0.7, 1.0]));
        for bad in ["a", "a=0.7", "a=1..0.7", "a=0..1", "a=0.7..x", "a=0.7..9", "a=NaN..1"] {
            assert!(parse_range(bad).is_err(), "{bad}");
        }
        assert!(parse_noise("0").is_err() && parse_noise("inf").is_err() && parse_noise("20").is_ok());
    }
}
