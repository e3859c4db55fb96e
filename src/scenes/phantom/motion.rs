//! The true motion: bones exactly rigid, soft tissue by a smooth blend of their screw motions.
//!
//! This is neither the chain mail nor its relaxation. A cubic B-spline lattice holds twists (logarithms of rigid
//! motions, Arsigny et al. 2005, "Polyrigid and polyaffine transformations"), blended by Euclidean distance to
//! the analytic bones, and a smooth random motion that fades towards bone. Close to a bone the blend hands over to
//! that bone's own twist, with weights that grow without bound at its surface. So the push map is exact in bone,
//! once differentiable outside bone, and can be evaluated, and inverted, at any point.

use super::anatomy::Anatomy;
use super::asymmetry::drawn_at;
use super::lattice::{CHANNELS, Lattice};
use super::shape::{Bounds, V3};
use super::texture::{smoothstep, uniform};
use crate::geometry::Rigid;
use nalgebra::{Matrix3, Point3, Translation3, UnitQuaternion};
use std::f64::consts::TAU;

/// Distance over which a bone's own motion takes over, mm; within the anatomy's bone reach.
const HANDOVER: f64 = 9.0;
/// Residual to which the push map is inverted, mm.
pub const INVERSE_TOLERANCE: f64 = 1e-4;
/// Waves of the random soft-tissue motion.
const WAVES: u64 = 14;

/// The true push map of a posed phantom.
#[derive(Debug, Clone)]
pub struct TrueMotion {
    anatomy: Anatomy,
    transforms: Vec<Rigid>,
    twists: Vec<[f64; 6]>,
    lattice: Lattice,
    scanner: V3,
    rough_shift: V3,
}

/// Motion of a neighbourhood: rigid, then a shift.
#[derive(Debug, Clone, Copy)]
struct Local {
    rigid: Rigid,
    shift: V3,
}

/// Where a fraction point was in the planning posture.
#[derive(Debug, Clone, Copy)]
pub struct PreImage {
    /// The planning point.
    pub point: Point3<f64>,
    /// Distance between its image and the fraction point, mm.
    pub residual: f64,
    /// Where the map takes the planning point.
    image: Point3<f64>,
    /// Estimate of the inverse of the map's derivative there.
    inverse: Matrix3<f64>,
}

/// Random motion of soft tissue.
#[derive(Debug, Clone, Copy)]
pub(super) struct RandomMotion {
    /// The greatest along each axis, mm.
    pub(super) mm: f64,
    pub(super) seed: u64,
}

impl TrueMotion {
    /// The motion in which bone `n` of the anatomy moves by `posed[n]` and then everything by `scanner`, over at
    /// least the box `within`, with a random motion of soft tissue.
    pub(super) fn new(anatomy: Anatomy, posed: &[Rigid], scanner: V3, within: Bounds, random: RandomMotion) -> Self {
        let twists: Vec<[f64; 6]> = posed.iter().map(twist).collect();
        let transforms: Vec<Rigid> = posed.iter().map(|t| Translation3::from(scanner) * t).collect();
        let boxes: Vec<Bounds> = anatomy.bones().iter().map(|b| b.solid.bounds()).collect();
        let lattice = Lattice::new(within, |x| node(&anatomy, &boxes, &twists, x, random));
        let middle = |n: usize| Point3::from((boxes[n][0] + boxes[n][1]) / 2.0);
        let shifts = transforms.iter().enumerate().map(|(n, t)| t * middle(n) - middle(n));
        let rough_shift = shifts.sum::<V3>() / boxes.len() as f64;
        Self { anatomy, transforms, twists, lattice, scanner, rough_shift }
    }

    /// The anatomy that moves.
    pub fn anatomy(&self) -> &Anatomy {
        &self.anatomy
    }

    /// Where a planning point goes in the fraction.
    pub fn push(&self, point: &Point3<f64>) -> Point3<f64> {
        let local = self.local(&point.coords);
        local.rigid * point + local.shift
    }

