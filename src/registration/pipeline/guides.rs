//! Structures that guide: which are outlined in both scans, how near their outlines come, and what speaks against them.

use super::{Case, PlanningScan};
use crate::config::{Config, SoftTissue};
use crate::error::{Error, Result};
use crate::evaluate::Surface;
use crate::evaluate::contour::distances;
use crate::findings;
use crate::refine::{DOUBTED_MM, UNBELIEVED_MM, depth_in};
use crate::skeleton::Skeleton;
use crate::volume::{Mask, Outline, Spans, Volume, Window, trilinear, trilinear_vector};
use crate::warning::{Warning, counted};
use nalgebra::Point3;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;

/// A structure that guides, planning's outline first.
pub(super) type GuidePair = (Outline, Outline);

/// Tissue so near a surface shows whether images agree with it, and is looked at for folds, mm.
const BESIDE_MM: f64 = 8.0;
/// A correlation beside a surface that falls by more than this tells that the images disagree with its outlines.
const LOST: f64 = 0.05;
/// An outline that is missed by more on the mean is told, mm, or half a voxel's longest edge where that is more.
const MISSED_MM: f64 = 1.0;

/// How near the outlines of a structure come to each other, measured in planning.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct OutlineAgreement {
    /// Dice coefficient of the voxels, 0 to 1.
    pub dice: f64,
    /// Mean distance to agreement of the surfaces, mm.
    pub mean_mm: f64,
    /// 95th percentile of their distances, mm.
    pub p95_mm: f64,
}

/// A structure that guided, and what came of it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct GuideReached {
    /// Its name.
    pub name: String,
    /// Volume in planning, ml.
    pub planning_ml: f64,
    /// Volume in the fraction, ml.
    pub fraction_ml: f64,
    /// By bones and images alone; `None` where nothing of one outline is seen in the other scan.
    pub before: Option<OutlineAgreement>,
    /// By the result.
    pub after: Option<OutlineAgreement>,
    /// Correlation of the images within 8 mm of its surface, before and after; `None` where they show no contrast.
    pub images: Option<[f64; 2]>,
    /// Folded cells within 8 mm of its surface.
    pub folded: usize,
}

/// The structures that both scans outline and the settings name, and what is to be said of the others.
///
/// # Errors
/// [`Error::Usage`] when guides are given and nothing can follow them; [`Error::Input`] when there is no pair, or one that the
/// settings name is not there.
pub(super) fn paired(case: &Case, skeleton: &Skeleton, config: &Config) -> Result<(Vec<GuidePair>, Vec<Warning>)> {
    let (there, here) = (&case.planning.guides, &case.fraction.guides);
    if there.is_empty() && here.is_empty() {
        return Ok((Vec::new(), Vec::new()));
    }
    if config.soft_tissue != SoftTissue::ChainMail || config.chainmail.relaxation.is_empty() {
        return Err(Error::usage(
            "guides need the relaxation of soft tissue, and these settings have none",
            "leave --guide out, or use another preset",
        ));
    }
    let names = |all: &[Outline]| all.iter().map(|o| o.name.clone()).collect::<BTreeSet<String>>();
    let (planning, fraction, wanted) = (names(there), names(here), &config.refine.guide.names);
    let is_bone = |name: &String| skeleton.bones.iter().any(|b| b.name == *name);
    let usable = |name: &String| planning.contains(name) && fraction.contains(name) && !is_bone(name);
    let list = |names: &BTreeSet<String>| names.iter().cloned().collect::<Vec<_>>().join(", ");
    if let Some(name) = wanted.iter().find(|name| !usable(name)) {
        let problem = match (is_bone(name), planning.contains(name), fraction.contains(name)) {
            (true, ..) => format!("{name} is a bone: bones are rigid and cannot guide"),
            (_, true, _) => format!("{name} is outlined in planning alone (fraction: {})", list(&fraction)),
            (_, _, true) => format!("{name} is outlined in the fraction alone (planning: {})", list(&planning)),
            _ => format!("{name} is outlined in neither scan ({})", list(&planning)),
        };
        let remedy = "name structures outlined in both scans, or leave --guide-names out";
        return Err(Error::refused(findings::GUIDE_LEFT_OUT, "guides", problem, remedy));
    }
    let taken = |name: &&String| usable(name) && (wanted.is_empty() || wanted.contains(name));
    let chosen: BTreeSet<&String> = planning.iter().filter(taken).collect();
    if chosen.is_empty() {
        let problem =
            format!("no structure is outlined in both scans ({}; fraction: {})", list(&planning), list(&fraction));
        let remedy = "outline a structure that is not a bone in both scans, with the same name";
        return Err(Error::refused(findings::GUIDE_LEFT_OUT, "guides", problem, remedy));
    }
    let mut warnings = Vec::new();
    let left: Vec<String> = planning.union(&fraction).filter(|name| !usable(name)).cloned().collect();
    if wanted.is_empty() && !left.is_empty() {
        let message =
            format!("not used as guides, because they are bones or outlined in one scan alone: {}", left.join(", "));
        warnings.push(Warning::new(findings::GUIDE_LEFT_OUT, message));
    }
    let of = |all: &[Outline], name: &String| all.iter().find(|o| o.name == *name).cloned();
    let pairs: Vec<GuidePair> = chosen.iter().filter_map(|name| Some((of(there, name)?, of(here, name)?))).collect();
    let cut: Vec<&str> = pairs.iter().filter(|(a, b)| a.is_cut() || b.is_cut()).map(|(a, _)| a.name.as_str()).collect();
    if !cut.is_empty() {
        let message = format!(
            "the edge of a scan cuts {}: outlines guide less within {DOUBTED_MM} mm of it, and not within {UNBELIEVED_MM} mm",
            cut.join(", ")
        );
        warnings.push(Warning::new(findings::GUIDE_CUT, message));
    }
    Ok((pairs, warnings))
}

