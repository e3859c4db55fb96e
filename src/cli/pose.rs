//! `aventail pose`: move the skeleton by hand and make the artificial CT.

use super::args::PoseArgs;
use super::inputs::{Flags, Inputs, changed, either, named};
use super::register::{open_folder, progress, settings, write_run};
use crate::config::ConfigFile;
use crate::error::{Error, Result};
use crate::io;
use crate::pipeline::{BoneMotion, pose};
use crate::runtime::Runtime;
use crate::skeleton;

/// Poses the case that the arguments name and writes the results; returns the table (or JSON) for the terminal.
///
/// # Errors
/// Of every kind but failed registration; see [`Error`].
pub fn run(args: &PoseArgs) -> Result<String> {
    let file = args.config.as_deref().map(ConfigFile::read).transpose()?.unwrap_or_default();
    let config = settings(&file, &args.run)?;
    let flags = Flags {
        planning: &args.planning,
        bones: &args.bones,
        fraction: None,
        labels: &args.labels,
        skeleton: &args.skeleton,
        landmarks: &args.landmarks,
        bone_landmarks: &args.motion.bone_landmarks,
    };
    let inputs = Inputs::new(&flags, &file.inputs)?;
    open_folder(&args.out)?;
    let runtime = Runtime::new(args.run.threads, progress(args.run.quiet))?;
    let mut case = inputs.load(&file.inputs, &runtime)?;
    let by_hand = either(&args.motion.pose, "pose", &file.inputs);
    let transforms = either(&args.motion.transforms, "transforms", &file.inputs);
    let motion = match (&by_hand, &transforms) {
        (Some(path), _) => {
            // The pose names bones and joints of the very skeleton that it is given to.
            if case.skeleton.is_none() {
                case.skeleton = Some(skeleton::build(&case.bones)?.skeleton);
            }
            let skeleton = case.skeleton.as_ref().ok_or_else(|| Error::Internal("the skeleton was just set".into()))?;
            BoneMotion::Pose(io::pose::read_pose(path, skeleton)?)
        }
        (None, Some(path)) => BoneMotion::Transforms(io::read_bone_transforms(path)?),
        (None, None) if !case.bone_landmarks.is_empty() => BoneMotion::Landmarks,
        (None, None) => {
            return Err(Error::usage(
                "no motion is given",
                "add --pose FILE, --transforms FILE or --bone-landmarks FILE",
            ));
        }
    };
    for (role, path) in [("pose", &by_hand), ("transforms", &transforms)] {
        if let Some(path) = path {
            let input = named(role, path)?;
            case.warnings.extend(changed(std::slice::from_ref(&input), &file.inputs));
            case.inputs.push(input);
        }
    }
    let (case, outcome) = pose(case, &motion, args.margin, &config, &runtime)?;
    write_run(&case, outcome, &config, &runtime, &args.out, args.run.json)
}
