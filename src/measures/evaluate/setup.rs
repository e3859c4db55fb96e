//! The one shift of the whole scan that a field is compared with: the couch shift where bones are known, else the field's mean.

use super::agreement::Alone;
use super::couch::{CouchBone, CouchMatch, NEAR_MIDDLE, middle, moments, near_middle};
use super::rigidity::BoneRigidity;
use crate::geometry::{Grid, Rigid};
use crate::volume::{LabelMap, Mask, Volume};
use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

/// One shift of the whole scan, planning to fraction.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct MeanShift {
    /// LPS mm.
    pub mm: Vector3<f64>,
    /// What it is, in words: `couch shift matched on ...`, or `mean displacement of ...`.
    pub of: String,
    /// Which of the two.
    #[serde(default)]
    pub alone: Alone,
}

/// Bones and how a field moves them.
#[derive(Clone, Copy)]
pub(super) struct MovedBones<'a> {
    /// Labels in planning.
    pub(super) labels: &'a LabelMap,
    /// Label and name of each bone.
    pub(super) rigid: &'a [(u16, String)],
    /// Labels of those of the spine.
    pub(super) spine: &'a [u16],
    /// The field's motion of each.
    pub(super) moved: &'a [BoneRigidity],
}

/// The couch shift of `register`, from the field's motion of each bone, or the mean of all that is measured where no bones are given.
pub(super) fn shift(
    bones: Option<MovedBones<'_>>,
    push: &Volume<[f32; 3]>,
    mask: &Mask,
    fraction: &Grid,
) -> Option<MeanShift> {
    if let Some(bones) = bones.filter(|b| !b.moved.is_empty()) {
        let couch = couch(bones, fraction);
        let of = format!("couch shift matched on {}", couch.chosen);
        return Some(MeanShift { mm: couch.shift(), of, alone: Alone::Couch });
    }
    let all = (0..push.grid().len()).filter(|&l| mask.data()[l]);
    let (sum, n) =
        all.fold((Vector3::zeros(), 0usize), |(sum, n), l| (sum + Vector3::from(push.data()[l].map(f64::from)), n + 1));
    let of = "mean displacement of everything that is measured".into();
    (n > 0).then(|| MeanShift { mm: sum / n as f64, of, alone: Alone::Mean })
}

/// The couch shift as `register` matches it: on bones of the spine near the middle of what both scans show, else on all bones.
fn couch(all: MovedBones<'_>, fraction: &Grid) -> CouchMatch {
    let shapes = moments(all.labels, None);
    let of = |bone: &BoneRigidity| {
        let (label, name) = all.rigid.iter().find(|(_, name)| *name == bone.name)?;
        Some((*label, CouchBone { name, moments: *shapes.get(label)?, motion: bone.best, matched: false }))
    };
    let mut bones: Vec<(u16, CouchBone<'_>)> = all.moved.iter().filter_map(of).collect();
    let moved = |b: &CouchBone<'_>| b.motion * b.moments.centre;
    let mean = bones.iter().map(|(_, b)| moved(b) - b.moments.centre).sum::<Vector3<f64>>() / bones.len() as f64;
    let height = |(label, b): &(u16, CouchBone<'_>)| {
        let shown = fraction.contains(&fraction.index(&moved(b)));
        (shown && all.spine.contains(label)).then_some(b.moments.centre.z)
    };
    let heights: Vec<Option<f64>> = bones.iter().map(height).collect();
    let whole = Rigid::translation(mean.x, mean.y, mean.z);
    let near = near_middle(&heights, middle(all.labels.volume.grid(), fraction, &whole));
    let why = if near.is_empty() { "all bones: none is of the spine" } else { NEAR_MIDDLE };
    for (n, (_, bone)) in bones.iter_mut().enumerate() {
        bone.matched = near.is_empty() || near.contains(&n);
    }
    let bones: Vec<CouchBone<'_>> = bones.into_iter().map(|(_, b)| b).collect();
    CouchMatch::of(&bones, why.into(), mean)
}
