//! Whether a fit is one: enough of the bones found, not mirrored, not stretched; and the likely cause where it is none.

use super::mirror::{Seen, as_they_are, likely_way, posed_twins, twins};
use super::planning::BoneSamples;
use super::samples::Samples;
use super::scale::Scale;
use super::search::MOST_MM3;
use super::similarity::Measure;
use super::tissue::Tissue;
use super::{BoneFit, DeterminedBy, FitOptions, FitResult};
use crate::error::{Error, Result};
use crate::findings;
use crate::skeleton::Skeleton;
use crate::volume::Volume;
use crate::warning::Warning;
use rayon::prelude::*;

/// A fit that finds less than this share of the bone volume in view is no registration: small bones can always be matched to
/// something, and of mirrored scans up to 0.4 is found. Of true pairs, cone-beam CT included, it was 0.999 or more.
pub(super) const LEAST_FOUND: f64 = 0.5;

/// Below this share bones are lost that matter.
const MOST_FOUND: f64 = 0.85;

/// Share of the bone volume in view that the image determines; 0 when none is in view.
pub(super) fn found_share(skeleton: &Skeleton, fits: &[BoneFit]) -> f64 {
    let volume = |only_found: bool| -> f64 {
        let bones =
            skeleton.bones.iter().zip(fits).filter(|(_, f)| !only_found || f.determined_by == DeterminedBy::Image);
        bones.map(|(b, f)| b.volume_mm3 * f.visible).sum()
    };
    let in_view = volume(false);
    if in_view > 0.0 { volume(true) / in_view } else { 0.0 }
}

/// A larger part of a bone than this is in view where it tells the bone's place.
const SHOWN: f64 = 0.3;
/// Smaller bones tell no place, mm^3: they match something anywhere.
const LEAST_MM3: f64 = 3000.0;
/// Bones that explain less of their contrast in a short view are told as weak. At wrong places (labels that do not reach what
/// the scan shows, mirrored scans) it was 0.55 to 0.70, at right ones in short cone-beam CTs 0.68 or more.
const SURE_PLACED: f64 = 0.75;
/// Less than this tells no place where one bone of several was found. At a wrong place it was 0.60, at right ones of the phantom
/// 0.69 and 0.71.
const SURE_ALONE: f64 = 0.65;

/// What short views tell of the place of the bones.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Placed {
    /// Share of the contrast in view that is explained; a large bone counts as one of [`MOST_MM3`].
    explained: f64,
    /// Large bones that the image has placed, of those that it shows enough of.
    bones: Vec<String>,
    /// Large bones that the image has placed, of cut ones too.
    placed: usize,
    /// Whether there are no more than one.
    alone: bool,
}

impl Placed {
    /// Of a fit.
    pub(super) fn of(skeleton: &Skeleton, fits: &[BoneFit]) -> Self {
        let all = || skeleton.bones.iter().zip(fits);
        let weight = |volume: f64, fit: &BoneFit| volume.min(MOST_MM3) * fit.visible;
        let sum: f64 = all().map(|(b, f)| weight(b.volume_mm3, f)).sum();
        let explained: f64 =
            all().map(|(b, f)| weight(b.volume_mm3, f) * f.similarity_after.unwrap_or(0.0)).sum::<f64>();
        let large = || all().filter(|(b, _)| b.volume_mm3 >= LEAST_MM3);
        let placed = |f: &BoneFit| f.determined_by == DeterminedBy::Image;
        Self {
            explained: if sum > 0.0 { explained / sum } else { 0.0 },
            bones: large().filter(|(_, f)| placed(f) && f.visible >= SHOWN).map(|(b, _)| b.name.clone()).collect(),
            placed: large().filter(|(_, f)| placed(f)).count(),
            alone: large().count() <= 1,
        }
    }

    /// Whether the image places a single large bone, or none, of several.
    fn one(&self) -> bool {
        self.bones.len() <= 1 && !self.alone
    }

    /// A word about a place that is not sure.
    ///
    /// # Errors
    /// [`Error::Registration`] where a single bone of several was found, and explains little: a piece of the skull
    /// taken for a clavicle explained 0.60. Cut neighbours that the image places too speak for the place.
    pub(super) fn judge(&self) -> Result<Option<Warning>> {
        let one = self.one();
        let weak = self.explained < SURE_PLACED;
        let percent = 100.0 * self.explained;
        if one && self.placed <= 1 && self.explained < SURE_ALONE {
            let bone = self.bones.first().map_or("no bone", String::as_str);
            return Err(Error::failed(
                findings::BONES_NOT_FOUND,
                format!(
                    "this short view shows too little bone: of the large ones the image places {bone} alone, and explains \
                     {percent:.0} % of the bone contrast in view; at wrong places it was up to 70 %"
                ),
                "give a fraction that shows two bones or more; or place the bones with a rigid motion (--start) or landmarks on \
                 bones (--bone-landmarks)",
            ));
        }
        let message = if one {
            "no two large bones are found in this short view, and one alone fits many places: check its level in the fusion \
             images, or place a bone with --bone-landmarks"
                .to_string()
        } else if weak {
            format!(
                "where they were found in this short view, the bones explain only {percent:.0} % of the bone contrast; at \
                 wrong places it was up to 70 %: check the level, left and right in the fusion images"
            )
        } else {
            return Ok(None);
        };
        Ok(Some(Warning::new(findings::WEAK_START, message)))
    }
}

