//! A plan in full, as it can be read again over nothing.

use super::super::pose::{entry, key, list};
use super::super::write_file;
use crate::error::Result;
use crate::postures::{PosturePlan, Six, Spread, pose_of};
use crate::skeleton::{Bone, JointPose, Skeleton};
use std::fmt::Write as _;
use std::path::Path;

/// Writes every value of a plan, with `head` as comments before them. Reading it back gives the same plan but for the last digits.
///
/// # Errors
/// [`Error::Write`](crate::error::Error::Write) when the file cannot be written.
pub fn write_postures(path: impl AsRef<Path>, skeleton: &Skeleton, plan: &PosturePlan, head: &[String]) -> Result<()> {
    let text = text(skeleton, plan, head);
    write_file(path, |out| out.write_all(text.as_bytes()))
}

fn text(skeleton: &Skeleton, plan: &PosturePlan, head: &[String]) -> String {
    let mut out: String = head.iter().map(|line| format!("# {line}\n")).collect();
    let mut add = |text: String| out.push_str(&text);
    add(format!(
        "# Degrees and mm; angles are flexion, lateral bending, axial turn about the joint's axes. A standard deviation is that of a\n\
         # normal distribution before it is cut at truncation_sd deviations and at the joint's range. Joints that are not listed have the\n\
         # skeleton's range and nothing of their own.\n\
         defaults = false\nscale = {:?}\ntruncation_sd = {:?}\n",
        plan.scale, plan.truncation_sd
    ));
    let overlap = plan.limits.overlap_mm.map_or_else(String::new, |mm| format!("overlap_mm = {mm:?}\n"));
    add(format!("\n[limits]\n{overlap}folded_cells = {}\n", plan.limits.folded_cells));
    for (bone, spread) in skeleton.bones.iter().zip(&plan.joints) {
        // What does not vary by itself and has its own range need not be said.
        if *spread != Spread::of(bone) {
            add(if bone.parent.is_none() { couch(bone, spread) } else { joint(&bone.name, spread) });
        }
    }
    poses(&mut out, skeleton, &plan.mean, "mean.");
    for mode in &plan.modes {
        writeln!(out, "\n[[modes]]\nname = {}", toml::Value::from(mode.name.as_str())).expect("a String takes text");
        poses(&mut out, skeleton, &mode.values, "modes.");
    }
    if !plan.volumes.is_empty() {
        out.push_str("\n[volumes]\n");
        for v in &plan.volumes {
            writeln!(out, "{} = [{}]", key(&v.organ), list(&v.range)).expect("a String takes text");
        }
    }
    for posture in &plan.postures {
        writeln!(out, "\n[[postures]]\nname = {}", toml::Value::from(posture.name.as_str()))
            .expect("a String takes text");
        for (bone, joint) in skeleton.bones.iter().zip(&posture.pose.joints) {
            if *joint != JointPose::default() {
                out.push_str(&entry(bone, joint, "postures."));
            }
        }
    }
    out
}

/// Joints that move, each as a table.
fn poses(out: &mut String, skeleton: &Skeleton, values: &[Six], within: &str) {
    let pose = pose_of(values);
    for (bone, joint) in skeleton.bones.iter().zip(&pose.joints) {
        if *joint != JointPose::default() {
            out.push_str(&entry(bone, joint, within));
        }
    }
}

/// Half widths of ranges that are alike on both sides.
fn most(ranges: &[[f64; 2]]) -> String {
    list(&ranges.iter().map(|r| r[1]).collect::<Vec<_>>())
}

fn couch(root: &Bone, spread: &Spread) -> String {
    let mut out = format!(
        "\n[couch]\nrotation_sd_deg = [{}]\nshift_sd_mm = [{}]\n",
        list(&spread.sd[..3]),
        list(&spread.sd[3..])
    );
    // Ranges that are not the root's own come from a plan, which gives them to either side alike.
    let own = Spread::of(root).range;
    for (key, part) in [("rotation_deg", 0..3), ("shift_mm", 3..6)] {
        if spread.range[part.clone()] != own[part.clone()] {
            writeln!(out, "{key} = [{}]", most(&spread.range[part])).expect("a String takes text");
        }
    }
    out
}

fn joint(name: &str, spread: &Spread) -> String {
    let mut out = format!("\n[bones.{}]\n", key(name));
    for (a, axis) in super::ANGLES.into_iter().enumerate() {
        if spread.sd[a] > 0.0 {
            writeln!(out, "{axis}_sd_deg = {:?}", spread.sd[a]).expect("a String takes text");
        }
        writeln!(out, "{axis}_deg = [{}]", list(&spread.range[a])).expect("a String takes text");
    }
    if spread.sd[3..].iter().any(|sd| *sd > 0.0) {
        writeln!(out, "shift_sd_mm = [{}]", list(&spread.sd[3..])).expect("a String takes text");
    }
    writeln!(out, "shift_mm = [{}]", most(&spread.range[3..])).expect("a String takes text");
    out
}
