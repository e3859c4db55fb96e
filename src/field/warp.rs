//! Carrying images and labels through a pull field, and points through a push field.

use super::{PullField, PushField};
use crate::error::Result;
use crate::geometry::Grid;
use crate::volume::{LabelMap, Mask, Volume, cubic, trilinear_vector};
use nalgebra::{Point3, Vector3};
use rayon::prelude::*;

/// How values between voxels are found.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Interpolation {
    /// Trilinear, as ITK's.
    #[default]
    Linear,
    /// Cubic convolution (Keys 1981, a = -1/2); overshoots at edges by up to an eighth of the step.
    Cubic,
}

/// An image at `y + v(y)` for every voxel `y` of the displacements' grid; `outside` where that is not in the image.
///
/// # Errors
/// Only for internal inconsistency of grids.
pub fn resample(
    v: &Volume<[f32; 3]>,
    image: &Volume<f32>,
    interpolation: Interpolation,
    outside: f32,
) -> Result<Volume<f32>> {
    let values = match interpolation {
        Interpolation::Linear => {
            let linear = Linear::new(image);
            pulled(v, image.grid(), |index| linear.at(index).unwrap_or(outside))
        }
        Interpolation::Cubic => pulled(v, image.grid(), |index| cubic(image, index).map_or(outside, |v| v.0 as f32)),
    };
    Volume::new(v.grid().clone(), values)
}

/// Trilinear values with the constants of the grid at hand and single-precision weights: the inner loop of a warp.
struct Linear<'a> {
    data: &'a [f32],
    strides: [usize; 3],
    /// Distance to the upper neighbour; 0 along an axis of one voxel.
    up: [usize; 3],
    /// Lower neighbour of the last voxel pair.
    most: [i32; 3],
    last: [f64; 3],
}

impl<'a> Linear<'a> {
    fn new(image: &'a Volume<f32>) -> Self {
        let (size, strides) = (image.grid().size(), image.grid().strides());
        Self {
            data: image.data(),
            strides,
            up: std::array::from_fn(|a| if size[a] > 1 { strides[a] } else { 0 }),
            most: size.map(|n| i32::try_from(n.saturating_sub(2)).unwrap_or(i32::MAX)),
            last: size.map(|n| (n - 1) as f64),
        }
    }

    /// The value at a continuous index; `None` outside the hull of the voxel centres.
    fn at(&self, index: &Vector3<f64>) -> Option<f32> {
        if !(0..3).all(|a| index[a] >= 0.0 && index[a] <= self.last[a]) {
            return None;
        }
        let low: [i32; 3] = std::array::from_fn(|a| (index[a] as i32).min(self.most[a]));
        let [tx, ty, tz]: [f32; 3] = std::array::from_fn(|a| (index[a] - f64::from(low[a])) as f32);
        let base = (0..3).map(|a| low[a] as usize * self.strides[a]).sum::<usize>();
        let [ux, uy, uz] = self.up;
        let line = |n: usize| {
            let a = self.data[n];
            a + tx * (self.data[n + ux] - a)
        };
        let face = |n: usize| {
            let a = line(n);
            a + ty * (line(n + uy) - a)
        };
        let a = face(base);
        Some(a + tz * (face(base + uz) - a))
    }
}

/// An image of the planning frame on the fraction grid, trilinear; `outside` where the pre-image is not in the image.
///
/// # Errors
/// Only for internal inconsistency of grids.
pub fn warp_image(pull: &PullField, image: &Volume<f32>, outside: f32) -> Result<Volume<f32>> {
    resample(&pull.displacement, image, Interpolation::Linear, outside)
}

/// A label map of the planning frame on the fraction grid; see [`resample_labels`](super::resample_labels).
///
/// # Errors
/// Only for internal inconsistency of grids.
pub fn warp_labels(pull: &PullField, labels: &LabelMap) -> Result<LabelMap> {
    super::resample_labels(&pull.displacement, labels)
}

