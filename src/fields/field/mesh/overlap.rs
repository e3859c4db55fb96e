//! Where the pushed patient lies on himself: fraction voxels that two parts of the body reach with air between them in
//! the planning CT, as an arm lowered into the thorax. Folds inside the tissue are another matter
//! ([`super::super::multiple_preimages`]).

use super::super::PushField;
use super::tetrahedra::{CellSide, cover};
use crate::geometry::Grid;
use crate::volume::{Mask, Volume};
use nalgebra::{Point3, Vector3};
use rayon::prelude::*;

/// Spacing of the rough search, mm.
const ROUGH_MM: f64 = 6.0;
/// Distance of the points of the body in the rough search, mm.
const POINTS_MM: f64 = 3.0;
/// Step along a line that is tested for leaving the body, mm.
const STEP_MM: f64 = 1.0;

/// Mask on the fraction grid of voxels inside two cells of the pushed body whose straight connection in planning leaves
/// the body; `None` when there are none. `body` lies on the push field's grid and holds the patient's cavities, so that an airway that closes does
/// not count. Inverted tetrahedra take no part.
pub fn overlaps(push: &PushField, body: &Mask, fraction: &Grid) -> Option<Mask> {
    let rough = fraction.coarsened(ROUGH_MM);
    let suspects = suspects(push, body, &rough)?;
    let grid = body.grid();
    let [ni, nj, nk] = grid.size();
    let corners = grid.cell_corners();
    let mut hits: Vec<(usize, usize)> = (0..nk - 1)
        .into_par_iter()
        .flat_map_iter(|k| {
            let mut hits = Vec::new();
            for j in 0..nj - 1 {
                for i in 0..ni - 1 {
                    let l = grid.linear([i, j, k]);
                    let near = || nearest(&rough, &moved(push, l)).is_some_and(|at| suspects.data()[at]);
                    if corners.iter().all(|c| body.data()[l + c]) && near() {
                        cover(push, [i, j, k], fraction, CellSide::Upright, |voxel| hits.push((voxel, l)));
                    }
                }
            }
            hits
        })
        .collect();
    hits.par_sort_unstable();
    let mut out = None;
    for group in hits.chunk_by(|a, b| a.0 == b.0) {
        let first = grid.centre(grid.voxel(group[0].1));
        if group[1..].iter().any(|(_, l)| apart(body, &first, &grid.centre(grid.voxel(*l)))) {
            out.get_or_insert_with(|| Volume::filled(fraction.clone(), false)).data_mut()[group[0].0] = true;
        }
    }
    out
}

/// Rough voxels that parts of the body reach that are apart, and their neighbours; `None` when there are none.
fn suspects(push: &PushField, body: &Mask, rough: &Grid) -> Option<Mask> {
    let grid = body.grid();
    let points: Vec<(u32, usize)> = points(push, body, rough).concat();
    // Whatever comes after the first point of a rough voxel is compared with it.
    let mut first = vec![None; rough.len()];
    for &(at, l) in &points {
        first[at as usize].get_or_insert(l);
    }
    let far = |&&(at, l): &&(u32, usize)| {
        let centre = |l: usize| grid.centre(grid.voxel(l));
        first[at as usize].is_some_and(|first| apart(body, &centre(first), &centre(l)))
    };
    let found: Vec<usize> = points.par_iter().filter(far).map(|(at, _)| *at as usize).collect();
    if found.is_empty() {
        return None;
    }
    let mut out = Volume::filled(rough.clone(), false);
    for at in found {
        let voxel = rough.voxel(at);
        let range = |a: usize| voxel[a].saturating_sub(1)..(voxel[a] + 2).min(rough.size()[a]);
        for k in range(2) {
            for j in range(1) {
                for i in range(0) {
                    let near = rough.linear([i, j, k]);
                    out.data_mut()[near] = true;
                }
            }
        }
    }
    Some(out)
}

