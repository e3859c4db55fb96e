//! The linear system of a step: how inverse-consistency errors answer to moves of soft voxels, and how smooth the moves are.

use super::POWER;
use super::inverse_error::InverseError;
use super::patch::{FIXED, Patch};
use crate::field::{PullField, PushField};
use crate::volume::Surrounding;
use nalgebra::{Matrix3, Vector3};
use rayon::prelude::*;
use std::collections::BTreeMap;

/// Weight of the moves themselves beside their roughness, 1/mm^2: what is not held anywhere stays.
const REST: f64 = 0.002;
/// Residual of the conjugate gradients, relative, and their limit.
const TOLERANCE: f64 = 1e-3;
const MOST_ITERATIONS: usize = 200;

/// Minimises over moves `d` of voxels, by their numbers in the patch: weighted squares of the errors, linear in `d`, plus the roughness of `d`.
pub(super) struct System {
    rows: Vec<SystemRow>,
    inverse: Vec<Answer>,
    /// The neighbours of each voxel by number, two along each axis.
    neighbours: Vec<[u32; 6]>,
    /// The weight of a difference between neighbours, by axis.
    stiffness: [f64; 3],
    /// The diagonal's part that the roughness makes.
    held: Vec<f64>,
}

/// One miss.
struct SystemRow {
    miss: Vector3<f64>,
    /// Square of its weight: a large error counts more.
    weight: f64,
    /// The voxel itself by number, and how the miss answers to it.
    own: u32,
    by: Matrix3<f64>,
    /// The fraction voxels around where it comes to lie, and their weights.
    around: [(u32, f64); 8],
}

impl SystemRow {
    /// By how much the miss changes when voxels move by `x`, to first order.
    fn change(&self, x: &[Vector3<f64>], pulled: &[Vector3<f64>]) -> Vector3<f64> {
        let back: Vector3<f64> = self.around.iter().map(|&(n, w)| pulled[n as usize] * w).sum();
        self.by * x[self.own as usize] - back
    }
}

/// How the pull at a fraction voxel answers to moves: by minus the inverse of the map's gradient at its pre-image.
struct Answer {
    back: Matrix3<f64>,
    /// The planning voxels around the pre-image by number, and their weights.
    around: [(u32, f64); 8],
}

impl System {
    pub(super) fn new(
        push: &PushField,
        pull: &PullField,
        errors: &[InverseError],
        patch: &Patch,
        limit: f64,
        roughness: f64,
    ) -> Self {
        let (planning, fraction) = (push.displacement.grid(), pull.displacement.grid());
        let mut known: BTreeMap<usize, u32> = BTreeMap::new();
        let mut rows = Vec::with_capacity(errors.len());
        for m in errors {
            let u = Vector3::from(push.displacement.data()[m.voxel].map(f64::from));
            let index = fraction.index(&(planning.centre(planning.voxel(m.voxel)) + u));
            let Some(around) = Surrounding::of(fraction, &index) else { continue };
            let mut number = |c: usize| {
                let next = known.len() as u32;
                (*known.entry(around.voxels[c]).or_insert(next), around.weights[c])
            };
            rows.push(SystemRow {
                miss: m.by,
                weight: (m.length() / limit).powi(POWER - 2),
                own: patch.number[m.voxel],
                by: Matrix3::identity() + around.slope(pull.displacement.data()) * fraction.inverse_step(),
                around: std::array::from_fn(&mut number),
            });
        }
        let mut inverse: Vec<(u32, usize)> = known.into_iter().map(|(voxel, n)| (n, voxel)).collect();
        inverse.sort_unstable();
        let answer = |&(_, voxel): &(u32, usize)| {
            let v = Vector3::from(pull.displacement.data()[voxel].map(f64::from));
            let around = Surrounding::of(planning, &planning.index(&(fraction.centre(fraction.voxel(voxel)) + v)));
            let found = around.and_then(|around| {
                let slope = around.slope(push.displacement.data()) * planning.inverse_step();
                let back = (Matrix3::identity() + slope).try_inverse()?;
                let of = |c: usize| (patch.number[around.voxels[c]], around.weights[c]);
                Some(Answer { back, around: std::array::from_fn(of) })
            });
            found.unwrap_or(Answer { back: Matrix3::zeros(), around: [(FIXED, 0.0); 8] })
        };
        let inverse = inverse.par_iter().map(answer).collect();
        let stiffness = planning.spacing().map(|h| roughness / (h * h));
        let held = |&v: &usize| {
            let linked = patch.linked(push, v);
            roughness * REST + linked.iter().zip(stiffness).map(|(&n, s)| n as f64 * s).sum::<f64>()
        };
        Self {
            rows,
            inverse,
            neighbours: std::iter::once([FIXED; 6]).chain(patch.movable.iter().map(|&v| patch.neighbours(v))).collect(),
            stiffness,
            held: std::iter::once(1.0).chain(patch.movable.iter().map(held)).collect(),
        }
    }

