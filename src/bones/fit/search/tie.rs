//! What a joint costs between candidates, which lie where they are within a few millimetres and degrees.

use super::super::prior::relative;
use crate::geometry::Rigid;
use crate::skeleton::Joint;

/// Standard deviation inside the soft range as a share of half of it, at least these (degrees, mm).
const INSIDE: f64 = 0.7;
const LEAST_DEG: f64 = 8.0;
const LEAST_MM: f64 = 4.0;
/// Standard deviation of the excess beyond it.
const BEYOND_DEG: f64 = 4.0;
const BEYOND_MM: f64 = 2.0;

/// Negative log-density of a joint between two motions.
pub fn tie(joint: &Joint, parent: &Rigid, child: &Rigid) -> f64 {
    let pose = relative(joint, parent, child);
    let square = |value: f64, low: f64, high: f64, least: f64, beyond: f64| {
        let sd = (INSIDE * 0.5 * (high - low)).max(least);
        let excess = value - value.clamp(low.min(high), high.max(low));
        0.5 * ((value / sd).powi(2) + (excess / beyond).powi(2))
    };
    (0..3)
        .map(|a| {
            let [low, high] = joint.rotation_range_deg[a];
            let range = joint.translation_range_mm[a];
            square(pose.rotation[a].to_degrees(), low, high, LEAST_DEG, BEYOND_DEG)
                + square(pose.translation[a], -range, range, LEAST_MM, BEYOND_MM)
        })
        .sum()
}
