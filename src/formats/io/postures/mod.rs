//! `postures.toml`: how the joints of a skeleton vary, and postures that somebody chose.

#[cfg(test)]
mod tests;
mod write;

pub use write::write_postures;

use super::keyed::{Keyed, parse};
use super::pose::{child, pose_in};
use crate::error::Result;
use crate::postures::{Mode, NamedPose, PosturePlan, Spread, VolumeRange, neck, sixes};
use crate::skeleton::{Bone, Skeleton};
use std::path::Path;

/// Keys of a plan.
const KEYS: [&str; 12] = [
    "defaults",
    "scale",
    "truncation_sd",
    "limits",
    "couch",
    "neck",
    "back",
    "bones",
    "mean",
    "modes",
    "volumes",
    "postures",
];
/// Keys of angles, in the order of a joint's axes.
const ANGLES: [&str; 3] = ["flexion", "lateral", "axial"];
/// Modes that neck and back may have by the defaults begin like this.
const BENT: [&str; 2] = ["neck", "back"];

/// Reads a plan of postures of a skeleton, laid over the usual variation ([`PosturePlan::usual`]) unless it says
/// `defaults = false`. Its keys are those of the examples in `data/postures.toml`.
///
/// # Errors
/// [`Error::Read`](crate::error::Error::Read) when the file is missing or no TOML; [`Error::Input`](crate::error::Error::Input), naming
/// file, key and value, for unknown bones and keys, values of the wrong type, negative deviations, and ranges that are
/// reversed or wider than the joint's.
pub fn read_postures(path: impl AsRef<Path>, skeleton: &Skeleton) -> Result<PosturePlan> {
    let table = parse(path.as_ref())?;
    let file = Keyed::new(path.as_ref(), &table);
    file.only(&KEYS)?;
    let usual = file.flag("defaults")?.unwrap_or(true);
    let mut plan = if usual { PosturePlan::usual(skeleton) } else { PosturePlan::still(skeleton) };
    let within = |key: &str, low: f64, high: f64| match file.number(key)? {
        Some(v) if !(low..=high).contains(&v) => Err(file.refuse(key, "out of range", format!("give {low} to {high}"))),
        v => Ok(v),
    };
    plan.scale = within("scale", 0.01, 100.0)?.unwrap_or(plan.scale);
    plan.truncation_sd = within("truncation_sd", 0.5, 6.0)?.unwrap_or(plan.truncation_sd);
    limits(&file, &mut plan)?;
    if let (Some(couch), Some(root), Some(bone)) =
        (file.inner("couch")?, plan.joints.first_mut(), skeleton.bones.first())
    {
        self::couch(&couch, root, bone)?;
    }
    for part in BENT {
        if let Some(keys) = file.inner(part)? {
            bend(&keys, part, &mut plan, skeleton)?;
        }
    }
    for (name, keys) in file.inner("bones")?.map_or_else(|| Ok(Vec::new()), |bones| bones.each())? {
        let at = child(name, &keys, skeleton)?;
        bone(&keys, &mut plan.joints[at], &skeleton.bones[at])?;
    }
    if let Some(mean) = file.inner("mean")? {
        plan.mean = sixes(&pose_in(&mean, skeleton, &[])?);
    }
    for (n, keys) in file.tables("modes")?.iter().enumerate() {
        let values = sixes(&pose_in(keys, skeleton, &["name"])?);
        let name = keys.text("name")?.map_or_else(|| format!("mode {}", n + 1), str::to_owned);
        if plan.modes.iter().any(|m| m.name == name) {
            return Err(keys.refuse("name", "there is a mode of this name", "give each mode another name"));
        }
        plan.modes.push(Mode { name, values });
    }
    if let Some(volumes) = file.inner("volumes")? {
        for organ in volumes.keys() {
            let range = pair(&volumes, organ)?.unwrap_or([1.0; 2]);
            plan.volumes.push(VolumeRange { organ: organ.into(), range });
        }
    }
    for (n, keys) in file.tables("postures")?.iter().enumerate() {
        let name = keys.text("name")?.map_or_else(|| format!("posture {}", n + 1), str::to_owned);
        plan.postures.push(NamedPose { name, pose: pose_in(keys, skeleton, &["name"])? });
    }
    Ok(plan)
}

fn limits(file: &Keyed, plan: &mut PosturePlan) -> Result<()> {
    let Some(keys) = file.inner("limits")? else { return Ok(()) };
    keys.only(&["overlap_mm", "folded_cells"])?;
    for key in ["overlap_mm", "folded_cells"] {
        if keys.number(key)?.is_some_and(|v| v < 0.0) {
            return Err(keys.refuse(key, "below 0", "give 0 or more"));
        }
    }
    plan.limits.overlap_mm = keys.number("overlap_mm")?;
    plan.limits.folded_cells = keys.number("folded_cells")?.unwrap_or_default() as usize;
    Ok(())
}

