//! Places of the bones that a search has weighed, as `report.json` and the page hold them.

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

/// What the search of a run has proposed, best first; nothing where a quick start was enough.
pub(super) fn searched(outcome: &Outcome) -> Vec<SearchedPlace> {
    let places = &outcome.weighed.hypotheses;
    let best = places.first().map_or(-1.0, |first| first.cost.min(-f64::MIN_POSITIVE));
    let bones = &outcome.skeleton.bones;
    let of = |place: &crate::fit::Hypothesis| {
        let moved = bones.iter().zip(&place.transforms).zip(&place.evidence);
        let moved = moved.map(|((bone, t), evidence)| (*evidence, t * bone.centroid - bone.centroid));
        let (all, sum) = moved.fold((0.0, Vector3::zeros()), |(all, sum), (w, shift)| (all + w, sum + shift * w));
        SearchedPlace {
            proposed_by: place.proposed_by.iter().filter_map(|&b| Some(bones.get(b)?.name.clone())).collect(),
            evidence_percent: (100.0 * place.cost / best).clamp(0.0, 100.0),
            apart_mm: place.apart_mm,
            shift_mm: if all > 0.0 { sum / all } else { sum },
        }
    };
    places.iter().map(of).collect()
}
