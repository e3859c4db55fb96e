//! How far a registration may be trusted, place by place.

use super::elements::bone_of_label;
use super::{Outcome, PlanningScan};
use crate::error::Result;
use crate::evaluate::uncertainty::{self, Evidence, PlanningSide, UncertaintyReport};
use crate::findings;
use crate::fit::DeterminedBy;
use crate::skeleton::Skeleton;
use crate::volume::{Mask, Volume, Window};
use std::collections::BTreeMap;

/// What the maps of all registrations of a patient need of its planning side.
///
/// # Errors
/// Only for internal inconsistency of grids.
pub(super) fn side(planning: &PlanningScan, skeleton: &Skeleton, body: &Mask, window: Window) -> Result<PlanningSide> {
    let bone_of_label = bone_of_label(skeleton);
    PlanningSide::new(&planning.ct, body, &planning.bones, window, |l| bone_of_label[usize::from(l)].is_some())
}

/// What a fraction's image told of soft tissue.
pub(super) struct Shown<'a> {
    /// HU.
    pub(super) fraction: &'a Volume<f32>,
    /// The field of the bones alone, where images pulled.
    pub(super) bones_alone: Option<&'a Volume<[f32; 3]>>,
    /// Where they misled and did not, after all.
    pub(super) misled: Option<&'a Mask>,
}

/// The map of a registration.
pub(super) fn of(
    planning: &PlanningScan,
    outcome: &Outcome,
    side: &PlanningSide,
    tissue: &Mask,
    images: Shown<'_>,
) -> Result<(Volume<f32>, UncertaintyReport)> {
    let bone_mm = bone_mm(outcome);
    uncertainty::map(&Evidence {
        side,
        fraction: images.fraction,
        body: &outcome.body,
        tissue,
        bones: &planning.bones,
        bone_mm: &bone_mm,
        push: &outcome.push,
        doubt: doubt(outcome),
        bones_alone: images.bones_alone,
        misled: images.misled,
    })
}

/// The fit's standard deviations take the voxels' noise for independent, which a blurred image's is not: so many times too small
/// (over the posed CTs, whose bones are known).
const DEPENDENT: f64 = 2.0;
/// A bone is known no better than this, mm.
const LEAST_MM: f64 = 0.03;
/// A joint's soft range is taken for so many standard deviations of it.
const RANGE_SD: f64 = 2.0;

/// What a weak start or lost bones make of it.
const DOUBT: f64 = 1.5;

/// Factor on the map of a run that warns of itself as a whole.
fn doubt(outcome: &Outcome) -> f64 {
    let doubtful = [findings::WEAK_START, findings::BONES_LOST, findings::LEVEL_UNSURE];
    if outcome.warnings.iter().any(|w| doubtful.iter().any(|f| w.is(f))) { DOUBT } else { 1.0 }
}

/// How well each bone's position is known, mm, by its label. A bone of which the image shows a part is known worse; one that
/// no image determines is where its joint lets it be, beside the bone that it hangs on.
fn bone_mm(outcome: &Outcome) -> BTreeMap<u16, f64> {
    let bones = &outcome.skeleton.bones;
    let mut mm: Vec<f64> = Vec::with_capacity(bones.len());
    for (bone, fit) in bones.iter().zip(&outcome.bone_fits) {
        let play = bone.joint.translation_range_mm.iter().map(|m| m * m).sum::<f64>().sqrt() / RANGE_SD;
        // Parents come first; where one does not, its own place is taken for known.
        let parent = bone.parent.and_then(|parent| mm.get(parent)).copied().unwrap_or(0.0);
        let by_joint = play.hypot(parent);
        let known = fit.position_sd_mm.is_finite() && fit.determined_by != DeterminedBy::Joint;
        let own = if fit.determined_by == DeterminedBy::Image {
            (DEPENDENT * fit.position_sd_mm / fit.visible.max(1e-3)).hypot(LEAST_MM)
        } else {
            fit.position_sd_mm
        };
        mm.push(if known { own.min(by_joint.max(LEAST_MM)) } else { by_joint });
    }
    bones.iter().map(|bone| bone.label).zip(mm).collect()
}
