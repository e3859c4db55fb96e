//! The fit from each start until one explains the bones.

use super::accept::{LEAST_FOUND, Placed, accept, not_found};
use super::coarse::Coarse;
use super::given::given;
use super::level::{Level, Levels};
use super::mirror::{Seen, posed};
use super::planning::BoneSamples;
use super::rivals::{SHORT_MM, best_level};
use super::schedule::Fitter;
use super::search::{Hypothesis, Search};
use super::shape::Shapes;
use super::similarity::Measure;
use super::start::{FitStart, Starts, common_motions, left, near_motions};
use super::tried::{Begun, Guess, Start, Tried};
use super::weighed::{Place, Weighed};
use super::{FitOptions, FitResult};
use crate::error::{Error, Result};
use crate::findings;
use crate::geometry::Rigid;
use crate::progress::Progress;
use crate::skeleton::Skeleton;
use crate::volume::Volume;
use crate::warning::Warning;
use rayon::prelude::*;

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
    Ok(fit_pose_weighed(skeleton, samples, fraction, start, options, progress)?.0)
}

/// As [`fit_pose`], with what else was weighed.
///
/// # Errors
/// As [`fit_pose`].
pub fn fit_pose_weighed(
    skeleton: &Skeleton,
    samples: &BoneSamples,
    fraction: &Volume<f32>,
    start: FitStart<'_>,
    options: &FitOptions,
    progress: &dyn Progress,
) -> Result<(FitResult, Weighed)> {
    let steps = 1 + options.outward.len() + options.levels.len();
    progress.step(0, steps, "couch shift");
    let levels = Levels::new(samples, fraction, options);
    let level = levels.at(BoneSamples::START)?;
    let mut fitter = Fitter::new(skeleton, options, &level, shapes(samples, fraction, options));
    fitter.given = start.given();
    let attempts = Attempts { fitter, level: &level, levels, samples, fraction, options, progress };
    let bones = skeleton.bones.len();
    let common = |found: Starts| -> Vec<Start> {
        let of = |(common, share)| Start { common, share, transforms: vec![common; bones], guess: Guess::Common };
        found.into_iter().map(of).collect()
    };
    let (all, image) = (&level.drawn.all, &level.fraction);
    let mut doubt = None;
    let mut lost = None;
    let starts = match &start {
        FitStart::Placed(known) => {
            let placed = given(skeleton, known)?;
            let transforms = placed.transforms;
            vec![Start { common: placed.common, share: 1.0, transforms, guess: Guess::Given }]
        }
        FitStart::Near(known) => {
            let (found, odd) = near_motions(known, all, image, options.measure)?;
            doubt = odd;
            common(found)
        }
        // The bones may explain the fraction one by one where all together do not.
        FitStart::Search => common(common_motions(all, image, options.measure).unwrap_or_else(|e| {
            lost = Some(e);
            Starts::new()
        })),
    };
    let known: Vec<Rigid> = starts.iter().map(|s| s.common).collect();
    let search = matches!(start, FitStart::Search);
    // In another modality a bone may match well at a wrong place: the skeleton tells, and a quick fit is made only where it does not.
    let by_ratio = options.measure == Measure::CorrelationRatio;
    let searched_first = search && by_ratio;
    let mut others = Vec::new();
    let mut hypotheses = Vec::new();
    let mut refused = None;
    let mut found = None;
    if searched_first {
        (found, others, hypotheses) = attempts.searched(None, &known)?;
    }
    if found.is_none() {
        (found, refused) = attempts.quick(starts, search)?;
    }
    let short = |tried: &Tried| attempts.fitter.height_shown(&tried.fit.transforms, fraction.grid()) < SHORT_MM;
    let unsure = match &start {
        FitStart::Search => by_ratio || found.as_ref().is_none_or(short),
        FitStart::Near(_) => found.is_none(),
        FitStart::Placed(_) => false,
    };
    if unsure && !searched_first {
        (found, others, hypotheses) = attempts.searched(found, &known)?;
    }
    if search {
        found = found.map(|tried| attempts.with_limbs(tried)).transpose()?;
    }
    if let Some(tried) = found {
        let placed = matches!(start, FitStart::Placed(_));
        let searched = tried.guess == Guess::Searched;
        let (mut fit, places) = attempts.judged(tried, others, placed)?;
        fit.warnings.extend(told(skeleton, &hypotheses).filter(|_| searched));
        if unsure {
            let doubt = Placed::of(skeleton, &fit.bones).judge()?;
            let said = fit.warnings.iter().any(|w| w.is(findings::WEAK_START));
            fit.warnings.extend(doubt.filter(|_| !said));
        }
        if let FitStart::Near(known) = &start {
            fit.warnings.extend(left(known, &fit.common, all, image, options.measure).or(doubt));
        }
        return Ok((fit, Weighed { places, hypotheses }));
    }
    if let Some(lost) = lost {
        return Err(lost);
    }
    let Tried { fit, found, scale, .. } = refused.ok_or_else(|| Error::Internal("a fit without a start".into()))?;
    scale.judge()?;
    let seen = Seen { samples: all, fraction: image };
    Err(not_found(&fit, found, seen, samples, fraction, skeleton, options)?)
}

