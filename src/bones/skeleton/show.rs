//! The joint tree as text.

use super::anatomy::is_of_spine;
use super::{Bone, Skeleton};
use std::fmt::Write;

/// The tree with each bone's size, joint, centre and ranges; one line per bone, parents above their children. A branch
/// hangs on the nearest line above it without its last step of indentation, any other bone on the nearest one in its column.
///
/// `voxels` is the number of voxels of each bone, in the order of the bones.
pub fn tree(skeleton: &Skeleton, voxels: &[usize]) -> String {
    let rows = rows(skeleton);
    let width =
        rows.iter().map(|(indent, n)| indent.chars().count() + skeleton.bones[*n].name.len()).max().unwrap_or(0);
    let joint = skeleton.bones.iter().map(|b| b.joint.name.len()).max().unwrap_or(0).max("joint".len());
    let mut out = format!(
        "{:width$}  {:>8}  {:joint$}  {:>22}  {:>28}  {:>14}\n",
        "bone", "voxels", "joint", "centre LPS mm", "flexion/lateral/axial deg", "shift +-mm"
    );
    for (indent, n) in rows {
        let bone = &skeleton.bones[n];
        let name = format!("{indent}{}", bone.name);
        let c = bone.joint.centre;
        let centre = format!("{:.1} {:.1} {:.1}", c.x, c.y, c.z);
        let (rotation, shift) = ranges(bone);
        let count = voxels.get(n).map_or_else(String::new, usize::to_string);
        writeln!(
            out,
            "{name:width$}  {count:>8}  {:joint$}  {centre:>22}  {rotation:>28}  {shift:>14}",
            bone.joint.name
        )
        .expect("writing to a string cannot fail");
    }
    out
}

/// Indentation and position of each bone, depth first. Bones branch off to the right; the spine and only children stay in
/// their parent's column, after its branches.
fn rows(skeleton: &Skeleton) -> Vec<(String, usize)> {
    let bones = &skeleton.bones;
    let is_axis = |n: usize| is_of_spine(&bones[n].name);
    let mut out = Vec::new();
    let root = (0..bones.len()).filter(|&n| bones[n].parent.is_none());
    let mut stack: Vec<(String, String, usize)> = root.map(|n| (String::new(), String::new(), n)).collect();
    while let Some((own, below, n)) = stack.pop() {
        let children: Vec<usize> = (0..bones.len()).filter(|&c| bones[c].parent == Some(n)).collect();
        let main = children.iter().copied().find(|&c| is_axis(c) || children.len() == 1);
        stack.extend(main.map(|c| (below.clone(), below.clone(), c)));
        let branches = children.iter().rev().filter(|c| Some(**c) != main);
        stack.extend(branches.map(|&c| (format!("{below}|-- "), format!("{below}|   "), c)));
        out.push((own, n));
    }
    out
}

/// Rotation and shift ranges of a bone's joint as text.
fn ranges(bone: &Bone) -> (String, String) {
    if bone.parent.is_none() {
        return ("free".into(), "free".into());
    }
    let joint = &bone.joint;
    let range = |[low, high]: [f64; 2]| {
        let same = (low + high).abs() < 1e-9;
        if same { format!("+-{high:.1}") } else { format!("{low:.1}..{high:.1}") }
    };
    let [x, y, z] = joint.translation_range_mm;
    (joint.rotation_range_deg.map(range).join(" "), format!("{x:.1} {y:.1} {z:.1}"))
}
