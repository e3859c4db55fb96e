//! `aventail pose`: move the skeleton by hand and make the artificial CT.

use super::args::{PlanningArgs, RunArgs};
use super::inputs::{config_file, either, planning_side};
use super::organs::OrganArgs;
use super::register::{saved, settings};
use super::run_folder;
use super::terminal::{command_line, progress};
use crate::config::InputRole;
use crate::error::{Error, Result};
use crate::report::planned;
use crate::runtime::Runtime;
use crate::session::{BonesBy, MotionSource, PoseRequest, Source, pose};
use clap::Args;
use std::path::{Path, PathBuf};

pub(super) const HELP: &str = "\
A pose file moves joints by bone name; `aventail skeleton --bones FILE` shows names, axes and
ranges:

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
    /// Landmarks known in both postures (CSV), to measure the error
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
    /// Pose file (TOML): motion of joints, by bone name
    #[arg(long, value_name = "FILE")]
    pub pose: Option<PathBuf>,
    /// Transforms of some or all bones, such as the bone_transforms.json of a run
    #[arg(long, value_name = "FILE")]
    pub transforms: Option<PathBuf>,
    /// Landmarks on bones in both postures, at least three per bone (CSV with a column `bone`)
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
    let planning = planning_side(&args.side, &args.organs.organs, &mut recorded)?;
    let own = |flag: &Option<PathBuf>, role: InputRole| either(flag, role, &file.inputs);
    let by_hand = own(&args.motion.pose, InputRole::Pose).map(|file| MotionSource::Pose(Source::File(file)));
    let transforms = || own(&args.motion.transforms, InputRole::Transforms);
    let transforms = || transforms().map(|file| MotionSource::Transforms(Source::File(file)));
    let marks = || own(&args.motion.bone_landmarks, InputRole::BoneLandmarks);
    let marks = || marks().map(|file| MotionSource::Landmarks(Source::File(file)));
    let mut request = PoseRequest {
        planning,
        motion: by_hand.or_else(transforms).or_else(marks).ok_or_else(no_motion)?,
        landmarks: own(&args.landmarks, InputRole::Landmarks).map(Source::File),
        margin_mm: args.margin,
        recorded,
        config,
        command: command_line(),
    };
    let runtime = Runtime::new(args.run.work.threads, progress(args.run.shown.quiet))?;
    let by = BonesBy { beside: &args.out, command: &request.command, quiet: args.run.shown.quiet };
    let others = request.needed();
    let told = request.config.planning.modality;
    request.planning.make_bones(&others, told, by, &runtime)?;
    let files = request.files();
    let files: Vec<&Path> = files.iter().map(PathBuf::as_path).chain(args.config.as_deref()).collect();
    let folder = run_folder(&args.out, &planned(&request.config), &files)?;
    request.judge()?;
    saved(pose(request, &runtime)?, folder, &args.out, &args.run, &[], &runtime)
}

fn no_motion() -> Error {
    Error::usage("no motion is given", "add --pose FILE, --transforms FILE or --bone-landmarks FILE")
}
