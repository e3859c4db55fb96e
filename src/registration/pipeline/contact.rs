//! Bones that run into each other or come apart, and skin that meets skin: measured, and said.

use crate::evaluate::contact::{Bone, ContactReport, RestingBones};
use crate::field::{self, PushField};
use crate::findings;
use crate::geometry::{Grid, Rigid};
use crate::skeleton::{self, Skeleton};
use crate::volume::{LabelMap, Mask};
use crate::warning::{Warning, counted};

/// Bones that overlap by more than this are warned of, mm, and by more than half of the largest voxel edge: a label's
/// surface is not known better than that on either bone.
const DEPTH_MM: f64 = 1.0;
/// Gaps that grow by this much more than the joint's soft range are warned of, mm.
/// With the true motions of the shared cases no joint opens by 0.5 mm.
const APART_MM: f64 = 2.0;

/// The bones of a skeleton where their labels lie.
pub(super) fn resting(labels: &LabelMap, skeleton: &Skeleton) -> RestingBones {
    let bone = |bone: &skeleton::Bone| Bone {
        name: bone.name.clone(),
        label: bone.label,
        parent: bone.parent,
        play_mm: bone.joint.translation_range_mm.iter().map(|m| m * m).sum::<f64>().sqrt(),
    };
    RestingBones::new(labels, skeleton.bones.iter().map(bone).collect())
}

/// Contact of the moved bones, and of skin with the mask of the fraction voxels concerned, if there are any.
pub(super) fn measure(
    bones: &RestingBones,
    transforms: &[Rigid],
    push: &PushField,
    body: &Mask,
    target: &Grid,
) -> (ContactReport, Option<Mask>) {
    let mut report = bones.moved(transforms);
    let skin = field::overlaps(push, body, target);
    report.skin_voxels = skin.as_ref().map_or(0, Mask::count);
    report.skin_ml = report.skin_voxels as f64 * target.voxel_volume() / 1000.0;
    (report, skin)
}

/// Overlaps deeper than this are warned of, mm. `voxel` is the longest edge of the voxels that the labels were drawn on, mm.
pub(super) fn least_depth(voxel: f64) -> f64 {
    DEPTH_MM.max(0.5 * voxel)
}

/// What of it deserves a warning. `voxel` is the longest edge of the voxels that the labels were drawn on, mm.
pub(super) fn warnings(report: &ContactReport, voxel: f64) -> Vec<Warning> {
    let mut out = Vec::new();
    let limit = least_depth(voxel);
    let deep: Vec<String> = report
        .overlaps
        .iter()
        .filter(|o| o.depth_mm > limit)
        .map(|o| format!("{} and {} ({:.1} mm)", o.bones[0], o.bones[1], o.depth_mm))
        .collect();
    if !deep.is_empty() {
        let list = deep.join(", ");
        let message = format!(
            "{} by more than {limit:.1} mm after their motion: {list}; check their labels and their fit in the fusion images",
            counted(deep.len(), "pair of bones overlaps", "pairs of bones overlap")
        );
        out.push(Warning::new(findings::BONES_OVERLAP, message));
    }
    let wide: Vec<String> = report
        .joints
        .iter()
        .filter(|j| j.growth_mm() > APART_MM + j.play_mm)
        .map(|j| format!("{} from {} ({:.1} to {:.1} mm)", j.bones[0], j.bones[1], j.planning_mm, j.fraction_mm))
        .collect();
    if !wide.is_empty() {
        let list = wide.join(", ");
        let joints = counted(wide.len(), "joint comes apart beyond its range", "joints come apart beyond their range");
        let message = format!("{joints}: {list}; check labels and fit");
        out.push(Warning::new(findings::BONES_APART, message));
    }
    if report.skin_voxels > 0 {
        let message = format!(
            "skin passes through skin in {:.2} ml of the fraction ({}); see \
             skin_contact.nii.gz, and do not trust dose or contours there",
            report.skin_ml,
            counted(report.skin_voxels, "voxel", "voxels")
        );
        out.push(Warning::new(findings::SKIN_MEETS_SKIN, message));
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::evaluate::contact::{BoneOverlap, JointGap};
    use nalgebra::Point3;

    #[test]
    fn warnings_name_what_exceeds_its_limit_and_nothing_else() {
        let overlap =
            |a: &str, depth_mm| BoneOverlap { bones: [a.into(), "skull".into()], depth_mm, at: Point3::origin() };
        let gap = |a: &str, fraction_mm| JointGap {
            bones: [a.into(), "skull".into()],
            planning_mm: 1.0,
            fraction_mm,
            play_mm: 3.0,
        };
        let report = ContactReport {
            overlaps: vec![overlap("mandible", 2.0), overlap("vertebrae_C1", 1.2)],
            joints: vec![gap("hyoid", 6.5), gap("sternum", 5.5)],
            skin_voxels: 0,
            skin_ml: 0.0,
        };
        let all = warnings(&report, 3.0);
        assert_eq!(all.iter().map(|w| w.code.as_str()).collect::<Vec<_>>(), ["bones-overlap", "bones-apart"]);
        assert!(all[0].message.contains("mandible") && !all[0].message.contains("C1"));
        assert!(all[1].message.contains("hyoid") && !all[1].message.contains("sternum"));
        assert!(warnings(&report, 1.0)[0].message.contains("C1"));
        let skin = ContactReport { skin_voxels: 5, skin_ml: 0.04, ..ContactReport::default() };
        assert_eq!(warnings(&skin, 1.0)[0].code, "skin-meets-skin");
    }
}
