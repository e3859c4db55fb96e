//! Landmark residuals before and after (thesis 4.3.3).

use crate::stats::Summary;
use nalgebra::Point3;
use serde::{Deserialize, Serialize};

/// A point known in both images, LPS mm.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Landmark {
    /// Its name.
    pub name: String,
    /// Position in the planning CT.
    pub planning: Point3<f64>,
    /// Position in the fraction CT.
    pub fraction: Point3<f64>,
}

/// Residual of one landmark.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct LandmarkResidual {
    /// The landmark.
    pub landmark: Landmark,
    /// Where the push field takes the planning position; `None` outside the planning grid.
    pub mapped: Option<Point3<f64>>,
    /// Distance before registration, mm (|x_planning - x_fraction|).
    pub before: f64,
    /// Distance after, mm (|x_mapped - x_fraction|); `None` outside the planning grid.
    pub after: Option<f64>,
}

/// Residuals of a set of landmarks.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct LandmarkReport {
    /// Each landmark's residual.
    pub each: Vec<LandmarkResidual>,
    /// Distances before, mm.
    pub before: Summary,
    /// Distances after, mm.
    pub after: Summary,
    /// Mean over landmarks of after / before (thesis eq. 4.2 as eq. 4.3 reads it).
    pub mean_of_ratios: f64,
    /// Standard deviation (n - 1) of after / before (thesis eq. 4.3).
    pub std_of_ratios: f64,
    /// Mean after / mean before: the steadier figure.
    pub ratio_of_means: f64,
}
