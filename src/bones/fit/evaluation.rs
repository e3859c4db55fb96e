//! What a measure of similarity says of one bone at one position, and what it may be told beforehand.

use crate::volume::ranges::RANGES;
use nalgebra::{Matrix6, SMatrix, SVector, Vector6};

/// Unexplained share that every image has; keeps the logarithm finite on noise-free ones.
pub(super) const LEAST_SHARE: f64 = 1e-6;

/// Similarity of one bone at one position.
#[derive(Debug, Clone)]
pub struct Evaluation {
    /// Cost.
    pub cost: f64,
    /// Gradient with respect to (rotation vector about the centre in radians, shift in mm).
    pub gradient: Vector6<f64>,
    /// Gauss-Newton curvature, positive semidefinite.
    pub curvature: Matrix6<f64>,
    /// Explained share `1 - q` of the visible samples.
    pub explained: f64,
    /// Mean visibility.
    pub visible: f64,
    /// Covariance of planning and fraction values and variance of the fraction's, each times the number of independent
    /// samples in view: the quotient is the bone's gain.
    pub contrast: [f64; 2],
    /// What the grey values of ranges of HU follow from, by the correlation ratio.
    pub normal: Option<Normal>,
}

/// What a bone's similarity takes from elsewhere instead of finding it anew at each position.
///
/// A sliver of a bone can buy a closer match by moving until more of it is in view, or by a gain that no scanner has.
#[derive(Debug, Clone, Copy)]
pub struct Held {
    /// Visible share that counts, whatever is in view.
    pub view: f64,
    /// Gain of the HU.
    pub gain: f64,
    /// Grey value of each range of HU, by the correlation ratio.
    pub grey: Option<Weights>,
}

impl Evaluation {
    /// Of a bone of which nothing is seen.
    pub fn nothing() -> Self {
        Self {
            cost: 0.0,
            gradient: Vector6::zeros(),
            curvature: Matrix6::zeros(),
            explained: 0.0,
            visible: 0.0,
            contrast: [0.0; 2],
            normal: None,
        }
    }
}

/// Sums of the least squares of grey values, each times the number of independent samples that one sample counts as: of several
/// bones they add up.
#[derive(Debug, Clone, Copy)]
pub struct Normal {
    /// Products of memberships.
    pub own: SMatrix<f64, RANGES, RANGES>,
    /// Products of memberships and grey values.
    pub both: Weights,
}

/// A value for each range of HU.
pub type Weights = SVector<f64, RANGES>;
