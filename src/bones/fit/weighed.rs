//! What the fit has weighed: where it has fitted the bones, and what the search proposed. The best is not always far ahead.

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
}

impl Place {
    pub(super) fn of(tried: &Tried) -> Self {
        let seen = tried.fit.bones.iter().map(|b| [b.visible, b.similarity_after.unwrap_or(0.0)]).collect();
        Self { transforms: tried.fit.transforms.clone(), cost: tried.cost, found: tried.found, seen }
    }
}

/// All that a fit has weighed.
#[derive(Debug, Clone, Default)]
pub struct Weighed {
    /// The result, then the others that found the bones.
    pub places: Vec<Place>,
    /// What the search proposed, best first; nothing where a quick start was enough.
    pub hypotheses: Vec<Hypothesis>,
}

/// Of each vertebra that counts, with its place in the skeleton: how many levels above its own the vertebra is that `there` has
/// where `here` has it. 0 is the same level.
pub fn levels_apart(
    skeleton: &Skeleton,
    here: &[Rigid],
    there: &[Rigid],
    counts: impl Fn(usize) -> bool,
) -> Vec<(usize, i32)> {
    let level = |b: usize| match Kind::of(&skeleton.bones[b].name) {
        Some(Kind::Spine(level)) if skeleton.bones[b].name.starts_with("vertebrae_") => Some(i32::from(level)),
        _ => None,
    };
    let spine: Vec<(usize, i32)> = (0..skeleton.bones.len()).filter_map(|b| Some((b, level(b)?))).collect();
    let nearest = |&(b, own): &(usize, i32)| {
        let at = here[b] * skeleton.bones[b].centroid;
        let off = |o: usize| (there[o] * skeleton.bones[o].centroid - at).norm();
        let (_, other) = spine.iter().copied().min_by(|x, y| off(x.0).total_cmp(&off(y.0)))?;
        Some((b, other - own))
    };
    spine.iter().filter(|(b, _)| counts(*b)).filter_map(nearest).collect()
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
