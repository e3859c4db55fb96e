//! The way to the fraction and back: where it ends beside its start.

use crate::field::{PullField, PushField};
use crate::geometry::wide_vector::{dot, plus};
use crate::geometry::{LANES, Wide, vectorised};
use crate::volume::interpolation::lanes::{NOWHERE, Sampler};
use crate::volume::{Mask, trilinear_vector};
use nalgebra::Vector3;
use rayon::prelude::*;
use std::ops::Range;

/// A planning voxel whose way there and back does not end where it began.
#[derive(Debug, Clone, Copy)]
pub(super) struct InverseError {
    /// Its position in storage.
    pub(super) voxel: usize,
    /// `u(x) + v(x + u(x))`, mm.
    pub(super) by: Vector3<f64>,
}

impl InverseError {
    /// mm.
    pub(super) fn length(&self) -> f64 {
        self.by.norm()
    }
}

/// Where the way of a planning voxel ends; `None` when it leaves the fraction's grid.
fn inverse_error(push: &PushField, pull: &PullField, voxel: usize) -> Option<InverseError> {
    let grid = push.displacement.grid();
    let u = Vector3::from(push.displacement.data()[voxel].map(f64::from));
    let index = pull.displacement.grid().index(&(grid.centre(grid.voxel(voxel)) + u));
    Some(InverseError { voxel, by: u + trilinear_vector(&pull.displacement, &index)? })
}

/// The ways of a plane's computed voxels that are not spared.
#[derive(Debug, Clone, Default)]
pub(super) struct Ways {
    /// Distances between start and end, mm.
    pub(super) lengths: Vec<f32>,
    /// The voxels that miss by more than asked for.
    pub(super) far: Vec<usize>,
}

/// The ways of some planes of the planning grid, with those that miss by more than `least` mm.
pub(super) fn ways(push: &PushField, pull: &PullField, spared: &Mask, least: f64, planes: &[usize]) -> Vec<Ways> {
    let (planning, fraction) = (push.displacement.grid(), pull.displacement.grid());
    let [nx, ny, _] = planning.size();
    let sampler = Sampler::new(&pull.displacement);
    let along: Vector3<f64> = fraction.inverse_step() * planning.step().column(0);
    let (u, computed, spared) = (push.displacement.data(), push.computed.data(), spared.data());
    let of_plane = |&k: &usize| {
        let counted = computed[nx * ny * k..][..nx * ny].iter().filter(|c| **c).count();
        let mut ways = Ways { lengths: Vec::with_capacity(counted), far: Vec::new() };
        for j in 0..ny {
            let row = planning.linear([0, j, k]);
            let start = fraction.index(&planning.centre([0, j, k]));
            vectorised(
                #[inline(always)]
                || {
                    for first in (0..nx).step_by(LANES) {
                        let run = row + first..row + (first + LANES).min(nx);
                        if !computed[run.clone()].iter().any(|c| *c) {
                            continue;
                        }
                        let mut moved = [Wide::default(); 3];
                        for (l, u) in u[run.clone()].iter().enumerate() {
                            for a in 0..3 {
                                moved[a].0[l] = u[a];
                            }
                        }
                        let block = Sampler::block(&(start + along * first as f64), &along);
                        let by = plus(&moved, &sampler.value(&block, &moved));
                        let length = dot(&by, &by).sqrt();
                        let place = sampler.land(&block, &moved);
                        for (l, voxel) in run.enumerate() {
                            if computed[voxel] && place[l] != NOWHERE && !spared[voxel] {
                                ways.lengths.push(length.0[l]);
                                if f64::from(length.0[l]) > least {
                                    ways.far.push(voxel);
                                }
                            }
                        }
                    }
                },
            );
        }
        ways
    };
    planes.par_iter().map(of_plane).collect()
}

/// The ways among those of `voxels` that miss by a length in a range, mm.
pub(super) fn inverse_errors(
    push: &PushField,
    pull: &PullField,
    voxels: &[usize],
    range: Range<f64>,
) -> Vec<InverseError> {
    voxels.par_iter().filter_map(|&v| inverse_error(push, pull, v)).filter(|m| range.contains(&m.length())).collect()
}