/// Fraction voxels whose pre-image is patient tissue: the voxel's nearest planning voxel is set in `mask`.
///
/// # Errors
/// Only for internal inconsistency of grids.
pub fn warp_mask(pull: &PullField, mask: &Mask) -> Result<Mask> {
    let grid = mask.grid();
    let values = pulled(&pull.displacement, grid, |index| {
        grid.contains(index) && mask.data()[grid.linear([0, 1, 2].map(|a| index[a].round() as usize))]
    });
    Volume::new(pull.displacement.grid().clone(), values)
}

/// Where the push field takes a planning point; `None` outside the planning grid.
pub fn push_point(push: &PushField, point: &Point3<f64>) -> Option<Point3<f64>> {
    let u = trilinear_vector(&push.displacement, &push.displacement.grid().index(point))?;
    Some(point + u)
}

/// `value(continuous index in the source)` at every voxel of the displacements' grid, in parallel over planes.
pub(super) fn pulled<T: Send + Default + Clone>(
    v: &Volume<[f32; 3]>,
    source: &Grid,
    value: impl Fn(&Vector3<f64>) -> T + Sync,
) -> Vec<T> {
    let grid = v.grid();
    let [nx, ny, _] = grid.size();
    let base = source.index(&grid.origin());
    let step = source.inverse_step() * grid.step();
    let turn = source.inverse_step();
    let last = Vector3::from(source.size().map(|n| (n - 1) as f64));
    let mut out = vec![T::default(); grid.len()];
    out.par_chunks_mut(nx).zip(v.data().par_chunks(nx)).enumerate().for_each(|(row, (out, v))| {
        let start = base + step * Vector3::new(0.0, (row % ny) as f64, (row / ny) as f64);
        for (i, (o, v)) in out.iter_mut().zip(v).enumerate() {
            let mut index = start + step.column(0) * i as f64 + turn * Vector3::from(v.map(f64::from));
            // Rounding of the field's single precision must not push the outermost voxel outside.
            for a in 0..3 {
                if index[a] < 0.0 && index[a] > -1e-3 {
                    index[a] = 0.0;
                } else if index[a] > last[a] && index[a] < last[a] + 1e-3 {
                    index[a] = last[a];
                }
            }
            *o = value(&index);
        }
    });
    out
}

#[cfg(test)]
#[expect(clippy::float_cmp, reason = "values that are exact by construction")]
mod tests {
    use super::*;

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
    fn the_inner_loop_is_trilinear() {
        let (_, grid) = shifted([0.0; 3]);
        let image = Volume::from_fn(grid, |l| ((l * 7919) % 1000) as f32);
        let linear = Linear::new(&image);
        for n in 0..2000 {
            let at = Vector3::new(n as f64 * 0.0057, (n % 97) as f64 * 0.094, (n % 31) as f64 * 0.234);
            let (a, b) = (linear.at(&at), crate::volume::trilinear(&image, &at));
            match (a, b) {
                (Some(a), Some(b)) => assert!((f64::from(a) - b).abs() < 1e-3, "{at}: {a} {b}"),
                (a, b) => assert!(a.is_none() && b.is_none(), "{at}"),
            }
        }
        assert_eq!(linear.at(&Vector3::new(11.0, 9.0, 7.0)), image.data().last().copied());
        assert!(linear.at(&Vector3::new(f64::NAN, 0.0, 0.0)).is_none());
    }

    #[test]
    fn cubic_is_exact_on_a_quadratic_where_linear_is_not() {
        let (pull, grid) = shifted([0.5, 0.0, 0.0]);
        let square = Volume::from_fn(grid.clone(), |l| (grid.voxel(l)[0] as f32).powi(2));
        let smooth = resample(&pull.displacement, &square, Interpolation::Cubic, 0.0).unwrap();
        let straight = resample(&pull.displacement, &square, Interpolation::Linear, 0.0).unwrap();
        assert!((smooth.at([4, 5, 5]) - 20.25).abs() < 1e-4);
        assert!((straight.at([4, 5, 5]) - 20.5).abs() < 1e-4);
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
