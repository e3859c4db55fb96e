//! Inverse consistency of the stored fields: planning to fraction and back should end where it began.
//!
//! The pull field inverts the push field at the fraction's voxels, but between them it is interpolated. Where the push field
//! bends within a voxel, as tissue does that is squeezed beside a rigid bone, interpolation misses by up to a millimetre or
//! two. Soft tissue around such places is moved a little, bones held, until the way there and back agrees: Gauss-Newton
//! steps on these inverse-consistency errors, as smooth as can be. The pull field stays the exact inverse.

mod ball;
mod inverse_error;
mod patch;
mod system;
#[cfg(test)]
mod tests;

use super::inverse::InvertOptions;
use super::{PullField, PushField};
use crate::error::Result;
use crate::geometry::Grid;
use crate::stats::Summary;
use crate::volume::Mask;
use ball::{Balls, touching};
use inverse_error::{InverseError, Ways, inverse_errors, ways};
use patch::Patch;
use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;
use system::System;

/// Gives the rigid bone that a planning voxel belongs to, by its position in storage.
pub trait BoneOf: Fn(usize) -> Option<u16> + Sync {}

impl<F: Fn(usize) -> Option<u16> + Sync> BoneOf for F {}

/// How well push and pull field have to agree.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ConsistencyOptions {
    /// Distance between start and end of the way there and back that soft tissue is moved for, mm.
    pub limit_mm: f64,
    /// Steps at most; 0 leaves the fields as they are.
    pub rounds: usize,
}

impl Default for ConsistencyOptions {
    fn default() -> Self {
        Self { limit_mm: 0.5, rounds: 40 }
    }
}

/// How well the stored fields agree, planning to fraction and back.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct ConsistencyReport {
    /// |u(x) + v(x + u(x))| over the computed planning voxels x that are not near bone contact and come to lie in the
    /// fraction, v interpolated, mm.
    pub there_and_back_mm: Summary,
    /// Of those, voxels beyond the limit.
    pub beyond: usize,
    /// Voxels that were beyond it before soft tissue was moved.
    pub beyond_before: usize,
    /// Greatest distance by which soft tissue was moved, mm.
    pub moved_mm: f64,
}

/// Bone contact closer than this makes a voxel's way there and back not count, mm: bones that slide on each other fold what lies
/// between them.
const CONTACT_MM: f64 = 10.0;
/// Share of the limit beyond which a miss makes its surroundings movable, and below which a voxel counts as mended.
/// From 0.6 on the same points were left, and moderate took 0.76 s for 0.48.
const SEED: f64 = 0.8;
const MENDED: f64 = 0.99;
/// Distance from such a miss up to which soft tissue may move, mm.
const REACH_MM: f64 = 8.0;
/// Misses below this share of the limit have no part in the steps.
const SMALL: f64 = 0.2;
/// A step that would move a voxel farther is none: what is laid over something else has no way back, mm.
const WILD_MM: f64 = 4.0;
/// Times that a step is tried, each half as long as the one before.
const HALVINGS: usize = 3;
/// The power of a miss that steps make smaller: high, so that the longest counts, and not so high that nothing else does.
/// At 6 a phantom keeps one point beyond the limit, at 10 the case change 11; at 8 neither keeps any.
const POWER: i32 = 8;
/// Weight of the moves' roughness (differences between neighbours per mm) against the errors: where it starts, by how much it grows after
/// a step that brought nothing and shrinks after one that did, and where that ends.
/// Fixed at 0.05 a phantom keeps 16 points beyond the limit, at 0.1 none.
const ROUGHNESS: f64 = 0.3;
const STIFFER: f64 = 4.0;
const SOFTER: f64 = 0.5;
const ROUGHNESS_RANGE: std::ops::Range<f64> = 0.1..5.0;
/// Misses beyond which nothing is moved: then the motion itself is at fault.
const MOST: usize = 5000;
/// Voxels moved in all steps of a cluster beyond which it is left as it has become: bounds the time, about 6 us each.
const MOST_MOVES: usize = 200_000;

/// The planning voxels near bones that touch, whose ways there and back do not count. They are the patient's, whatever moves.
///
/// # Errors
/// Only for internal inconsistency of grids.
pub fn beside_contact(planning: &Grid, bone: &impl BoneOf) -> Result<Mask> {
    let mut near = Balls::new(planning, [CONTACT_MM; 3]);
    near.add(&touching(planning, bone));
    near.into_mask()
}

/// What soft tissue is moved beside.
#[derive(Debug)]
pub struct Beside<'a, B> {
    /// Which rigid bone a planning voxel belongs to; such voxels do not move.
    pub bone: &'a B,
    /// Voxels of the planning grid whose ways do not count ([`beside_contact`]).
    pub spared: &'a Mask,
}

