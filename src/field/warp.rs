//! Carrying images and labels through a pull field, and points through a push field.

use super::{PullField, PushField};
use crate::error::Result;
use crate::geometry::Grid;
use crate::volume::{LabelMap, Mask, Volume, cubic, trilinear, trilinear_vector};
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
        Interpolation::Linear => match Linear::new(image) {
            Some(linear) => pulled_raw(v, image.grid(), |index| linear.at(&index).unwrap_or(outside)),
            None => pulled(v, image.grid(), |index| trilinear(image, index).map_or(outside, |v| v as f32)),
        },
        Interpolation::Cubic => pulled(v, image.grid(), |index| cubic(image, index).map_or(outside, |v| v.0 as f32)),
    };
    Volume::new(v.grid().clone(), values)
}

/// How far outside the hull of the voxel centres an index still counts as on it, voxels: rounding of the field's single
/// precision must not push the outermost voxel outside.
const ROUNDING: f64 = 1e-3;

/// Trilinear values with the constants of the grid at hand and single-precision weights: the inner loop of a warp.
struct Linear<'a> {
    data: &'a [f32],
    /// Distances to the next row and plane; 0 along an axis of one voxel.
    up: [usize; 2],
    strides: [usize; 3],
    /// Lower neighbour of the last pair of voxels.
    most: [u32; 3],
    last: [f64; 3],
}

impl<'a> Linear<'a> {
    /// `None` for an image of a single column, which has no pairs of voxels.
    fn new(image: &'a Volume<f32>) -> Option<Self> {
        let (size, strides) = (image.grid().size(), image.grid().strides());
        let up = |a: usize| if size[a] > 1 { strides[a] } else { 0 };
        let pair = |n: usize| u32::try_from(n.saturating_sub(2)).ok();
        (size[0] > 1).then_some(())?;
        Some(Self {
            data: image.data(),
            up: [up(1), up(2)],
            strides,
            most: [pair(size[0])?, pair(size[1])?, pair(size[2])?],
            last: size.map(|n| (n - 1) as f64),
        })
    }

    /// The value at a continuous index; `None` outside the hull of the voxel centres.
    fn at(&self, index: &Vector3<f64>) -> Option<f32> {
        let (mut base, mut t) = (0, [0f32; 3]);
        for a in 0..3 {
            let (x, last) = (index[a], self.last[a]);
            if !(x >= -ROUNDING && x <= last + ROUNDING) {
                return None;
            }
            let x = x.max(0.0).min(last);
            let low = (x as u32).min(self.most[a]);
            t[a] = (x - f64::from(low)) as f32;
            base += low as usize * self.strides[a];
        }
        let line = |n: usize| -> Option<f32> {
            let [a, b] = self.data.get(n..)?.first_chunk::<2>()?;
            Some(a + t[0] * (b - a))
        };
        let face = |n: usize| -> Option<f32> {
            let a = line(n)?;
            Some(a + t[1] * (line(n + self.up[0])? - a))
        };
        let a = face(base)?;
        Some(a + t[2] * (face(base + self.up[1])? - a))
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

/// `value(continuous index in the source)` at every voxel of the displacements' grid, in parallel over rows. Indices that
/// rounding puts outside the hull of the voxel centres are put back on it.
pub(super) fn pulled<T: Send + Default + Clone>(
    v: &Volume<[f32; 3]>,
    source: &Grid,
    value: impl Fn(&Vector3<f64>) -> T + Sync,
) -> Vec<T> {
    let last = Vector3::from(source.size().map(|n| (n - 1) as f64));
    pulled_raw(v, source, |index| {
        let near = |i: f64, l: f64| {
            let held = i.clamp(0.0, l);
            if (i - held).abs() < ROUNDING { held } else { i }
        };
        value(&index.zip_map(&last, near))
    })
}

/// As [`pulled`], with indices as they are.
fn pulled_raw<T: Send + Default + Clone>(
    v: &Volume<[f32; 3]>,
    source: &Grid,
    value: impl Fn(Vector3<f64>) -> T + Sync,
) -> Vec<T> {
    let grid = v.grid();
    let [nx, ny, _] = grid.size();
    let base = source.index(&grid.origin());
    let step = source.inverse_step() * grid.step();
    let turn = *source.inverse_step();
    let mut out = vec![T::default(); grid.len()];
    out.par_chunks_mut(nx).zip(v.data().par_chunks(nx)).enumerate().for_each(|(row, (out, v))| {
        let start = base + step * Vector3::new(0.0, (row % ny) as f64, (row / ny) as f64);
        let along: Vector3<f64> = step.column(0).into_owned();
        for (i, (o, v)) in out.iter_mut().zip(v).enumerate() {
            *o = value(start + along * i as f64 + turn * Vector3::from(v.map(f64::from)));
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
        let linear = Linear::new(&image).unwrap();
        for n in 0..2000 {
            let at = Vector3::new(n as f64 * 0.0057, (n % 97) as f64 * 0.094, (n % 31) as f64 * 0.234);
            let (a, b) = (linear.at(&at), trilinear(&image, &at));
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
