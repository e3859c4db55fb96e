//! Two doses compared, and how exactly a field must be known for a dose.

use super::interpolate::interpolate;
use crate::error::{Error, Result};
use crate::field::{Outside, covers};
use crate::findings;
use crate::stats::Summary;
use crate::volume::Volume;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// Difference of two doses over the voxels that both grids cover and where either is above a tenth of the reference's
/// maximum, Gy.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct DoseDifference {
    /// Dose minus reference.
    pub signed: Summary,
    /// Its magnitude.
    pub magnitude: Summary,
    /// What of the reference lies outside the dose's grid: nothing is known of it, and it is left out.
    pub reference_outside: Outside,
    /// What of the dose lies outside the reference's grid; it is left out.
    pub dose_outside: Outside,
}

/// Share of the maximum above which voxels count.
const COUNTS: f32 = 0.1;

/// `dose` minus `reference` on the reference's grid, and its figures. Where the dose's grid does not reach, the map is 0 and
/// the figures leave it out: a dose that is not known is not 0 Gy.
///
/// # Errors
/// [`Error::Input`] when the grids have nothing in common.
pub fn difference(dose: &Volume<f32>, reference: &Volume<f32>) -> Result<(Volume<f32>, DoseDifference)> {
    let grid = reference.grid();
    let (reference_outside, dose_outside) = (Outside::of(reference, dose.grid()), Outside::of(dose, grid));
    if reference_outside.volume_percent >= 100.0 {
        let problem = "no voxel of the reference lies inside the dose's grid: there is nothing to compare";
        return Err(Error::refused(findings::DOSES_APART, "the two doses", problem, "give doses of one frame"));
    }
    let still = Volume::filled(grid.clone(), [0f32; 3]);
    let mapped = interpolate(dose, &still, grid)?;
    let least = COUNTS * reference.extremes()[1].max(0.0);
    let known = |l: usize| covers(dose.grid(), &grid.centre(grid.voxel(l)));
    let all = reference_outside.volume_percent <= 0.0;
    let map =
        Volume::from_fn(grid.clone(), |l| if all || known(l) { mapped.data()[l] - reference.data()[l] } else { 0.0 });
    let counted: Vec<f64> = (map.data().iter().zip(mapped.data()).zip(reference.data()))
        .enumerate()
        .filter(|(l, ((_, a), b))| (**a > least || **b > least) && (all || known(*l)))
        .map(|(_, ((d, _), _))| f64::from(*d))
        .collect();
    let magnitude: Vec<f64> = counted.iter().map(|d| d.abs()).collect();
    let figures = DoseDifference {
        signed: Summary::of(&counted),
        magnitude: Summary::of(&magnitude),
        reference_outside,
        dose_outside,
    };
    Ok((map, figures))
}

/// Distance to dose difference: how far from each voxel's centre the nearest voxel lies whose dose differs by at least
/// `tolerance_gy`, up to `limit_mm`, mm. A field that is known better than this moves no voxel's dose by the tolerance.
///
/// Saleh-Sayah, Weiss, Salguero and Siebers, Med. Phys. 38 (2011) 2360. Resolved to the dose's voxels.
pub fn distance_to_difference(dose: &Volume<f32>, tolerance_gy: f64, limit_mm: f64) -> Volume<f32> {
    let grid = dose.grid();
    let size = grid.size().map(|n| n as i32);
    let steps = offsets(grid.spacing(), limit_mm);
    let flat = flat(dose, tolerance_gy as f32, limit_mm);
    let data = dose.data();
    let out: Vec<f32> = (0..grid.len())
        .into_par_iter()
        .map(|l| {
            if flat[l] {
                return limit_mm as f32;
            }
            let v = grid.voxel(l).map(|c| c as i32);
            let found = steps.iter().find(|(o, _)| {
                let at: [i32; 3] = std::array::from_fn(|a| v[a] + o[a]);
                (0..3).all(|a| at[a] >= 0 && at[a] < size[a])
                    && f64::from((data[grid.linear(at.map(|c| c as usize))] - data[l]).abs()) >= tolerance_gy
            });
            found.map_or(limit_mm as f32, |s| s.1)
        })
        .collect();
    Volume::new(grid.clone(), out).expect("one value per voxel")
}

/// Offsets up to a distance, nearest first, with their lengths.
fn offsets(spacing: [f64; 3], limit: f64) -> Vec<([i32; 3], f32)> {
    let reach = spacing.map(|s| (limit / s) as i32);
    let mut all = Vec::new();
    for k in -reach[2]..=reach[2] {
        for j in -reach[1]..=reach[1] {
            for i in -reach[0]..=reach[0] {
                let far = [i, j, k].iter().zip(spacing).map(|(n, s)| (f64::from(*n) * s).powi(2)).sum::<f64>().sqrt();
                if far > 0.0 && far < limit {
                    all.push(([i, j, k], far as f32));
                }
            }
        }
    }
    all.sort_by(|a, b| a.1.total_cmp(&b.1).then(a.0.cmp(&b.0)));
    all
}

