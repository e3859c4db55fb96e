//! The same skeleton seen from another bone.

use super::{Bone, Joint, Skeleton};
use crate::error::{Error, Result};
use crate::skeleton::anatomy;

/// The skeleton with the bone at `new_root` (position in [`Skeleton::bones`]) as its root.
///
/// Joints between the new and the old root are turned round: the same centre and axes, rotation ranges negated
/// and swapped. Every set of bone transforms is reachable as before; `pose_of` of the result converts a pose. Bones
/// change their order: the result is parent-first again.
///
/// # Errors
/// When there is no such bone.
pub fn reroot(skeleton: &Skeleton, new_root: usize) -> Result<Skeleton> {
    let bones = &skeleton.bones;
    if new_root >= bones.len() {
        return Err(Error::Internal(format!("new root {new_root} of {} bones", bones.len())));
    }
    let mut parents: Vec<Option<usize>> = bones.iter().map(|b| b.parent).collect();
    let mut joints: Vec<Joint> = bones.iter().map(|b| b.joint.clone()).collect();
    let mut at = new_root;
    while let Some(parent) = bones[at].parent {
        parents[parent] = Some(at);
        joints[parent] = reversed(&bones[at].joint);
        at = parent;
    }
    parents[new_root] = None;
    let free = anatomy::unlimited();
    joints[new_root] = Joint {
        name: "root".into(),
        centre: bones[new_root].centroid,
        rotation_range_deg: free.rotation_deg,
        translation_range_mm: free.translation_mm,
        source: free.source,
        axes: bones[new_root].joint.axes,
    };
    let bones = bones.iter().zip(joints).zip(&parents);
    Ok(in_order(bones.map(|((b, joint), &parent)| Bone { joint, parent, ..b.clone() }).collect()))
}

/// The joint seen from the child: the inverse motion.
fn reversed(joint: &Joint) -> Joint {
    Joint { rotation_range_deg: joint.rotation_range_deg.map(|[low, high]| [-high, -low]), ..joint.clone() }
}

/// Puts bones in parent-first order, otherwise as they were. Bones that no way leads to from the root are dropped.
pub fn in_order(bones: Vec<Bone>) -> Skeleton {
    let mut order: Vec<usize> = Vec::with_capacity(bones.len());
    let ready = |n: usize, order: &[usize]| !order.contains(&n) && bones[n].parent.is_none_or(|p| order.contains(&p));
    while let Some(next) = (0..bones.len()).find(|&n| ready(n, &order)) {
        order.push(next);
    }
    let mut place = vec![0; bones.len()];
    for (new, &old) in order.iter().enumerate() {
        place[old] = new;
    }
    let moved = |&old: &usize| Bone { parent: bones[old].parent.map(|p| place[p]), ..bones[old].clone() };
    Skeleton { bones: order.iter().map(moved).collect() }
}
