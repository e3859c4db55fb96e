//! A regular voxel grid: size, spacing, origin and 3x3 direction, with index to world and back.

use crate::error::{Error, Result};
use nalgebra::{Matrix3, Matrix4, Point3, Vector3};
use serde::{Deserialize, Serialize};
use std::ops::Range;

/// Regular grid in the LPS world frame, millimetres.
///
/// Voxel `(i, j, k)` has its **centre** at `origin + direction * (spacing .* (i, j, k))`; `i` runs fastest
/// in storage. Direction is orthonormal and may be left-handed.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "Plain", into = "Plain")]
pub struct Grid {
    size: [usize; 3],
    spacing: [f64; 3],
    origin: Point3<f64>,
    direction: Matrix3<f64>,
    to_world: Matrix3<f64>,
    to_index: Matrix3<f64>,
}

/// What is serialised: the direction as rows.
#[derive(Clone, Serialize, Deserialize)]
struct Plain {
    size: [usize; 3],
    spacing: [f64; 3],
    origin: [f64; 3],
    direction: [[f64; 3]; 3],
}

impl TryFrom<Plain> for Grid {
    type Error = Error;
    fn try_from(p: Plain) -> Result<Self> {
        Self::new(p.size, p.spacing, p.origin.into(), Matrix3::from_fn(|r, c| p.direction[r][c]))
    }
}

impl From<Grid> for Plain {
    fn from(g: Grid) -> Self {
        let direction = std::array::from_fn(|r| std::array::from_fn(|c| g.direction[(r, c)]));
        Self { size: g.size, spacing: g.spacing, origin: g.origin.into(), direction }
    }
}

/// Largest departure of direction columns from orthonormality that is taken for rounding in a header.
const ORTHONORMAL_TOLERANCE: f64 = 1e-3;

impl Grid {
    /// A grid from its parts.
    ///
    /// # Errors
    /// When a size is zero, a spacing is not positive and finite, or the direction is not orthonormal.
    pub fn new(size: [usize; 3], spacing: [f64; 3], origin: Point3<f64>, direction: Matrix3<f64>) -> Result<Self> {
        let bad = |problem: String| Err(Error::input("grid", problem, "check the geometry in the image header"));
        if size.contains(&0) || size.iter().try_fold(1usize, |a, &b| a.checked_mul(b)).is_none() {
            return bad(format!("size {size:?} is empty or too large"));
        }
        if spacing.iter().any(|s| !(s.is_finite() && *s > 0.0)) || origin.iter().any(|o| !o.is_finite()) {
            return bad(format!(
                "spacing {spacing:?} mm, origin {:?} mm: not positive and finite",
                origin.coords.as_slice()
            ));
        }
        let off = (direction.transpose() * direction - Matrix3::identity()).abs().max();
        if !off.is_finite() || off > ORTHONORMAL_TOLERANCE {
            return bad(format!("axes are sheared or not of unit length (departure {off:.2e})"));
        }
        let to_world = direction * Matrix3::from_diagonal(&Vector3::from(spacing));
        let Some(to_index) = to_world.try_inverse() else {
            return bad("axes are linearly dependent".into());
        };
        Ok(Self { size, spacing, origin, direction, to_world, to_index })
    }

    /// An axis-aligned grid (direction = identity).
    ///
    /// # Errors
    /// As [`Grid::new`].
    pub fn axis_aligned(size: [usize; 3], spacing: [f64; 3], origin: [f64; 3]) -> Result<Self> {
        Self::new(size, spacing, origin.into(), Matrix3::identity())
    }

    /// A grid from a 4x4 index-to-world matrix (LPS mm).
    ///
    /// # Errors
    /// As [`Grid::new`], in particular for a sheared matrix.
    pub fn from_affine(size: [usize; 3], affine: &Matrix4<f64>) -> Result<Self> {
        let linear: Matrix3<f64> = affine.fixed_view::<3, 3>(0, 0).into_owned();
        let spacing: [f64; 3] = std::array::from_fn(|c| linear.column(c).norm());
        let direction = Matrix3::from_fn(|r, c| linear[(r, c)] / spacing[c]);
        Self::new(size, spacing, Point3::new(affine[(0, 3)], affine[(1, 3)], affine[(2, 3)]), direction)
    }

