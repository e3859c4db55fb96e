//! How far a registration may be trusted, place by place.

use super::PlanningScan;
use super::elements::bone_of_label;
use crate::error::Result;
use crate::evaluate::uncertainty::{self, Evidence, PlanningSide, UncertaintyReport};
use crate::field::PushField;
use crate::findings;
use crate::fit::{BoneFit, DeterminedBy, FitCurvature};
use crate::sampling::{PosePosterior, PosedBone};
use crate::skeleton::{Bone, Skeleton};
use crate::volume::{LabelMap, Mask, Spans, Volume, Window};
use crate::warning::Warning;
use std::collections::BTreeMap;

/// What the maps of all registrations of a patient need of its planning side: the CT (HU), or what another modality shows of it.
///
/// # Errors
/// Only for internal inconsistency of grids.
pub(super) fn side(
    planning: &Volume<f32>,
    bones: &LabelMap,
    skeleton: &Skeleton,
    body: &Mask,
    window: Window,
) -> Result<PlanningSide> {
    let bone_of_label = bone_of_label(skeleton);
    PlanningSide::new(planning, body, bones, window, |l| bone_of_label[usize::from(l)].is_some())
}

/// A motion as the map sees it.
pub(super) struct Found<'a> {
    pub(super) bones: &'a [Bone],
    pub(super) fits: &'a [BoneFit],
    /// The patient in the planning CT.
    pub(super) body: &'a Mask,
    pub(super) push: &'a PushField,
    /// What was said of the fit.
    pub(super) warnings: &'a [Warning],
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
    found: &Found<'_>,
    side: &PlanningSide,
    images: Shown<'_>,
) -> Result<(Spans<f32>, UncertaintyReport)> {
    let bone_mm = bone_mm(found.bones, found.fits);
    uncertainty::map(&Evidence {
        side,
        fraction: images.fraction,
        body: found.body,
        planning: &planning.ct,
        bones: &planning.bones,
        bone_mm: &bone_mm,
        push: found.push,
        doubt: doubt(found.warnings),
        bones_alone: images.bones_alone,
        misled: images.misled,
    })
}