/// What a guided field is compared by: planning and the fraction in one frame, and the field of bones and images alone.
pub(super) struct Compared<'a> {
    pub(super) planning: &'a Volume<f32>,
    pub(super) body: &'a Mask,
    pub(super) fraction: &'a Volume<f32>,
    pub(super) window: Window,
    pub(super) first: &'a Volume<[f32; 3]>,
    pub(super) guided: &'a Volume<[f32; 3]>,
}

impl Compared<'_> {
    /// Correlation of both images within [`BESIDE_MM`] of a structure's surface, before and after; `None` where nothing is seen
    /// or has contrast.
    pub(super) fn correlations(&self, planning: &Outline) -> Option<[f64; 2]> {
        let depth = depth_in(planning);
        let grid = depth.grid();
        let shown = |n: usize| {
            let at = grid.centre(grid.voxel(n));
            let voxel = self.body.grid().voxel_at(&at)?;
            let beside = f64::from(depth.data()[n].abs()) < BESIDE_MM && *self.body.at(voxel);
            let p = self.window.of(*self.planning.data().get(self.body.grid().linear(voxel)).filter(|_| beside)?);
            let there = |field: &Volume<[f32; 3]>| {
                let u = trilinear_vector(field, &field.grid().index(&at))?;
                let f = trilinear(self.fraction, &self.fraction.grid().index(&(at + u))).filter(|f| !f.is_nan())?;
                Some(f64::from(self.window.of(f as f32)))
            };
            Some([f64::from(p), there(self.first)?, there(self.guided)?])
        };
        let all: Vec<[f64; 3]> = (0..grid.len()).into_par_iter().filter_map(shown).collect();
        Some([correlation(&all, 1)?, correlation(&all, 2)?])
    }
}

/// Least contrast that tells of anything, HU.
const LEAST_CONTRAST_HU: f64 = 3.0;

/// Correlation of the first with another value.
fn correlation(all: &[[f64; 3]], other: usize) -> Option<f64> {
    let n = all.len() as f64;
    let mean = |q: usize| all.iter().map(|v| v[q]).sum::<f64>() / n;
    let (a, b) = (mean(0), mean(other));
    let sum = |f: &dyn Fn(&[f64; 3]) -> f64| all.iter().map(f).sum::<f64>() / n;
    let (aa, bb) = (sum(&|v| (v[0] - a).powi(2)), sum(&|v| (v[other] - b).powi(2)));
    let contrast = !all.is_empty() && aa.min(bb).sqrt() > LEAST_CONTRAST_HU;
    contrast.then(|| sum(&|v| (v[0] - a) * (v[other] - b)) / (aa * bb).sqrt())
}

/// What is measured with: the field before, where it is known, and that of the result, both into the fraction; its folds.
pub(super) struct GuidedField<'a> {
    first: Option<&'a Volume<[f32; 3]>>,
    push: &'a Volume<[f32; 3]>,
    /// Where the first voxels of folded cells lie, LPS mm.
    folded: Vec<Point3<f64>>,
}

impl<'a> GuidedField<'a> {
    /// What came of structures, in their order, whose images correlate so beside them without and with guides.
    pub(super) fn all(
        first: Option<&'a Volume<[f32; 3]>>,
        push: &'a Volume<[f32; 3]>,
        jacobian: &Spans<f32>,
        pairs: &[GuidePair],
        images: &[Option<[f64; 2]>],
    ) -> Vec<GuideReached> {
        if pairs.is_empty() {
            return Vec::new();
        }
        let (map, grid) = (jacobian.to_volume(), push.grid());
        let folded = map.data().iter().enumerate().filter(|(_, j)| **j <= 0.0);
        let field = Self { first, push, folded: folded.map(|(n, _)| grid.centre(grid.voxel(n))).collect() };
        pairs.iter().zip(images).map(|(pair, images)| field.reached(pair, *images)).collect()
    }

    /// What came of a structure.
    fn reached(&self, (planning, fraction): &GuidePair, images: Option<[f64; 2]>) -> GuideReached {
        let there = depth_in(fraction);
        let beside = depth_in(planning);
        let near = |at: &Point3<f64>| trilinear(&beside, &beside.grid().index(at)).is_some_and(|d| d.abs() < BESIDE_MM);
        GuideReached {
            name: planning.name.clone(),
            planning_ml: planning.volume_ml(),
            fraction_ml: fraction.volume_ml(),
            before: self.first.and_then(|field| agreement(planning, fraction, &there, field)),
            after: agreement(planning, fraction, &there, self.push),
            images,
            folded: self.folded.iter().filter(|at| near(at)).count(),
        }
    }
}

