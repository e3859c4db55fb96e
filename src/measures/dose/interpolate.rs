//! Plain mapping of dose by interpolation, and sums over fractions.

use crate::error::{Error, Result};
use crate::geometry::Grid;
use crate::volume::{Volume, trilinear, trilinear_vector};
use nalgebra::{Point3, Vector3};
use rayon::prelude::*;

/// Dose at the points where a field leads from each voxel of `to`: trilinear; 0 Gy outside the dose grid.
///
/// `field` leads from the frame of `to` to that of `dose`; outside its grid it is the identity. Interpolation does not
/// conserve energy where tissue is compressed or stretched: [`super::energy_mass`] does.
///
/// # Errors
/// Only for internal inconsistency of grids.
pub fn interpolate(dose: &Volume<f32>, field: &Volume<[f32; 3]>, to: &Grid) -> Result<Volume<f32>> {
    let [nx, ny, _] = to.size();
    let mut out = vec![0f32; to.len()];
    out.par_chunks_mut(nx * ny).enumerate().for_each(|(k, plane)| {
        for (n, o) in plane.iter_mut().enumerate() {
            let p = to.centre([n % nx, n / nx, k]);
            *o = dose_at(dose, &(p + displacement(field, &p))) as f32;
        }
    });
    Volume::new(to.clone(), out)
}

/// Weighted sum of doses on one grid.
///
/// # Errors
/// [`Error::Input`] without doses, for a weight that is not finite, and when grids differ.
pub fn accumulate(doses: &[(f64, &Volume<f32>)]) -> Result<Volume<f32>> {
    let Some((_, first)) = doses.first() else {
        return Err(Error::input("doses", "there is none to accumulate", "give at least one dose"));
    };
    let mut sum = vec![0f64; first.grid().len()];
    for (weight, dose) in doses {
        if !weight.is_finite() {
            return Err(Error::input(
                "weights",
                format!("{weight} is no finite number"),
                "give the number of fractions",
            ));
        }
        if !dose.grid().matches(first.grid(), 1e-3) {
            return Err(Error::input("doses", "they lie on different grids", "map them onto one grid"));
        }
        sum.par_iter_mut().zip(dose.data()).for_each(|(s, d)| *s += weight * f64::from(*d));
    }
    Volume::new(first.grid().clone(), sum.into_iter().map(|s| s as f32).collect())
}

/// A field's displacement at a point; the identity outside its grid, as in ITK.
pub fn displacement(field: &Volume<[f32; 3]>, p: &Point3<f64>) -> Vector3<f64> {
    trilinear_vector(field, &snapped(field.grid(), p)).unwrap_or_default()
}

/// Dose at a point, Gy: trilinear; 0 outside the dose grid.
pub fn dose_at(dose: &Volume<f32>, p: &Point3<f64>) -> f64 {
    trilinear(dose, &snapped(dose.grid(), p)).unwrap_or(0.0)
}

/// Continuous index; a voxel reaches half a step beyond its centre, where the edge's value holds, as in ITK.
pub(super) fn snapped(grid: &Grid, p: &Point3<f64>) -> Vector3<f64> {
    let last = Vector3::from(grid.size().map(|n| (n - 1) as f64));
    let index = grid.index(p);
    index.zip_map(&last, |i, last| if i > -0.501 && i < last + 0.501 { i.clamp(0.0, last) } else { i })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_shift_moves_dose_and_fractions_add_up() {
        let grid = Grid::axis_aligned([10, 6, 5], [2.0, 2.0, 3.0], [0.0; 3]).unwrap();
        let dose = Volume::from_fn(grid.clone(), |l| grid.voxel(l)[0] as f32);
        let field = Volume::filled(grid.clone(), [4.0f32, 0.0, 0.0]);
        let mapped = interpolate(&dose, &field, &grid).unwrap();
        assert!((mapped.at([3, 2, 2]) - 5.0).abs() < 1e-6 && mapped.at([8, 2, 2]).abs() < 1e-6);
        let sum = accumulate(&[(20.0, &dose), (15.0, &mapped)]).unwrap();
        assert!((sum.at([3, 2, 2]) - 135.0).abs() < 1e-4);
        assert!(accumulate(&[]).is_err() && accumulate(&[(f64::NAN, &dose)]).is_err());
    }
}
