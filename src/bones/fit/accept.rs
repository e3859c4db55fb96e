//! Whether a fit is one: enough of the bones found, not mirrored, not stretched; and the likely cause where it is none.

use super::mirror::{as_they_are, likely_way, twins};
use super::planning::BoneSamples;
use super::samples::Samples;
use super::scale::Scale;
use super::similarity::Measure;
use super::tissue::Tissue;
use super::{BoneFit, FitOptions, FitResult};
use crate::error::{Error, Result};
use crate::skeleton::Skeleton;
use crate::volume::Volume;
use crate::warning::Warning;

/// A fit that finds less than this share of the bone volume in view is no registration: small bones can always be matched to
/// something, and of mirrored scans up to 0.4 is found. Of true pairs, cone-beam CT included, it was 0.999 or more.
pub(super) const LEAST_FOUND: f64 = 0.5;

/// Below this share bones are lost that matter.
const MOST_FOUND: f64 = 0.85;

/// Share of the bone volume in view that the image determines; 0 when none is in view.
pub(super) fn found_share(skeleton: &Skeleton, fits: &[BoneFit]) -> f64 {
    let volume = |only_found: bool| -> f64 {
        let bones = skeleton.bones.iter().zip(fits).filter(|(_, f)| !only_found || f.determined_by == "image");
        bones.map(|(b, f)| b.volume_mm3 * f.visible).sum()
    };
    let in_view = volume(false);
    if in_view > 0.0 { volume(true) / in_view } else { 0.0 }
}

/// Judges a fit that has found a share of the bones of at least [`LEAST_FOUND`].
///
/// `coarse`: all bones' samples and the fraction at the start's resolution.
///
/// # Errors
/// [`Error::Registration`] where the fraction is mirrored or stretched.
pub(super) fn accept(
    fit: &mut FitResult,
    (scale, found): (&Scale, f64),
    (samples, fraction): (&Samples, &Tissue),
    measure: Measure,
) -> Result<()> {
    let twins = twins(samples, fraction, &fit.common, measure)?;
    fit.warnings.extend(twins.judge()?);
    fit.warnings.extend(scale.judge()?);
    if found < MOST_FOUND {
        let lost = |b: &&BoneFit| b.determined_by != "image" && b.visible > 0.3;
        let names: Vec<&str> = fit.bones.iter().filter(lost).map(|b| b.name.as_str()).collect();
        let message = format!(
            "only {:.0} % by volume of the bones in view are found in the fraction CT; not found: {}. Look at them in the \
             fusion images before anything else",
            100.0 * found,
            names.join(", ")
        );
        fit.warnings.push(Warning::new("bones-lost", message));
    }
    Ok(())
}

/// Why a fit has found too few bones, with the likely cause.
///
/// # Errors
/// [`Error::Internal`] when a resolution has no samples.
pub(super) fn not_found(
    (fit, found): (&FitResult, f64),
    coarse: (&Samples, &Tissue),
    (samples, fraction): (&BoneSamples, &Volume<f32>),
    options: &FitOptions,
) -> Result<Error> {
    let finer = options.levels.first().and_then(|&l| Some((samples.at(l)?, Tissue::blurred(fraction, l.0))));
    let (drawn, fine) = finer.ok_or_else(|| Error::Internal("a level of the fit has no samples".into()))?;
    let own = as_they_are(&drawn.all, &fine, &fit.common, options.measure);
    let problem = format!(
        "of the bones that should be in view, only {:.0} % by volume are found in the fraction CT ({} of {} bones)",
        100.0 * found.max(0.0),
        fit.bones.iter().filter(|b| b.determined_by == "image").count(),
        fit.bones.len()
    );
    Ok(match likely_way(coarse, (&drawn.all, &fine), own, options.measure) {
        Some((way, share)) => Error::failed(
            "fraction-turned",
            format!(
                "{problem}; {way}, the planning CT's bones would explain {:.0} % of its contrast for {:.0} %",
                100.0 * share,
                100.0 * own
            ),
            "the direction in one of the two headers is wrong, or the patient lay another way: write the file anew from its \
             DICOM series, and look at both scans in one viewer",
        ),
        None => Error::failed(
            "bones-not-found",
            problem,
            "check that both CTs show the same patient and a common body region, in HU, without metal or motion over the \
             bones; landmarks on bones (--bone-landmarks) can place them",
        ),
    })
}