/// Points of the body, by plane: the rough voxel that each is moved to, and its planning voxel.
fn points(push: &PushField, body: &Mask, rough: &Grid) -> Vec<Vec<(u32, usize)>> {
    let grid = body.grid();
    let size = grid.size();
    let stride: [usize; 3] = grid.spacing().map(|s| ((POINTS_MM / s) as usize).max(1));
    let along = rough.inverse_step() * grid.step().column(0);
    let of_plane = |k: usize| {
        let mut points = Vec::new();
        for j in (0..size[1]).step_by(stride[1]) {
            let row = grid.linear([0, j, k]);
            let start = rough.index(&grid.centre([0, j, k]));
            for i in (0..size[0]).step_by(stride[0]).filter(|i| body.data()[row + i]) {
                let u = Vector3::from(push.displacement.data()[row + i].map(f64::from));
                if let Some(at) = rough.voxel_near(&(start + along * i as f64 + rough.inverse_step() * u)) {
                    points.push((rough.linear(at) as u32, row + i));
                }
            }
        }
        points
    };
    let planes: Vec<usize> = (0..size[2]).step_by(stride[2]).collect();
    planes.into_par_iter().map(of_plane).collect()
}

/// Where a planning voxel goes.
fn moved(push: &PushField, voxel: usize) -> Point3<f64> {
    let grid = push.displacement.grid();
    grid.centre(grid.voxel(voxel)) + Vector3::from(push.displacement.data()[voxel].map(f64::from))
}

/// The storage position of the voxel that a point lies in.
fn nearest(grid: &Grid, p: &Point3<f64>) -> Option<usize> {
    grid.voxel_at(p).map(|voxel| grid.linear(voxel))
}

/// Whether the straight line between the centres of two voxels leaves the body.
fn apart(body: &Mask, a: &Point3<f64>, b: &Point3<f64>) -> bool {
    let steps = ((b - a).norm() / STEP_MM).ceil();
    let grid = body.grid();
    let (from, step) = (grid.index(a), grid.inverse_step() * (b - a) / steps);
    // Between two voxels of the grid a line does not leave it.
    let at = |n: usize| (from + step * n as f64).map(|c| (c + 0.5) as usize);
    (1..steps as usize).map(at).any(|v| !body.at(v.into()))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two slabs with a gap of 12 mm, `x` in [4, 16] and [28, 44]; the first moves by `shift`, squeezing the air.
    fn slabs(shift: f32) -> (PushField, Mask) {
        let grid = Grid::axis_aligned([49, 20, 20], [1.0; 3], [0.0; 3]).unwrap();
        let body = Volume::from_fn(grid.clone(), |l| {
            let [i, j, k] = grid.voxel(l);
            ((4..=16).contains(&i) || (28..=44).contains(&i)) && (3..=16).contains(&j) && (3..=16).contains(&k)
        });
        let u = |l: usize| {
            let i = grid.voxel(l)[0] as f32;
            [shift * ((28.0 - i) / 12.0).clamp(0.0, 1.0), 0.0, 0.0]
        };
        let displacement = Volume::from_fn(grid.clone(), u);
        (PushField { displacement, computed: Volume::filled(grid, true) }, body)
    }

    #[test]
    fn skin_that_passes_skin_is_found_with_its_volume() {
        let target = Grid::axis_aligned([98, 20, 40], [0.5, 1.0, 0.5], [-0.25, 0.0, 0.0]).unwrap();
        for (shift, depth) in [(10.0, 0.0), (12.0, 0.0), (15.0, 3.0), (18.0, 6.0)] {
            let (push, body) = slabs(shift);
            let found = overlaps(&push, &body, &target);
            let mm3 = found.map_or(0, |found| found.count()) as f64 * target.voxel_volume();
            let want = depth * 13.0 * 13.0;
            assert!((mm3 - want).abs() <= 0.15 * want + 1e-9, "{shift}: {mm3} {want}");
        }
    }

    #[test]
    fn a_fold_inside_tissue_is_no_contact_of_skin() {
        let (mut push, _) = slabs(0.0);
        let grid = push.displacement.grid().clone();
        push.displacement =
            Volume::from_fn(grid.clone(), |l| [-12.0 * ((grid.voxel(l)[0] as f32 - 20.0) / 6.0).tanh(), 0.0, 0.0]);
        assert!(overlaps(&push, &Volume::filled(grid.clone(), true), &grid).is_none());
    }
}
