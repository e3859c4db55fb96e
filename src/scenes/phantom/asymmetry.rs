//! What keeps the two sides of the phantom apart, as people's are: its solids are drawn alike on both, and bent here.
//!
//! The spine curves to one side and back, one shoulder is lower, one half of the face and of the neck lies further forward,
//! and the chin is off the middle; by 2 to 4 mm each, as faces and shoulders of healthy people differ. None of it is the
//! motion of a rigid body, so that no turn of the head explains it. The bend is smooth (no distance changes by more than
//! a tenth), and in motion bones are as rigid as they would be without: only their shapes are bent.

use super::shape::V3;
use super::texture::smoothstep;
use std::f64::consts::TAU;

/// How far the spine curves to the left and to the right, mm, and the height of a full wave.
const CURVE_MM: f64 = 2.0;
const CURVE_HEIGHT: f64 = 270.0;
/// How far a point of one side lies in front, mm, at the sides of a head this wide.
const FORWARD_MM: f64 = 2.0;
const FORWARD_HALF_WIDTH: f64 = 70.0;
/// How much lower the left shoulder is, mm per mm from the middle; fading between these heights.
const LOWER: f64 = 0.02;
const LOWER_BELOW: [f64; 2] = [-170.0, -60.0];
/// How far the chin lies to the left, mm; in front of, and below, these lines.
const CHIN_MM: f64 = 2.5;
const CHIN_FRONT: [f64; 2] = [-90.0, -30.0];
const CHIN_BELOW: [f64; 2] = [-60.0, 10.0];

/// Nothing is moved by more than this along an axis, mm.
pub(super) const MOST_MM: f64 = 6.0;

/// How far what is drawn at a point is moved by the bend, mm.
fn bend(p: &V3) -> V3 {
    let curve = CURVE_MM * (TAU * p.z / CURVE_HEIGHT).sin();
    let chin = CHIN_MM
        * smoothstep(CHIN_FRONT[1], CHIN_FRONT[0], p.y)
        * smoothstep(CHIN_BELOW[1], CHIN_BELOW[0], p.z)
        * smoothstep(-160.0, -110.0, p.z);
    let side = (p.x / FORWARD_HALF_WIDTH).clamp(-1.0, 1.0);
    let forward = -FORWARD_MM * side * (1.5 - 0.5 * side * side);
    let lower = -LOWER * p.x * smoothstep(LOWER_BELOW[1], LOWER_BELOW[0], p.z);
    V3::new(curve + chin, forward, lower)
}

/// The point of the drawing that lies at a point of the patient.
pub(super) fn drawn_at(patient: &V3) -> V3 {
    patient - bend(patient)
}

/// Where a point of the drawing lies in the patient.
pub(super) fn placed(drawn: &V3) -> V3 {
    // The bend's slopes are far below 1: each step takes an order off the error.
    (0..24).fold(*drawn, |at, _| drawn + bend(&at))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn points() -> impl Iterator<Item = V3> {
        (0..400u32).map(|n| {
            let at = |prime: f64, low: f64, high: f64| low + (high - low) * (f64::from(n) * prime).fract();
            V3::new(at(0.618_034, -200.0, 200.0), at(0.754_878, -120.0, 100.0), at(0.569_840, -280.0, 140.0))
        })
    }

    #[test]
    fn placing_and_drawing_undo_each_other() {
        for p in points() {
            assert!((drawn_at(&placed(&p)) - p).norm() < 1e-9, "{p:?}");
        }
    }

    #[test]
    fn distances_hardly_change_and_the_sides_differ() {
        let mut apart = 0.0f64;
        for p in points() {
            let slope = |a: usize| (bend(&(p + V3::ith(a, 1e-4))) - bend(&(p - V3::ith(a, 1e-4)))) / 2e-4;
            let most = nalgebra::Matrix3::from_columns(&[slope(0), slope(1), slope(2)]).singular_values().max();
            assert!(most < 0.12, "{p:?}: {most}");
            // What a mirror image would have instead.
            let mirror = |v: V3| V3::new(-v.x, v.y, v.z);
            assert!(bend(&p).amax() < MOST_MM, "{p:?}");
            apart = apart.max((bend(&p) - mirror(bend(&mirror(p)))).norm());
        }
        assert!(apart > 5.0, "{apart}");
    }
}
