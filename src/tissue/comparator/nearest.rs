//! Each voxel moves rigidly with its nearest bone: the simplest model that keeps bones rigid.

use super::push_field;
use crate::chainmail::{Initiators, Tissue};
use crate::error::Result;
use crate::field::PushField;
use crate::volume::{Volume, distance};
use rayon::prelude::*;

/// The push field on the planning grid. It jumps where two bones are equally near, and so folds or tears there.
///
/// # Errors
/// Only for internal inconsistency of grids.
pub fn nearest_bone(tissue: &Tissue<'_>, bones: &Initiators<'_>) -> Result<PushField> {
    let grid = tissue.ct.grid();
    // Bones from 1: 0 is no bone.
    let labels = Volume::from_fn(grid.clone(), |v| tissue.bone(v).map_or(0, |b| b + 1));
    let nearest = distance::nearest_label(&labels);
    let mut out = vec![[0f32; 3]; grid.len()];
    let plane = grid.size()[0] * grid.size()[1];
    out.par_chunks_mut(plane).enumerate().for_each(|(k, out)| {
        for (at, o) in out.iter_mut().enumerate() {
            let v = k * plane + at;
            if let Some(b) = nearest.data()[v].checked_sub(1) {
                let x = grid.centre(grid.voxel(v));
                let u = bones.transforms[usize::from(b)] * x - x;
                *o = [u.x as f32, u.y as f32, u.z as f32];
            }
        }
    });
    push_field(tissue, out)
}
