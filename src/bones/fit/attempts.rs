//! The fit from each start until one explains the bones.

use super::accept::{LEAST_FOUND, accept, not_found};
use super::given::given;
use super::level::Level;
use super::mirror::{Seen, posed};
use super::planning::BoneSamples;
use super::rivals::best_level;
use super::schedule::{Fitter, Start, Tried};
use super::start::{FitStart, Starts, common_motions, left, near_motions};
use super::{FitOptions, FitResult};
use crate::error::{Error, Result};
use crate::geometry::Rigid;
use crate::progress::Progress;
use crate::skeleton::Skeleton;
use crate::volume::Volume;

/// Fits the pose of the skeleton to the fraction CT.
///
/// `samples` are the skeleton's bones in the planning CT, drawn with the same options; the two images (HU) may have any
/// offset. Bones outside the fraction's field of view follow their joints.
///
/// # Errors
/// [`Error::Registration`] when the images show no common anatomy: no couch shift explains the bones, or no bone is found
/// in the end.
pub fn fit_pose(
    skeleton: &Skeleton,
    samples: &BoneSamples,
    fraction: &Volume<f32>,
    start: FitStart<'_>,
    options: &FitOptions,
    progress: &dyn Progress,
) -> Result<FitResult> {
    let steps = 1 + options.outward.len() + options.levels.len();
    progress.step(0, steps, "couch shift");
    let level = Level::new(samples, fraction, BoneSamples::START, options)?;
    let fitter = Fitter::new(skeleton, options, &level);
    let common = |found: Starts| -> Vec<Start> {
        let of = |(common, share)| Start { common, share, transforms: vec![common; skeleton.bones.len()] };
        found.into_iter().map(of).collect()
    };
    let (all, image) = (&level.drawn.all, &level.fraction);
    let seen = Seen { samples: all, fraction: image };
    let fresh = !matches!(start, FitStart::Placed(_));
    let mut doubt = None;
    let starts = match &start {
        FitStart::Placed(known) => {
            let placed = given(skeleton, known)?;
            vec![Start { common: placed.common, share: 1.0, transforms: placed.transforms }]
        }
        FitStart::Near(known) => {
            let (found, odd) = near_motions(known, all, image, options.measure)?;
            doubt = odd;
            common(found)
        }
        FitStart::Search => common(common_motions(all, image, options.measure)?),
    };
    let mut refused = None;
    for begin in starts {
        let mut tried = fitter.from(begin, samples, fraction, fresh, progress)?;
        if fresh && tried.found >= LEAST_FOUND {
            let again = |common| {
                let share = level.explained(&common, options.measure);
                let begin = Start { common, share, transforms: vec![common; skeleton.bones.len()] };
                fitter.from(begin, samples, fraction, true, progress)
            };
            let explained = |common: &Rigid| level.explained(common, options.measure);
            tried = best_level(&fitter, tried, fraction.grid(), again, explained)?;
        }
        if tried.found >= LEAST_FOUND {
            let Tried { mut fit, found, scale, .. } = tried;
            let posed = posed(&level.drawn.bones, &fit.transforms);
            accept(&mut fit, &scale, found, seen, &posed, options.measure)?;
            if let FitStart::Near(known) = &start {
                fit.warnings.extend(left(known, &fit.common, all, image, options.measure).or(doubt));
            }
            return Ok(fit);
        }
        // What is said of the best start.
        refused.get_or_insert(tried);
    }
    let Tried { fit, found, scale, .. } = refused.ok_or_else(|| Error::Internal("a fit without a start".into()))?;
    scale.judge()?;
    Err(not_found(&fit, found, seen, samples, fraction, skeleton, options)?)
}
