//! The part of a case that a region of interest needs.

use super::Case;
use crate::error::{Error, Result};
use crate::fit::FitResult;
use crate::skeleton::Skeleton;
use crate::volume::region::{RegionOptions, part, voxels_of_box};
use crate::volume::{LabelMap, Mask};
use nalgebra::{Point3, Vector3};

/// Cuts planning CT, labels and patient to the region and its margin, and the fraction to where they come to lie.
///
/// # Errors
/// [`Error::Usage`] when the region lies outside the scans, or no bone acts on it.
pub(super) fn cut(
    case: &Case,
    (skeleton, body, fit): (&Skeleton, &Mask, &FitResult),
    region: &RegionOptions,
) -> Result<(Case, Mask)> {
    let range = region.voxels(&case.bones)?;
    let bones = LabelMap { volume: part(&case.bones.volume, &range)?, names: case.bones.names.clone() };
    let present = bones.counts();
    let acting: Vec<usize> =
        (0..skeleton.bones.len()).filter(|&b| present.contains_key(&skeleton.bones[b].label)).collect();
    if acting.is_empty() {
        return Err(Error::usage(
            format!("no bone lies within {} mm of the region", region.margin_mm),
            "enlarge region.margin_mm, or choose a region near bones",
        ));
    }
    let planning = part(&case.planning, &range)?;
    let start = [Vector3::repeat(f64::MAX), Vector3::repeat(f64::MIN)];
    let corners = planning.grid().corners();
    let [low, high] = acting
        .iter()
        .flat_map(|&b| corners.map(|c| fit.transforms[b] * c))
        .fold(start, |[l, h], p| [l.inf(&p.coords), h.sup(&p.coords)]);
    let there = voxels_of_box(case.fraction.grid(), [Point3::from(low), Point3::from(high)], 0.0).ok_or_else(|| {
        Error::usage("the region comes to lie outside the fraction CT", "choose a region that both scans show")
    })?;
    let inside = |p: &Point3<f64>| planning.grid().contains(&planning.grid().index(p));
    let landmarks = case.landmarks.iter().filter(|l| inside(&l.planning)).cloned().collect();
    let cut = Case {
        fraction: part(&case.fraction, &there)?,
        landmarks,
        bone_landmarks: Vec::new(),
        skeleton: None,
        warnings: Vec::new(),
        inputs: case.inputs.clone(),
        planning,
        bones,
    };
    Ok((cut, part(body, &range)?))
}