/// Judges a fit that has found a share of the bones of at least [`LEAST_FOUND`].
///
/// `seen`: all bones and the fraction at the start's resolution; `posed`: the bones as the fit has posed them; `finer`: these at
/// a finer resolution, where the bones have no common motion.
///
/// # Errors
/// [`Error::Registration`] where the fraction is mirrored or stretched.
pub(super) fn accept(
    fit: &mut FitResult,
    scale: &Scale,
    skeleton: &Skeleton,
    seen: Seen<'_>,
    posed: &Samples,
    measure: Measure,
    finer: Option<Seen<'_>>,
) -> Result<()> {
    let twins = match finer {
        Some(finer) => posed_twins(finer.fraction, finer.samples, measure)?,
        None => twins(seen, posed, &fit.common, measure)?,
    };
    let one = Placed::of(skeleton, &fit.bones).one();
    fit.warnings.extend(if one { twins.doubt() } else { twins.judge()? });
    fit.warnings.extend(scale.judge()?);
    let found = found_share(skeleton, &fit.bones);
    if found < MOST_FOUND {
        let lost = |b: &&BoneFit| b.determined_by != DeterminedBy::Image && b.visible > 0.3;
        let names: Vec<&str> = fit.bones.iter().filter(lost).map(|b| b.name.as_str()).collect();
        let message = format!(
            "the fraction places only {:.0} % by volume of the bones in view; the others follow their joints: {}. Look \
             at them in the fusion images before anything else",
            100.0 * found,
            names.join(", ")
        );
        fit.warnings.push(Warning::new(findings::BONES_LOST, message));
    }
    Ok(())
}

/// Why a fit has found too few bones, with the likely cause.
///
/// # Errors
/// [`Error::Internal`] when a resolution has no samples.
pub(super) fn not_found(
    fit: &FitResult,
    found: f64,
    coarse: Seen<'_>,
    samples: &BoneSamples,
    fraction: &Volume<f32>,
    skeleton: &Skeleton,
    options: &FitOptions,
) -> Result<Error> {
    let finer = options.levels.first().and_then(|&l| Some((samples.at(l)?, Tissue::blurred(fraction, l.blur_mm))));
    let (drawn, fine) = finer.ok_or_else(|| Error::Internal("a level of the fit has no samples".into()))?;
    let own = as_they_are(&drawn.all, &fine, &fit.common, options.measure);
    let problem = format!(
        "of the bones that should be in view, only {:.0} % by volume are found in the fraction ({} of {} bones)",
        100.0 * found.max(0.0),
        fit.bones.iter().filter(|b| b.determined_by == DeterminedBy::Image).count(),
        fit.bones.len()
    );
    let finer = Seen { samples: &drawn.all, fraction: &fine };
    Ok(match likely_way(coarse, finer, own, options.measure) {
        Some((way, share)) => Error::failed(
            findings::FRACTION_TURNED,
            format!(
                "{problem}; {way}, the planning CT's bones would explain {:.0} % of its contrast for {:.0} %",
                100.0 * share,
                100.0 * own
            ),
            "the direction in one of the two headers is wrong, or the patient lay another way: write the file anew from its \
             DICOM series, and look at both scans in one viewer",
        ),
        None => {
            let in_hu = options.measure != Measure::CorrelationRatio;
            let hidden = || hidden_by(fraction, bone_in_height(skeleton, &drawn.all, fraction));
            let (cause, units) = if in_hu { (hidden(), ", in HU") } else { (None, "") };
            Error::failed(
                findings::BONES_NOT_FOUND,
                cause.map_or(problem.clone(), |cause| format!("{problem}; {cause}")),
                format!(
                    "check that both scans show the same patient and a common body region{units}, without metal or motion over \
                     the bones; a rigid motion (--start) or landmarks on bones (--bone-landmarks) can place them"
                ),
            )
        }
    })
}

