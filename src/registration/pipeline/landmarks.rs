//! What landmarks tell of a run, beside their residuals.

use crate::evaluate::landmark::{Landmark, LandmarkReport, LandmarkResidual};
use crate::field::PushField;
use crate::findings;
use crate::warning::{Warning, counted};
use nalgebra::Vector3;

/// A landmark is worse off than under the couch shift alone when it is so much farther off, mm: less is picking.
const PICKED_MM: f64 = 0.5;

/// Landmarks that lie where nothing was computed, or that the registration takes farther off than the couch shift alone does.
pub(super) fn warnings(
    landmarks: &[Landmark],
    push: &PushField,
    report: &LandmarkReport,
    couch: &Vector3<f64>,
) -> Vec<Warning> {
    let grid = push.computed.grid();
    let computed = |n: usize| grid.voxel_at(&landmarks[n].planning).is_some_and(|v| *push.computed.at(v));
    let all = 0..landmarks.len();
    let outside: Vec<&str> = all.filter(|n| !computed(*n)).map(|n| landmarks[n].name.as_str()).collect();
    let off = |l: &Landmark| (l.planning + couch - l.fraction).norm();
    let is_worse = |r: &&LandmarkResidual| r.after.is_some_and(|after| after > off(&r.landmark) + PICKED_MM);
    let worse: Vec<&str> = report.each.iter().filter(is_worse).map(|r| r.landmark.name.as_str()).collect();
    let mut out = Vec::new();
    if !outside.is_empty() {
        out.push(Warning::new(
            findings::LANDMARKS_OUTSIDE,
            format!(
                "{} where no displacement was computed: {}",
                counted(outside.len(), "landmark lies", "landmarks lie"),
                outside.join(", ")
            ),
        ));
    }
    if !worse.is_empty() {
        out.push(Warning::new(
            findings::LANDMARKS_WORSE,
            format!(
                "of {} {} farther off than under the couch shift alone: {}",
                counted(landmarks.len(), "landmark", "landmarks"),
                counted(worse.len(), "is", "are"),
                worse.join(", ")
            ),
        ));
    }
    out
}
