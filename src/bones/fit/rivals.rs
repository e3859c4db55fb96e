//! Whether a short scan shows the levels of the spine that the fit took it for: vertebrae look alike, and a fit that is one
//! level off explains much of them.

use super::DeterminedBy;
use super::probable::{SURE, probabilities};
use super::schedule::Fitter;
use super::tried::{Guess, Tried, weak_start};
use crate::error::Result;
use crate::findings;
use crate::geometry::{Grid, Rigid};
use crate::warning::Warning;
use nalgebra::{UnitQuaternion, Vector3};

/// A scan that shows the bones over more than this tells their levels by itself, mm.
pub(super) const SHORT_MM: f64 = 130.0;
/// Levels up and down that are tried.
const LEVELS: [f64; 4] = [1.0, -1.0, 2.0, -2.0];
/// Times that the search goes on from a better level.
const ROUNDS: usize = 3;
/// A fit at another level is better by more than this share of the evidence: less is how it ended.
const BETTER: f64 = 1.02;
/// Fits this near to each other are one, as a share of a level.
const SAME: f64 = 0.5;

/// The best of a fit and of those that begin some levels of the spine away, with a word where another may be right; then the
/// others.
///
/// `others` are fits from other starts; `again` fits from other places, as far from a fit as the motions say, and gives those that
/// found the bones elsewhere than fits that are known; `explained` tells the share of the bones' contrast that one explains.
///
/// # Errors
/// As a fit.
pub(super) fn best_level(
    fitter: &Fitter<'_>,
    first: Tried,
    mut others: Vec<Tried>,
    fraction: &Grid,
    again: impl Fn(&Tried, &[Rigid], &[&Tried]) -> Result<Vec<Tried>>,
    explained: impl Fn(&Rigid) -> f64,
) -> Result<(Tried, Vec<Tried>)> {
    let mut best = first;
    let mut height = fitter.height_shown(&best.fit.transforms, fraction);
    for _ in 0..ROUNDS {
        let Some(step) = fitter.level_step(&best).filter(|_| height < SHORT_MM) else { break };
        let common = fitter.best_shown(&best);
        let shifts =
            LEVELS.map(|by| Rigid::from_parts((common.rotation * step * by).into(), UnitQuaternion::identity()));
        let known: Vec<&Tried> = std::iter::once(&best).chain(&others).collect();
        let found = again(&best, &shifts, &known)?;
        others.extend(found);
        others.sort_by(|a, b| a.cost.total_cmp(&b.cost));
        if others.first().is_none_or(|other| other.cost > BETTER * best.cost) {
            break;
        }
        let mut better = others.remove(0);
        // Where the bones are, not where the fit began.
        better.fit.common = fitter.best_shown(&better);
        better.fit.common_share = explained(&better.fit.common);
        better.fit.warnings.retain(|w| !w.is(findings::WEAK_START));
        better.fit.warnings.extend(weak_start(better.fit.common_share).filter(|_| better.guess != Guess::Searched));
        others.push(std::mem::replace(&mut best, better));
        height = fitter.height_shown(&best.fit.transforms, fraction);
    }
    if let Some(step) = fitter.level_step(&best).map(|step| step.norm()) {
        let mut apart: Vec<Tried> = Vec::new();
        for tried in others {
            // What ended where another fit did is no other place.
            let mut known = std::iter::once(&best).chain(&apart);
            if known.all(|t| fitter.apart(&t.fit.transforms, &tried.fit.transforms) > SAME * step) {
                apart.push(tried);
            }
        }
        others = apart;
        best.fit.warnings.extend(fitter.doubt(&best, &others, height));
    }
    Ok((best, others))
}

impl Fitter<'_> {
    /// A word about a fit at another level that may be the right one.
    fn doubt(&self, best: &Tried, others: &[Tried], height: f64) -> Option<Warning> {
        let costs: Vec<f64> = std::iter::once(best).chain(others).map(|t| t.cost).collect();
        let probable = probabilities(&costs);
        let here = probable.first().copied().filter(|p| *p < SURE)?;
        let (rival, there) = others.iter().zip(&probable[1..]).min_by(|a, b| a.0.cost.total_cmp(&b.0.cost))?;
        let message = format!(
            "the fraction shows {height:.0} mm of the bones; {:.0} mm away, at another level of the spine, they fit with {:.0} % \
             of the evidence: the result is right with a probability of {:.0} %, that place with {:.0} %; check the levels in the \
             fusion images, or place a vertebra with --bone-landmarks",
            self.apart(&best.fit.transforms, &rival.fit.transforms),
            100.0 * rival.cost / best.cost,
            100.0 * here,
            100.0 * there,
        );
        Some(Warning::new(findings::LEVEL_UNSURE, message))
    }

    /// Motion of the bone that the fraction shows most of.
    pub(super) fn best_shown(&self, tried: &Tried) -> Rigid {
        let bones =
            self.skeleton.bones.iter().zip(&tried.fit.bones).filter(|(_, f)| f.determined_by == DeterminedBy::Image);
        let most = bones.max_by(|a, b| (a.0.volume_mm3 * a.1.visible).total_cmp(&(b.0.volume_mm3 * b.1.visible)));
        most.map_or(tried.fit.common, |(_, fit)| fit.transform)
    }

    /// Height, along the planning's third axis, of what the fraction shows of the bones, mm.
    pub(super) fn height_shown(&self, transforms: &[Rigid], fraction: &Grid) -> f64 {
        let mut range = [f64::MAX, f64::MIN];
        for (points, t) in self.points.iter().zip(transforms) {
            for p in points.iter().filter(|p| fraction.contains(&fraction.index(&(t * **p)))) {
                range = [range[0].min(p.z), range[1].max(p.z)];
            }
        }
        (range[1] - range[0]).max(0.0)
    }

    /// From a vertebra in view to the one above it, on the mean, mm; `None` where no two are joined.
    fn level_step(&self, tried: &Tried) -> Option<Vector3<f64>> {
        let bones = &self.skeleton.bones;
        let spine = |b: usize| bones[b].name.starts_with("vertebrae_");
        let steps: Vec<Vector3<f64>> = (0..bones.len())
            .filter_map(|b| Some((b, bones[b].parent?)))
            .filter(|&(b, p)| spine(b) && spine(p) && tried.fit.bones[b].visible.max(tried.fit.bones[p].visible) > 0.1)
            .map(|(b, p)| self.centres[b] - self.centres[p])
            .map(|d| if d.z < 0.0 { -d } else { d })
            .collect();
        (!steps.is_empty()).then(|| steps.iter().sum::<Vector3<f64>>() / steps.len() as f64)
    }
}