/// How well planning's structure agrees with the fraction's that a field brings to planning.
fn agreement(
    planning: &Outline,
    fraction: &Outline,
    there: &Volume<f32>,
    field: &Volume<[f32; 3]>,
) -> Option<OutlineAgreement> {
    let grid = planning.inside.grid();
    let cut = fraction.is_cut();
    // Inside in planning, inside in the fraction; nothing where the fraction is not seen.
    let both = |n: usize| {
        let at = grid.centre(grid.voxel(n));
        let own = planning.inside.data()[n];
        let u = trilinear_vector(field, &field.grid().index(&at)).unwrap_or_default();
        match trilinear(there, &there.grid().index(&(at + u))) {
            Some(depth) => [own, depth < 0.0],
            None => [own && !cut, false],
        }
    };
    let both = Volume::from_fn(grid.clone(), both);
    let count = |of: fn(&[bool; 2]) -> bool| both.data().iter().filter(|v| of(v)).count() as f64;
    let surface = |side: usize| Surface::of(&both, move |v: [bool; 2]| v[side]);
    let apart = distances(&surface(0)?, &surface(1)?);
    Some(OutlineAgreement {
        dice: 2.0 * count(|v| v[0] && v[1]) / (count(|v| v[0]) + count(|v| v[1])),
        mean_mm: apart.mean_mm,
        p95_mm: apart.hausdorff_95_mm,
    })
}

/// What speaks against guides; `voxel`: the longest edge of a voxel, mm.
pub(super) fn warnings(reached: &[GuideReached], voxel: f64) -> Vec<Warning> {
    let mut out = Vec::new();
    for GuideReached { name, after, images, folded, .. } in reached {
        if let Some([before, after]) = images.filter(|[before, after]| before - after > LOST) {
            let message = format!(
                "{name}: with guides the images match worse near its surface (correlation {before:.2} without, {after:.2} \
                 with): an outline may be misplaced, or of another structure"
            );
            out.push(Warning::new(findings::GUIDE_CONTRADICTS, message));
        }
        match after {
            Some(left) if left.mean_mm > MISSED_MM.max(0.5 * voxel) => {
                let message = format!(
                    "{name}: the deformed outline misses that of the fraction by {:.1} mm on average (95 % within {:.1} mm): \
                     bones hold it back, or tissue would fold",
                    left.mean_mm, left.p95_mm
                );
                out.push(Warning::new(findings::GUIDE_MISSED, message));
            }
            None => {
                let message =
                    format!("{name}: the field maps no part of its outline in the fraction near that in planning");
                out.push(Warning::new(findings::GUIDE_MISSED, message));
            }
            Some(_) => {}
        }
        if *folded > 0 {
            let message = format!(
                "{name}: the field folds in {} within {BESIDE_MM:.0} mm of its surface",
                counted(*folded, "cell", "cells")
            );
            out.push(Warning::new(findings::GUIDE_FOLDS, message));
        }
    }
    out
}

/// Whether planning has structures that may guide, so that tissue is drawn though no image pulls.
pub(super) fn may_guide(planning: &PlanningScan, config: &Config) -> bool {
    !planning.guides.is_empty() && config.soft_tissue == SoftTissue::ChainMail
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Grid;

    #[test]
    fn cells_that_fold_beside_a_guide_are_counted_and_named() {
        let grid = Grid::axis_aligned([40, 30, 20], [2.0, 2.0, 3.0], [0.0; 3]).unwrap();
        let ball = |n: usize| (grid.centre(grid.voxel(n)) - Point3::new(24.0, 30.0, 30.0)).norm() < 12.0;
        let outline = Outline::of("gland", &Volume::from_fn(grid.clone(), ball), |v| v).unwrap();
        let push = Volume::filled(grid.clone(), [0f32; 3]);
        let mut jacobian = Volume::filled(grid.clone(), 1f32);
        let told = |jacobian: &Volume<f32>| {
            let pairs = [(outline.clone(), outline.clone())];
            let found = GuidedField::all(None, &push, &Spans::of_volume(jacobian), &pairs, &[None]);
            (
                found[0].folded,
                warnings(&found, 3.0).iter().any(|w| w.code == "guide-folds" && w.message.contains("gland")),
            )
        };
        // In the middle, 12 mm deep, and 30 mm away.
        for voxel in [[12, 15, 10], [33, 15, 10]] {
            jacobian.data_mut()[grid.linear(voxel)] = -0.1;
            assert_eq!(told(&jacobian), (0, false), "{voxel:?}");
        }
        // On its surface, and 4 mm outside.
        jacobian.data_mut()[grid.linear([18, 15, 10])] = -0.1;
        jacobian.data_mut()[grid.linear([20, 15, 10])] = 0.0;
        assert_eq!(told(&jacobian), (2, true));
    }
}
