//! Pre-images beside a surface along which tissue slides: the field jumps there, and between voxels of both sides it is neither's.
//! What such a voxel of the fraction shows is sought on one side at a time.

use super::super::{PullField, PushField};
use super::invert::InverseReport;
use super::pre_image::InvertOptions;
use crate::geometry::Grid;
use crate::volume::{Mask, trilinear_vector};
use nalgebra::{Point3, Vector3};
use rayon::prelude::*;

/// Less than this share of a place's neighbours on a side say nothing of it.
const LEAST: f64 = 1e-3;

/// A push field of which one side of a surface counts.
struct OneSided<'a> {
    push: &'a PushField,
    /// What slides along its border, on the field's grid.
    region: &'a Mask,
}

impl OneSided<'_> {
    fn grid(&self) -> &Grid {
        self.push.displacement.grid()
    }

    /// The eight voxels around a place with their weights; `None` beyond the grid.
    fn around(&self, at: &Point3<f64>) -> Option<[(usize, f64); 8]> {
        let (grid, index) = (self.grid(), self.grid().index(at));
        if !grid.contains(&index) {
            return None;
        }
        let size = grid.size();
        let low: [usize; 3] = std::array::from_fn(|a| (index[a].max(0.0) as usize).min(size[a].saturating_sub(2)));
        Some(std::array::from_fn(|c| {
            let mut weight = 1.0;
            let voxel = std::array::from_fn(|a| {
                let t = (index[a] - low[a] as f64).clamp(0.0, 1.0);
                let high = c >> a & 1;
                weight *= if high == 1 { t } else { 1.0 - t };
                (low[a] + high).min(size[a] - 1)
            });
            (grid.linear(voxel), weight)
        }))
    }

    /// Whether a place lies between voxels of both sides.
    fn between(&self, at: &Point3<f64>) -> bool {
        let Some(around) = self.around(at) else { return false };
        let first = self.region.data()[around[0].0];
        around.iter().any(|(voxel, _)| self.region.data()[*voxel] != first)
    }

    /// The displacement of one side, and the share of the voxels around that tell it.
    fn value(&self, at: &Point3<f64>, side: bool) -> Option<(Vector3<f64>, f64)> {
        let (mut sum, mut share) = (Vector3::zeros(), 0.0);
        for (voxel, weight) in self.around(at)?.into_iter().filter(|(v, _)| self.region.data()[*v] == side) {
            sum += Vector3::from(self.push.displacement.data()[voxel].map(f64::from)) * weight;
            share += weight;
        }
        (share > LEAST).then(|| (sum / share, share))
    }

    /// The pre-image on one side, from a guess, and the share of the voxels around it on that side.
    fn solve(
        &self,
        y: &Point3<f64>,
        from: Vector3<f64>,
        side: bool,
        options: &InvertOptions,
    ) -> Option<(Vector3<f64>, f64)> {
        let mut v = from;
        for _ in 0..options.max_iterations {
            let (u, share) = self.value(&(y + v), side)?;
            let change = (v + u).norm();
            v = -u;
            if change < options.tolerance_mm {
                return Some((v, share));
            }
        }
        None
    }
}