/// Descriptors of both images, where those of the planning image are there: made for an image of another modality.
fn shapes<'a>(samples: &'a BoneSamples, fraction: &Volume<f32>, options: &FitOptions) -> Option<Shapes<'a>> {
    let planning = samples.anatomy.undescribed.as_ref()?;
    let drawn = samples.at(*options.outward.first()?)?;
    Some(Shapes::new(Coarse::new(fraction), planning, &drawn.bones))
}

/// A hypothesis of the search that is worth less than this share of the best one is no rival.
const RIVAL: f64 = 0.8;
/// A search tries more places than a quick start, so it has to find more of the bones: the one wrong place among 52
/// short views found 0.55 of them, right ones 0.61 or more.
const SEARCHED_FOUND: f64 = 0.6;
/// A fit that has less than this share of another one's evidence before the last pass is not finished. Of 89 such fits in 20
/// slabs of cone-beam CTs 87 ended below half, too; without them results and warnings of all 20 are the same.
const FAR_LESS: f64 = 0.5;
/// A searched fit takes the place of a quick one where its evidence is greater by more than this share.
const BETTER: f64 = 1.02;

/// Which bones proposed the start, and what the next best one is worth.
fn told(skeleton: &Skeleton, hypotheses: &[Hypothesis]) -> Option<Warning> {
    let best = hypotheses.first()?;
    let names: Vec<&str> = best.proposed_by.iter().map(|&b| skeleton.bones[b].name.as_str()).collect();
    let next = hypotheses.get(1).map_or_else(String::new, |next| {
        let share = (next.cost / best.cost).clamp(0.0, 1.0);
        format!("; the next best, {:.0} mm away, has {:.0} % of its evidence", next.apart_mm, 100.0 * share)
    });
    let message = format!(
        "the start was searched: single bones proposed places, and the joints favour that of {}{next}",
        names.join(", ")
    );
    Some(Warning::new(findings::START_SEARCHED, message))
}

/// What all attempts share.
struct Attempts<'a> {
    fitter: Fitter<'a>,
    level: &'a Level<'a>,
    levels: Levels<'a>,
    samples: &'a BoneSamples,
    fraction: &'a Volume<f32>,
    options: &'a FitOptions,
    progress: &'a dyn Progress,
}

