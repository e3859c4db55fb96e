//! What the fit has weighed: where it has fitted the bones, and what the search proposed. The best is not always far ahead.

use super::probable::probabilities;
use super::search::Hypothesis;
use super::tried::Tried;
use crate::geometry::Rigid;
use crate::skeleton::{Skeleton, anatomy::Kind};

/// Bones that were fitted from one start.
#[derive(Debug, Clone)]
pub struct Place {
    /// Motion of each bone, planning to fraction.
    pub transforms: Vec<Rigid>,
    /// Cost of all bones and joints in the end: the less, the more evidence.
    pub cost: f64,
    /// Share of the bone volume in view that the image determines.
    pub found: f64,
    /// Of each bone the share in view, and the share of its contrast that the image explains.
    pub seen: Vec<[f64; 2]>,
    /// Probability that the bones lie here, 0 to 1; what all places lack of 1 belongs to those that were not fitted.
    pub probability: f64,
    /// How far from the result it takes the bones, on the mean, mm.
    pub apart_mm: f64,
}

impl Place {
    fn of(tried: &Tried, probability: f64, apart_mm: f64) -> Self {
        let seen = tried.fit.bones.iter().map(|b| [b.visible, b.similarity_after.unwrap_or(0.0)]).collect();
        Self {
            transforms: tried.fit.transforms.clone(),
            cost: tried.cost,
            found: tried.found,
            seen,
            probability,
            apart_mm,
        }
    }

    /// A result and the fits that found the bones elsewhere; `apart` tells how far two sets of motions take the bones apart, mm.
    pub(super) fn all(result: &Tried, others: &[Tried], apart: impl Fn(&[Rigid], &[Rigid]) -> f64) -> Vec<Self> {
        let tried = || std::iter::once(result).chain(others);
        let costs: Vec<f64> = tried().map(|t| t.cost).collect();
        let from_result = |t: &Tried| apart(&result.fit.transforms, &t.fit.transforms);
        tried().zip(probabilities(&costs)).map(|(t, p)| Self::of(t, p, from_result(t))).collect()
    }
}

/// All that a fit has weighed.
#[derive(Debug, Clone, Default)]
pub struct Weighed {
    /// The result, then the fits that found the bones elsewhere.
    pub places: Vec<Place>,
    /// What the search proposed, best first; nothing where a quick start was enough.
    pub hypotheses: Vec<Hypothesis>,
}

/// Level of a vertebra.
fn level(skeleton: &Skeleton, bone: usize) -> Option<i32> {
    let name = &skeleton.bones[bone].name;
    match Kind::of(name) {
        Some(Kind::Spine(level)) if name.starts_with("vertebrae_") => Some(i32::from(level)),
        _ => None,
    }
}

/// The vertebra that `there` has nearest to where `here` has bone `bone`, by its place in the skeleton.
pub fn lies_at(skeleton: &Skeleton, here: &[Rigid], there: &[Rigid], bone: usize) -> Option<usize> {
    let at = here[bone] * skeleton.bones[bone].centroid;
    let off = |o: usize| (there[o] * skeleton.bones[o].centroid - at).norm();
    let spine = (0..skeleton.bones.len()).filter(|b| level(skeleton, *b).is_some());
    spine.min_by(|x, y| off(*x).total_cmp(&off(*y)))
}

/// Of each vertebra that counts, with its place in the skeleton: how many levels above its own the vertebra is that `there` has
/// where `here` has it. 0 is the same level.
pub fn levels_apart(
    skeleton: &Skeleton,
    here: &[Rigid],
    there: &[Rigid],
    counts: impl Fn(usize) -> bool,
) -> Vec<(usize, i32)> {
    let by = |bone: usize| {
        let own = level(skeleton, bone)?;
        let other = level(skeleton, lies_at(skeleton, here, there, bone)?)?;
        Some((bone, other - own))
    };
    (0..skeleton.bones.len()).filter(|b| counts(*b)).filter_map(by).collect()
}

/// The middle one of [`levels_apart`]; `None` where no vertebra counts.
pub fn level_apart(
    skeleton: &Skeleton,
    here: &[Rigid],
    there: &[Rigid],
    counts: impl Fn(usize) -> bool,
) -> Option<i32> {
    let mut all: Vec<i32> = levels_apart(skeleton, here, there, counts).into_iter().map(|(_, by)| by).collect();
    all.sort_unstable();
    all.get(all.len() / 2).copied()
}

#[cfg(test)]
mod tests {
    use super::super::hanging::hanging;
    use super::*;

    #[test]
    fn a_spine_moved_up_by_its_vertebrae_is_so_many_levels_apart() {
        let mut skeleton = hanging(&[None, Some(0), Some(1), Some(2), Some(3), Some(4), Some(5)]);
        for (n, bone) in skeleton.bones.iter_mut().enumerate() {
            bone.name = if n < 6 { format!("vertebrae_C{}", 7 - n) } else { "skull".into() };
            bone.centroid.z = 20.0 * n as f64;
        }
        let here = vec![Rigid::identity(); 7];
        let moved = |mm: f64| vec![Rigid::translation(1.0, -2.0, mm); 7];
        let middle = |b: usize| (1..4).contains(&b);
        assert_eq!(level_apart(&skeleton, &here, &moved(8.0), middle), Some(0));
        // What lies one level up is shown where the vertebra below it was.
        assert_eq!(level_apart(&skeleton, &here, &moved(-21.0), middle), Some(1));
        assert_eq!(level_apart(&skeleton, &here, &moved(19.0), middle), Some(-1));
        assert_eq!(level_apart(&skeleton, &here, &moved(0.0), |b| b == 6), None);
        assert_eq!(levels_apart(&skeleton, &here, &moved(-42.0), |b| b == 2), [(2, 2)]);
    }
}