/// Gives fraction voxels whose pre-image lies between both sides of where tissue slides one on the side that they belong to: the
/// one with more of its surroundings on its own side. `region` slides along its border; on the grid of `push`.
pub fn take_sides(
    push: &PushField,
    pull: &mut PullField,
    report: &mut InverseReport,
    region: &Mask,
    options: &InvertOptions,
) {
    let sided = OneSided { push, region };
    let fraction = pull.displacement.grid().clone();
    let voxel_mm = fraction.spacing().into_iter().fold(0.0, f64::max);
    let row = fraction.size()[0];
    let inside = pull.inside.data();
    // Of voxels that had no exact pre-image and have one now: those of tissue, and those missed by more than a voxel.
    let found: Vec<[usize; 3]> = pull
        .displacement
        .data_mut()
        .par_chunks_mut(row)
        .enumerate()
        .map(|(line, out)| {
            let mut found = [0; 3];
            for (i, out) in out.iter_mut().enumerate().filter(|(i, _)| inside[line * row + i]) {
                let y = fraction.centre(fraction.voxel(line * row + i));
                let v = Vector3::from(out.map(f64::from));
                if !sided.between(&(y + v)) {
                    continue;
                }
                let sides = [true, false].map(|side| {
                    let (start, _) = sided.value(&(y + v), side)?;
                    sided.solve(&y, -start, side, options)
                });
                let Some((better, _)) = sides.into_iter().flatten().reduce(|a, b| if b.1 > a.1 { b } else { a }) else {
                    continue;
                };
                let missed =
                    trilinear_vector(&push.displacement, &sided.grid().index(&(y + v))).map_or(0.0, |u| (u + v).norm());
                if missed >= options.tolerance_mm {
                    let tissue = sided.grid().voxel_at(&(y + v)).is_some_and(|at| *push.computed.at(at));
                    found[0] += 1;
                    found[1] += usize::from(tissue);
                    found[2] += usize::from(tissue && missed > voxel_mm);
                }
                *out = [better.x as f32, better.y as f32, better.z as f32];
            }
            found
        })
        .collect();
    let less = |of: &mut usize, n: usize| *of = of.saturating_sub(found.iter().map(|f| f[n]).sum());
    less(&mut report.unconverged, 0);
    less(&mut report.unconverged_tissue, 1);
    less(&mut report.strayed, 2);
    report.strayed = report.strayed.min(report.unconverged_tissue);
    if report.unconverged == 0 {
        report.unconverged_max_mm = 0.0;
    }
}

#[cfg(test)]
mod tests {
    use super::super::invert::invert;
    use super::*;
    use crate::volume::Volume;

    #[test]
    fn beside_a_slanted_surface_what_slides_and_what_does_not_are_each_inverted() {
        let grid = Grid::axis_aligned([40, 30, 36], [1.5, 2.0, 1.5], [0.0; 3]).unwrap();
        let normal: Vector3<f64> = Vector3::new(0.5, 0.2, 1.0).normalize();
        // Along the surface, by 11 mm.
        let slide: Vector3<f64> = Vector3::new(1.0, 0.0, -0.5).normalize() * 11.0;
        assert!(slide.dot(&normal).abs() < 1e-9);
        let above = |p: &Point3<f64>| p.coords.dot(&normal) - 40.0;
        let region = Volume::from_fn(grid.clone(), |l| above(&grid.centre(grid.voxel(l))) > 0.0);
        let displacement = region.map(|inside| if *inside { slide.map(|c| c as f32).into() } else { [0.0; 3] });
        let push = PushField { displacement, computed: Volume::filled(grid.clone(), true) };
        let options = InvertOptions::default();
        let (mut pull, mut report) = invert(&push, &grid, None, &options).unwrap();
        // Voxels near the surface, by no less than the half of a voxel that no side is sure of, whose pre-image is another one's.
        let wrong = |pull: &PullField| -> usize {
            let of = |n: &usize| {
                let y = grid.centre(grid.voxel(*n));
                let v = if above(&y) > 0.0 { -slide } else { Vector3::zeros() };
                let deep = grid.voxel(*n).iter().zip(grid.size()).all(|(c, n)| *c > 8 && c + 8 < n);
                let off = (Vector3::from(pull.displacement.data()[*n].map(f64::from)) - v).norm();
                deep && (1.2..4.0).contains(&above(&y).abs()) && off > 2e-3
            };
            (0..grid.len()).filter(of).count()
        };
        let before = wrong(&pull);
        take_sides(&push, &mut pull, &mut report, &region, &options);
        let after = wrong(&pull);
        println!("{before} wrong pre-images, then {after}");
        assert!(before > 5 && after == 0, "{before} {after}");
        assert_eq!((report.unconverged_tissue, report.strayed), (0, 0));
    }
}
