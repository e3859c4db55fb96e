//! Bones in parent-first order.

use super::{Bone, Skeleton};

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
