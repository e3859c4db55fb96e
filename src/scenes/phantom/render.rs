//! Images of the phantom: planning CT with labels, fraction CT through the inverse of the true motion.

use super::anatomy::{Anatomy, Seen};
use super::motion::{INVERSE_TOLERANCE, PreImage, TrueMotion};
use super::options::PhantomOptions;
use super::shape::V3;
use super::texture::{stored, voxel_noise};
use super::voxel::Voxel;
use crate::error::Result;
use crate::field::PushField;
use crate::geometry::Grid;
use crate::volume::{Mask, Volume};
use nalgebra::Point3;
use rayon::prelude::*;

/// PlanningRender CT, bone labels and patient mask.
pub(super) struct PlanningRender {
    pub(super) ct: Volume<f32>,
    pub(super) labels: Volume<u16>,
    pub(super) body: Mask,
}

/// Draws the anatomy on the planning grid.
pub(super) fn planning(anatomy: &Anatomy, grid: &Grid, options: &PhantomOptions) -> Result<PlanningRender> {
    let slice = grid.strides()[2];
    let whole = Voxel::new(grid.spacing(), options.edge_mm);
    let mut ct = vec![0.0f32; grid.len()];
    let mut labels = vec![0u16; grid.len()];
    let mut body = vec![false; grid.len()];
    let slices = ct.par_chunks_mut(slice).zip(labels.par_chunks_mut(slice)).zip(body.par_chunks_mut(slice));
    slices.enumerate().for_each(|(k, ((ct, labels), body))| {
        for n in 0..slice {
            let voxel = k * slice + n;
            let p = grid.centre(grid.voxel(voxel)).coords;
            let Seen { cover, hu, label, .. } = anatomy.over(&whole, &p, |offset| p + offset);
            let outer = if cover < 1.0 { anatomy.couch_hu(&p) } else { 0.0 };
            let noise = options.planning_noise_hu * voxel_noise(options.seed, voxel);
            ct[n] = stored(outer + (hu - outer) * cover + noise);
            labels[n] = label;
            body[n] = cover >= 0.5;
        }
    });
    Ok(PlanningRender {
        ct: Volume::new(grid.clone(), ct)?,
        labels: Volume::new(grid.clone(), labels)?,
        body: Volume::new(grid.clone(), body)?,
    })
}

/// Draws the posed phantom on the fraction grid. Also the number of voxels whose pre-image was not found to
/// [`INVERSE_TOLERANCE`].
pub(super) fn fraction(motion: &TrueMotion, grid: &Grid, options: &PhantomOptions) -> Result<(Volume<f32>, usize)> {
    let [ni, nj, _] = grid.size();
    let whole = Voxel::new(grid.spacing(), options.edge_mm);
    let couch_shift = V3::from(options.couch_shift_mm) + V3::from(options.scanner_shift_mm);
    let mut ct = vec![0.0f32; grid.len()];
    let unfound = ct.par_chunks_mut(ni * nj).enumerate().map(|(k, slice)| {
        let mut unfound = 0;
        for (j, row) in slice.chunks_mut(ni).enumerate() {
            let mut walk = Walk::default();
            for (i, out) in row.iter_mut().enumerate() {
                let y = grid.centre([i, j, k]);
                let before = walk.planning_point(motion, &y, grid.spacing()[0]);
                let (cover, inner) = match before {
                    Some(x) => {
                        unfound += usize::from(x.residual > INVERSE_TOLERANCE);
                        let back = std::cell::OnceCell::new();
                        let turned = |o: &V3| back.get_or_init(|| motion.turn(&x.point.coords).inverse()) * o;
                        let seen = motion.anatomy().over(&whole, &x.point.coords, |o| x.point.coords + turned(o));
                        (seen.cover, seen.hu)
                    }
                    None => (0.0, 0.0),
                };
                let outer = if cover < 1.0 { motion.anatomy().couch_hu(&(y.coords - couch_shift)) } else { 0.0 };
                let hu = outer + (inner - outer) * cover;
                let scaled = (hu + 1000.0) * options.fraction_gain - 1000.0 + options.fraction_offset_hu;
                let noise = voxel_noise(options.seed.wrapping_add(1), grid.linear([i, j, k]));
                *out = stored(scaled + options.fraction_noise_hu * noise);
            }
        }
        unfound
    });
    let unfound = unfound.sum();
    Ok((Volume::new(grid.clone(), ct)?, unfound))
}

/// Pre-images along a row: each search starts from the one before, and air far from skin is passed over.
#[derive(Default)]
struct Walk {
    last: Option<PreImage>,
    passed: f64,
}

/// Way in outer air, mm, after which the motion is looked up anew.
const STRIDE: f64 = 8.0;

impl Walk {
    /// The pre-image of a point, `spacing` mm after the one before, or `None` well outside the patient.
    fn planning_point(&mut self, motion: &TrueMotion, y: &Point3<f64>, spacing: f64) -> Option<PreImage> {
        let last = match self.last {
            Some(last) if self.passed < STRIDE => last,
            _ => {
                self.passed = 0.0;
                motion.guess(y)
            }
        };
        self.last = Some(last);
        self.passed += spacing;
        if motion.anatomy().outer_air(&last.towards(y).coords) {
            return None;
        }
        let found = motion.pull(y, Some(&last));
        self.passed = 0.0;
        self.last = Some(found);
        Some(found)
    }
}

/// The true push field at the voxels of a grid.
pub(super) fn truth(motion: &TrueMotion, body: &Mask) -> Result<PushField> {
    let grid = body.grid();
    let slice = grid.strides()[2];
    let mut u = vec![[0.0f32; 3]; grid.len()];
    u.par_chunks_mut(slice).enumerate().for_each(|(k, u)| {
        for (n, u) in u.iter_mut().enumerate() {
            let x = grid.centre(grid.voxel(k * slice + n));
            *u = (motion.push(&x) - x).map(|c| c as f32).into();
        }
    });
    Ok(PushField { displacement: Volume::new(grid.clone(), u)?, computed: body.clone() })
}
