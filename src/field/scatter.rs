//! Resampling by five tetrahedra (thesis 4.2.5, after Rodriguez): the planning voxels are vertices of a mesh that moves
//! with the push field, and each fraction voxel takes the barycentric mean of the tetrahedron it lies in.
//!
//! No inverse is needed. Where the mesh folds, a voxel lies in several tetrahedra: upright ones win over inverted ones,
//! of equals the last in storage. The cut is mirrored in alternate cells, as the Jacobian's (see [`super::jacobian`]),
//! so that the tetrahedra fill space.

use super::PushField;
use crate::error::Result;
use crate::geometry::Grid;
use crate::volume::Volume;
use nalgebra::Vector3;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// How the planning CT is brought onto the fraction grid.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Resampling {
    /// Each fraction voxel looks up its pre-image: trilinear, through the inverse of the push field.
    #[default]
    PullBack,
    /// The deformed mesh of planning voxels is drawn: linear in each of five tetrahedra (thesis 4.2.5).
    FiveTetrahedra,
}

/// What the drawing of the mesh found.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct ScatterReport {
    /// Fraction voxels inside the mesh.
    pub drawn: usize,
    /// Fraction voxels inside more than one tetrahedron (not on their common face): the mesh folds there.
    pub overlapped: usize,
    /// Fraction voxels that lie only in inverted tetrahedra.
    pub inverted: usize,
}

/// Corner `c` of a cell lies high along i, j, k where bits 0, 1, 2 of `c` are set. Each tetrahedron is positive in an
/// undeformed, right-handed cell.
const EVEN: [[usize; 4]; 5] = [[0, 1, 2, 4], [3, 2, 1, 7], [5, 4, 7, 1], [6, 7, 4, 2], [1, 2, 4, 7]];
const ODD: [[usize; 4]; 5] = [[1, 3, 0, 5], [2, 0, 3, 6], [4, 0, 6, 5], [7, 3, 5, 6], [0, 5, 3, 6]];

/// A voxel counts as inside a tetrahedron when no barycentric coordinate is below this.
const INSIDE: f64 = -1e-9;
/// Barycentric coordinates above this are inside for certain, not on a common face.
const WELL_INSIDE: f64 = 1e-6;
/// Tetrahedra smaller than this, in cubic voxels, hold no point.
const LEAST_VOLUME: f64 = 1e-12;

/// What a fraction voxel has received.
#[derive(Clone, Copy, Default)]
struct Drop {
    value: f32,
    /// 0 nothing, 1 from an inverted tetrahedron, 2 from an upright one.
    rank: u8,
    /// How many tetrahedra hold the voxel well inside.
    count: u8,
}

/// The planning image on `grid`, by five tetrahedra; `outside` where no tetrahedron lies.
///
/// # Errors
/// Only for internal inconsistency of grids.
pub fn scatter_image(
    push: &PushField,
    image: &Volume<f32>,
    grid: &Grid,
    outside: f32,
) -> Result<(Volume<f32>, ScatterReport)> {
    let mesh = Mesh::new(push, image, grid);
    let plane = grid.size()[0] * grid.size()[1];
    // Slabs do not change the result: every voxel sees the cells in the same order.
    let slab = grid.size()[2].div_ceil(4 * rayon::current_num_threads()).max(1);
    let mut drops = vec![Drop::default(); grid.len()];
    drops.par_chunks_mut(slab * plane).enumerate().for_each(|(n, part)| mesh.draw(n * slab, part));
    let count = |f: fn(&Drop) -> bool| drops.par_iter().filter(|d| f(d)).count();
    let report = ScatterReport {
        drawn: count(|d| d.rank > 0),
        overlapped: count(|d| d.count > 1),
        inverted: count(|d| d.rank == 1),
    };
    let values = drops.iter().map(|d| if d.rank > 0 { d.value } else { outside }).collect();
    Ok((Volume::new(grid.clone(), values)?, report))
}

/// The planning voxels and where they go, in indices of the target grid.
struct Mesh<'a> {
    push: &'a PushField,
    image: &'a Volume<f32>,
    target: &'a Grid,
    base: Vector3<f64>,
    step: nalgebra::Matrix3<f64>,
    turn: nalgebra::Matrix3<f64>,
    /// Least and greatest target index along k over each row (j, k) of planning voxels.
    reach: Vec<[f64; 2]>,
    /// -1 where the two grids have different handedness.
    sense: f64,
}

