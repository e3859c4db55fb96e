//! Settings of the refinement by image.

use super::level::mean_edge;
use crate::chainmail::Lattice;
use serde::{Deserialize, Serialize};

/// How strongly and how often the images pull.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RefineOptions {
    /// Weight of the images' grey values against the chain mail's elasticity; 0 leaves soft tissue to bones and skin.
    pub weight: f64,
    /// Times that the images are compared anew at each spacing of the relaxation, at most.
    pub passes: usize,
    /// An element that moves by no more than this share of the elements' spacing after a comparison has settled: it is not
    /// compared again while all beside it have settled too, and none is once all but a hundredth have.
    pub settled: f64,
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
    /// The farthest that images draw an element away from where its links alone would hold it, as a share of the elements'
    /// spacing: a single element does not follow what its neighbours know nothing of.
    pub departure: f64,
    /// The skin's own pull.
    pub skin: SkinOptions,
}

impl RefineOptions {
    /// Whether anything pulls besides bones and links.
    pub fn pulls(&self) -> bool {
        self.weight > 0.0 || self.skin.weight > 0.0
    }

    /// [`crate::chainmail::Pull::farthest`] on a lattice, mm.
    pub(super) fn farthest(&self, lattice: &Lattice) -> f32 {
        (self.departure * mean_edge(&lattice.grid.spacing())) as f32
    }
}

/// The outline of the fraction as an initiator of its own.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SkinOptions {
    /// Weight of the skin against the chain mail's elasticity; 0 for none.
    pub weight: f64,
    /// How well an outline tells where the skin is, one standard deviation, mm.
    pub sd_mm: f64,
    /// The skin is not believed within half of this distance from the edge of either scan, and fully from one and a half
    /// on, mm.
    pub edge_mm: f64,
}

impl Default for SkinOptions {
    fn default() -> Self {
        Self { weight: 0.0, sd_mm: 0.5, edge_mm: 6.0 }
    }
}

impl Default for RefineOptions {
    fn default() -> Self {
        Self {
            weight: 1.0,
            passes: 8,
            settled: 0.015,
            rounds: 3,
            blur: 0.2,
            least_blur: 0.4,
            window_hu: [-250.0, 300.0],
            robust: 2.0,
            departure: 0.04,
            skin: SkinOptions::default(),
        }
    }
}
