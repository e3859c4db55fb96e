//! Settings of the refinement by image.

use serde::{Deserialize, Serialize};

/// How strongly and how often the images pull.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RefineOptions {
    /// Weight of the images against the chain mail's elasticity; 0 leaves soft tissue to the bones alone.
    pub weight: f64,
    /// Times that the images are compared anew at each spacing of the relaxation.
    pub passes: usize,
    /// Rounds of relaxation after each comparison.
    pub rounds: usize,
    /// Blur (sigma) of both images, as a share of the elements' spacing.
    pub blur: f64,
    /// Least blur (sigma), as a share of the voxels' mean edge.
    pub least_blur: f64,
    /// HU below and above which all is alike: air and bone are the model's and the skeleton's business.
    pub window_hu: [f32; 2],
    /// Differences beyond this many times the noise count less (Huber).
    pub robust: f64,
}

impl Default for RefineOptions {
    fn default() -> Self {
        Self { weight: 1.0, passes: 8, rounds: 3, blur: 0.2, least_blur: 0.4, window_hu: [-250.0, 300.0], robust: 2.0 }
    }
}
