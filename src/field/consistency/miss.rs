//! The way to the fraction and back: where it ends beside its start.

use crate::field::{PullField, PushField};
use crate::volume::{Mask, trilinear_vector};
use nalgebra::Vector3;
use rayon::prelude::*;

/// A planning voxel whose way there and back does not end where it began.
#[derive(Debug, Clone, Copy)]
pub(super) struct Miss {
    /// Its position in storage.
    pub(super) voxel: usize,
    /// `u(x) + v(x + u(x))`, mm.
    pub(super) by: Vector3<f64>,
}

impl Miss {
    /// mm.
    pub(super) fn length(&self) -> f64 {
        self.by.norm()
    }
}

/// Where the way of a planning voxel ends; `None` when it leaves the fraction's grid.
fn miss(push: &PushField, pull: &PullField, voxel: usize) -> Option<Miss> {
    let grid = push.displacement.grid();
    let u = Vector3::from(push.displacement.data()[voxel].map(f64::from));
    let index = pull.displacement.grid().index(&(grid.centre(grid.voxel(voxel)) + u));
    Some(Miss { voxel, by: u + trilinear_vector(&pull.displacement, &index)? })
}

/// Distances between start and end of the way of all computed voxels that are not spared, mm, in parts; and those ways that
/// miss by more than `least` mm.
pub(super) fn everywhere(push: &PushField, pull: &PullField, spared: &Mask, least: f64) -> (Vec<Vec<f32>>, Vec<Miss>) {
    let [nx, ny, nz] = push.displacement.grid().size();
    let of_plane = |k: usize| {
        let voxels = k * nx * ny..(k + 1) * nx * ny;
        let counts = |v: &usize| push.computed.data()[*v] && !spared.data()[*v];
        let all: Vec<Miss> = voxels.filter(counts).filter_map(|v| miss(push, pull, v)).collect();
        let lengths: Vec<f32> = all.iter().map(|m| m.length() as f32).collect();
        (lengths, all.into_iter().filter(|m| m.length() > least).collect::<Vec<_>>())
    };
    let (lengths, found): (Vec<_>, Vec<_>) = (0..nz).into_par_iter().map(of_plane).unzip();
    (lengths, found.concat())
}

/// The ways among those of `voxels` that miss by more than `least` mm.
pub(super) fn misses(push: &PushField, pull: &PullField, voxels: &[usize], least: f64) -> Vec<Miss> {
    voxels.par_iter().filter_map(|&v| miss(push, pull, v)).filter(|m| m.length() > least).collect()
}
