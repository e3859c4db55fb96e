//! How many samples are drawn, and how they are scaled.

use serde::{Deserialize, Serialize};

/// What is drawn.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SamplingOptions {
    /// How many samples; the same seed draws the same ones first, however many follow.
    pub number: usize,
    /// Seed: the same bits for the same run and seed.
    pub seed: u64,
    /// Standard deviation of each component of soft tissue over the map of uncertainty.
    pub scale: f64,
}

impl Default for SamplingOptions {
    fn default() -> Self {
        Self { number: 50, seed: 0, scale: SCALE }
    }
}

/// With it nine of ten mean errors of balls of 5 to 15 mm lie within the samples' interval on most cases (docs/decisions/samples.md).
const SCALE: f64 = 0.6;
/// More samples than this are refused.
const MOST: usize = 1000;

impl SamplingOptions {
    /// What is wrong with them, if anything.
    pub fn problem(&self) -> Option<String> {
        if !(2..=MOST).contains(&self.number) {
            return Some(format!("{} samples are asked for: give 2 to {MOST}", self.number));
        }
        (!(self.scale.is_finite() && self.scale > 0.0)).then(|| format!("a scale of {} is not above 0", self.scale))
    }
}

/// Over what lengths errors are alike, and what fractions of one planning scan have in common.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Correlation {
    /// Lengths of three random fields, mm, ascending: each is correlated by exp(-(d / length)^2).
    pub lengths_mm: [f64; 3],
    /// Share of the variance that has the first length; the second has the rest. The third takes what would fold tissue over a
    /// shorter one.
    pub first_share: f64,
    /// Share of soft tissue's variance that fractions of one planning scan have in common.
    pub common_tissue: f64,
    /// Share of the bones' variance that they have in common.
    pub common_bones: f64,
}

impl Correlation {
    /// Of a CT with its planning CT.
    pub const CT: Self =
        Self { lengths_mm: [8.0, 18.0, 60.0], first_share: 0.5, common_tissue: 0.2, common_bones: 0.0 };
    /// Of a fraction with other grey values: a cone-beam CT, an MR.
    pub const OTHER: Self =
        Self { lengths_mm: [17.0, 43.0, 100.0], first_share: 0.45, common_tissue: 0.25, common_bones: 0.85 };
}
