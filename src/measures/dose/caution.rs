//! Where a mapped dose deserves doubt: an uncertain field in a steep dose.

use crate::volume::{Mask, Volume};
use nalgebra::Vector3;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// A dose is steep where it changes by more than this share of its maximum per mm.
pub const STEEP: f64 = 0.01;
/// A residual times gradient above this share of the maximum dose deserves doubt.
const ERROR: f64 = 0.01;

/// Voxels of a mapped dose that deserve doubt.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct Caution {
    /// Steep voxels where the field folds or its chain leaves the image.
    pub folded_or_outside: usize,
    /// Those of them where the field folds. Earlier reports lack it.
    #[serde(default)]
    pub folded: usize,
    /// Voxels where the field's residual times the gradient exceeds 1 % of the maximum dose.
    pub uncertain: usize,
    /// Volume of both, ml.
    pub ml: f64,
    /// Greatest residual times gradient, Gy.
    pub greatest_gy: f64,
}

/// Where a dose changes by more than [`STEEP`] of its maximum per mm.
pub fn steep(dose: &Volume<f32>) -> Mask {
    let most = f64::from(dose.extremes()[1].max(0.0));
    let steep: Vec<bool> =
        (0..dose.data().len()).into_par_iter().map(|l| most > 0.0 && gradient(dose, l) > STEEP * most).collect();
    Volume::new(dose.grid().clone(), steep).expect("one value per voxel")
}

/// Change of a dose per mm at a voxel, Gy: central differences, one-sided at the edges.
fn gradient(dose: &Volume<f32>, l: usize) -> f64 {
    let grid = dose.grid();
    let (size, strides, v) = (grid.size(), grid.strides(), grid.voxel(l));
    let by_index = [0, 1, 2].map(|a| {
        let (down, up) = (usize::from(v[a] > 0), usize::from(v[a] + 1 < size[a]));
        let span = (down + up).max(1) as f64;
        f64::from(dose.data()[l + up * strides[a]] - dose.data()[l - down * strides[a]]) / span
    });
    (grid.inverse_step().transpose() * Vector3::from(by_index)).norm()
}

/// Compares `uncertainty_mm` (residual of the field at each voxel; infinite where it leaves the image, no number where it folds)
/// with the gradient of `dose`, on one grid.
pub fn caution(dose: &Volume<f32>, uncertainty_mm: &Volume<f32>) -> Caution {
    let grid = dose.grid();
    let size = grid.size();
    let strides = grid.strides();
    let most = f64::from(dose.extremes()[1].max(0.0));
    let planes: Vec<Caution> = (0..size[2])
        .into_par_iter()
        .map(|k| {
            let mut found = Caution::default();
            for l in k * strides[2]..(k + 1) * strides[2] {
                let (g, u) = (gradient(dose, l), f64::from(uncertainty_mm.data()[l]));
                if !u.is_finite() {
                    let steep = usize::from(g > STEEP * most && most > 0.0);
                    found.folded_or_outside += steep;
                    found.folded += if u.is_nan() { steep } else { 0 };
                } else {
                    found.uncertain += usize::from(g * u > ERROR * most && most > 0.0);
                    found.greatest_gy = found.greatest_gy.max(g * u);
                }
            }
            found
        })
        .collect();
    let mut all = planes.iter().fold(Caution::default(), |a, p| Caution {
        folded_or_outside: a.folded_or_outside + p.folded_or_outside,
        folded: a.folded + p.folded,
        uncertain: a.uncertain + p.uncertain,
        ml: 0.0,
        greatest_gy: a.greatest_gy.max(p.greatest_gy),
    });
    all.ml = (all.folded_or_outside + all.uncertain) as f64 * grid.voxel_volume() / 1000.0;
    all
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Grid;

    #[test]
    fn only_doubt_in_steep_dose_counts() {
        // 5 Gy/mm between x = 10 and 20, flat beside it; maximum 50 Gy.
        let grid = Grid::axis_aligned([40, 5, 5], [1.0, 2.0, 2.5], [0.0; 3]).unwrap();
        let dose = Volume::from_fn(grid.clone(), |l| 5.0 * (grid.voxel(l)[0].clamp(10, 20) - 10) as f32);
        let at = |steep: f32, flat: f32| {
            Volume::from_fn(grid.clone(), |l| match grid.voxel(l)[0] {
                15 => steep,
                30 => flat,
                _ => 0.0,
            })
        };
        assert_eq!(caution(&dose, &at(f32::INFINITY, f32::INFINITY)).folded_or_outside, 25);
        // Folds are told apart from what lies outside.
        let apart = |steep| {
            let found = caution(&dose, &at(steep, f32::NAN));
            (found.folded_or_outside, found.folded)
        };
        assert_eq!((apart(f32::INFINITY), apart(f32::NAN)), ((25, 0), (25, 25)));
        let doubt = caution(&dose, &at(0.2, 10.0)); // 1 Gy is 2 %
        assert_eq!((doubt.uncertain, doubt.folded_or_outside), (25, 0));
        assert!((doubt.greatest_gy - 1.0).abs() < 1e-6 && (doubt.ml - 25.0 * 0.005).abs() < 1e-9);
        assert_eq!(caution(&dose, &at(0.05, 10.0)).uncertain, 0);
        let row: Vec<bool> = steep(&dose).data()[..40].to_vec();
        assert_eq!(
            row.iter().enumerate().filter(|(_, s)| **s).map(|(i, _)| i).collect::<Vec<_>>(),
            (10..=20).collect::<Vec<_>>()
        );
        assert_eq!(caution(&Volume::filled(grid.clone(), 0.0), &at(9.0, 9.0)), Caution::default());
    }
    #[test]
    fn a_fold_counts_only_where_the_dose_is_steep() {
        // 50 Gy at most: more than 1 Gy/mm is steep with STEEP = 0.02 per mm, the slope beside it has half of it.
        let grid = Grid::axis_aligned([60, 3, 3], [1.0; 3], [0.0; 3]).unwrap();
        let dose = Volume::from_fn(grid.clone(), |l| {
            let x = grid.voxel(l)[0] as f64;
            let slope = 0.5 * STEEP * 50.0;
            (if x < 20.0 { slope * x } else { (slope * 20.0 + 5.0 * (x - 20.0)).min(50.0) }) as f32
        });
        let folded = |at: usize| {
            let doubt = Volume::from_fn(grid.clone(), |l| if grid.voxel(l)[0] == at { f32::INFINITY } else { 0.0 });
            caution(&dose, &doubt).folded_or_outside
        };
        assert_eq!((folded(10), folded(23), folded(50)), (0, 9, 0));
    }

    #[test]
    fn at_the_edges_of_the_dose_it_is_as_steep_as_inside() {
        // 1 Gy/mm and 60 Gy at most: steep where more than 0.6 Gy/mm.
        let grid = Grid::axis_aligned([61, 2, 1], [1.0; 3], [0.0; 3]).unwrap();
        let dose = Volume::from_fn(grid.clone(), |l| grid.voxel(l)[0] as f32);
        assert!(steep(&dose).data().iter().all(|s| *s));
    }
}
