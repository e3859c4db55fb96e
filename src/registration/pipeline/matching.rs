//! On which bones the couch shift of a registration is matched.

use super::outcome::is_placed;
use crate::error::{Error, Result};
use crate::evaluate::couch::{CouchBone, CouchMatch, CouchOptions, NEAR_MIDDLE, middle, moments, near_middle};
use crate::fit::{BoneFit, FitResult};
use crate::geometry::Grid;
use crate::skeleton::{Bone, Skeleton, is_of_spine};
use crate::volume::LabelMap;
use nalgebra::Vector3;

/// Refuses names that are no bone of the planning scan.
///
/// # Errors
/// [`Error::Usage`] when a bone has not the name, or no bone lies in the box.
pub(super) fn check(options: &CouchOptions, skeleton: &Skeleton, bones: &LabelMap) -> Result<()> {
    let known = |name: &str| skeleton.bones.iter().any(|b| b.name == name);
    if let Some(name) = options.bones.iter().find(|name| !known(name)) {
        let names: Vec<&str> = skeleton.bones.iter().map(|b| b.name.as_str()).collect();
        return Err(Error::usage(
            format!("no bone of the planning scan is named {name}: the couch shift cannot be matched on it"),
            format!("give some of {}, or none for the spine", names.join(", ")),
        ));
    }
    if let Some(within) = options.box_mm
        && !moments(bones, Some(within)).keys().any(|label| skeleton.bones.iter().any(|b| b.label == *label))
    {
        return Err(Error::usage(
            format!(
                "no bone lies in the box {}: the couch shift cannot be matched there",
                within.map(|v| v.to_string()).join(",")
            ),
            "give least x, y, z, then greatest, in LPS mm of the planning scan, around bones",
        ));
    }
    Ok(())
}

/// The couch shift, matched as `options` ask; `common`: mean motion of the whole, where no bone can be matched.
pub(super) fn couch_match(
    options: &CouchOptions,
    skeleton: &Skeleton,
    bones: &LabelMap,
    fit: &FitResult,
    [planning, fraction]: [&Grid; 2],
    common: &Vector3<f64>,
) -> CouchMatch {
    let shapes = moments(bones, options.box_mm);
    let (chosen, why) = chosen(options, skeleton, fit, middle(planning, fraction, &fit.common));
    let fitted = skeleton.bones.iter().zip(&fit.transforms).zip(chosen);
    let shaped = fitted.filter_map(|((bone, motion), matched)| {
        let moments = *shapes.get(&bone.label)?;
        Some(CouchBone { name: &bone.name, moments, motion: *motion, matched })
    });
    CouchMatch::of(&shaped.collect::<Vec<_>>(), why, *common)
}

/// Which bones are matched, and why, in words.
fn chosen(options: &CouchOptions, skeleton: &Skeleton, fit: &FitResult, middle: f64) -> (Vec<bool>, String) {
    let all = skeleton.bones.iter().zip(&fit.bones);
    if options.box_mm.is_some() {
        let placed: Vec<bool> = all.clone().map(|(_, fit)| is_placed(fit)).collect();
        // A box of bones that follow their joints alone is matched on these.
        return match placed.contains(&true) {
            true => (placed, "bones in the given box".into()),
            false => (vec![true; skeleton.bones.len()], "bones in the given box, which follow their joints".into()),
        };
    }
    if !options.bones.is_empty() {
        let named = all.map(|(bone, _)| options.bones.contains(&bone.name)).collect();
        return (named, "the given bones".into());
    }
    let height =
        |(bone, fit): (&Bone, &BoneFit)| (is_of_spine(&bone.name) && is_placed(fit)).then_some(bone.centroid.z);
    let near = near_middle(&all.clone().map(height).collect::<Vec<_>>(), middle);
    if near.is_empty() {
        let placed: Vec<bool> = all.map(|(_, fit)| is_placed(fit)).collect();
        let why = if placed.contains(&true) {
            "all placed bones: none is of the spine"
        } else {
            "mean motion: no bone is placed"
        };
        return (placed, why.into());
    }
    ((0..skeleton.bones.len()).map(|n| near.contains(&n)).collect(), NEAR_MIDDLE.into())
}