/// Volume of bone, mm^3, that a scan as high as the fraction shows of the labelled bones on the mean.
fn bone_in_height(skeleton: &Skeleton, samples: &Samples, fraction: &Volume<f32>) -> f64 {
    let range = |z: &mut dyn Iterator<Item = f64>| {
        let [low, high] = z.fold([f64::MAX, f64::MIN], |[low, high], z| [low.min(z), high.max(z)]);
        (high - low).max(1.0)
    };
    let labelled = range(&mut samples.points.iter().map(|p| p.z));
    let shown = range(&mut fraction.grid().corners().iter().map(|p| p.z));
    skeleton.bones.iter().map(|b| b.volume_mm3).sum::<f64>() * (shown / labelled).min(1.0)
}

/// HU from which a voxel is dense, and from which it is metal: cortical bone ends below 2000 HU, teeth below 3000.
const DENSE_HU: f32 = 250.0;
const METAL_HU: f32 = 2500.0;
/// More of what is dense than this share is no filling of a tooth.
const MOST_METAL: f64 = 0.05;
/// Less that is dense than this share of the labelled bones is another region, or another patient.
const LEAST_DENSE: f64 = 0.2;

/// What in the fraction CT (HU) may hide the bones, as far as its values tell, in words.
fn hidden_by(fraction: &Volume<f32>, bones_mm3: f64) -> Option<String> {
    let above = |hu: f32| fraction.data().par_iter().filter(|v| **v >= hu).count() as f64;
    let (dense, metal) = (above(DENSE_HU), above(METAL_HU));
    let ml = fraction.grid().voxel_volume() / 1000.0;
    if metal > MOST_METAL * dense {
        return Some(format!(
            "{:.0} ml of it are above {METAL_HU} HU, {:.0} % of all that is dense: metal, or its artefacts, hide the bones",
            metal * ml,
            100.0 * metal / dense
        ));
    }
    (dense * ml < LEAST_DENSE * bones_mm3 / 1000.0).then(|| {
        format!(
            "the fraction CT holds {:.0} ml above {DENSE_HU} HU, the labels {:.0} ml of bone on such a height: it shows another \
             region, or no bone",
            dense * ml,
            bones_mm3 / 1000.0
        )
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Grid;

    #[test]
    fn a_place_is_sure_where_several_bones_explain_what_is_in_view() {
        let bones =
            |n: usize| ["vertebrae_C3", "vertebrae_C4", "mandible"][..n].iter().map(ToString::to_string).collect();
        let sure = Placed { explained: 0.8, bones: bones(3), placed: 3, alone: false };
        assert_eq!(sure.judge().unwrap(), None);
        // A cone-beam CT with teeth, or a wrong level.
        let weak = Placed { explained: 0.69, ..sure.clone() };
        assert!(weak.judge().unwrap().is_some_and(|w| w.is(findings::WEAK_START)));
        // One vertebra of several fits many places; a femur that has no neighbour is what is sought.
        let one = Placed { bones: bones(1), placed: 1, ..sure.clone() };
        assert!(one.judge().unwrap().is_some_and(|w| w.message.contains("no two")));
        let right = Placed { bones: bones(1), placed: 1, ..weak.clone() };
        // One vertebra wholly in view between three cut bones (a view of 43 mm, right by 0.05 mm).
        let between = Placed { explained: 0.63, placed: 4, ..right.clone() };
        assert!(between.judge().unwrap().is_some_and(|w| w.message.contains("no two")));
        assert!(right.judge().unwrap().is_some_and(|w| w.message.contains("no two")));
        let refused = Placed { explained: 0.6, ..right }.judge().unwrap_err();
        assert_eq!(refused.finding(), Some(findings::BONES_NOT_FOUND));
        assert!(refused.problem().contains("vertebrae_C3 alone"), "{}", refused.problem());
        let femur = Placed { bones: bones(1), placed: 1, alone: true, ..sure };
        assert_eq!(femur.judge().unwrap(), None);
        let weak_femur = Placed { bones: bones(1), placed: 1, alone: true, ..weak };
        assert!(weak_femur.judge().unwrap().is_some_and(|w| w.is(findings::WEAK_START)));
    }

    #[test]
    fn metal_and_a_scan_without_bone_are_named() {
        let grid = Grid::axis_aligned([20, 20, 20], [5.0; 3], [0.0; 3]).unwrap();
        // Of a litre, a tenth is bone; so many of its voxels are metal.
        let ct = |metal: usize| {
            let value = |n: usize| if n < metal { 3071.0 } else { 600.0 };
            Volume::from_fn(grid.clone(), |n| if n < 800 { value(n) } else { 40.0 })
        };
        assert_eq!(hidden_by(&ct(4), 100_000.0), None);
        assert!(hidden_by(&ct(80), 100_000.0).unwrap().contains("10 ml of it are above 2500 HU, 10 %"));
        assert!(hidden_by(&ct(0), 1_000_000.0).unwrap().contains("no bone"));
    }
}
