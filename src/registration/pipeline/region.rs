//! The part of a case that a region of interest needs.

use super::{Case, FractionScan, PlanningScan};
use crate::chainmail::fades_within;
use crate::error::{Error, Result};
use crate::fit::FitResult;
use crate::geometry::Grid;
use crate::skeleton::Skeleton;
use crate::volume::region::{RegionOptions, part, voxels_of_box};
use crate::volume::{LabelMap, Mask, Volume};
use nalgebra::{Point3, Vector3};
use std::ops::Range;

/// The field fades around a region over no more than this, mm, which is enough for displacements up to 26 mm: where scanners'
/// origins lie apart it would be half a metre, and the part as large as the whole.
const MOST_FADE_MM: f64 = 50.0;

/// Cuts planning CT, labels and patient to the region and its margin, and the fraction to where they come to lie. Both scans
/// keep what lies around as far as the field needs to fade, as it does around a patient: nothing there is bone or patient.
///
/// # Errors
/// [`Error::Usage`] when the region lies outside the scans, or no bone acts on it.
pub(super) fn cut(
    case: &Case,
    skeleton: &Skeleton,
    body: &Mask,
    fit: &FitResult,
    region: &RegionOptions,
) -> Result<(Case, Mask)> {
    let kept = region.voxels(&case.planning.bones)?;
    let bones =
        LabelMap { volume: part(&case.planning.bones.volume, &kept)?, names: case.planning.bones.names.clone() };
    let present = bones.counts();
    let acting: Vec<usize> =
        (0..skeleton.bones.len()).filter(|&b| present.contains_key(&skeleton.bones[b].label)).collect();
    if acting.is_empty() {
        return Err(Error::usage(
            format!("no bone lies within {} mm of the region", region.margin_mm),
            "enlarge region.margin_mm, or choose a region near bones",
        ));
    }
    let grid = bones.volume.grid();
    let moved = |b: &usize| grid.corners().map(|c| (c, fit.transforms[*b] * c));
    let moved: Vec<_> = acting.iter().flat_map(moved).collect();
    let fade = fades_within(moved.iter().map(|(c, p)| (p - c).norm()).fold(0.0, f64::max)).min(MOST_FADE_MM);
    let start = [Vector3::repeat(f64::MAX), Vector3::repeat(f64::MIN)];
    let [low, high] = moved.iter().fold(start, |[l, h], (_, p)| [l.inf(&p.coords), h.sup(&p.coords)]);
    let there =
        voxels_of_box(case.fraction.ct.grid(), [Point3::from(low), Point3::from(high)], fade).ok_or_else(|| {
            Error::usage("the region comes to lie outside the fraction", "choose a region that both scans show")
        })?;
    let around = grown(&kept, fade, case.planning.ct.grid());
    let inside = |p: &Point3<f64>| grid.contains(&grid.index(p));
    let landmarks = case.fraction.landmarks.iter().filter(|l| inside(&l.planning)).cloned().collect();
    let bones = LabelMap {
        volume: only(&case.planning.bones.volume, &kept, &around)?,
        names: case.planning.bones.names.clone(),
    };
    let guides = case.planning.guides.clone();
    let planning = PlanningScan { guides, ..PlanningScan::new(part(&case.planning.ct, &around)?, bones) };
    let guides = case.fraction.guides.clone();
    let fraction = FractionScan { landmarks, guides, ..FractionScan::new(part(&case.fraction.ct, &there)?) };
    Ok((Case { planning: planning.into(), fraction }, only(body, &kept, &around)?))
}

/// A range of voxels and those less than `mm` from it, as far as the grid goes.
fn grown(kept: &[Range<usize>; 3], mm: f64, grid: &Grid) -> [Range<usize>; 3] {
    std::array::from_fn(|a| {
        let more = (mm / grid.spacing()[a]).ceil() as usize;
        kept[a].start.saturating_sub(more)..(kept[a].end + more).min(grid.size()[a])
    })
}

/// The values around a range of voxels, of which only those in it are kept.
fn only<T: Copy + Default>(
    volume: &Volume<T>,
    kept: &[Range<usize>; 3],
    around: &[Range<usize>; 3],
) -> Result<Volume<T>> {
    let mut out = part(volume, around)?;
    let grid = out.grid().clone();
    for (voxel, value) in out.data_mut().iter_mut().enumerate() {
        let at = grid.voxel(voxel);
        if (0..3).any(|a| !kept[a].contains(&(at[a] + around[a].start))) {
            *value = T::default();
        }
    }
    Ok(out)
}
