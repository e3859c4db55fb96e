//! Thin-plate splines through control points on the bones (thesis 2.2.1, 4.2.3; Bookstein, IEEE PAMI 11, 1989).
//!
//! In three dimensions the spline that bends least is an affine map plus one term `w |x - c|` per control point `c`. With
//! 6 points on each of 42 bones that is 252 square roots per voxel. They are evaluated directly, row by row and in
//! single precision, so that the compiler turns the innermost loop into vector instructions; no far field or coarser grid
//! is needed (docs/decisions/thesis.md).

use super::{control_points, push_field};
use crate::chainmail::{Initiators, Tissue};
use crate::error::{Error, Result};
use crate::field::PushField;
use nalgebra::{DMatrix, Point3, Vector3};
use rayon::prelude::*;

/// Control points on each bone: the thesis has 5 to 6 (4.2.3).
const POINTS_PER_BONE: usize = 6;

/// An interpolating thin-plate spline of displacements.
#[derive(Debug, Clone)]
pub struct ThinPlate {
    centres: Vec<Point3<f64>>,
    /// One weight per centre, then the affine part: constant, and derivatives along x, y and z. All relative to `middle`.
    weights: DMatrix<f64>,
    middle: Point3<f64>,
}

impl ThinPlate {
    /// The spline that moves each first point by the vector beside it. Points LPS mm.
    ///
    /// Affine where fewer than five points, or points in one plane, leave it open: the least one.
    ///
    /// # Errors
    /// [`Error::Registration`] when no spline passes through the points, as for two equal ones with different motion.
    pub fn new(moves: &[(Point3<f64>, Vector3<f64>)]) -> Result<Self> {
        let n = moves.len();
        let middle = Point3::from(moves.iter().map(|m| m.0.coords).sum::<Vector3<f64>>() / n.max(1) as f64);
        let mut system = DMatrix::zeros(n + 4, n + 4);
        let mut wanted = DMatrix::zeros(n + 4, 3);
        for (i, (p, u)) in moves.iter().enumerate() {
            for (j, (q, _)) in moves.iter().enumerate() {
                system[(i, j)] = (p - q).norm();
            }
            let d = p - middle;
            for (c, v) in [1.0, d.x, d.y, d.z].into_iter().enumerate() {
                system[(i, n + c)] = v;
                system[(n + c, i)] = v;
            }
            wanted.row_mut(i).copy_from(&u.transpose());
        }
        let solution = system.clone().full_piv_lu().solve(&wanted);
        let weights = match solution {
            Some(w) if (&system * &w - &wanted).amax() < 1e-6 => w,
            // Too few points for the affine part: the smallest solution of all.
            _ => system.clone().svd(true, true).solve(&wanted, 1e-9).map_err(|e| Error::Internal(e.to_owned()))?,
        };
        let off = (&system * &weights - &wanted).amax();
        if off > 1e-3 {
            return Err(Error::registration(
                format!("no thin-plate spline passes through the {n} control points (off by {off:.3} mm)"),
                "check the bone labels: two bones may share a surface voxel",
            ));
        }
        Ok(Self { centres: moves.iter().map(|m| m.0).collect(), weights, middle })
    }

    /// Displacement at a point, mm, in double precision.
    pub fn at(&self, x: &Point3<f64>) -> Vector3<f64> {
        let n = self.centres.len();
        let row = |r: usize| self.weights.row(r).transpose().fixed_rows::<3>(0).into_owned();
        let d = x - self.middle;
        let affine = row(n) + row(n + 1) * d.x + row(n + 2) * d.y + row(n + 3) * d.z;
        self.centres.iter().enumerate().fold(affine, |sum, (i, c)| sum + row(i) * (x - c).norm())
    }

    /// Displacements at `out.len()` points from `start`, `step` apart, in single precision.
    fn along(&self, start: &Point3<f64>, step: &Vector3<f64>, row: &mut KernelRow) {
        let n = self.centres.len();
        let w = |r: usize, c: usize| self.weights[(r, c)];
        for a in 0..3 {
            let d = start - self.middle;
            let value = |d: &Vector3<f64>| w(n, a) + w(n + 1, a) * d.x + w(n + 2, a) * d.y + w(n + 3, a) * d.z;
            let (first, slope) = (value(&d), value(&(d + step)) - value(&d));
            for (i, o) in row.sum[a].iter_mut().enumerate() {
                *o = (first + slope * i as f64) as f32;
            }
        }
        let s = step.map(|v| v as f32);
        for (i, c) in self.centres.iter().enumerate() {
            let d = (start - c).map(|v| v as f32);
            for (r, at) in row.distance.iter_mut().zip(&row.position) {
                let (x, y, z) = (d.x + at * s.x, d.y + at * s.y, d.z + at * s.z);
                *r = (x * x + y * y + z * z).sqrt();
            }
            for a in 0..3 {
                let weight = w(i, a) as f32;
                for (o, r) in row.sum[a].iter_mut().zip(&row.distance) {
                    *o += weight * r;
                }
            }
        }
    }
}

