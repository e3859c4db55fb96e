//! What the phantom's images are like.

use super::posture::Posture;
use crate::error::{Error, Result};
use crate::geometry::Grid;
use serde::{Deserialize, Serialize};

/// Options of the phantom: grids, image quality, and the fraction's posture.
///
/// The anatomy has its origin at the atlanto-occipital joint; its crown is 139 mm above, and it is drawn down to
/// T7, about 275 mm below.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct PhantomOptions {
    /// Voxels of the planning grid.
    pub size: [usize; 3],
    /// Spacing of the planning grid, mm.
    pub spacing_mm: [f64; 3],
    /// Height of the planning grid's top slice over the atlanto-occipital joint, mm.
    pub top_mm: f64,
    /// Width over which tissues mix at their borders (partial volume), mm.
    pub edge_mm: f64,
    /// Thickness of a layer of fat put around the patient, mm.
    pub fat_mm: f64,
    /// Standard deviation of the planning CT's noise, HU.
    pub planning_noise_hu: f64,
    /// Standard deviation of the fraction CT's noise, HU.
    pub fraction_noise_hu: f64,
    /// Factor on the fraction's HU above air.
    pub fraction_gain: f64,
    /// HU added to the fraction.
    pub fraction_offset_hu: f64,
    /// Spacing of the fraction grid, mm; 0 takes the planning spacing along that axis.
    pub fraction_spacing_mm: [f64; 3],
    /// Shift of the fraction grid against the planning grid, in planning voxels.
    pub fraction_grid_shift: [f64; 3],
    /// Height that the fraction's field of view lacks at the top, mm.
    pub fraction_cut_top_mm: f64,
    /// Height that the fraction's field of view lacks at the bottom, mm.
    pub fraction_cut_bottom_mm: f64,
    /// Shift of the fraction scanner's origin, mm: patient, couch and grid are moved together.
    pub scanner_shift_mm: [f64; 3],
    /// Shift of the couch in the fraction, mm; the couch does not follow the patient.
    pub couch_shift_mm: [f64; 3],
    /// Posture in the fraction.
    pub posture: Posture,
    /// Greatest random soft-tissue motion along each axis, mm.
    pub soft_tissue_mm: f64,
    /// Seed of noise and random motion.
    pub seed: u64,
}

/// Most voxels of a phantom, and what their edges may be, mm.
const MOST_VOXELS: usize = 1_000_000_000;
const SPACING_MM: [f64; 2] = [0.1, 100.0];
/// No shift, noise or offset is greater, mm or HU.
const MOST: f64 = 1e5;

impl Default for PhantomOptions {
    /// 2 x 2 x 3 mm from the crown to T7, the demo posture.
    fn default() -> Self {
        Self {
            size: [256, 178, 140],
            spacing_mm: [2.0, 2.0, 3.0],
            top_mm: 142.5,
            edge_mm: 1.8,
            fat_mm: 0.0,
            planning_noise_hu: 8.0,
            fraction_noise_hu: 14.0,
            fraction_gain: 1.015,
            fraction_offset_hu: 6.0,
            fraction_spacing_mm: [0.0; 3],
            fraction_grid_shift: [0.37, -0.41, 0.29],
            fraction_cut_top_mm: 33.0,
            fraction_cut_bottom_mm: 0.0,
            scanner_shift_mm: [0.0; 3],
            couch_shift_mm: [2.5, 1.0, -4.0],
            posture: Posture::default(),
            soft_tissue_mm: 2.0,
            seed: 20_190_611,
        }
    }
}

impl PhantomOptions {
    /// A small phantom for tests: the same field of view at 5 x 5 x 6 mm.
    pub fn coarse() -> Self {
        Self { size: [103, 72, 70], spacing_mm: [5.0, 5.0, 6.0], edge_mm: 4.0, ..Self::default() }
    }

    /// The same field of view with another spacing, mm; borders of tissues widen with it.
    #[must_use]
    pub fn with_spacing(self, spacing: [f64; 3]) -> Self {
        let size =
            std::array::from_fn(|a| (self.size[a] as f64 * self.spacing_mm[a] / spacing[a]).round().max(4.0) as usize);
        let edge_mm = self.edge_mm * (spacing[0] / self.spacing_mm[0]).max(0.5);
        Self { size, edge_mm, spacing_mm: spacing, ..self }
    }

    /// The thesis's scan: 512 x 512 x 126 voxels of 0.98 x 0.98 x 3 mm, from the forehead down, of a patient of 7 million voxels.
    pub fn thesis_scale() -> Self {
        Self {
            size: [512, 512, 126],
            spacing_mm: [0.98, 0.98, 3.0],
            top_mm: 112.0,
            edge_mm: 1.2,
            fat_mm: 18.0,
            ..Self::default()
        }
    }

    /// The planning grid.
    ///
    /// # Errors
    /// When size or spacing are no grid.
    pub fn planning_grid(&self) -> Result<Grid> {
        let half: [f64; 3] = std::array::from_fn(|a| self.size[a].saturating_sub(1) as f64 * self.spacing_mm[a]);
        Grid::axis_aligned(self.size, self.spacing_mm, [-half[0] / 2.0, -12.0 - half[1] / 2.0, self.top_mm - half[2]])
    }

