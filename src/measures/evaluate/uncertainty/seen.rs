//! Uncertainty where both images speak.

use super::Evidence;
use super::side::AVERAGE_MM;
use crate::error::Result;
use crate::geometry::vectorised;
use crate::stats::{Line, gain_and_offset};
use crate::volume::{Mask, Volume, gaussian, trilinear, trilinear_vector};
use nalgebra::{Point3, Vector3};
use rayon::prelude::*;

/// Gradient that noise alone shows, HU/mm.
const NOISE_GRADIENT: f64 = 10.0;
/// Disagreement and mismatch that are always there, mm.
const FLOOR_MM: f64 = 0.1;
/// Scale of the product, so that two thirds of errors are smaller.
/// Fitted to the four shared cases; from three of them it is 0.46 to 0.53.
const SCALE: f64 = 0.5;
/// The median mismatch is below this, mm, where tissue is found as well as the scale says: 0.44 to 0.47 on the posed CTs. With
/// more (0.61 on the phantom at 3 mm, 1.9 on a cone-beam CT) errors are larger everywhere than place by place shows.
const USUAL_MISMATCH_MM: f64 = 0.5;
/// The most that images which agree so badly raise the map by.
const MOST_RAISED: f64 = 1.5;
/// HU inside this much of 0 enter the fit of gain and offset: not the window's ends.
const MIDDLE_HU: f32 = 200.0;
/// Tissue follows the bones around it, not the nearest alone: their uncertainty is averaged over this, mm.
const FOLLOWED_MM: f64 = 12.0;
/// Share of the neighbourhood that both images must show to speak.
const LEAST_SEEN: f32 = 0.05;

/// The uncertainty at each node of the map, mm; `None` where the images say nothing.
pub(super) fn seen(e: &Evidence<'_>, alone: &Volume<[f32; 3]>) -> Result<Vec<Option<f32>>> {
    let grid = &e.side.grid;
    let fraction: Vec<Option<[f32; 8]>> = e.side.soft.par_iter().map(|(n, _)| shown(e, *n as usize)).collect();
    let pairs = || e.side.soft.iter().zip(&fraction).filter_map(|((n, p), f)| Some((*n as usize, p, f.as_ref()?)));
    let middle = pairs().flat_map(|(_, p, f)| p.iter().zip(f)).filter(|(p, f)| p.abs().max(f.abs()) < MIDDLE_HU);
    let line = gain_and_offset(middle.map(|(p, f)| (f64::from(*p), f64::from(*f))));
    let Line { gain, offset } = line.unwrap_or(Line { gain: 1.0, offset: 0.0 });
    let (mut weight, mut difference) = (vec![0f32; grid.len()], vec![0f32; grid.len()]);
    for (n, p, f) in pairs() {
        let sum: f64 = p.iter().zip(f).map(|(p, f)| (f64::from(*p) - gain * f64::from(*f) - offset).powi(2)).sum();
        (weight[n], difference[n]) = (1.0, (sum / p.len() as f64) as f32);
    }
    let average = |values| Ok(gaussian(&Volume::new(grid.clone(), values)?, AVERAGE_MM));
    let (weight, difference) = rayon::join(|| average(weight), || average(difference));
    let (weight, difference): (Volume<f32>, Volume<f32>) = (weight?, difference?);
    // Beside a bone that no image determines its own field is as unsure as the bone.
    let variance = |label: &u16| e.bone_mm.get(label).map_or(0.0, |mm| (mm * mm) as f32);
    let bones: Vec<f32> = e.side.owner.data().par_iter().map(variance).collect();
    let bones: Volume<f32> = gaussian(&Volume::new(grid.clone(), bones)?, FOLLOWED_MM);
    let distance = |n: usize| {
        let x = grid.centre(grid.voxel(n));
        let at = |v: &Volume<[f32; 3]>| trilinear_vector(v, &v.grid().index(&x)).unwrap_or_else(Vector3::zeros);
        (at(&e.push.displacement) - at(alone)).norm().hypot(f64::from(bones.data()[n]).sqrt())
    };
    let misled = |n: usize| {
        let at = |m: &Mask| m.grid().voxel_at(&grid.centre(grid.voxel(n))).is_some_and(|v| *m.at(v));
        e.misled.is_some_and(at)
    };
    let mismatch = |n: usize| {
        let w = weight.data()[n];
        let slope = f64::from(e.side.slope.data()[n]).sqrt() + NOISE_GRADIENT;
        (w > LEAST_SEEN && !misled(n)).then(|| f64::from(difference.data()[n] / w).sqrt() / slope)
    };
    let mismatch: Vec<Option<f64>> = (0..grid.len()).into_par_iter().map(mismatch).collect();
    let scale = SCALE * unlike(e.side.soft.iter().filter_map(|(n, _)| mismatch[*n as usize]).collect());
    let value = |(n, q): (usize, &Option<f64>)| {
        q.map(|q| (scale * ((distance(n) + FLOOR_MM) * (q + FLOOR_MM).powi(2)).cbrt()) as f32)
    };
    Ok(mismatch.par_iter().enumerate().map(value).collect())
}

/// Factor on the map for images that agree less than those that its scale was fitted to.
fn unlike(mut mismatch: Vec<f64>) -> f64 {
    let half = mismatch.len() / 2;
    if mismatch.is_empty() {
        return 1.0;
    }
    let median = *mismatch.select_nth_unstable_by(half, f64::total_cmp).1;
    (median / USUAL_MISMATCH_MM).powi(2).clamp(1.0, MOST_RAISED)
}

/// Windowed fraction HU at the eight points of a node, where the field says; `None` where one lies outside the fraction CT.
fn shown(e: &Evidence<'_>, n: usize) -> Option<[f32; 8]> {
    let (grid, u) = (&e.side.grid, &e.push.displacement);
    let x = grid.centre(grid.voxel(n));
    let offsets = grid.eighths();
    vectorised(
        #[inline(always)]
        || {
            let shift = match trilinear_vector(u, &u.grid().index(&x)) {
                Some(shift) => shift,
                None => Vector3::zeros(),
            };
            let there: Point3<f64> = x + shift;
            let mut values = [0f32; 8];
            for (value, o) in values.iter_mut().zip(&offsets) {
                let hu = trilinear(e.fraction, &e.fraction.grid().index(&(there + o)))?;
                if hu.is_nan() {
                    return None;
                }
                *value = e.side.window.of(hu as f32);
            }
            Some(values)
        },
    )
}
