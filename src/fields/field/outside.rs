//! How much of something lies outside a grid: of an image outside a field, of a dose outside another dose.

use crate::findings;
use crate::geometry::Grid;
use crate::volume::Volume;
use crate::warning::Warning;
use nalgebra::{Point3, Vector3};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// Less of a dose or of the patient outside a field is not worth a word, percent.
pub const WORTH: f64 = 0.1;
/// Less of labels or contours: bones are cut where a scan ends.
pub const WORTH_OF_LABELS: f64 = 1.0;
/// Less of an image: what lies beyond the other scan comes in at its edges.
pub const WORTH_OF_IMAGE: f64 = 5.0;

/// What lies outside a grid, whose outermost voxels reach half a voxel beyond their centres.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct Outside {
    /// Volume outside, ml.
    pub volume_ml: f64,
    /// Share of the volume, percent.
    pub volume_percent: f64,
    /// Share of what the values add up to, percent; of a dose the share of the integral dose.
    pub amount_percent: f64,
}

/// Whether a grid's voxels hold a point; a hair beyond is rounding.
#[inline]
pub fn covers(grid: &Grid, point: &Point3<f64>) -> bool {
    let index = grid.index(point);
    (0..3).all(|a| index[a] > -0.501 && index[a] < grid.size()[a] as f64 - 0.499)
}

impl Outside {
    /// Of a dose, outside `cover`.
    pub fn of(dose: &Volume<f32>, cover: &Grid) -> Self {
        Self::weighted(dose.grid(), cover, |l| f64::from(dose.data()[l].max(0.0)))
    }

    /// Of the voxels of a grid that `weight` (by place in storage) says to count, and of these weights.
    pub fn weighted(grid: &Grid, cover: &Grid, weight: impl Fn(usize) -> f64 + Sync) -> Self {
        let corner = |c: usize| {
            let size = grid.size();
            Vector3::from_fn(|a, _| if c >> a & 1 == 1 { size[a] as f64 - 0.5 } else { -0.5 })
        };
        // A box whose corners are all covered is covered.
        if (0..8).all(|c| covers(cover, &grid.world(&corner(c)))) {
            return Self::default();
        }
        let slice = grid.strides()[2];
        let planes: Vec<[f64; 4]> = (0..grid.size()[2])
            .into_par_iter()
            .map(|k| {
                let mut sums = [0.0; 4];
                for l in k * slice..(k + 1) * slice {
                    let w = weight(l);
                    let out = f64::from(!covers(cover, &grid.centre(grid.voxel(l))));
                    sums = [sums[0] + 1.0, sums[1] + out, sums[2] + w, sums[3] + out * w];
                }
                sums
            })
            .collect();
        let [all, out, weights, lost] = planes.iter().fold([0.0; 4], |sum, p| std::array::from_fn(|n| sum[n] + p[n]));
        let percent = |part: f64, whole: f64| if whole > 0.0 { 100.0 * part / whole } else { 0.0 };
        Self {
            volume_ml: out * grid.voxel_volume() / 1000.0,
            volume_percent: percent(out, all),
            amount_percent: percent(lost, weights),
        }
    }
}

/// A word about the share of `what` that lies outside a field, percent, where it is more than `worth`.
pub fn outside_field(what: &str, field: &str, percent: f64, worth: f64) -> Option<Warning> {
    (percent > worth).then(|| {
        let message =
            format!("{percent:.1} % of {what} lies outside {field}, which is the identity there: it is not moved");
        Warning::new(findings::OUTSIDE_FIELD, message)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn half_of_a_box_with_all_of_its_dose() {
        let grid = Grid::axis_aligned([10, 4, 4], [1.0, 2.0, 5.0], [0.0; 3]).unwrap();
        let cover = Grid::axis_aligned([5, 2, 2], [1.0, 4.0, 10.0], [0.0, 1.0, 2.5]).unwrap();
        let dose = Volume::from_fn(grid.clone(), |l| if grid.voxel(l)[0] > 5 { 2.0f32 } else { 0.0 });
        let out = Outside::of(&dose, &cover);
        assert!((out.volume_ml - 0.8).abs() < 1e-12 && (out.volume_percent - 50.0).abs() < 1e-12, "{out:?}");
        assert!((out.amount_percent - 100.0).abs() < 1e-12, "{out:?}");
        assert_eq!(Outside::of(&dose, &grid), Outside::default());
    }
}