/// Moves soft tissue of `push` until the way to the fraction and back through the stored fields misses by no more than the limit, and `pull`
/// with it; what does not come out better stays as it was.
///
/// No cell is folded that was not.
pub fn agree(
    push: &mut PushField,
    pull: &mut PullField,
    beside: &Beside<'_, impl BoneOf>,
    invert: &InvertOptions,
    options: &ConsistencyOptions,
) -> ConsistencyReport {
    // The lengths of all ways, how many of them are beyond the limit, and the ways that miss by nearly as much.
    let summary = |push: &PushField, pull: &PullField, ways: &[Ways]| {
        let far: Vec<usize> = ways.iter().flat_map(|plane| plane.far.iter().copied()).collect();
        let found = inverse_errors(push, pull, &far, 0.0..f64::INFINITY);
        let beyond = found.iter().filter(|m| m.length() > options.limit_mm).count();
        (Summary::of_singles(&ways.iter().map(|plane| plane.lengths.as_slice()).collect::<Vec<_>>()), beyond, found)
    };
    let least = options.limit_mm * SEED;
    let planes: Vec<usize> = (0..push.displacement.grid().size()[2]).collect();
    let mut all = ways(push, pull, beside.spared, least, &planes);
    let (there_and_back_mm, beyond_before, found) = summary(push, pull, &all);
    let report = ConsistencyReport { there_and_back_mm, beyond: beyond_before, beyond_before, moved_mm: 0.0 };
    if beyond_before == 0 || found.len() > MOST || options.rounds == 0 {
        return report;
    }
    let (moved_mm, changed) = mend(push, pull, &found, beside, invert, options);
    let changed: Vec<usize> = changed.into_iter().collect();
    let again = ways(push, pull, beside.spared, least, &changed);
    changed.iter().zip(again).for_each(|(&k, again)| all[k] = again);
    let (there_and_back_mm, beyond, _) = summary(push, pull, &all);
    ConsistencyReport { there_and_back_mm, beyond, beyond_before, moved_mm }
}

/// Takes the steps, cluster by cluster; returns how far soft tissue was moved at most, mm, and the planes of the planning grid
/// in which ways may have changed.
fn mend(
    push: &mut PushField,
    pull: &mut PullField,
    found: &[InverseError],
    beside: &Beside<'_, impl BoneOf>,
    invert: &InvertOptions,
    options: &ConsistencyOptions,
) -> (f64, BTreeSet<usize>) {
    let limit = options.limit_mm;
    // Interpolation misses by less than a voxel; what misses by more has been laid on by something else.
    let grids = [push.displacement.grid(), pull.displacement.grid()];
    let most = grids.iter().flat_map(|g| g.spacing()).fold(limit, f64::max);
    let found: Vec<InverseError> = found.iter().filter(|m| m.length() < most).copied().collect();
    // What steps are to make smaller, as the system's weights do.
    let merit =
        |errors: &[InverseError]| errors.iter().map(|m| (m.length().min(most) / limit).powi(POWER)).sum::<f64>();
    let mut patch = Patch::new(push.displacement.grid(), pull.displacement.grid());
    let (mut moved, mut changed) = (0.0f64, BTreeSet::new());
    for cluster in patch.clusters(&found) {
        if longest(&cluster) <= limit {
            continue;
        }
        let (mut roughness, mut moves) = (ROUGHNESS, 0);
        let mut seeds: Vec<usize> = cluster.iter().map(|m| m.voxel).collect();
        for _ in 0..options.rounds {
            patch.extend(&seeds, beside, push, pull, invert);
            moves += patch.movable.len();
            if moves > MOST_MOVES {
                break;
            }
            let mut rows = inverse_errors(push, pull, &patch.watched, limit * SMALL..f64::INFINITY);
            let best = merit(&rows);
            rows.retain(|m| m.length() < most);
            let mut steps = System::new(push, pull, &rows, &patch, limit, roughness).solve();
            let wild = patch.beyond(&steps, WILD_MM);
            if !wild.is_empty() {
                patch.bar(&wild);
                continue;
            }
            let mut astray = Vec::new();
            let taken = (0..HALVINGS).find_map(|_| {
                astray = patch.advance(&steps, push, pull, invert);
                let left = inverse_errors(push, pull, &patch.watched, limit * SMALL..f64::INFINITY);
                if astray.is_empty() && merit(&left) < best {
                    return Some(left);
                }
                patch.restore(push, pull);
                steps.iter_mut().for_each(|step| *step *= 0.5);
                None
            });
            let Some(mut left) = taken else {
                if !astray.is_empty() {
                    patch.bar(&astray);
                    continue;
                }
                roughness *= STIFFER;
                if roughness > ROUGHNESS_RANGE.end {
                    break;
                }
                continue;
            };
            left.retain(|m| (limit * SEED..most).contains(&m.length()));
            patch.keep(push, pull);
            roughness = (roughness * SOFTER).max(ROUGHNESS_RANGE.start);
            if longest(&left) < limit * MENDED {
                break;
            }
            seeds = left.iter().map(|m| m.voxel).collect();
        }
        moved = moved.max(patch.restore(push, pull));
        changed.extend(patch.watched.iter().map(|&v| push.displacement.grid().voxel(v)[2]));
        patch.clear();
    }
    (moved, changed)
}

/// The longest miss, mm.
fn longest(errors: &[InverseError]) -> f64 {
    errors.iter().map(InverseError::length).fold(0.0, f64::max)
}
