//! Carrying images and labels through a pull field, and points through a push field.

use super::{PullField, PushField};
use crate::error::Result;
use crate::volume::{LabelMap, Mask, Volume, trilinear, trilinear_vector};
use nalgebra::{Point3, Vector3};
use rayon::prelude::*;

/// An image of the planning frame on the fraction grid, trilinear; `outside` where the pre-image is not in the image.
///
/// # Errors
/// Only for internal inconsistency of grids.
pub fn warp_image(pull: &PullField, image: &Volume<f32>, outside: f32) -> Result<Volume<f32>> {
    let values = pulled(pull, image, |index| trilinear(image, index).map_or(outside, |v| v as f32));
    Volume::new(pull.displacement.grid().clone(), values)
}

/// A label map of the planning frame on the fraction grid: the label with the greatest trilinear weight.
///
/// Ties go to the smaller label; outside the map the label is 0. Names are kept.
///
/// # Errors
/// Only for internal inconsistency of grids.
pub fn warp_labels(pull: &PullField, labels: &LabelMap) -> Result<LabelMap> {
    let map = &labels.volume;
    let values = pulled(pull, map, |index| vote(map, index));
    Ok(LabelMap { volume: Volume::new(pull.displacement.grid().clone(), values)?, names: labels.names.clone() })
}

/// Fraction voxels whose pre-image is patient tissue: the voxel's nearest planning voxel is set in `mask`.
///
/// # Errors
/// Only for internal inconsistency of grids.
pub fn warp_mask(pull: &PullField, mask: &Mask) -> Result<Mask> {
    let grid = mask.grid();
    let values = pulled(pull, mask, |index| {
        grid.contains(index) && mask.data()[grid.linear([0, 1, 2].map(|a| index[a].round() as usize))]
    });
    Volume::new(pull.displacement.grid().clone(), values)
}

/// Where the push field takes a planning point; `None` outside the planning grid.
pub fn push_point(push: &PushField, point: &Point3<f64>) -> Option<Point3<f64>> {
    let u = trilinear_vector(&push.displacement, &push.displacement.grid().index(point))?;
    Some(point + u)
}

/// `value(continuous index in the source)` at every fraction voxel, in parallel over planes.
fn pulled<S, T: Send + Default + Clone>(
    pull: &PullField,
    source: &Volume<S>,
    value: impl Fn(&Vector3<f64>) -> T + Sync,
) -> Vec<T>
where
    S: Sync,
{
    let grid = pull.displacement.grid();
    let [nx, ny, _] = grid.size();
    let base = source.grid().index(&grid.origin());
    let step = source.grid().inverse_step() * grid.step();
    let turn = source.grid().inverse_step();
    let v = pull.displacement.data();
    let mut out = vec![T::default(); grid.len()];
    out.par_chunks_mut(nx * ny).enumerate().for_each(|(k, out)| {
        for (n, o) in out.iter_mut().enumerate() {
            let d = Vector3::from(v[k * nx * ny + n].map(f64::from));
            let mut index = base + step * Vector3::new((n % nx) as f64, (n / nx) as f64, k as f64) + turn * d;
            // Rounding of the field's single precision must not push the outermost voxel outside.
            for a in 0..3 {
                let last = (source.grid().size()[a] - 1) as f64;
                if index[a] < 0.0 && index[a] > -1e-3 {
                    index[a] = 0.0;
                } else if index[a] > last && index[a] < last + 1e-3 {
                    index[a] = last;
                }
            }
            *o = value(&index);
        }
    });
    out
}

/// The label with the greatest trilinear weight at a continuous index.
fn vote(map: &Volume<u16>, index: &Vector3<f64>) -> u16 {
    let grid = map.grid();
    if !grid.contains(index) {
        return 0;
    }
    let size = grid.size();
    let low: [usize; 3] = [0, 1, 2].map(|a| (index[a] as usize).min(size[a] - 1));
    let mut votes = [(0u16, 0f64); 8];
    let mut kinds = 0;
    for c in 0..8usize {
        let mut weight = 1.0;
        let at = [0, 1, 2].map(|a| {
            let t = index[a] - low[a] as f64;
            let up = c >> a & 1;
            weight *= if up == 1 { t } else { 1.0 - t };
            (low[a] + up).min(size[a] - 1)
        });
        let label = *map.at(at);
        match votes[..kinds].iter_mut().find(|v| v.0 == label) {
            Some(v) => v.1 += weight,
            None => {
                votes[kinds] = (label, weight);
                kinds += 1;
            }
        }
    }
    votes[..kinds].iter().max_by(|a, b| a.1.total_cmp(&b.1).then(b.0.cmp(&a.0))).map_or(0, |v| v.0)
}

#[cfg(test)]
#[expect(clippy::float_cmp, reason = "values that are exact by construction")]
mod tests {
    use super::*;
    use crate::geometry::Grid;

    fn shifted(shift: [f32; 3]) -> (PullField, Grid) {
        let grid = Grid::axis_aligned([12, 10, 8], [1.0, 2.0, 3.0], [5.0, -7.0, 11.0]).unwrap();
        let pull =
            PullField { displacement: Volume::filled(grid.clone(), shift), inside: Volume::filled(grid.clone(), true) };
        (pull, grid)
    }

    #[test]
    fn a_shift_by_a_voxel_moves_values_by_a_voxel() {
        let (pull, grid) = shifted([1.0, 0.0, -3.0]);
        let image = Volume::from_fn(grid.clone(), |l| l as f32);
        let out = warp_image(&pull, &image, -1.0).unwrap();
        assert_eq!(*out.at([3, 4, 5]), *image.at([4, 4, 4]));
        assert_eq!(*out.at([11, 4, 5]), -1.0);
        assert_eq!(*out.at([3, 4, 0]), -1.0);
    }

    #[test]
    fn labels_vote_and_keep_their_names() {
        let (pull, grid) = shifted([0.4, 0.0, 0.0]);
        let map = Volume::from_fn(grid.clone(), |l| if grid.voxel(l)[0] >= 6 { 7u16 } else { 0 });
        let names = [(7, "skull".to_owned())].into();
        let out = warp_labels(&pull, &LabelMap { volume: map, names }).unwrap();
        assert_eq!((*out.volume.at([5, 5, 5]), *out.volume.at([6, 5, 5])), (0, 7));
        assert_eq!(out.names[&7], "skull");
    }
}