    /// The fraction grid.
    ///
    /// # Errors
    /// When nothing is left of the field of view or the numbers are no grid.
    pub fn fraction_grid(&self) -> Result<Grid> {
        let planning = self.planning_grid()?;
        let spacing: [f64; 3] = std::array::from_fn(|a| match self.fraction_spacing_mm[a] {
            0.0 => self.spacing_mm[a],
            own => own,
        });
        let mut length: [f64; 3] = std::array::from_fn(|a| (self.size[a] - 1) as f64 * self.spacing_mm[a]);
        length[2] -= self.fraction_cut_top_mm + self.fraction_cut_bottom_mm;
        if !length.iter().zip(&spacing).all(|(l, s)| *l > 0.0 && *s > 0.0) {
            let problem = format!("a fraction of {length:.0?} mm at {spacing:?} mm spacing is empty");
            return Err(Error::input("phantom options", problem, "cut less of the field of view"));
        }
        let size = std::array::from_fn(|a| (length[a] / spacing[a] + 1e-9).floor() as usize + 1);
        let low = planning.origin();
        let cut = [0.0, 0.0, self.fraction_cut_bottom_mm];
        let origin = std::array::from_fn(|a| {
            low[a] + self.fraction_grid_shift[a] * self.spacing_mm[a] + self.scanner_shift_mm[a] + cut[a]
        });
        Grid::axis_aligned(size, spacing, origin)
    }

    /// Refuses numbers that no image can have.
    pub(super) fn check(&self) -> Result<()> {
        let amounts = [self.edge_mm, self.fraction_gain];
        let none_or_more = [self.planning_noise_hu, self.fraction_noise_hu, self.soft_tissue_mm, self.fat_mm];
        let any = [self.fraction_offset_hu, self.top_mm, self.fraction_cut_top_mm, self.fraction_cut_bottom_mm];
        let vectors = [self.fraction_grid_shift, self.scanner_shift_mm, self.couch_shift_mm, self.fraction_spacing_mm];
        let fine = amounts.iter().all(|v| v.is_finite() && *v > 0.0)
            && none_or_more.iter().all(|v| v.is_finite() && *v >= 0.0)
            && any.iter().chain(vectors.iter().flatten()).all(|v| v.is_finite());
        if fine {
            return self.check_size(&none_or_more, &any, &vectors);
        }
        let problem =
            format!("edge {} mm, gain {}, noise, motion and fat {none_or_more:?}", self.edge_mm, self.fraction_gain);
        Err(Error::input("phantom options", problem, "give finite numbers; edge and gain must be positive"))
    }

    /// Refuses finite numbers that no memory or patient holds.
    fn check_size(&self, amounts: &[f64], numbers: &[f64], vectors: &[[f64; 3]]) -> Result<()> {
        let voxels = self.size.iter().try_fold(1usize, |all, n| all.checked_mul(*n));
        let mut spacings = self.spacing_mm.iter().chain(self.fraction_spacing_mm.iter().filter(|s| **s != 0.0));
        let mut all = amounts.iter().chain(numbers).chain(vectors.iter().flatten());
        let sensible = voxels.is_some_and(|n| n <= MOST_VOXELS)
            && spacings.all(|s| (SPACING_MM[0]..=SPACING_MM[1]).contains(s))
            && all.all(|v| v.abs() <= MOST);
        if sensible {
            return Ok(());
        }
        let spacing = (self.spacing_mm, self.fraction_spacing_mm);
        let problem = format!("size {:?}, spacing {spacing:?} mm, or a number beyond {MOST:.0}", self.size);
        Err(Error::input("phantom options", problem, "give at most 10^9 voxels of 0.1 to 100 mm, and smaller numbers"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Where the field of view ends, from the outer faces of its voxels: low and high, mm.
    fn extent(options: &PhantomOptions) -> [[f64; 2]; 3] {
        let grid = options.planning_grid().unwrap();
        std::array::from_fn(|a| {
            let (low, spacing) = (grid.origin()[a], grid.spacing()[a]);
            [low - spacing / 2.0, low + (grid.size()[a] as f64 - 0.5) * spacing]
        })
    }

    #[test]
    fn another_spacing_keeps_the_field_of_view() {
        let own = PhantomOptions { seed: 7, fat_mm: 3.0, ..PhantomOptions::default() };
        for spacing in [[6.0, 6.0, 6.0], [1.0, 1.0, 1.5], [2.5, 4.0, 3.0], [2.0, 2.0, 3.0]] {
            let other = own.clone().with_spacing(spacing);
            assert_eq!((other.spacing_mm, other.seed, other.fat_mm), (spacing, 7, 3.0));
            for (axis, (a, b)) in extent(&own).iter().zip(extent(&other)).enumerate() {
                // Half a voxel at most by rounding to whole ones; the top slice's centre stays where it is.
                let rounding = 0.5 * spacing[axis] + 0.5 * (spacing[axis] - own.spacing_mm[axis]).abs();
                for (a, b) in a.iter().zip(b) {
                    assert!((a - b).abs() <= rounding + 1e-9, "{spacing:?}, axis {axis}: {a} and {b}");
                }
            }
        }
        assert_eq!(own.clone().with_spacing(own.spacing_mm), own);
    }

    #[test]
    fn borders_widen_with_coarse_voxels_and_no_grid_is_too_small() {
        let own = PhantomOptions::default();
        let edge = |x: f64, z: f64| own.clone().with_spacing([x, 2.0, z]).edge_mm / own.edge_mm;
        for (x, factor) in [(6.0, 3.0), (2.0, 1.0), (1.0, 0.5), (0.25, 0.5)] {
            assert!((edge(x, 3.0) - factor).abs() < 1e-12 && (edge(x, 30.0) - factor).abs() < 1e-12, "{x}");
        }
        let huge = own.with_spacing([1e4; 3]);
        assert_eq!(huge.size, [4; 3]);
        assert!(huge.planning_grid().is_ok());
    }
}
