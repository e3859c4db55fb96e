//! What the default propagation's shortcuts cost in accuracy: coarse elements for waves, and waves that are pruned.

use super::Scene;
use crate::chainmail::{ChainmailOptions, Pruning, Variant, propagate};
use crate::error::Result;
use crate::field::PushField;
use crate::progress::Silent;
use crate::stats::Summary;
use serde::{Deserialize, Serialize};

/// Distances between fields at the voxels of soft tissue, mm.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct AgainstExact {
    /// The default field without images, and the one whose waves run through every voxel, none pruned, all else the same.
    pub field: Distances,
    /// The same before relaxation, where the latter's elements are the voxels: thesis eq. 5.7 as it stands.
    pub superposition: Distances,
    /// The most that pruned waves can change before relaxation, as the run prints it.
    pub pruning: Option<Pruning>,
}

/// A sample of distances, mm.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Distances {
    /// Mean.
    pub mean: f64,
    /// 95th percentile.
    pub p95: f64,
    /// Largest.
    pub max: f64,
}

/// Measures them on the scene.
///
/// # Errors
/// Only for internal inconsistency of grids.
pub(super) fn against_exact(scene: &Scene) -> Result<AgainstExact> {
    let options = ChainmailOptions::default();
    let variant = Variant { waves_mm: 0.0, prune_ratio: 0.0, ..Variant::default() };
    let waves = ChainmailOptions { variant, ..options.clone() };
    let plain = |options| ChainmailOptions { relaxation: Vec::new(), mend: 0, ..options };
    let (tissue, bones) = scene.chainmail(&options);
    let of = |options: &ChainmailOptions| propagate(&tissue, &bones, options, None, &Silent);
    let default = of(&options)?;
    let field = distances(scene, &default.push, &of(&waves)?.push);
    let exact = ChainmailOptions { spacing_mm: 0.0, ..plain(waves) };
    let superposition = distances(scene, &of(&plain(options))?.push, &of(&exact)?.push);
    Ok(AgainstExact { field, superposition, pruning: default.pruning })
}

fn distances(scene: &Scene, a: &PushField, b: &PushField) -> Distances {
    let soft = |v: &usize| a.computed.data()[*v] && scene.phantom.bones.volume.data()[*v] == 0;
    let apart = |v: usize| {
        let (a, b) = (a.displacement.data()[v], b.displacement.data()[v]);
        (0..3).map(|c| f64::from(a[c] - b[c]).powi(2)).sum::<f64>().sqrt()
    };
    let found = Summary::of(&(0..a.computed.data().len()).filter(soft).map(apart).collect::<Vec<_>>());
    Distances { mean: found.mean, p95: found.p95, max: found.max }
}