/// Three standard deviations.
fn deviations(keys: &Keyed, key: &str, into: &mut [f64]) -> Result<()> {
    if let Some(sd) = keys.numbers::<3>(key)? {
        if sd.iter().any(|v| *v < 0.0) {
            return Err(keys.refuse(key, "a standard deviation is below 0", "give 0 or more"));
        }
        into.copy_from_slice(&sd);
    }
    Ok(())
}

/// Ranges to either side along three axes.
fn sides(keys: &Keyed, key: &str, into: &mut [[f64; 2]], joint: &[[f64; 2]]) -> Result<()> {
    let Some(most) = keys.numbers::<3>(key)? else { return Ok(()) };
    for ((range, joint), most) in into.iter_mut().zip(joint).zip(most) {
        if most < 0.0 {
            return Err(keys.refuse(key, "a range is negative", "write how far it may go to either side, 0 or more"));
        }
        *range = narrow(keys, key, joint, [-most, most])?;
    }
    Ok(())
}

/// A range that the joint's own holds.
fn narrow(keys: &Keyed, key: &str, joint: &[f64; 2], wanted: [f64; 2]) -> Result<[f64; 2]> {
    // A digit of a written file may be rounded.
    let room = 1e-9 * (1.0 + joint[0].abs().max(joint[1].abs()));
    if wanted[0] < joint[0] - room || wanted[1] > joint[1] + room {
        let problem = format!("beyond the joint's range of {} to {}", joint[0], joint[1]);
        let remedy =
            "stay within it, or widen the joint in a file for --skeleton (`aventail skeleton --out` writes one)";
        return Err(keys.refuse(key, problem, remedy));
    }
    Ok(wanted)
}

/// Two numbers that ascend.
fn pair(keys: &Keyed, key: &str) -> Result<Option<[f64; 2]>> {
    match keys.numbers::<2>(key)? {
        Some([low, high]) if low > high => {
            let problem = "the first number is greater than the second";
            Err(keys.refuse(key, problem, "write [least, greatest]"))
        }
        range => Ok(range),
    }
}

fn couch(keys: &Keyed, root: &mut Spread, bone: &Bone) -> Result<()> {
    let own = Spread::of(bone).range;
    keys.only(&["rotation_sd_deg", "shift_sd_mm", "rotation_deg", "shift_mm"])?;
    deviations(keys, "rotation_sd_deg", &mut root.sd[..3])?;
    deviations(keys, "shift_sd_mm", &mut root.sd[3..])?;
    sides(keys, "rotation_deg", &mut root.range[..3], &own[..3])?;
    sides(keys, "shift_mm", &mut root.range[3..], &own[3..])
}

/// A joint by itself.
fn bone(keys: &Keyed, spread: &mut Spread, bone: &Bone) -> Result<()> {
    let own = Spread::of(bone).range;
    let of = |end: &str| ANGLES.map(|a| format!("{a}{end}"));
    let (sds, ranges) = (of("_sd_deg"), of("_deg"));
    let known: Vec<&str> = sds.iter().chain(&ranges).map(String::as_str).chain(["shift_sd_mm", "shift_mm"]).collect();
    keys.only(&known)?;
    for a in 0..3 {
        if let Some(sd) = keys.number(&sds[a])? {
            if sd < 0.0 {
                return Err(keys.refuse(&sds[a], "below 0", "give 0 or more"));
            }
            spread.sd[a] = sd;
        }
        if let Some(wanted) = pair(keys, &ranges[a])? {
            spread.range[a] = narrow(keys, &ranges[a], &own[a], wanted)?;
        }
    }
    deviations(keys, "shift_sd_mm", &mut spread.sd[3..])?;
    sides(keys, "shift_mm", &mut spread.range[3..], &own[3..])
}

/// The neck or the back as a whole, and what each of its levels does besides.
fn bend(keys: &Keyed, part: &str, plan: &mut PosturePlan, skeleton: &Skeleton) -> Result<()> {
    let more: &[&str] = if part == "neck" { &["rest_sd_deg"] } else { &[] };
    keys.only(&[&["flexion_sd_deg", "lateral_sd_deg", "axial_sd_deg"], more].concat())?;
    let mut sd = [0.0; 3];
    for (a, axis) in ANGLES.into_iter().enumerate() {
        let (key, name) = (format!("{axis}_sd_deg"), format!("{part} {axis}"));
        // What is not named stays as it is by the defaults: the sum of its levels.
        let now = plan.modes.iter().find(|m| m.name == name).map_or(0.0, |m| m.values.iter().map(|v| v[a]).sum());
        sd[a] = keys.number(&key)?.unwrap_or(now);
        if sd[a] < 0.0 {
            return Err(keys.refuse(&key, "below 0", "give 0 or more"));
        }
    }
    plan.bend(skeleton, part, sd);
    let mut rest = [0.0; 3];
    deviations(keys, "rest_sd_deg", &mut rest)?;
    if keys.keys().any(|k| k == "rest_sd_deg") {
        neck(skeleton).into_iter().for_each(|n| plan.joints[n].sd[..3].copy_from_slice(&rest));
    }
    Ok(())
}