impl Attempts<'_> {
    fn fit(&self, begin: Start) -> Result<Tried> {
        self.fitter.from(begin, &self.levels, self.progress)
    }

    /// The first fit from these starts that finds the bones, else what came of the best start. Where they come from a search, the first
    /// is the only one.
    fn quick(&self, starts: Vec<Start>, first_only: bool) -> Result<(Option<Tried>, Option<Tried>)> {
        let mut refused = None;
        for begin in starts {
            let tried = self.fit(begin)?;
            if tried.found >= LEAST_FOUND {
                return Ok((Some(tried), refused));
            }
            refused.get_or_insert(tried);
            if first_only {
                break;
            }
        }
        Ok((None, refused))
    }

    /// Fits from these starts that find this share of the bones, and whether one led to a fit that is known. A fit is not finished
    /// where another one has the bones at that place, nor with far less evidence than one that found them.
    fn rivals(&self, starts: Vec<Start>, known: &[&Tried], least: f64) -> Result<(Vec<Tried>, bool)> {
        self.levels.keep();
        let begin = |start| self.fitter.begin(start, &self.levels, self.progress);
        let mut begun = starts.into_par_iter().map(begin).collect::<Result<Vec<Begun<'_>>>>()?;
        begun.sort_by(|a, b| a.cost().unwrap_or(0.0).total_cmp(&b.cost().unwrap_or(0.0)));
        let mut tried: Vec<Tried> = Vec::new();
        let mut again = false;
        for rival in begun {
            let is_known = known.iter().any(|other| self.fitter.same(&rival, other));
            again |= is_known;
            if is_known || tried.iter().any(|other| self.fitter.same(&rival, other)) {
                continue;
            }
            let found = known.iter().copied().chain(&tried).filter(|other| other.found >= least);
            let best = found.filter_map(|other| other.passed.as_ref()).map(|p| p.cost).fold(0.0, f64::min);
            if rival.cost().is_some_and(|cost| cost > FAR_LESS * best) {
                continue;
            }
            tried.push(self.fitter.finish(rival, &self.levels, self.progress)?);
        }
        tried.retain(|t| t.found >= least);
        Ok((tried, again))
    }

    /// A fit, again with the limbs that it has lost where they are found.
    fn with_limbs(&self, tried: Tried) -> Result<Tried> {
        let Some(&resolution) = self.options.outward.first() else { return Ok(tried) };
        if !self.fitter.lost_limb(&tried.fit.bones) {
            return Ok(tried);
        }
        let level = self.levels.at(resolution)?;
        let Some(transforms) = self.fitter.limbs(&tried.fit.bones, &level, self.options.measure)? else {
            return Ok(tried);
        };
        let (common, share) = (tried.fit.common, tried.fit.common_share);
        let guess = if tried.guess == Guess::Searched { Guess::Searched } else { Guess::Each };
        let again = self.fit(Start { common, share, transforms, guess })?;
        Ok(if again.cost < tried.cost { again } else { tried })
    }

    /// The better of a quick fit and the best of those that the search begins, the others that found the bones, and what the search
    /// proposed.
    fn searched(&self, quick: Option<Tried>, known: &[Rigid]) -> Result<(Option<Tried>, Vec<Tried>, Vec<Hypothesis>)> {
        let Some(&resolution) = self.options.outward.first() else { return Ok((quick, Vec::new(), Vec::new())) };
        let level = self.levels.at(resolution)?;
        let (skeleton, anatomy) = (self.fitter.skeleton, &self.samples.anatomy);
        let (tissue, bones) = (&level.fraction, &level.drawn.bones[..]);
        let search = Search {
            skeleton,
            anatomy,
            tissue,
            bones,
            measure: self.options.measure,
            shapes: self.fitter.shapes.as_ref(),
        };
        let hypotheses = search.hypotheses(self.fraction, known)?;
        let start = |h: &Hypothesis| {
            let common = h.transforms[h.root];
            let share = self.level.explained(&common, self.options.measure);
            Start { common, share, transforms: h.transforms.clone(), guess: Guess::Searched }
        };
        // The rivals of the best one; those that are worth less are tried while none has found the bones.
        let best = hypotheses.first().map_or(0.0, |h| h.cost);
        let worth = hypotheses.partition_point(|h| h.cost <= RIVAL * best).max(1).min(hypotheses.len());
        let (first, rest) = hypotheses.split_at(worth);
        let quick_one: Vec<&Tried> = quick.iter().collect();
        let (mut all, mut again) = self.rivals(first.iter().map(start).collect(), &quick_one, SEARCHED_FOUND)?;
        for hypothesis in rest {
            if again || !all.is_empty() {
                break;
            }
            (all, again) = self.rivals(vec![start(hypothesis)], &quick_one, SEARCHED_FOUND)?;
        }
        all.sort_by(|a, b| a.cost.total_cmp(&b.cost));
        if let Some(quick) = quick {
            // The quick one stays where it is as good.
            let first = all.first().is_none_or(|found| found.cost > BETTER * quick.cost);
            all.insert(if first { 0 } else { 1 }, quick);
        }
        let mut all = all.into_iter();
        Ok((all.next(), all.collect(), hypotheses))
    }

    /// A fit that has found the bones, after a look at other levels of the spine, and all places that were weighed, its own first.
    ///
    /// # Errors
    /// [`Error::Registration`] where the fraction is mirrored or stretched.
    fn judged(&self, mut tried: Tried, mut others: Vec<Tried>, placed: bool) -> Result<(FitResult, Vec<Place>)> {
        let measure = self.options.measure;
        let explained = |common: &Rigid| self.level.explained(common, measure);
        if !placed {
            let start = |from: &Tried, shift: &Rigid| {
                let common = shift * self.fitter.best_shown(from);
                let transforms = match from.guess {
                    Guess::Common => vec![common; from.fit.transforms.len()],
                    _ => from.fit.transforms.iter().map(|t| shift * t).collect(),
                };
                Start { common, share: explained(&common), transforms, guess: from.guess }
            };
            let again = |from: &Tried, shifts: &[Rigid], known: &[&Tried]| {
                let starts = shifts.iter().map(|shift| start(from, shift)).collect();
                Ok(self.rivals(starts, known, LEAST_FOUND)?.0)
            };
            (tried, others) = best_level(&self.fitter, tried, others, self.fraction.grid(), again, explained)?;
        }
        let places = Place::all(&tried, &others, |here, there| self.fitter.apart(here, there));
        let Tried { mut fit, scale, guess, .. } = tried;
        let own = posed(&self.level.drawn.bones, &fit.transforms);
        let seen = Seen { samples: &self.level.drawn.all, fraction: &self.level.fraction };
        let resolution = self.options.levels.first().filter(|_| guess == Guess::Searched);
        let fine = resolution.map(|r| self.levels.at(*r)).transpose()?;
        let fine = fine.map(|level| (posed(&level.drawn.bones, &fit.transforms), level.fraction));
        let finer = fine.as_ref().map(|(samples, fraction)| Seen { samples, fraction: fraction.as_ref() });
        accept(&mut fit, &scale, self.fitter.skeleton, seen, &own, measure, finer)?;
        Ok((fit, places))
    }
}