    /// The moves by number, mm, by conjugate gradients; that of [`FIXED`] is 0.
    pub(super) fn solve(&self) -> Vec<Vector3<f64>> {
        let n = self.held.len();
        let mut scratch = vec![Vector3::zeros(); self.inverse.len()];
        let mut x = vec![Vector3::zeros(); n];
        let mut r = vec![Vector3::zeros(); n];
        self.gather(|row| -row.miss * row.weight, &mut scratch, &mut r);
        let scale: Vec<Vector3<f64>> = self.diagonal().iter().map(|d| d.map(f64::recip)).collect();
        let mut z: Vec<Vector3<f64>> = r.iter().zip(&scale).map(|(r, s)| r.component_mul(s)).collect();
        let mut p = z.clone();
        let mut q = vec![Vector3::zeros(); n];
        let inner = |a: &[Vector3<f64>], b: &[Vector3<f64>]| a.iter().zip(b).map(|(a, b)| a.dot(b)).sum::<f64>();
        let first = inner(&r, &r);
        let mut along = inner(&r, &z);
        for _ in 0..MOST_ITERATIONS {
            if inner(&r, &r) <= TOLERANCE * TOLERANCE * first {
                break;
            }
            self.apply(&p, &mut scratch, &mut q);
            let length = along / inner(&p, &q);
            if !length.is_finite() {
                break;
            }
            for i in 0..n {
                x[i] += p[i] * length;
                r[i] -= q[i] * length;
                z[i] = r[i].component_mul(&scale[i]);
            }
            let next = inner(&r, &z);
            let share = next / along;
            along = next;
            for i in 0..n {
                p[i] = z[i] + p[i] * share;
            }
        }
        x
    }

    /// `out = (J'WJ + L) x`.
    fn apply(&self, x: &[Vector3<f64>], scratch: &mut [Vector3<f64>], out: &mut [Vector3<f64>]) {
        let pulled = self.pulled(x);
        self.gather(|row| row.change(x, &pulled) * row.weight, scratch, out);
        for (i, ((out, near), held)) in out.iter_mut().zip(&self.neighbours).zip(&self.held).enumerate() {
            let linked = |(d, &n): (usize, &u32)| x[n as usize] * self.stiffness[d / 2];
            *out += x[i] * *held - near.iter().enumerate().map(linked).sum::<Vector3<f64>>();
        }
    }

    /// By how much pre-images of the fraction voxels around go back when voxels move by `x`.
    fn pulled(&self, x: &[Vector3<f64>]) -> Vec<Vector3<f64>> {
        let of = |a: &Answer| a.back * a.around.iter().map(|&(n, w)| x[n as usize] * w).sum::<Vector3<f64>>();
        self.inverse.iter().map(of).collect()
    }

    /// By how much each miss changes when voxels move by `x`, to first order.
    #[cfg(test)]
    pub(super) fn changes(&self, x: &[Vector3<f64>]) -> Vec<Vector3<f64>> {
        let pulled = self.pulled(x);
        self.rows.iter().map(|row| row.change(x, &pulled)).collect()
    }

    /// `out = J' e`, where `e` is what each row has.
    fn gather(&self, e: impl Fn(&SystemRow) -> Vector3<f64>, scratch: &mut [Vector3<f64>], out: &mut [Vector3<f64>]) {
        scratch.fill(Vector3::zeros());
        out.fill(Vector3::zeros());
        for row in &self.rows {
            let e = e(row);
            out[row.own as usize] += row.by.transpose() * e;
            for &(n, w) in &row.around {
                scratch[n as usize] -= e * w;
            }
        }
        for (answer, s) in self.inverse.iter().zip(scratch.iter()) {
            let s = answer.back.transpose() * s;
            for &(n, w) in &answer.around {
                out[n as usize] += s * w;
            }
        }
        // What is fixed stays.
        out[FIXED as usize] = Vector3::zeros();
    }

    /// About the diagonal of the system, for the scale of the conjugate gradients: as if no two paths led to one voxel.
    fn diagonal(&self) -> Vec<Vector3<f64>> {
        let squares = |m: &Matrix3<f64>| Vector3::from_fn(|c, _| m.column(c).norm_squared());
        let mut out: Vec<Vector3<f64>> = self.held.iter().map(|&h| Vector3::repeat(h)).collect();
        let mut weight = vec![0.0; self.inverse.len()];
        for row in &self.rows {
            out[row.own as usize] += squares(&row.by) * row.weight;
            for &(n, w) in &row.around {
                weight[n as usize] += row.weight * w * w;
            }
        }
        for (answer, weight) in self.inverse.iter().zip(weight) {
            for &(n, w) in &answer.around {
                out[n as usize] += squares(&answer.back) * (weight * w * w);
            }
        }
        out
    }
}
