//! Options of `aventail evaluate`.

use super::super::args::{CommonArgs, DirectionName};
use clap::Args;
use std::path::{Path, PathBuf};

/// What `aventail evaluate --help` adds.
pub(in crate::cli) const AFTER: &str = "\
What is measured depends on what is given:
  always                    Jacobian characteristics and volumes, digital folds, Jacobian jumps,
                            curl, inverse consistency
  --planning                measures in the patient instead of the whole grid; Jacobian picture
  --compare A B             also the difference of each field from the first, and landmark errors
                            against each other
  --planning --fraction     similarity of the CTs before and after; fusion picture
  --bones                   departure from rigid motion per bone; bone contact and sliding
                            interfaces counted separately
  --labels-planning --labels-fraction
                            Dice, mean distance to agreement, Hausdorff and its 95th percentile,
                            centre of mass
  --landmarks               errors before and after, per landmark
  --then --direct           transitivity over three images
Every value with a limit (that of AAPM TG-132 if there is one; docs/metrics.md) passes, needs review
or fails, by the same rules as in `register`; --config sets the limits (table `verdict`). A verdict
does not replace a person's decision.

Writes to OUT: evaluation.html, evaluation.json, evaluation.csv, evaluation.md, landmarks.csv,
pictures/*.png

Examples:
  aventail evaluate --planning-to-fraction vf.mha --planning ct.nii.gz --fraction fx.nii.gz --bones bones.nii.gz --out eval
  aventail evaluate --compare ours.nii.gz plastimatch.nii.gz --planning ct.nii.gz --landmarks points.csv --out compare";

/// Options of `evaluate`.
#[derive(Debug, Args)]
pub struct EvaluateArgs {
    /// Field on the planning grid: planning x goes to x + u(x); other tools write it for fixed =
    /// planning
    #[arg(long, value_name = "FILE", conflicts_with = "compare")]
    pub planning_to_fraction: Option<PathBuf>,
    /// Field on the fraction grid: fraction y shows planning y + v(y); other tools write it for
    /// fixed = fraction
    #[arg(long, value_name = "FILE", conflicts_with = "compare")]
    pub fraction_to_planning: Option<PathBuf>,
    /// Several fields of one case to compare, all in the direction of --direction
    #[arg(long, value_name = "FILE", num_args = 1..)]
    pub compare: Vec<PathBuf>,
    /// Direction of the fields of --compare
    #[arg(long, value_enum, default_value = "planning-to-fraction")]
    pub direction: DirectionName,
    /// Planning CT in HU
    #[arg(long, value_name = "FILE")]
    pub planning: Option<PathBuf>,
    /// Fraction CT in HU
    #[arg(long, value_name = "FILE")]
    pub fraction: Option<PathBuf>,
    /// Bone labels in the planning frame
    #[arg(long, value_name = "FILE")]
    pub bones: Option<PathBuf>,
    /// Structures in the planning frame
    #[arg(long, value_name = "FILE")]
    pub labels_planning: Option<PathBuf>,
    /// The same structures in the fraction frame, with the same names
    #[arg(long, value_name = "FILE", requires = "labels_planning")]
    pub labels_fraction: Option<PathBuf>,
    /// Names of the labels (JSON), {"labels": {"1": "skull", ...}}, for label files without names
    #[arg(long, value_name = "FILE")]
    pub labels: Option<PathBuf>,
    /// Points known in both images (CSV)
    #[arg(long, value_name = "FILE")]
    pub landmarks: Option<PathBuf>,
    /// Mask in the planning frame (nonzero inside): measure there instead of in the patient
    #[arg(long, value_name = "FILE")]
    pub mask: Option<PathBuf>,
    /// Field from the fraction to a third image, for transitivity
    #[arg(long, value_name = "FILE", requires = "direct")]
    pub then: Option<PathBuf>,
    /// Field from planning straight to the third image
    #[arg(long, value_name = "FILE", requires = "then")]
    pub direct: Option<PathBuf>,
    /// Folder for the results; made if missing
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// Settings (TOML), or the report.json of a run: the field is judged by its limits (table
    /// `verdict`)
    #[arg(long, value_name = "FILE")]
    pub config: Option<PathBuf>,
    /// Threads, progress, and how the result is told.
    #[command(flatten)]
    pub common: CommonArgs,
}

impl EvaluateArgs {
    /// All files to read.
    pub(super) fn files(&self) -> Vec<&Path> {
        let one = [
            &self.planning_to_fraction,
            &self.fraction_to_planning,
            &self.planning,
            &self.fraction,
            &self.bones,
            &self.labels_planning,
            &self.labels_fraction,
            &self.labels,
            &self.landmarks,
            &self.mask,
            &self.then,
            &self.direct,
            &self.config,
        ];
        one.into_iter().flatten().chain(&self.compare).map(PathBuf::as_path).collect()
    }
}