    /// Where a fraction point was in planning, searched from the pre-image of a point near by, if known.
    ///
    /// The residual tells whether the search has ended: it is at most [`INVERSE_TOLERANCE`] then.
    pub fn pull(&self, target: &Point3<f64>, near: Option<&PreImage>) -> PreImage {
        let start = near.copied().unwrap_or_else(|| self.guess(target));
        let mut best = self.step(&start, target);
        let mut fresh = false;
        for _ in 0..20 {
            if best.residual <= INVERSE_TOLERANCE {
                return best;
            }
            let next = self.step(&best, target);
            if next.residual <= 0.6 * best.residual {
                best = next;
            } else if fresh {
                break;
            } else {
                // The estimate came from elsewhere: begin again with the motion here.
                best = self.check(best.point, target);
                fresh = true;
            }
        }
        self.newton(best, target)
    }

    /// A first guess of a pre-image: two steps from the bones' mean shift.
    pub(super) fn guess(&self, target: &Point3<f64>) -> PreImage {
        let first = self.check(target - self.rough_shift, target);
        self.check(first.towards(target), target)
    }

    /// One step of Broyden's (1965) method: the estimate of the derivative learns from each evaluation.
    fn step(&self, from: &PreImage, target: &Point3<f64>) -> PreImage {
        let point = from.towards(target);
        let image = self.push(&point);
        let moved = point - from.point;
        let predicted = from.inverse * (image - from.image);
        let scale = moved.dot(&predicted);
        let mut inverse = from.inverse;
        if scale > 0.2 * moved.norm_squared() && scale > 1e-16 {
            inverse += (moved - predicted) * (moved.transpose() * from.inverse) / scale;
        }
        PreImage { point, residual: (image - target).norm(), image, inverse }
    }

    /// Damped Newton steps for places where the motion changes quickly, such as between the teeth.
    fn newton(&self, mut best: PreImage, target: &Point3<f64>) -> PreImage {
        const H: f64 = 1e-4;
        for _ in 0..40 {
            if best.residual <= INVERSE_TOLERANCE {
                break;
            }
            let column = |a: usize| {
                let mut e = V3::zeros();
                e[a] = H;
                (self.push(&(best.point + e)) - self.push(&(best.point - e))) / (2.0 * H)
            };
            let jacobian = Matrix3::from_columns(&[column(0), column(1), column(2)]);
            let miss = target - self.push(&best.point);
            let Some(inverse) = jacobian.try_inverse() else { break };
            let step = inverse * miss;
            let tries = (0..12).map(|n| self.check(best.point + step * 0.5f64.powi(n), target));
            match tries.into_iter().find(|t| t.residual < best.residual) {
                Some(t) => best = t,
                None => break,
            }
        }
        best
    }

    /// A candidate with the local rotation as the estimate of the derivative.
    fn check(&self, point: Point3<f64>, target: &Point3<f64>) -> PreImage {
        let local = self.local(&point.coords);
        let image = local.rigid * point + local.shift;
        let inverse = local.rigid.rotation.inverse().to_rotation_matrix().into_inner();
        PreImage { point, residual: (image - target).norm(), image, inverse }
    }

    /// The rotation of the neighbourhood of a planning point, planning to fraction; a bone's own in bone.
    pub(super) fn turn(&self, p: &V3) -> UnitQuaternion<f64> {
        self.local(p).rigid.rotation
    }

    fn local(&self, p: &V3) -> Local {
        let near = self.anatomy.near_bones(p);
        if let Some((bone, _)) = near.bones().iter().find(|b| b.1 <= 0.0) {
            return Local { rigid: self.transforms[usize::from(*bone)], shift: V3::zeros() };
        }
        let mut sum = self.lattice.at(p);
        let mut total = 1.0;
        for &(bone, d) in near.bones().iter().filter(|b| b.1 < HANDOVER) {
            let weight = (HANDOVER / d - 1.0).powi(2).min(1e18);
            total += weight;
            for (s, t) in sum.iter_mut().zip(&self.twists[usize::from(bone)]) {
                *s += weight * t;
            }
        }
        let s = sum.map(|v| v / total);
        Local {
            rigid: exponential(&[s[0], s[1], s[2], s[3], s[4], s[5]]),
            shift: V3::new(s[6], s[7], s[8]) + self.scanner,
        }
    }
}

impl PreImage {
    /// Where another fraction point near by came from, as far as the estimate of the derivative tells.
    pub(super) fn towards(&self, target: &Point3<f64>) -> Point3<f64> {
        self.point + self.inverse * (target - self.image)
    }
}

