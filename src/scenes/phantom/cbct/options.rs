//! What a cone-beam machine does to an image, effect by effect.

use crate::error::{Error, Result};
use serde::{Deserialize, Serialize};

/// What a cone-beam machine does to an image. Every effect can be left out; see
/// [`CbctOptions::off`].
///
/// With `w` the voxel's share of water's attenuation, (HU + 1000) / 1000 kept between 0 and 1, the
/// new value is `-1000 + gain * (HU + 1000) + w * (cupping + shading + rim) + streaks + noise`, and
/// `padding_hu` where nothing was measured.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct CbctOptions {
    /// Factor on HU above air; 1 changes nothing.
    pub gain: f64,
    /// HU added to water on the axis; less by the square of the distance to it, none from
    /// `cupping_radius_mm` on.
    pub cupping_hu: f64,
    /// Where cupping ends, mm from the axis.
    pub cupping_radius_mm: f64,
    /// Greatest HU that slow shading adds to water, or takes from it.
    pub shading_hu: f64,
    /// Wavelength of the shading, mm.
    pub shading_mm: f64,
    /// Share of cupping, shading and rim that air gets too; 0 leaves air alone, 1 adds them
    /// everywhere alike.
    pub air_share: f64,
    /// Standard deviation of the noise, HU; white.
    pub noise_hu: f64,
    /// Greatest HU of one streak; 0 draws none.
    pub streak_hu: f64,
    /// Radius of the reconstruction circle about the axis, mm; 0 has no circle.
    pub circle_radius_mm: f64,
    /// The axis, from the middle of the image: left and back, mm.
    pub circle_offset_mm: [f64; 2],
    /// HU that truncation adds to water at the circle.
    pub rim_hu: f64,
    /// Depth inside the circle over which the rim falls to 37 %, mm.
    pub rim_mm: f64,
    /// Value of what was not measured: outside of the circle and in blank slices.
    pub padding_hu: f64,
    /// Slices at the lower and at the upper end that hold only padding.
    pub blank_slices: [usize; 2],
    /// Length of the scan, mm, about the middle of the image; 0 keeps all slices.
    pub length_mm: f64,
}

impl Default for CbctOptions {
    /// All effects: a circle of 250 mm, 240 mm long, a fifth of the contrast lost.
    fn default() -> Self {
        Self {
            gain: 0.8,
            cupping_hu: -180.0,
            cupping_radius_mm: 150.0,
            shading_hu: 60.0,
            shading_mm: 180.0,
            air_share: 0.0,
            noise_hu: 60.0,
            streak_hu: 80.0,
            circle_radius_mm: 125.0,
            circle_offset_mm: [0.0; 2],
            rim_hu: 250.0,
            rim_mm: 4.0,
            padding_hu: -1024.0,
            blank_slices: [2, 2],
            length_mm: 240.0,
        }
    }
}

impl CbctOptions {
    /// No effect at all: what a test switches on its own effects in.
    pub fn off() -> Self {
        Self {
            gain: 1.0,
            cupping_hu: 0.0,
            shading_hu: 0.0,
            noise_hu: 0.0,
            streak_hu: 0.0,
            circle_radius_mm: 0.0,
            rim_hu: 0.0,
            blank_slices: [0; 2],
            length_mm: 0.0,
            ..Self::default()
        }
    }

    /// Reads TOML as the program writes it; what is not named keeps its default.
    ///
    /// # Errors
    /// What is wrong, and where.
    pub fn parse(text: &str) -> std::result::Result<Self, String> {
        toml::from_str(text.trim_start_matches('\u{feff}')).map_err(|e| e.to_string())
    }

    /// The options as TOML.
    ///
    /// # Errors
    /// Never in practice: all of them are numbers.
    pub fn to_toml(&self) -> Result<String> {
        toml::to_string(self).map_err(|e| Error::Internal(format!("options of a cone-beam CT: {e}")))
    }

    /// Refuses what no image can have.
    pub(super) fn check(&self) -> Result<()> {
        let positive = [self.gain, self.cupping_radius_mm, self.shading_mm, self.rim_mm];
        let none_or_more = [self.noise_hu, self.circle_radius_mm, self.length_mm, self.air_share];
        let [left, back] = self.circle_offset_mm;
        let any = [self.cupping_hu, self.shading_hu, self.streak_hu, self.rim_hu, self.padding_hu, left, back];
        let fine = positive.iter().all(|v| v.is_finite() && *v > 0.0)
            && none_or_more.iter().all(|v| v.is_finite() && *v >= 0.0)
            && any.iter().all(|v| v.is_finite());
        if fine {
            return Ok(());
        }
        let problem = format!(
            "gain, radius of cupping, wavelength of shading and depth of the rim {positive:?}, noise, radius of the circle, \
             length and share of air {none_or_more:?}, others {any:?}"
        );
        Err(Error::input(
            "options of the cone-beam CT",
            problem,
            "give finite numbers, positive ones for the first four and none below 0 for the next four",
        ))
    }
}