/// What the fit leaves open of the bones, as far as the map says; `open` is the curvature where it ended, if an image took part.
pub(super) fn posterior(bones: &[Bone], fits: &[BoneFit], open: Option<&FitCurvature>) -> PosePosterior {
    let known = bone_mm(bones, fits);
    let fits = bones.iter().zip(fits).enumerate();
    let bone = |(n, (bone, fit)): (usize, (&Bone, &BoneFit))| {
        let centre = open.and_then(|open| open.centres.get(n)).unwrap_or(&bone.centroid);
        let radius = open.and_then(|open| open.radii.get(n)).copied();
        PosedBone {
            name: bone.name.clone(),
            label: bone.label,
            centre: fit.transform * centre,
            // A cube's corners and faces lie about that far from its middle.
            radius_mm: radius.unwrap_or_else(|| 0.5 * bone.volume_mm3.cbrt()).max(1.0),
            position_sd_mm: known.get(&bone.label).copied().unwrap_or(0.0),
        }
    };
    PosePosterior::new(fits.map(bone).collect(), open.map(|open| &open.matrix))
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
fn doubt(warnings: &[Warning]) -> f64 {
    let doubtful = [findings::WEAK_START, findings::BONES_LOST, findings::LEVEL_UNSURE];
    if warnings.iter().any(|w| doubtful.iter().any(|f| w.is(f))) { DOUBT } else { 1.0 }
}

/// How well each bone's position is known, mm, by its label. A bone of which the image shows a part is known worse; one that
/// no image determines is where its joint lets it be, beside the bone that it hangs on, and no better known than the fit's own
/// deviation, in which turns of all joints between it and the image count: those take a skull out of view the farthest.
fn bone_mm(bones: &[Bone], fits: &[BoneFit]) -> BTreeMap<u16, f64> {
    let mut mm: Vec<f64> = Vec::with_capacity(bones.len());
    for (bone, fit) in bones.iter().zip(fits) {
        let play = bone.joint.translation_range_mm.iter().map(|m| m * m).sum::<f64>().sqrt() / RANGE_SD;
        // Parents come first; where one does not, its own place is taken for known.
        let parent = bone.parent.and_then(|parent| mm.get(parent)).copied().unwrap_or(0.0);
        let by_joint = play.hypot(parent).max(LEAST_MM);
        let sd = fit.position_sd_mm;
        mm.push(match fit.determined_by {
            _ if !sd.is_finite() => by_joint,
            DeterminedBy::Joint => by_joint.max(sd),
            DeterminedBy::Image => (DEPENDENT * sd / fit.visible.max(1e-3)).hypot(LEAST_MM).min(by_joint),
            DeterminedBy::Skin => sd,
            DeterminedBy::Given => sd.min(by_joint),
        });
    }
    bones.iter().map(|bone| bone.label).zip(mm).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fit::Stop;
    use crate::geometry::Rigid;
    use crate::skeleton::Joint;
    use nalgebra::{Matrix3, Point3};

    /// A skull that hangs on an atlas with 1 mm of play, in a scan that shows neither, or both.
    fn known(determined_by: DeterminedBy, visible: f64) -> [f64; 2] {
        let joint = Joint {
            name: String::new(),
            centre: Point3::origin(),
            axes: Matrix3::identity(),
            rotation_range_deg: [[-15.0, 15.0]; 3],
            translation_range_mm: [2.0, 0.0, 0.0],
            source: String::new(),
        };
        let bone = |label: u16, parent: Option<usize>| Bone {
            label,
            name: format!("bone {label}"),
            volume_mm3: 1e4,
            centroid: Point3::origin(),
            parent,
            joint: joint.clone(),
        };
        let fit = |position_sd_mm: f64| BoneFit {
            name: String::new(),
            transform: Rigid::identity(),
            visible,
            similarity_before: None,
            similarity_after: None,
            stop: Stop::FollowsJoint,
            unsettled_mm: 0.0,
            position_sd_mm,
            rotation_sd_deg: 0.0,
            beyond_range: Default::default(),
            motion_mm: 0.0,
            determined_by,
        };
        let all = bone_mm(&[bone(1, None), bone(2, Some(0))], &[fit(0.2), fit(9.0)]);
        [all[&1], all[&2]]
    }

    #[test]
    fn a_bone_out_of_view_is_no_better_known_than_the_turns_of_its_joints_let_it_be() {
        // By play alone it would be known to 1.4 mm.
        let [atlas, skull] = known(DeterminedBy::Joint, 0.0);
        assert!((atlas - 1.0).abs() < 1e-12 && (skull - 9.0).abs() < 1e-12, "{atlas} {skull}");
        // What the image shows is known by the image, and at worst by the joint.
        let [atlas, skull] = known(DeterminedBy::Image, 1.0);
        assert!((atlas - 0.4f64.hypot(LEAST_MM)).abs() < 1e-12 && skull < 1.1, "{atlas} {skull}");
        // Of half a bone half as well.
        let [atlas, _] = known(DeterminedBy::Image, 0.5);
        assert!((atlas - 0.8f64.hypot(LEAST_MM)).abs() < 1e-12, "{atlas}");
    }

    #[test]
    fn a_run_that_doubts_itself_as_a_whole_is_trusted_less() {
        let said = |code| doubt(&[Warning::new(findings::FOLDED, ""), Warning::new(code, "")]);
        for code in [findings::WEAK_START, findings::BONES_LOST, findings::LEVEL_UNSURE] {
            assert!((said(code) - 1.5).abs() < 1e-12, "{code:?}");
        }
        assert!((said(findings::SLIDING) - 1.0).abs() < 1e-12 && (doubt(&[]) - 1.0).abs() < 1e-12);
    }
}
