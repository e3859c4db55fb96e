//! Rank 5: the pose of the skeleton that best explains the fraction CT.

use crate::geometry::Rigid;
use serde::{Deserialize, Serialize};

/// How well one bone's position is known after the fit.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct BoneFit {
    /// Bone name.
    pub name: String,
    /// Planning to fraction, LPS mm.
    pub transform: Rigid,
    /// Share (0 to 1) of the bone's sample points that fall inside the fraction image.
    pub visible: f64,
    /// Similarity (1 best, 0 none) after couch shift alone; `None` when nothing is visible.
    pub similarity_before: Option<f64>,
    /// Similarity after the fit.
    pub similarity_after: Option<f64>,
    /// Why the last optimisation that moved this bone stopped.
    pub stop: String,
    /// One standard deviation of the bone's position (mm, worst direction at its centroid), from the cost's curvature.
    pub position_sd_mm: f64,
    /// One standard deviation of the bone's rotation (degrees, worst axis), from the cost's curvature.
    pub rotation_sd_deg: f64,
    /// Largest excess over a joint limit: degrees or mm beyond the soft range; 0 inside it.
    pub limit_excess: f64,
    /// Mean displacement of the bone's points, mm.
    pub motion_mm: f64,
    /// `image` when the image determined the bone, `joint` when it follows its parent.
    pub determined_by: String,
}
