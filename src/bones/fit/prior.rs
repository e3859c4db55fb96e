//! What a joint allows: a Gaussian about the planning posture, with steep sides beyond the soft range.

use super::lie::left_jacobian_inverse;
use crate::geometry::Rigid;
use crate::skeleton::{Excess, Joint, JointPose};
use nalgebra::{Matrix3, SMatrix, SVector, Vector3};
use serde::{Deserialize, Serialize};
use std::fmt;

/// Standard deviation inside the soft range as a share of half the range.
const INSIDE: f64 = 0.5;
/// Greatest standard deviations inside the soft range: a patient is set up in the posture of planning, so that a joint
/// uses a small part of what anatomy allows. Degrees and mm.
const MOST_DEG: f64 = 8.0;
const MOST_MM: f64 = 5.0;
/// Standard deviation of the excess beyond a rotation limit, degrees.
const BEYOND_DEG: f64 = 1.5;
/// Standard deviation of the excess beyond a translation limit, mm.
const BEYOND_MM: f64 = 0.5;
/// Least standard deviations (fused joints), degrees and mm.
const LEAST_DEG: f64 = 0.02;
const LEAST_MM: f64 = 0.01;

/// Penalty of one joint: value, gradient and curvature with respect to small motions of parent and child.
///
/// Order of the 12 variables: parent rotation (radians, about `parent_centre`), parent shift (mm), child likewise.
pub struct Penalty {
    /// Negative log-density, 0 in the planning posture.
    pub cost: f64,
    /// Gradient.
    pub gradient: SVector<f64, 12>,
    /// Gauss-Newton curvature.
    pub curvature: SMatrix<f64, 12, 12>,
}

/// Joint motion between two bone transforms, in joint axes.
pub fn relative(joint: &Joint, parent: &Rigid, child: &Rigid) -> JointPose {
    let m = parent.inverse() * child;
    let back = joint.axes.transpose();
    JointPose {
        rotation: (back * m.rotation.scaled_axis()).into(),
        translation: (back * (m * joint.centre - joint.centre)).into(),
    }
}

/// How far a joint lies beyond its soft range, along the worst axis; 0 inside it.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct BeyondRange {
    /// Of its rotation, degrees.
    pub rotation_deg: f64,
    /// Of its shift, mm.
    pub shift_mm: f64,
}

impl BeyondRange {
    /// The worst of what a joint is beyond its ranges.
    pub fn of(excess: &Excess) -> Self {
        let most = |values: &[f64; 3]| values.iter().map(|v| v.abs()).fold(0.0, f64::max);
        Self { rotation_deg: most(&excess.rotation_deg), shift_mm: most(&excess.translation_mm) }
    }

    /// Whether the joint has left its range.
    pub fn any(&self) -> bool {
        self.rotation_deg > 0.0 || self.shift_mm > 0.0
    }
}

impl fmt::Display for BeyondRange {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let parts = [(self.rotation_deg, "degrees"), (self.shift_mm, "mm")];
        let parts = parts.iter().filter(|p| p.0 > 0.0).map(|(value, unit)| match value {
            // Not as "0.0", which reads as if it were inside.
            v if *v < 0.05 => format!("less than 0.1 {unit}"),
            v => format!("{v:.1} {unit}"),
        });
        f.write_str(&parts.collect::<Vec<_>>().join(" and "))
    }
}

/// Penalty of a joint; centres are where the small rotations of parent and child turn about (world, fraction side).
pub fn penalty(
    joint: &Joint,
    parent: &Rigid,
    child: &Rigid,
    parent_centre: &Vector3<f64>,
    child_centre: &Vector3<f64>,
) -> Penalty {
    let at_parent = (parent * joint.centre).coords;
    let at_child = (child * joint.centre).coords;
    let to_axes: Matrix3<f64> = joint.axes.transpose() * parent.rotation.inverse().to_rotation_matrix().matrix();
    let pose = relative(joint, parent, child);
    let phi = joint.axes * Vector3::from(pose.rotation);
    // Rotation: d phi = J^-1 R_p^T (w_c - w_p).
    let turn =
        joint.axes.transpose() * left_jacobian_inverse(&phi) * parent.rotation.inverse().to_rotation_matrix().matrix();
    let mut rows = SMatrix::<f64, 6, 12>::zeros();
    rows.fixed_view_mut::<3, 3>(0, 0).copy_from(&-turn);
    rows.fixed_view_mut::<3, 3>(0, 6).copy_from(&turn);
    // Translation: t = A^T R_p^T (q_c - q_p); the parent's rotation also turns the frame it is seen in.
    let gap = at_child - at_parent;
    rows.fixed_view_mut::<3, 3>(3, 0)
        .copy_from(&(to_axes * ((at_parent - parent_centre).cross_matrix() + gap.cross_matrix())));
    rows.fixed_view_mut::<3, 3>(3, 3).copy_from(&-to_axes);
    rows.fixed_view_mut::<3, 3>(3, 6).copy_from(&(-to_axes * (at_child - child_centre).cross_matrix()));
    rows.fixed_view_mut::<3, 3>(3, 9).copy_from(&to_axes);
    let mut out = Penalty { cost: 0.0, gradient: SVector::zeros(), curvature: SMatrix::zeros() };
    let mut add = |row: usize, residual: f64, sd: f64| {
        let r = rows.row(row) / sd;
        out.cost += 0.5 * (residual / sd).powi(2);
        out.gradient += r.transpose() * (residual / sd);
        out.curvature += r.transpose() * r;
    };
    for a in 0..3 {
        let [low, high] = joint.rotation_range_deg[a].map(f64::to_radians);
        let angle = pose.rotation[a];
        add(a, angle, (INSIDE * 0.5 * (high - low)).clamp(LEAST_DEG.to_radians(), MOST_DEG.to_radians()));
        let excess = angle - angle.clamp(low.min(high), high.max(low));
        if excess != 0.0 {
            add(a, excess, BEYOND_DEG.to_radians());
        }
        let range = joint.translation_range_mm[a];
        let shift = pose.translation[a];
        add(3 + a, shift, (INSIDE * range).clamp(LEAST_MM, MOST_MM));
        let excess = shift - shift.clamp(-range, range);
        if excess != 0.0 {
            add(3 + a, excess, BEYOND_MM);
        }
    }
    out
}