/// Blended twist and random motion at a lattice node.
fn node(anatomy: &Anatomy, boxes: &[Bounds], twists: &[[f64; 6]], x: &V3, random: RandomMotion) -> [f64; CHANNELS] {
    let drawn = drawn_at(x);
    let mut order: Vec<(f64, usize)> = boxes.iter().enumerate().map(|(n, b)| (box_distance(b, &drawn), n)).collect();
    order.sort_by(|a, b| a.0.total_cmp(&b.0));
    let (mut nearest, mut total, mut out) = (f64::MAX, 0.0, [0.0; CHANNELS]);
    for (at_least, bone) in order {
        // Bones this much farther than the nearest would weigh about 1 %.
        if at_least > 4.0 * nearest + 12.0 {
            break;
        }
        // From afar a bone is its box.
        let d = if at_least > 40.0 { at_least } else { anatomy.bones()[bone].solid.distance(&drawn).max(0.0) };
        nearest = nearest.min(d);
        let weight = (d + 3.0).powi(-3);
        total += weight;
        for (o, t) in out.iter_mut().zip(&twists[bone]) {
            *o += weight * t;
        }
    }
    for o in &mut out[..6] {
        *o /= total;
    }
    let fade = random.mm * smoothstep(3.0, 28.0, nearest);
    if fade > 0.0 {
        let r = random_motion(x, random.seed) * fade;
        out[6..].copy_from_slice(r.as_slice());
    }
    out
}

/// Sum of seeded plane waves of 60 to 150 mm, at most 1 along each axis in practice.
fn random_motion(x: &V3, seed: u64) -> V3 {
    let mut out = V3::zeros();
    for n in 0..WAVES {
        let r = |m: u64| uniform(seed, 8 * n + m);
        let direction = V3::new(r(0), r(1), r(2)).normalize();
        let phase = TAU * (direction.dot(x) / (105.0 + 45.0 * r(3)) + r(4));
        out += V3::new(r(5), r(6), r(7)) * phase.sin();
    }
    out * 0.4
}

fn box_distance([lo, hi]: &Bounds, p: &V3) -> f64 {
    (lo - p).sup(&(p - hi)).sup(&V3::zeros()).norm()
}

/// Logarithm of a rigid motion: rotation vector, then the translation part.
fn twist(t: &Rigid) -> [f64; 6] {
    let w = t.rotation.scaled_axis();
    let v = left_jacobian(&w).try_inverse().map_or(t.translation.vector, |inverse| inverse * t.translation.vector);
    [w.x, w.y, w.z, v.x, v.y, v.z]
}

/// Rigid motion of a twist.
fn exponential(s: &[f64; 6]) -> Rigid {
    let w = V3::new(s[0], s[1], s[2]);
    let v = left_jacobian(&w) * V3::new(s[3], s[4], s[5]);
    Rigid::from_parts(Translation3::from(v), UnitQuaternion::from_scaled_axis(w))
}

/// Integral of the rotation along the screw; takes the twist's translation part to the translation.
fn left_jacobian(w: &V3) -> Matrix3<f64> {
    let a2 = w.norm_squared();
    let a = a2.sqrt();
    let (b, c) = if a < 1e-4 {
        (0.5 - a2 / 24.0, 1.0 / 6.0 - a2 / 120.0)
    } else {
        ((1.0 - a.cos()) / a2, (a - a.sin()) / (a2 * a))
    };
    let k = w.cross_matrix();
    Matrix3::identity() + k * b + k * k * c
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn exponential_undoes_the_logarithm(w in prop::array::uniform3(-1.8f64..1.8), v in prop::array::uniform3(-300.0f64..300.0)) {
            let t = Rigid::new(V3::from(v), V3::from(w));
            let back = exponential(&twist(&t));
            prop_assert!((back.to_homogeneous() - t.to_homogeneous()).abs().max() < 1e-9);
        }

        #[test]
        fn half_a_screw_twice_is_the_screw(w in prop::array::uniform3(-1.5f64..1.5), v in prop::array::uniform3(-300.0f64..300.0)) {
            let t = Rigid::new(V3::from(v), V3::from(w));
            let half = exponential(&twist(&t).map(|s| s / 2.0));
            prop_assert!(((half * half).to_homogeneous() - t.to_homogeneous()).abs().max() < 1e-8);
        }
    }
}