    /// The 4x4 index-to-world matrix (LPS mm).
    pub fn affine(&self) -> Matrix4<f64> {
        let mut m = Matrix4::identity();
        m.fixed_view_mut::<3, 3>(0, 0).copy_from(&self.to_world);
        m.fixed_view_mut::<3, 1>(0, 3).copy_from(&self.origin.coords);
        m
    }

    /// Voxels along each axis.
    pub fn size(&self) -> [usize; 3] {
        self.size
    }
    /// Voxel spacing in mm along each axis.
    pub fn spacing(&self) -> [f64; 3] {
        self.spacing
    }
    /// World position of voxel (0, 0, 0)'s centre.
    pub fn origin(&self) -> Point3<f64> {
        self.origin
    }
    /// Direction cosines, one column per axis.
    pub fn direction(&self) -> &Matrix3<f64> {
        &self.direction
    }
    /// Index-to-world linear part: columns are the mm vectors from a voxel to its next along each axis.
    pub fn step(&self) -> &Matrix3<f64> {
        &self.to_world
    }
    /// World-to-index linear part.
    pub fn inverse_step(&self) -> &Matrix3<f64> {
        &self.to_index
    }
    /// Number of voxels.
    #[expect(clippy::len_without_is_empty, reason = "a grid is never empty")]
    pub fn len(&self) -> usize {
        self.size.iter().product()
    }
    /// Volume of one voxel in cubic mm.
    pub fn voxel_volume(&self) -> f64 {
        self.spacing.iter().product()
    }
    /// Distances in storage between neighbours along each axis.
    pub fn strides(&self) -> [usize; 3] {
        [1, self.size[0], self.size[0] * self.size[1]]
    }
    /// Storage position of a voxel.
    pub fn linear(&self, [i, j, k]: [usize; 3]) -> usize {
        i + self.size[0] * (j + self.size[1] * k)
    }
    /// Voxel of a storage position.
    pub fn voxel(&self, linear: usize) -> [usize; 3] {
        let [nx, ny, _] = self.size;
        [linear % nx, linear / nx % ny, linear / (nx * ny)]
    }
    /// World position of a voxel's centre.
    pub fn centre(&self, [i, j, k]: [usize; 3]) -> Point3<f64> {
        self.world(&Vector3::new(i as f64, j as f64, k as f64))
    }
    /// World position of a continuous index.
    pub fn world(&self, index: &Vector3<f64>) -> Point3<f64> {
        self.origin + self.to_world * index
    }
    /// Continuous index of a world position.
    pub fn index(&self, world: &Point3<f64>) -> Vector3<f64> {
        self.to_index * (world - self.origin)
    }
    /// The voxel that a world position lies in; `None` outside the grid.
    pub fn voxel_at(&self, world: &Point3<f64>) -> Option<[usize; 3]> {
        self.voxel_near(&self.index(world))
    }
    /// The index of a place, drawn onto the voxels' centres where it lies beyond them.
    #[inline(always)]
    pub fn index_within(&self, world: &Point3<f64>) -> Vector3<f64> {
        let last = Vector3::from(self.size.map(|n| (n - 1) as f64));
        self.index(world).zip_map(&last, |i, l| i.clamp(0.0, l))
    }

