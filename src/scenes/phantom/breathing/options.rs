//! What the breathing phantom is like.

use crate::error::{Error, Result};
use crate::geometry::Grid;
use serde::{Deserialize, Serialize};

/// Greatest amplitude, mm: the lung is not turned inside out below it, and no one breathes deeper.
const DEEPEST_MM: f64 = 60.0;
/// The field of view: least and greatest LPS, mm.
const VIEW: [[f64; 3]; 2] = [[-177.0, -126.0, -306.0], [177.0, 141.0, 24.0]];

/// Options of the breathing phantom.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct BreathingOptions {
    /// Spacing of both grids, mm; the field of view stays.
    pub spacing_mm: [f64; 3],
    /// Width over which tissues mix at their borders (partial volume), mm.
    pub edge_mm: f64,
    /// How far the diaphragm goes down from planning to fraction, mm: below 0 it goes up.
    pub amplitude_mm: f64,
    /// How far the lung turns in its pleura, degrees.
    pub turn_deg: f64,
    /// Setup of the patient in the fraction, degrees about the LPS axes, about the origin.
    pub setup_rotation_deg: [f64; 3],
    /// Setup of the patient in the fraction, LPS mm.
    pub setup_shift_mm: [f64; 3],
    /// Standard deviation of the planning CT's noise, HU.
    pub planning_noise_hu: f64,
    /// Standard deviation of the fraction CT's noise, HU.
    pub fraction_noise_hu: f64,
    /// Whether a lung that grows is less dense: air comes in, tissue stays.
    pub keep_mass: bool,
    /// Seed of the noise.
    pub seed: u64,
}

impl Default for BreathingOptions {
    /// 2.5 x 2.5 x 3 mm, breathed in by 20 mm.
    fn default() -> Self {
        Self {
            spacing_mm: [2.5, 2.5, 3.0],
            edge_mm: 2.2,
            amplitude_mm: 20.0,
            turn_deg: 4.0,
            setup_rotation_deg: [0.4, -0.3, 0.8],
            setup_shift_mm: [4.0, -3.0, 6.0],
            planning_noise_hu: 8.0,
            fraction_noise_hu: 12.0,
            keep_mass: true,
            seed: 20_190_611,
        }
    }
}

impl BreathingOptions {
    /// A small phantom for tests: the same field of view at 4 x 4 x 5 mm.
    pub fn coarse() -> Self {
        Self { spacing_mm: [4.0, 4.0, 5.0], edge_mm: 3.5, ..Self::default() }
    }

    /// The planning grid.
    ///
    /// # Errors
    /// When the spacing makes no grid.
    pub fn planning_grid(&self) -> Result<Grid> {
        self.grid([0.0; 3])
    }

    /// The fraction grid: it lies a third of a voxel and the setup's shift off the planning grid.
    ///
    /// # Errors
    /// When the spacing makes no grid.
    pub fn fraction_grid(&self) -> Result<Grid> {
        self.grid(std::array::from_fn(|a| self.setup_shift_mm[a] + 0.34 * self.spacing_mm[a]))
    }

    fn grid(&self, shift: [f64; 3]) -> Result<Grid> {
        let size =
            std::array::from_fn(|a| ((VIEW[1][a] - VIEW[0][a]) / self.spacing_mm[a]).floor().max(3.0) as usize + 1);
        Grid::axis_aligned(size, self.spacing_mm, std::array::from_fn(|a| VIEW[0][a] + shift[a]))
    }

    /// Refuses numbers that no image can have.
    pub(super) fn check(&self) -> Result<()> {
        let positive = self.spacing_mm.iter().chain([&self.edge_mm]);
        let noise = [self.planning_noise_hu, self.fraction_noise_hu];
        let turns = self.setup_rotation_deg.iter().chain([&self.turn_deg]);
        let fine = positive.into_iter().all(|v| v.is_finite() && *v > 0.0)
            && noise.iter().all(|v| v.is_finite() && *v >= 0.0)
            && turns.into_iter().all(|v| v.abs() <= 30.0)
            && self.setup_shift_mm.iter().all(|v| v.abs() <= 1000.0)
            && self.amplitude_mm.abs() <= DEEPEST_MM;
        if fine {
            return Ok(());
        }
        let problem = format!(
            "spacing {:?} mm, edge {} mm, amplitude {} mm, turns {} and {:?} degrees, shift {:?} mm, noise {noise:?} HU",
            self.spacing_mm,
            self.edge_mm,
            self.amplitude_mm,
            self.turn_deg,
            self.setup_rotation_deg,
            self.setup_shift_mm
        );
        let remedy =
            "give finite numbers: an amplitude of at most 60 mm, turns of at most 30 degrees, no negative noise";
        Err(Error::input("options of the breathing phantom", problem, remedy))
    }
}