/// Voxels around which the dose stays within the tolerance in the whole box of the limit: there is nothing to find.
fn flat(dose: &Volume<f32>, tolerance: f32, limit: f64) -> Vec<bool> {
    let grid = dose.grid();
    let reach = grid.spacing().map(|s| (limit / s) as usize);
    let extreme = |better: fn(f32, f32) -> f32| {
        let mut values = dose.data().to_vec();
        for (axis, reach) in reach.iter().enumerate() {
            let (n, stride) = (grid.size()[axis], grid.strides()[axis]);
            let from = values;
            values = (0..grid.len())
                .into_par_iter()
                .map(|l| {
                    let c = grid.voxel(l)[axis];
                    let (low, high) = (c.saturating_sub(*reach), (c + reach).min(n - 1));
                    (low..=high).map(|m| from[l - c * stride + m * stride]).fold(from[l], better)
                })
                .collect();
        }
        values
    };
    let (low, high) = (extreme(f32::min), extreme(f32::max));
    let within = |((d, low), high): ((&f32, &f32), &f32)| d - low < tolerance && high - d < tolerance;
    dose.data().iter().zip(&low).zip(&high).map(within).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Grid;

    #[test]
    fn a_gradient_gives_its_distance_and_flat_dose_the_limit() {
        // 2 Gy per 2 mm voxel on the left half, flat on the right.
        let grid = Grid::axis_aligned([60, 9, 7], [2.0, 2.0, 3.0], [0.0; 3]).unwrap();
        let dose = Volume::from_fn(grid.clone(), |l| 2.0 * grid.voxel(l)[0].min(30) as f32);
        let map = distance_to_difference(&dose, 3.0, 15.0);
        assert!((map.at([15, 4, 3]) - 4.0).abs() < 1e-6); // 4 Gy two voxels away
        assert!((map.at([31, 4, 3]) - 6.0).abs() < 1e-6);
        assert!((map.at([45, 4, 3]) - 15.0).abs() < 1e-6);
    }

    #[test]
    fn differences_by_hand() {
        let grid = Grid::axis_aligned([10, 4, 4], [1.0; 3], [0.0; 3]).unwrap();
        let reference = Volume::from_fn(grid.clone(), |l| if grid.voxel(l)[0] < 5 { 0.0 } else { 50.0f32 });
        let dose = reference.map(|d| if *d > 0.0 { d + 2.0 } else { 0.5 });
        let (map, figures) = difference(&dose, &reference).unwrap();
        assert!((map.at([7, 1, 1]) - 2.0).abs() < 1e-6 && (map.at([1, 1, 1]) - 0.5).abs() < 1e-6);
        assert_eq!(figures.signed.n, 80); // what is near zero in both does not count
        assert!((figures.signed.mean - 2.0).abs() < 1e-6 && (figures.magnitude.max - 2.0).abs() < 1e-6);
    }
    #[test]
    fn what_one_dose_does_not_cover_is_left_out() {
        let grid = Grid::axis_aligned([10, 4, 4], [1.0; 3], [0.0; 3]).unwrap();
        let reference = Volume::filled(grid, 50.0f32);
        let part = Volume::filled(Grid::axis_aligned([5, 8, 4], [1.0; 3], [0.0; 3]).unwrap(), 51.0f32);
        let (map, figures) = difference(&part, &reference).unwrap();
        assert!((map.at([4, 1, 1]) - 1.0).abs() < 1e-6 && map.at([7, 1, 1]).abs() < 1e-6);
        assert!(figures.signed.n == 80 && (figures.signed.mean - 1.0).abs() < 1e-6, "{figures:?}");
        assert!((figures.reference_outside.amount_percent - 50.0).abs() < 1e-9, "{figures:?}");
        assert!((figures.dose_outside.volume_percent - 50.0).abs() < 1e-9, "{figures:?}");
        let apart = Volume::filled(Grid::axis_aligned([5, 5, 5], [1.0; 3], [90.0; 3]).unwrap(), 1.0f32);
        let error = difference(&apart, &reference).unwrap_err();
        assert_eq!((error.code(), error.exit_code()), ("doses-apart", 4));
    }

    #[test]
    fn a_hot_spot_counts_whichever_dose_has_it() {
        let grid = Grid::axis_aligned([10, 4, 4], [1.0; 3], [0.0; 3]).unwrap();
        let hot = |at: usize| Volume::from_fn(grid.clone(), |l| if grid.voxel(l)[0] == at { 40.0f32 } else { 0.0 });
        let (_, figures) = difference(&hot(2), &hot(7)).unwrap();
        assert_eq!((figures.signed.n, figures.signed.mean, figures.magnitude.mean), (32, 0.0, 40.0));
    }

    #[test]
    fn a_higher_dose_beside_a_voxel_is_as_near_as_a_lower_one() {
        let grid = Grid::axis_aligned([40, 3, 3], [1.0; 3], [0.0; 3]).unwrap();
        let step = Volume::from_fn(grid.clone(), |l| if grid.voxel(l)[0] < 20 { 0.0 } else { 5.0f32 });
        let map = distance_to_difference(&step, 3.0, 8.0);
        for (x, expected) in [(10, 8.0), (17, 3.0), (19, 1.0), (20, 1.0), (22, 3.0), (30, 8.0)] {
            assert!((map.at([x, 1, 1]) - expected).abs() < 1e-6, "{x}: {}", map.at([x, 1, 1]));
        }
    }
}