impl<'a> Mesh<'a> {
    fn new(push: &'a PushField, image: &'a Volume<f32>, target: &'a Grid) -> Self {
        let own = push.displacement.grid();
        let [_, nj, nk] = own.size();
        let step = target.inverse_step() * own.step();
        let mut mesh = Self {
            push,
            image,
            target,
            base: target.index(&own.origin()),
            step,
            turn: *target.inverse_step(),
            reach: Vec::new(),
            sense: step.determinant().signum(),
        };
        mesh.reach = (0..nj * nk)
            .into_par_iter()
            .map(|row| {
                let mut places = Vec::new();
                mesh.places(row % nj, row / nj, &mut places);
                places.iter().fold([f64::MAX, f64::MIN], |r, p| [r[0].min(p.z), r[1].max(p.z)])
            })
            .collect();
        mesh
    }

    /// Target indices of the row of planning voxels (j, k).
    fn places(&self, j: usize, k: usize, out: &mut Vec<Vector3<f64>>) {
        let own = self.push.displacement.grid();
        let start = own.linear([0, j, k]);
        out.clear();
        out.extend(self.push.displacement.data()[start..start + own.size()[0]].iter().enumerate().map(|(i, u)| {
            self.base
                + self.step * Vector3::new(i as f64, j as f64, k as f64)
                + self.turn * Vector3::from(u.map(f64::from))
        }));
    }

    /// Draws all cells into the planes of `part`, the first of which is plane `first` of the target.
    fn draw(&self, first: usize, part: &mut [Drop]) {
        let [ni, nj, nk] = self.push.displacement.grid().size();
        let planes = part.len() / (self.target.size()[0] * self.target.size()[1]);
        let (low, high) = (first as f64, (first + planes - 1) as f64);
        let mut rows: [Vec<Vector3<f64>>; 4] = Default::default();
        for k in 0..nk - 1 {
            for j in 0..nj - 1 {
                let four = [(j, k), (j + 1, k), (j, k + 1), (j + 1, k + 1)];
                let reach = four.map(|(j, k)| self.reach[j + nj * k]);
                if reach.iter().all(|r| r[0] > high) || reach.iter().all(|r| r[1] < low) {
                    continue;
                }
                for (row, (j, k)) in rows.iter_mut().zip(four) {
                    self.places(j, k, row);
                }
                let value = four.map(|(j, k)| self.push.displacement.grid().linear([0, j, k]));
                for i in 0..ni - 1 {
                    let at: [Vector3<f64>; 8] = std::array::from_fn(|c| rows[c >> 1][i + (c & 1)]);
                    let hu: [f32; 8] = std::array::from_fn(|c| self.image.data()[value[c >> 1] + i + (c & 1)]);
                    let cut = if (i + j + k) % 2 == 0 { &EVEN } else { &ODD };
                    for t in cut {
                        self.tetrahedron(t.map(|c| at[c]), t.map(|c| hu[c]), first, part);
                    }
                }
            }
        }
    }