    /// The voxel nearest to a continuous index; `None` outside the grid.
    pub fn voxel_near(&self, at: &Vector3<f64>) -> Option<[usize; 3]> {
        let within = (0..3).all(|a| at[a] > -0.5 && at[a] < self.size[a] as f64 - 0.5);
        // Cutting off is cheaper than rounding, and the same from zero on.
        within.then(|| [0, 1, 2].map(|a| (at[a] + 0.5) as usize))
    }
    /// Whether a continuous index lies within the hull of the voxel centres.
    pub fn contains(&self, index: &Vector3<f64>) -> bool {
        (0..3).all(|a| index[a] >= 0.0 && index[a] <= (self.size[a] - 1) as f64)
    }
    /// Distances in storage from a voxel to the eight corners of the cell that begins there; bit `a` of the position says
    /// whether the corner lies high along axis `a`.
    pub fn cell_corners(&self) -> [usize; 8] {
        let [i, j, k] = self.strides();
        [0, i, j, i + j, k, i + k, j + k, i + j + k]
    }
    /// The cells that have a voxel as a corner, by their first voxel in storage: eight, at the border of the grid fewer.
    pub fn cells_around(&self, voxel: [usize; 3]) -> impl Iterator<Item = usize> {
        let (own, size) = (self.linear(voxel), self.size);
        // The cell of which the voxel is corner `c` begins one voxel before it along the axes of `c`.
        let begins =
            move |c: usize| (0..3).all(|a| voxel[a].checked_sub(c >> a & 1).is_some_and(|first| first + 1 < size[a]));
        self.cell_corners().into_iter().enumerate().filter(move |(c, _)| begins(*c)).map(move |(_, by)| own - by)
    }
    /// From a voxel's centre to the middles of its eight parts, mm.
    pub fn eighths(&self) -> [Vector3<f64>; 8] {
        std::array::from_fn(|c| self.step() * Vector3::from_fn(|a, _| if c >> a & 1 == 1 { 0.25 } else { -0.25 }))
    }
    /// The eight corner voxels' centres.
    pub fn corners(&self) -> [Point3<f64>; 8] {
        std::array::from_fn(|c| {
            self.centre(std::array::from_fn(|a| if c >> a & 1 == 1 { self.size[a] - 1 } else { 0 }))
        })
    }
    /// The grid moved by a vector, LPS mm.
    pub fn shifted(&self, by: &Vector3<f64>) -> Self {
        Self { origin: self.origin + by, ..self.clone() }
    }
    /// World position of the grid's middle.
    pub fn middle(&self) -> Point3<f64> {
        self.world(&Vector3::from(self.size.map(|n| (n - 1) as f64 / 2.0)))
    }
    /// Edge of the cube with the volume of a voxel, mm.
    pub fn mean_edge(&self) -> f64 {
        self.spacing().iter().product::<f64>().cbrt()
    }

    /// Whether both grids have the same size and their corners agree within `tolerance` mm.
    pub fn matches(&self, other: &Self, tolerance: f64) -> bool {
        self.size == other.size && self.corners().iter().zip(other.corners()).all(|(a, b)| (a - b).norm() <= tolerance)
    }

    /// A grid over the same box with about `spacing` mm (never finer than this grid along any axis).
    ///
    /// Keeps direction and middle, so that it does not depend on where the storage begins; its outermost voxel centres lie
    /// on this grid's or beyond them.
    pub fn coarsened(&self, spacing: f64) -> Self {
        let coarse: [f64; 3] = std::array::from_fn(|a| spacing.max(self.spacing[a]));
        let size = std::array::from_fn(|a| {
            ((self.size[a] - 1) as f64 * self.spacing[a] / coarse[a] - 1e-9).ceil() as usize + 1
        });
        let origin = self.world(&-Vector3::from([0, 1, 2].map(|a| self.overhang(size[a], coarse[a], a))));
        let to_world = self.direction * Matrix3::from_diagonal(&Vector3::from(coarse));
        let to_index = Matrix3::from_diagonal(&Vector3::from(coarse.map(f64::recip))) * self.direction.transpose();
        Self { size, spacing: coarse, origin, to_world, to_index, ..self.clone() }
    }

    /// The voxels that belong to each index of `coarse`, which [`Grid::coarsened`] made, along one axis: those that lie nearest.
    ///
    /// A voxel half-way between two belongs to the outer one, so that storing the image backwards changes nothing (but for a
    /// voxel in the very middle).
    pub fn voxels_by_nearest(&self, coarse: &Self, axis: usize) -> Vec<Range<usize>> {
        let (size, count) = (self.size[axis], coarse.size[axis]);
        let ratio = coarse.spacing[axis] / self.spacing[axis];
        let overhang = self.overhang(count, coarse.spacing[axis], axis);
        let first = |c: usize| {
            let border = (c as f64 - 0.5) * ratio - overhang;
            let whole = border.round();
            let border = if (border - whole).abs() < 1e-6 { whole } else { border };
            let first = if 2 * c < count { border.floor() + 1.0 } else { border.ceil() };
            (first.max(0.0) as usize).min(size)
        };
        (0..count).map(|c| first(c)..first(c + 1)).collect()
    }

