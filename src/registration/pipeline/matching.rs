//! On which bones the couch shift of a registration is matched.

use super::outcome::is_placed;
use crate::error::{Error, Result};
use crate::evaluate::couch::{CouchBone, CouchMatch, CouchOptions, moments};
use crate::fit::FitResult;
use crate::geometry::Grid;
use crate::skeleton::{Skeleton, anatomy::Kind};
use crate::volume::LabelMap;
use nalgebra::Vector3;

/// Bones of the spine whose centre is so near the middle are matched, mm along the body: three or four vertebrae to each side.
const NEAR_MM: f64 = 60.0;
/// So many at least, however far they lie.
const FEWEST: usize = 3;

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
    let (chosen, why) = chosen(options, skeleton, fit, middle(planning, fraction, fit));
    let fitted = skeleton.bones.iter().zip(&fit.transforms).zip(chosen);
    let shaped = fitted.filter_map(|((bone, motion), matched)| {
        let moments = *shapes.get(&bone.label)?;
        Some(CouchBone { name: &bone.name, moments, motion: *motion, matched })
    });
    CouchMatch::of(&shaped.collect::<Vec<_>>(), why, *common)
}

/// Height in planning of the middle of what both scans show, mm.
fn middle(planning: &Grid, fraction: &Grid, fit: &FitResult) -> f64 {
    let back = fit.common.inverse();
    let range = |points: &mut dyn Iterator<Item = f64>| {
        points.fold([f64::MAX, f64::MIN], |[low, high], z| [low.min(z), high.max(z)])
    };
    let [low, high] = range(&mut planning.corners().map(|c| c.z).into_iter());
    let [from, to] = range(&mut fraction.corners().map(|c| (back * c).z).into_iter());
    // Scans that show nothing in common have no middle: planning's own.
    if from >= high || to <= low { f64::midpoint(low, high) } else { f64::midpoint(low.max(from), high.min(to)) }
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
    let mut near: Vec<(f64, usize)> = all
        .clone()
        .enumerate()
        .filter(|(_, (bone, fit))| matches!(Kind::of(&bone.name), Some(Kind::Spine(_))) && is_placed(fit))
        .map(|(n, (bone, _))| ((bone.centroid.z - middle).abs(), n))
        .collect();
    near.sort_by(|a, b| a.0.total_cmp(&b.0));
    let taken = near.iter().filter(|(off, _)| *off <= NEAR_MM).count().max(FEWEST).min(near.len());
    if taken == 0 {
        let placed: Vec<bool> = all.map(|(_, fit)| is_placed(fit)).collect();
        let why = if placed.contains(&true) {
            "all placed bones: none is of the spine"
        } else {
            "mean motion: no bone is placed"
        };
        return (placed, why.into());
    }
    let taken: Vec<usize> = near[..taken].iter().map(|n| n.1).collect();
    let why = "bones of the spine nearest the middle of what both scans show";
    ((0..skeleton.bones.len()).map(|n| taken.contains(&n)).collect(), why.into())
}