    /// Draws one tetrahedron.
    fn tetrahedron(&self, p: [Vector3<f64>; 4], hu: [f32; 4], first: usize, part: &mut [Drop]) {
        let [nx, ny, _] = self.target.size();
        let planes = part.len() / (nx * ny);
        let size = [(0, nx), (0, ny), (first, first + planes)];
        let mut range = [(0usize, 0usize); 3];
        for a in 0..3 {
            let least = p.iter().map(|v| v[a]).fold(f64::MAX, f64::min);
            let greatest = p.iter().map(|v| v[a]).fold(f64::MIN, f64::max);
            let from = (least - 1e-9).ceil().max(size[a].0 as f64);
            let to = (greatest + 1e-9).floor().min(size[a].1 as f64 - 1.0);
            // Also false where a coordinate is no number.
            if from <= to {
                range[a] = (from as usize, to as usize + 1);
            } else {
                return;
            }
        }
        let (e1, e2, e3) = (p[1] - p[0], p[2] - p[0], p[3] - p[0]);
        let volume = e1.dot(&e2.cross(&e3));
        if volume.abs() < LEAST_VOLUME {
            return;
        }
        let rank = if volume * self.sense > 0.0 { 2 } else { 1 };
        let dual = [e2.cross(&e3) / volume, e3.cross(&e1) / volume, e1.cross(&e2) / volume];
        for z in range[2].0..range[2].1 {
            for y in range[1].0..range[1].1 {
                for x in range[0].0..range[0].1 {
                    let d = Vector3::new(x as f64, y as f64, z as f64) - p[0];
                    let b = dual.map(|v| v.dot(&d));
                    let b0 = 1.0 - b[0] - b[1] - b[2];
                    let least = b0.min(b[0]).min(b[1]).min(b[2]);
                    if least < INSIDE {
                        continue;
                    }
                    let drop = &mut part[x + nx * (y + ny * (z - first))];
                    if least > WELL_INSIDE {
                        drop.count = drop.count.saturating_add(1);
                    }
                    if rank >= drop.rank {
                        let value = b0 * f64::from(hu[0])
                            + b[0] * f64::from(hu[1])
                            + b[1] * f64::from(hu[2])
                            + b[2] * f64::from(hu[3]);
                        *drop = Drop { value: value as f32, rank, ..*drop };
                    }
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cells(u: impl Fn(usize, [usize; 3]) -> [f32; 3]) -> (PushField, Volume<f32>) {
        let grid = Grid::axis_aligned([9, 8, 7], [1.0, 2.0, 3.0], [5.0, -7.0, 11.0]).unwrap();
        let displacement = Volume::from_fn(grid.clone(), |l| u(l, grid.voxel(l)));
        let image = Volume::from_fn(grid.clone(), |l| {
            let c = grid.centre(grid.voxel(l));
            (3.0 * c.x - 2.0 * c.y + 5.0 * c.z) as f32
        });
        (PushField { computed: Volume::filled(grid, true), displacement }, image)
    }

    #[test]
    fn linear_images_survive_an_affine_motion_exactly() {
        let (push, image) = cells(|_, [i, j, k]| [0.3 + 0.1 * i as f32, -0.4 + 0.1 * k as f32, 0.2 * j as f32]);
        let target = Grid::axis_aligned([12, 14, 12], [0.8, 1.3, 2.1], [4.0, -8.0, 10.0]).unwrap();
        let (out, report) = scatter_image(&push, &image, &target, -1e4).unwrap();
        // The affine push map and its exact inverse.
        let own = push.displacement.grid();
        let mut drawn = 0;
        for n in 0..target.len() {
            let y = target.centre(target.voxel(n));
            let map = |x: &nalgebra::Point3<f64>| {
                let i = own.index(x);
                x + Vector3::new(0.3 + 0.1 * i.x, -0.4 + 0.1 * i.z, 0.2 * i.y)
            };
            let mut x = y;
            (0..200).for_each(|_| x -= map(&x) - y);
            let inside = own.contains(&own.index(&x));
            if out.data()[n] > -1e4 {
                drawn += 1;
                let want = 3.0 * x.x - 2.0 * x.y + 5.0 * x.z;
                assert!((f64::from(out.data()[n]) - want).abs() < 1e-3, "{} {want}", out.data()[n]);
            } else {
                assert!(!inside, "voxel {n} lies in the mesh");
            }
        }
        assert!(drawn > 500 && report.drawn == drawn && report.overlapped == 0 && report.inverted == 0, "{report:?}");
    }

    #[test]
    fn a_flipped_target_grid_gives_the_same_values() {
        let (push, image) = cells(|l, _| [0.2 * (l % 3) as f32, 0.1, -0.1 * (l % 2) as f32]);
        let grid = Grid::axis_aligned([9, 8, 7], [1.0, 2.0, 3.0], [5.0, -7.0, 11.0]).unwrap();
        let mut direction = nalgebra::Matrix3::identity();
        direction[(0, 0)] = -1.0;
        let flipped =
            Grid::new([9, 8, 7], [1.0, 2.0, 3.0], nalgebra::Point3::new(13.0, -7.0, 11.0), direction).unwrap();
        let (a, ra) = scatter_image(&push, &image, &grid, 0.0).unwrap();
        let (b, rb) = scatter_image(&push, &image, &flipped, 0.0).unwrap();
        assert_eq!(ra, rb);
        for n in 0..grid.len() {
            let [i, j, k] = grid.voxel(n);
            assert!((a.data()[n] - b.at([8 - i, j, k])).abs() < 1e-3);
        }
    }

    #[test]
    fn folds_are_counted_and_upright_cells_win() {
        // The middle plane of voxels is pushed beyond the next one: a fold.
        let (push, image) = cells(|_, [i, ..]| [if i == 4 { 1.6 } else { 0.0 }, 0.0, 0.0]);
        let target = Grid::axis_aligned([8, 7, 6], [1.0, 2.0, 3.0], [5.35, -6.5, 11.7]).unwrap();
        let (out, report) = scatter_image(&push, &image, &target, -1e4).unwrap();
        // At x = 5.35 of the voxel index the stretched cell, the inverted one and the next one overlap: 7 x 6 voxels.
        assert_eq!(report, ScatterReport { drawn: out.data().len(), overlapped: 42, inverted: 0 });
    }
}