    /// How many of its voxels lie between the first one of a grid with the same middle, `size` voxels of `spacing` mm, and the
    /// first of its own.
    fn overhang(&self, size: usize, spacing: f64, axis: usize) -> f64 {
        0.5 * ((size - 1) as f64 * spacing / self.spacing[axis] - (self.size[axis] - 1) as f64)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn refuses_shear_and_empty() {
        let mut shear = Matrix3::identity();
        shear[(0, 1)] = 0.1;
        assert!(Grid::new([2, 2, 2], [1.0; 3], Point3::origin(), shear).is_err());
        assert!(Grid::axis_aligned([2, 0, 2], [1.0; 3], [0.0; 3]).is_err());
        assert!(Grid::axis_aligned([2, 2, 2], [1.0, f64::NAN, 1.0], [0.0; 3]).is_err());
    }

    #[test]
    fn coarsened_covers_the_box() {
        let g = Grid::axis_aligned([469, 267, 90], [1.0, 1.0, 3.0], [0.0; 3]).unwrap();
        let c = g.coarsened(3.0);
        assert_eq!(c.size(), [157, 90, 90]);
        assert!(g.corners().iter().all(|corner| c.contains(&c.index(corner))));
        let middle = |g: &Grid| nalgebra::center(&g.corners()[0], &g.corners()[7]);
        assert!((middle(&c) - middle(&g)).norm() < 1e-9);
        assert_eq!(g.coarsened(1.0).size()[0], 469);
    }

    #[test]
    fn voxels_belong_to_one_coarse_voxel_each_and_backwards_to_its_mirror_image() {
        for size in 1..120 {
            for ratio in [1.0, 4.0 / 3.0, 2.0, 2.5, 4.0, 4.0 / 0.98, 8.0] {
                let fine = Grid::axis_aligned([size, 1, 1], [1.0; 3], [0.0; 3]).unwrap();
                let grid = fine.coarsened(ratio);
                let (coarse, ranges) = (grid.size()[0], fine.voxels_by_nearest(&grid, 0));
                let owner = |voxel: usize| ranges.iter().position(|r| r.contains(&voxel)).unwrap();
                assert_eq!(ranges.iter().map(|r| r.len()).sum::<usize>(), size, "{size} {ratio}");
                for voxel in (0..size).filter(|v| 2 * v + 1 != size) {
                    assert_eq!(owner(size - 1 - voxel), coarse - 1 - owner(voxel), "{size} {ratio} {voxel}");
                    // Nearest in the world, where the coarse voxels lie.
                    let apart = fine.centre([voxel, 0, 0]).x - grid.centre([owner(voxel), 0, 0]).x;
                    assert!(apart.abs() <= 0.5 * ratio + 1e-6, "{size} {ratio} {voxel}: {apart}");
                }
            }
        }
    }

    proptest! {
        #[test]
        fn index_world_round_trip(axis in prop::array::uniform3(-1.0f64..1.0), angle in 0.0f64..3.1,
                                  flip in any::<bool>(), spacing in prop::array::uniform3(0.3f64..10.0),
                                  at in prop::array::uniform3(-50.0f64..500.0)) {
            let axis = nalgebra::Unit::new_normalize(Vector3::from(axis) + Vector3::new(0.0, 0.0, 1e-9));
            let mut d = nalgebra::Rotation3::from_axis_angle(&axis, angle).into_inner();
            if flip { d.column_mut(0).neg_mut(); }
            let g = Grid::new([9, 8, 7], spacing, Point3::new(5.0, -300.0, 1e3), d).unwrap();
            let i = Vector3::from(at);
            prop_assert!((g.index(&g.world(&i)) - i).norm() < 1e-9);
            let h = Grid::from_affine(g.size(), &g.affine()).unwrap();
            prop_assert!(h.matches(&g, 1e-9));
        }
    }
}
