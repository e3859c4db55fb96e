//! Settings of the refinement by image.

use super::guide::GuideOptions;
use crate::chainmail::Lattice;
use crate::volume::Window;
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
    /// Blur (sigma) of both images, as a share of the elements' spacing; no setting: 0.35 is worse on all cases.
    #[serde(skip)]
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
    /// What is done about a fraction whose grey values differ from planning's, as a cone-beam CT's do.
    pub shading: ShadingOptions,
    /// The skin's own pull.
    pub skin: SkinOptions,
    /// The pull of structures that both scans outline.
    pub guide: GuideOptions,
}

/// When a fraction's grey values are corrected before images pull, and how they pull then.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ShadingOptions {
    /// Shading from here on is taken out, HU; below it a CT is as good as its gain and offset.
    pub least_hu: f64,
    /// A gain that departs from 1 by more is taken out too.
    pub least_gain: f64,
}

impl Default for ShadingOptions {
    fn default() -> Self {
        Self { least_hu: 20.0, least_gain: 0.15 }
    }
}

/// Where planning shows lung, HU below the window count at this scale inside the patient: its vessels are contrast. Without it
/// a repeated chest CT errs by 4.2 mm, with it by 1.85 (docs/decisions/images.md).
const LUNG_SCALE: f32 = 0.3;

/// The window that holds the borders of air and bone, HU.
const BORDERS_HU: [f32; 2] = [-500.0, 500.0];

impl RefineOptions {
    /// These for a fraction whose grey values were corrected.
    pub(super) fn corrected(&self) -> Self {
        Self {
            // Such an image is noisier than its voxels tell, whose noise hangs together. With half the weight and less blur
            // cone-beam cases err by 0.62 and 0.29 mm, as a CT does by 0.64 and 0.30 (docs/decisions/images.md).
            weight: self.weight * 0.5,
            blur: 0.15,
            least_blur: 0.3,
            // The borders of air and bone are what noise hides least: 0.57 mm for 0.62.
            window_hu: BORDERS_HU,
            ..self.clone()
        }
    }

    /// These for planning that is shown as an MR.
    pub(super) fn translated(&self) -> Self {
        // What planning does not tell of the fraction's texture counts as noise, and weakens the pull. With twice the weight, not
        // half, smooth motion errs by 0.89 mm for 1.00 (T2), posed motion by 0.59 for 0.56 (docs/decisions/mr.md).
        Self { weight: self.weight * 2.0, window_hu: BORDERS_HU, ..self.clone() }
    }

    /// The window in which images are compared; `lung` tells whether planning shows any.
    pub fn window(&self, lung: bool) -> Window {
        let [low, high] = self.window_hu;
        Window { low, high, thin: if lung { LUNG_SCALE } else { 0.0 } }
    }

    /// Whether anything pulls besides bones and links.
    pub fn pulls(&self) -> bool {
        self.weight > 0.0 || self.skin.weight > 0.0
    }

    /// [`crate::chainmail::Pull::farthest`] on a lattice, mm.
    pub(super) fn farthest(&self, lattice: &Lattice) -> f32 {
        (self.departure * lattice.grid.mean_edge()) as f32
    }
}

/// The outline of the fraction as an initiator of its own.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SkinOptions {
    /// Weight of the skin against the chain mail's elasticity; 0 for none.
    pub weight: f64,
}

impl Default for RefineOptions {
    fn default() -> Self {
        Self {
            weight: 1.0,
            passes: 30,
            settled: 0.015,
            rounds: 3,
            blur: 0.2,
            least_blur: 0.4,
            window_hu: [-250.0, 300.0],
            robust: 2.0,
            departure: 0.04,
            shading: ShadingOptions::default(),
            skin: SkinOptions::default(),
            guide: GuideOptions::default(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn vessels_of_a_lung_are_contrast_where_there_is_a_lung() {
        let options = RefineOptions::default();
        let contrast = |lung: bool| options.window(lung).of(-550.0) - options.window(lung).of(-850.0);
        assert!(contrast(false).abs() < 1e-6, "{}", contrast(false));
        assert!((contrast(true) - 300.0 * LUNG_SCALE).abs() < 1e-3, "{}", contrast(true));
    }

    #[test]
    fn a_corrected_fraction_pulls_half_as_much_and_another_modality_twice() {
        let options = RefineOptions { weight: 3.0, ..RefineOptions::default() };
        assert!((options.corrected().weight - 1.5).abs() < 1e-12 && (options.translated().weight - 6.0).abs() < 1e-12);
    }
}
