//! Places of the bones that a search has proposed and a fit has weighed, as `report.json` and the page hold them.

use crate::fit::{Place, lies_at};
use crate::pipeline::Outcome;
use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

/// A place of all bones that the search of an unclear start has proposed.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SearchedPlace {
    /// Bones that proposed it.
    pub proposed_by: Vec<String>,
    /// Its evidence, percent of that of the best place.
    pub evidence_percent: f64,
    /// How far from there it takes the bones, on the mean, mm.
    pub apart_mm: f64,
    /// Motion of the bones' middles, mean by their evidence, planning to fraction, LPS mm.
    pub shift_mm: Vector3<f64>,
}

/// Evidence at a cost, percent of that at the best cost.
fn evidence_percent(cost: f64, best: f64) -> f64 {
    (100.0 * cost / best.min(-f64::MIN_POSITIVE)).clamp(0.0, 100.0)
}

/// What the search of a run has proposed, best first; nothing where a quick start was enough.
pub(super) fn searched(outcome: &Outcome) -> Vec<SearchedPlace> {
    let places = &outcome.weighed.hypotheses;
    let best = places.first().map_or(-1.0, |first| first.cost);
    let bones = &outcome.skeleton.bones;
    let of = |place: &crate::fit::Hypothesis| {
        let moved = bones.iter().zip(&place.transforms).zip(&place.evidence);
        let moved = moved.map(|((bone, t), evidence)| (*evidence, t * bone.centroid - bone.centroid));
        let (all, sum) = moved.fold((0.0, Vector3::zeros()), |(all, sum), (w, shift)| (all + w, sum + shift * w));
        SearchedPlace {
            proposed_by: place.proposed_by.iter().filter_map(|&b| Some(bones.get(b)?.name.clone())).collect(),
            evidence_percent: evidence_percent(place.cost, best),
            apart_mm: place.apart_mm,
            shift_mm: if all > 0.0 { sum / all } else { sum },
        }
    };
    places.iter().map(of).collect()
}

/// A place where all bones were fitted; the first is the result.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct FittedPlace {
    /// The vertebra of planning that is shown best in the result, and the one that lies there by this place; nothing without
    /// vertebrae.
    pub level: Option<[String; 2]>,
    /// How far from the result it takes the bones, on the mean, mm.
    pub apart_mm: f64,
    /// Its evidence, percent of the result's.
    pub evidence_percent: f64,
    /// Probability that the bones lie there, percent. What is left of 100 belongs to places that were not fitted.
    pub probability_percent: f64,
}

/// Where a run has fitted the bones, the result first; nothing where that is the only place.
pub(super) fn fitted(outcome: &Outcome) -> Vec<FittedPlace> {
    let places = &outcome.weighed.places;
    let Some(result) = places.first().filter(|_| places.len() > 1) else { return Vec::new() };
    let bones = &outcome.skeleton.bones;
    let shown = |b: usize| result.seen[b][0] * bones[b].volume_mm3;
    let spine = (0..bones.len()).filter(|b| bones[*b].name.starts_with("vertebrae_") && shown(*b) > 0.0);
    let best = spine.max_by(|a, b| shown(*a).total_cmp(&shown(*b)));
    let of = |place: &Place| FittedPlace {
        level: best.and_then(|b| {
            let there = lies_at(&outcome.skeleton, &result.transforms, &place.transforms, b)?;
            Some([b, there].map(|b| bones[b].name.clone()))
        }),
        apart_mm: place.apart_mm,
        evidence_percent: evidence_percent(place.cost, result.cost),
        probability_percent: 100.0 * place.probability,
    };
    places.iter().map(of).collect()
}