/// Working space for one row of voxels.
struct KernelRow {
    position: Vec<f32>,
    distance: Vec<f32>,
    sum: [Vec<f32>; 3],
}

impl KernelRow {
    fn new(n: usize) -> Self {
        Self {
            position: (0..n).map(|i| i as f32).collect(),
            distance: vec![0.0; n],
            sum: std::array::from_fn(|_| vec![0.0; n]),
        }
    }
}

/// The push field on the planning grid, from control points that move with their bones.
///
/// Not confined to the patient and not rigid inside bones: that is what it is compared for.
///
/// # Errors
/// See [`ThinPlate::new`].
pub fn thin_plate(tissue: &Tissue<'_>, bones: &Initiators<'_>) -> Result<PushField> {
    let points = control_points(tissue, bones.transforms.len(), POINTS_PER_BONE);
    let moves: Vec<_> =
        points.iter().map(|p| (p.planning, bones.transforms[usize::from(p.bone)] * p.planning - p.planning)).collect();
    let spline = ThinPlate::new(&moves)?;
    let grid = tissue.ct.grid();
    let [ni, nj, _] = grid.size();
    let step: Vector3<f64> = grid.step().column(0).into_owned();
    let mut out = vec![[0f32; 3]; grid.len()];
    out.par_chunks_mut(ni * nj).enumerate().for_each(|(k, plane)| {
        let mut row = KernelRow::new(ni);
        for (j, line) in plane.chunks_mut(ni).enumerate() {
            spline.along(&grid.centre([0, j, k]), &step, &mut row);
            for (i, o) in line.iter_mut().enumerate() {
                *o = [row.sum[0][i], row.sum[1][i], row.sum[2][i]];
            }
        }
    });
    push_field(tissue, out)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn points() -> Vec<Point3<f64>> {
        (0..40)
            .map(|i| {
                let t = f64::from(i);
                Point3::new(90.0 * (1.3 * t).sin(), 70.0 * (2.1 * t).cos() - 200.0, 11.0 * t - 900.0)
            })
            .collect()
    }

    #[test]
    fn affine_motion_comes_back_everywhere() {
        let affine = |p: &Point3<f64>| Vector3::new(0.1 * p.x - 0.05 * p.z + 3.0, 0.02 * p.y, 0.03 * p.x + 0.01 * p.z);
        let spline = ThinPlate::new(&points().iter().map(|p| (*p, affine(p))).collect::<Vec<_>>()).unwrap();
        for p in [Point3::new(10.0, -180.0, -700.0), Point3::new(-300.0, 0.0, 100.0)] {
            assert!((spline.at(&p) - affine(&p)).norm() < 1e-6);
        }
    }

    #[test]
    fn control_points_move_as_told_and_single_precision_is_enough() {
        let wave = |p: &Point3<f64>| Vector3::new(8.0 * (p.z / 90.0).sin(), -5.0 * (p.x / 60.0).cos(), p.y / 70.0);
        let moves: Vec<_> = points().iter().map(|p| (*p, wave(p))).collect();
        let spline = ThinPlate::new(&moves).unwrap();
        assert!(moves.iter().all(|(p, u)| (spline.at(p) - u).norm() < 1e-6));
        let (start, step) = (Point3::new(-250.0, -210.0, -650.0), Vector3::new(0.7, 0.7, 0.1));
        let mut row = KernelRow::new(500);
        spline.along(&start, &step, &mut row);
        let off = (0..500).map(|i| {
            let exact = spline.at(&(start + step * f64::from(i as u32)));
            (exact - Vector3::from_fn(|a, _| f64::from(row.sum[a][i]))).norm()
        });
        assert!(off.fold(0.0, f64::max) < 2e-3);
    }

    #[test]
    fn one_point_is_a_shift_and_two_motions_of_one_point_are_refused() {
        let p = Point3::new(1.0, 2.0, 3.0);
        let shift = ThinPlate::new(&[(p, Vector3::x())]).unwrap();
        assert!((shift.at(&p) - Vector3::x()).norm() < 1e-9);
        assert!(ThinPlate::new(&[(p, Vector3::x()), (p, Vector3::y())]).is_err());
    }
}
