//! What an image, a label map or their headers must be by themselves.

use super::PlanningScan;
use crate::body::mr;
use crate::config::{Config, Modality};
use crate::error::{Error, Result};
use crate::findings;
use crate::geometry::Grid;
use crate::plausibility::{in_hounsfield, no_hounsfield};
use crate::volume::Volume;
use crate::warning::Warning;
use rayon::prelude::*;

/// The labels lie on the planning grid.
pub(super) fn check_labels(planning: &PlanningScan) -> Result<()> {
    check_grids(planning.ct.grid(), planning.bones.volume.grid())
}

/// Whether bone labels lie on the planning CT's grid; headers are enough to tell.
///
/// # Errors
/// [`Error::Input`] when they do not.
pub fn check_grids(ct: &Grid, bones: &Grid) -> Result<()> {
    let tolerance = 0.1 * ct.spacing().into_iter().fold(f64::MAX, f64::min);
    if !ct.matches(bones, tolerance) {
        return Err(Error::input(
            "bone labels",
            format!(
                "their grid (size {:?}, spacing {:?} mm, origin {:.2?} mm) is not that of the planning CT (size {:?}, spacing {:?} mm, origin {:.2?} mm)",
                bones.size(),
                bones.spacing(),
                bones.origin().coords.as_slice(),
                ct.size(),
                ct.spacing(),
                ct.origin().coords.as_slice()
            ),
            "give the labels of this planning CT, or resample them onto its grid with nearest-neighbour interpolation",
        ));
    }
    Ok(())
}

/// Judges the fraction of a case by itself, in little time: before anything long begins.
///
/// # Errors
/// [`Error::Input`] where it is no CT in HU, or no MR where the settings say that it is one.
pub fn check_fraction(fraction: &Volume<f32>, config: &Config) -> Result<Vec<Warning>> {
    match config.fraction.modality {
        Modality::Auto | Modality::Ct => check_image("fraction CT", fraction, config),
        Modality::Mr => check_mr("fraction MR", fraction, config),
    }
}

/// An MR that can show a patient.
///
/// # Errors
/// [`Error::Input`] where it shows nothing or looks like a CT in HU.
pub fn check_mr(what: &str, image: &Volume<f32>, config: &Config) -> Result<Vec<Warning>> {
    check_values(what, image, "an MR")?;
    config.checks.told(no_hounsfield(what, image).map(|()| Vec::new()))
}

impl PlanningScan {
    /// With an MR, on any scale, for the CT, where the settings name it.
    ///
    /// # Errors
    /// As [`mr::tissue_scale`], and where it looks like a CT in HU.
    pub fn by_modality(self, config: &Config) -> Result<Self> {
        match config.planning.modality {
            Modality::Auto | Modality::Ct => Ok(self),
            Modality::Mr => {
                check_mr("planning MR", &self.ct, config)?;
                Ok(Self { ct: mr::tissue_scale(&self.ct)?.image, ..self })
            }
        }
    }
}

/// Whether an image of this grid can show a patient; headers are enough to tell.
///
/// # Errors
/// [`Error::Input`] when it cannot.
pub fn check_size(what: &str, grid: &Grid) -> Result<()> {
    if grid.size().iter().all(|&n| n >= 4) {
        return Ok(());
    }
    let problem = format!("its size is {:?} voxels", grid.size());
    Err(Error::input(what, problem, "a volume of at least 4 voxels along every axis is needed"))
}

/// A CT that can show a patient.
pub(super) fn check_image(what: &str, image: &Volume<f32>, config: &Config) -> Result<Vec<Warning>> {
    check_values(what, image, "a CT in HU")?;
    config.checks.told(in_hounsfield(what, image).map(|odd| odd.into_iter().collect()))
}

/// A word about a planning scan that is given as the fraction, by its voxels: as another file, too.
pub fn same_scan(planning: &Volume<f32>, fraction: &Volume<f32>) -> Option<Warning> {
    let same = planning.grid().matches(fraction.grid(), SAME_MM) && planning.data() == fraction.data();
    same.then(|| {
        let message =
            "planning and fraction are one and the same scan: nothing had to move, and nothing is shown of the day";
        Warning::new(findings::SAME_SCAN, message)
    })
}

/// Corner distance up to which grids are those of one scan, mm.
const SAME_MM: f64 = 1e-3;

/// An image that shows something; `kind` is what to give instead.
fn check_values(what: &str, image: &Volume<f32>, kind: &str) -> Result<()> {
    check_size(what, image.grid())?;
    let first = image.data()[0];
    if image.data().iter().all(|v| v.to_bits() == first.to_bits()) {
        let remedy = format!("give {kind} that shows the patient");
        return Err(Error::input(what, format!("every voxel is {first}"), remedy));
    }
    let odd = image.data().par_iter().filter(|v| !v.is_finite()).count();
    if odd > 0 {
        let problem = format!("{odd} voxels are NaN or infinite");
        return Err(Error::input(what, problem, format!("give {kind} whose every voxel has a value")));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector3;

    #[test]
    fn planning_given_as_the_fraction_is_told() {
        let grid = Grid::axis_aligned([4, 3, 2], [1.0; 3], [0.0; 3]).unwrap();
        let ct = Volume::from_fn(grid.clone(), |n| n as f32);
        let told = |other: &Volume<f32>| same_scan(&ct, other).is_some_and(|w| w.is(findings::SAME_SCAN));
        let mut noisy = ct.clone();
        noisy.data_mut()[5] += 1.0;
        let moved = Volume::new(grid.shifted(&Vector3::new(0.0, 2.0, 0.0)), ct.data().to_vec()).unwrap();
        assert!(told(&ct.clone()) && !told(&noisy) && !told(&moved));
    }

    #[test]
    fn labels_lie_on_the_cts_grid_but_for_rounding() {
        let ct = Grid::axis_aligned([8, 7, 6], [1.0, 1.0, 3.0], [10.0, -20.0, 100.0]).unwrap();
        let off = |mm: f64| check_grids(&ct, &ct.shifted(&Vector3::new(0.0, mm, 0.0)));
        assert!(off(0.0).is_ok() && off(0.05).is_ok());
        // Half a voxel is another grid.
        assert!(off(0.5).unwrap_err().to_string().contains("is not that of the planning CT"));
    }
}
