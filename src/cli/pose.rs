//! `aventail pose`: move the skeleton by hand and make the artificial CT.

use super::args::{PlanningArgs, RunArgs};
use super::auto::{Ask, Bones};
use super::headers::judge;
use super::inputs::{Flags, Inputs, changed, config_file, either};
use super::organs::OrganArgs;
use super::register::{Told, settings, write_run};
use super::run_folder;
use super::terminal::progress;
use crate::config::InputRole;
use crate::error::{Error, Result};
use crate::io;
use crate::pipeline::{BoneMotion, InputFile, pose};
use crate::report::planned;
use crate::runtime::Runtime;
use crate::skeleton;
use clap::Args;
use std::path::{Path, PathBuf};

pub(super) const HELP: &str = "\
A pose file moves joints by bone name; `aventail skeleton --bones FILE` shows names, axes and ranges:

  [bones.clavicula_right]
  shift_mm = [0.0, 0.0, 5.0]        # left, back, up

  [bones.skull]
  axial_deg = 10.0                  # also flexion_deg, lateral_deg

Writes to OUT what `register` writes, with the artificial CT as planning_on_fraction.nii.gz.

Examples:
  aventail pose --planning planning_ct.nii.gz --bones bones.nii.gz --pose pose.toml --out raised
  aventail pose --planning planning_ct.nii.gz --bones bones.nii.gz --pose still.toml --organs parotid_left.nii.gz \\
                --volume-change parotid_left=0.8 --out shrunk";

/// Options of `pose`.
#[derive(Debug, Args)]
pub struct PoseArgs {
    /// Planning CT, its bones and their names.
    #[command(flatten)]
    pub side: PlanningArgs,
    /// How the bones move.
    #[command(flatten)]
    pub motion: MotionArgs,
    /// Folder for the results; made if missing
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// Grow the artificial CT beyond the planning grid by this much on all sides, mm
    #[arg(long, value_name = "MM", default_value_t = 0.0, value_parser = parse_margin)]
    pub margin: f64,
    /// Organs and their change of volume.
    #[command(flatten)]
    pub organs: OrganArgs,
    /// Landmarks known in both postures (CSV), to evaluate the result
    #[arg(long, value_name = "FILE")]
    pub landmarks: Option<PathBuf>,
    /// Settings (TOML), or the report.json of an earlier run to repeat it
    #[arg(long, value_name = "FILE")]
    pub config: Option<PathBuf>,
    /// Options of every run.
    #[command(flatten)]
    pub run: RunArgs,
}

/// How the bones of `pose` move.
#[derive(Debug, Args)]
#[group(multiple = false)]
pub struct MotionArgs {
    /// Motion of each joint, by bone name (TOML)
    #[arg(long, value_name = "FILE")]
    pub pose: Option<PathBuf>,
    /// Transform of some or all bones: the bone_transforms.json of a run
    #[arg(long, value_name = "FILE")]
    pub transforms: Option<PathBuf>,
    /// Landmarks on bones in both postures, three or more each (CSV with a column `bone`)
    #[arg(long, value_name = "FILE")]
    pub bone_landmarks: Option<PathBuf>,
}

/// A length from 0 to 500 mm.
pub(super) fn parse_margin(text: &str) -> Result<f64, String> {
    let value: f64 = text.parse().map_err(|_| format!("`{text}` is no number"))?;
    if (0.0..=500.0).contains(&value) { Ok(value) } else { Err("give 0 to 500 mm".into()) }
}

/// Poses the case that the arguments name and writes the results; returns the table (or JSON) for the terminal.
///
/// # Errors
/// Of every kind but failed registration; see [`Error`].
pub fn run(args: &PoseArgs) -> Result<String> {
    let file = args.config.as_deref().map(config_file).transpose()?.unwrap_or_default();
    let mut config = settings(&file, &args.run)?;
    args.organs.apply(&mut config)?;
    let mut recorded = file.inputs.clone();
    let ask = Ask {
        bones: args.side.bones.as_deref(),
        labels: args.side.labels.as_deref(),
        planning: either(&args.side.planning, InputRole::Planning, &recorded),
        needed: Vec::new(),
        beside: &args.out,
        quiet: args.run.shown.quiet,
    };
    let bones = Bones::of(ask, &mut recorded, &*progress(args.run.shown.quiet))?;
    let flags = Flags {
        planning: &args.side.planning,
        bones: &bones.file,
        labels: &args.side.labels,
        organs: &args.organs.organs,
        skeleton: &args.side.skeleton,
        landmarks: &args.landmarks,
        bone_landmarks: &args.motion.bone_landmarks,
        start: &None,
    };
    let inputs = Inputs::new(&flags, &recorded)?;
    let by_hand = either(&args.motion.pose, InputRole::Pose, &file.inputs);
    let transforms = either(&args.motion.transforms, InputRole::Transforms, &file.inputs);
    if by_hand.is_none() && transforms.is_none() && !inputs.has_bone_landmarks() {
        return Err(no_motion());
    }
    let more = [args.config.as_deref(), by_hand.as_deref(), transforms.as_deref()];
    let files: Vec<&Path> = inputs.files().into_iter().chain(more.into_iter().flatten()).collect();
    let folder = run_folder(&args.out, &planned(&config), &files)?;
    let runtime = Runtime::new(args.run.work.threads, progress(args.run.shown.quiet))?;
    judge(inputs.planning(), inputs.bones(), &[], &config)?;
    let mut planning = inputs.load(&recorded, &config, &runtime)?;
    planning.warnings.extend(bones.warnings);
    let marks = inputs.marks()?;
    let motion = match (&by_hand, &transforms) {
        (Some(path), _) => {
            // The pose names bones and joints of the very skeleton that it is given to.
            if planning.skeleton.is_none() {
                planning.skeleton = Some(skeleton::build(&planning.bones)?.skeleton);
            }
            let skeleton =
                planning.skeleton.as_ref().ok_or_else(|| Error::Internal("the skeleton was just set".into()))?;
            BoneMotion::Pose(io::pose::read_pose(path, skeleton)?)
        }
        (None, Some(path)) => BoneMotion::Transforms(io::read_bone_transforms(path)?),
        (None, None) if !marks.bone_landmarks.is_empty() => BoneMotion::Landmarks(marks.bone_landmarks),
        (None, None) => return Err(no_motion()),
    };
    let mut more = marks.inputs;
    for (role, path) in [(InputRole::Pose, &by_hand), (InputRole::Transforms, &transforms)] {
        if let Some(path) = path {
            more.push(InputFile::read(role, path)?);
        }
    }
    planning.warnings.extend(changed(&more, &file.inputs));
    planning.inputs.extend(more);
    let (case, outcome) = pose(planning, &motion, marks.landmarks, args.margin, &config, &runtime)?;
    write_run(&case, outcome, &config, &runtime, folder, &args.out, Told::of(&args.run))
}

fn no_motion() -> Error {
    Error::usage("no motion is given", "add --pose FILE, --transforms FILE or --bone-landmarks FILE")
}
