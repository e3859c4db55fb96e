//! Carrying images and labels through a pull field, and points through a push field.

use super::{PullField, PushField};
use crate::error::Result;
use crate::geometry::{Grid, LANES, vectorised};
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
            walked(
                v,
                image.grid(),
                #[inline(always)]
                |place| linear.at(place).unwrap_or(outside),
            )
        }
        Interpolation::Cubic => pulled(v, image.grid(), |index| cubic(image, index).map_or(outside, |v| v.0 as f32)),
    };
    Volume::new(v.grid().clone(), values)
}

/// How far outside the hull of the voxel centres an index still counts as on it, voxels: rounding of the field's single
/// precision must not push the outermost voxel outside.
const ROUNDING: f64 = 1e-3;

/// A place between voxels: the lower ones along each axis, which may lie outside the grid, and the way to the upper ones.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Place {
    pub(super) low: [i32; 3],
    pub(super) t: [f32; 3],
}

/// A place inside a grid: storage position of the lower corner, and the way to the upper ones.
pub(super) struct Corner {
    pub(super) base: usize,
    pub(super) t: [f32; 3],
}

/// How places lie in a grid.
pub(super) struct Hull {
    size: [usize; 3],
    strides: [usize; 3],
    /// Pairs of voxels along each axis.
    pairs: [u32; 3],
    /// Distances in storage to the upper corners; 0 along an axis of one voxel.
    pub(super) up: [usize; 3],
}

impl Hull {
    pub(super) fn new(grid: &Grid) -> Self {
        let (size, strides) = (grid.size(), grid.strides());
        let up = std::array::from_fn(|a| if size[a] > 1 { strides[a] } else { 0 });
        // More voxels along an axis than an image can have: places beyond are looked up the slow way.
        let pairs = size.map(|n| u32::try_from(n - 1).unwrap_or(u32::MAX));
        Self { size, strides, pairs, up }
    }

    /// The corner of a place; `None` outside the hull of the voxel centres.
    #[inline(always)]
    pub(super) fn corner(&self, Place { low: [i, j, k], t }: Place) -> Option<Corner> {
        if (i as u32) < self.pairs[0] && (j as u32) < self.pairs[1] && (k as u32) < self.pairs[2] {
            let base = i as usize + j as usize * self.strides[1] + k as usize * self.strides[2];
            return Some(Corner { base, t });
        }
        self.edge(Place { low: [i, j, k], t })
    }

    /// As [`Hull::corner`] where a coordinate may lie on the last voxel, or beyond the hull by rounding.
    #[cold]
    fn edge(&self, Place { low, mut t }: Place) -> Option<Corner> {
        let mut base = 0;
        for a in 0..3 {
            let last = self.size[a] as i64 - 1;
            let lower = match i64::from(low[a]) {
                l if l >= 0 && l < last => l,
                l if l == last && f64::from(t[a]) <= ROUNDING => {
                    t[a] = if last > 0 { 1.0 } else { 0.0 };
                    (last - 1).max(0)
                }
                -1 if f64::from(t[a]) >= 1.0 - ROUNDING => {
                    t[a] = 0.0;
                    0
                }
                _ => return None,
            };
            base += lower as usize * self.strides[a];
        }
        Some(Corner { base, t })
    }
}

/// Trilinear values with single-precision weights: the inner loop of a warp.
struct Linear<'a> {
    data: &'a [f32],
    hull: Hull,
}

impl<'a> Linear<'a> {
    fn new(image: &'a Volume<f32>) -> Self {
        Self { data: image.data(), hull: Hull::new(image.grid()) }
    }

    /// The value at a place; `None` outside the hull of the voxel centres.
    #[inline(always)]
    fn at(&self, place: Place) -> Option<f32> {
        let Corner { base, t } = self.hull.corner(place)?;
        let [right, up, above] = self.hull.up;
        let line = |n: usize| -> Option<f32> {
            let (a, b) = (*self.data.get(n)?, *self.data.get(n + right)?);
            Some(a + t[0] * (b - a))
        };
        let face = |n: usize| -> Option<f32> {
            let a = line(n)?;
            Some(a + t[1] * (line(n + up)? - a))
        };
        let a = face(base)?;
        Some(a + t[2] * (face(base + above)? - a))
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
    let near = |i: f64, l: f64| {
        let held = i.clamp(0.0, l);
        if (i - held).abs() < ROUNDING { held } else { i }
    };
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
            let index = start + along * i as f64 + turn * Vector3::from(v.map(f64::from));
            *o = value(&index.zip_map(&last, near));
        }
    });
    out
}

/// Indices farther than this from a row of voxels are outside of everything.
const FAR: f32 = 1e6;

/// As [`pulled`], with places instead of indices, in single precision relative to the row: [`LANES`] voxels at a time.
pub(super) fn walked<T: Send + Default + Clone>(
    v: &Volume<[f32; 3]>,
    source: &Grid,
    value: impl Fn(Place) -> T + Sync,
) -> Vec<T> {
    let grid = v.grid();
    let [nx, ny, _] = grid.size();
    let base = source.index(&grid.origin());
    let step = source.inverse_step() * grid.step();
    let turn: [[f32; 3]; 3] = std::array::from_fn(|a| std::array::from_fn(|c| source.inverse_step()[(a, c)] as f32));
    let along: [[f32; LANES]; 3] = std::array::from_fn(|a| std::array::from_fn(|l| (step[(a, 0)] * l as f64) as f32));
    let mut out = vec![T::default(); grid.len()];
    out.par_chunks_mut(nx).zip(v.data().par_chunks(nx)).enumerate().for_each(|(row, (out, v))| {
        vectorised(
            #[inline(always)]
            || {
                // Filled anew for each block; arrays that are handed round by value would be copied more often than computed.
                let (mut u, mut low, mut t) = ([[0f32; LANES]; 3], [[0i32; LANES]; 3], [[0f32; LANES]; 3]);
                for (n, (out, v)) in out.chunks_mut(LANES).zip(v.chunks(LANES)).enumerate() {
                    for (l, v) in v.iter().enumerate() {
                        (u[0][l], u[1][l], u[2][l]) = (v[0], v[1], v[2]);
                    }
                    let index = Vector3::new((n * LANES) as f64, (row % ny) as f64, (row / ny) as f64);
                    for a in 0..3 {
                        let start = (base[a] + (step.row(a) * index)[0]).clamp(-1e8, 1e8);
                        let whole = start.floor();
                        let (rest, whole, by) = ((start - whole) as f32, whole as i32, turn[a]);
                        for l in 0..LANES {
                            let x = (rest + along[a][l]) + (by[0] * u[0][l] + by[1] * u[1][l] + by[2] * u[2][l]);
                            (low[a][l], t[a][l]) = lower(x, whole);
                        }
                    }
                    for (l, o) in out.iter_mut().enumerate() {
                        *o = value(Place { low: [low[0][l], low[1][l], low[2][l]], t: [t[0][l], t[1][l], t[2][l]] });
                    }
                }
            },
        )
    });
    out
}

/// The lower voxel and the way from it; what is far off or no number comes to lie far outside.
#[inline(always)]
fn lower(x: f32, whole: i32) -> (i32, f32) {
    // Added to a number below 2^22 this leaves the nearest whole number in the low bits: without a rounding instruction,
    // which the oldest 64-bit machines lack, a cast costs several times as much.
    const MAGIC: f32 = 12_582_912.0;
    let near = x.abs() < FAR;
    let held = if near { x } else { 0.0 };
    let shifted = held + MAGIC;
    let nearest = shifted - MAGIC;
    let above = nearest > held;
    let floor = nearest - if above { 1.0 } else { 0.0 };
    let low = shifted.to_bits() as i32 - MAGIC.to_bits() as i32 - i32::from(above);
    (low + if near { whole } else { -400_000_000 }, held - floor)
}

#[cfg(test)]
#[expect(clippy::float_cmp, reason = "values that are exact by construction")]
mod tests {
    use super::*;
    use crate::volume::trilinear;

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

    fn place(at: &Vector3<f64>) -> Place {
        let low = at.map(f64::floor);
        Place { low: [0, 1, 2].map(|a| low[a] as i32), t: [0, 1, 2].map(|a| (at[a] - low[a]) as f32) }
    }

    #[test]
    fn the_inner_loop_is_trilinear() {
        let (_, grid) = shifted([0.0; 3]);
        let image = Volume::from_fn(grid, |l| ((l * 7919) % 1000) as f32);
        let linear = Linear::new(&image);
        for n in 0..2000 {
            let at = Vector3::new(n as f64 * 0.0057, (n % 97) as f64 * 0.094, (n % 31) as f64 * 0.234);
            let (a, b) = (linear.at(place(&at)), trilinear(&image, &at));
            match (a, b) {
                (Some(a), Some(b)) => assert!((f64::from(a) - b).abs() < 1e-3, "{at}: {a} {b}"),
                (a, b) => assert!(a.is_none() && b.is_none(), "{at}"),
            }
        }
        assert_eq!(linear.at(place(&Vector3::new(11.0, 9.0, 7.0))), image.data().last().copied());
        // On the edge by rounding, and beyond it.
        assert_eq!(linear.at(place(&Vector3::new(11.0005, -0.0005, 7.0))), Some(*image.at([11, 0, 7])));
        assert_eq!(linear.at(place(&Vector3::new(11.002, 3.0, 3.0))), None);
        let flat = Volume::filled(Grid::axis_aligned([1, 4, 4], [1.0; 3], [0.0; 3]).unwrap(), 5.0f32);
        assert_eq!(Linear::new(&flat).at(place(&Vector3::new(0.0, 3.0, 2.5))), Some(5.0));
        assert_eq!(Linear::new(&flat).at(place(&Vector3::new(0.5, 3.0, 2.5))), None);
    }

    #[test]
    fn eight_at_a_time_is_one_at_a_time() {
        // Oblique, left-handed, another spacing; displacements of hundreds of voxels, infinite, and no number.
        let turn = nalgebra::Rotation3::from_euler_angles(0.3, -0.2, 0.5).into_inner();
        let own = Grid::new([21, 7, 5], [1.5, 2.0, 2.5], Point3::new(-14.0, 3.0, 9.0), turn).unwrap();
        let mut mirrored = turn.transpose();
        mirrored.column_mut(1).neg_mut();
        let source = Grid::new([40, 30, 20], [0.9, 1.1, 1.3], Point3::new(-20.0, 21.0, -5.0), mirrored).unwrap();
        let image = Volume::from_fn(source.clone(), |l| {
            let [i, j, k] = source.voxel(l).map(|c| c as f32);
            3.0 * i - 2.0 * j + k
        });
        let mut v =
            Volume::from_fn(own.clone(), |l| [4.0, -3.0, 2.0].map(|s| s * ((l * 37 % 101) as f32 / 50.0 - 1.0)));
        (v.data_mut()[5], v.data_mut()[6]) = ([f32::NAN; 3], [0.0, f32::INFINITY, 0.0]);
        (v.data_mut()[7], v.data_mut()[8]) = ([3e4, 0.0, 0.0], [-1e30; 3]);
        let got = resample(&v, &image, Interpolation::Linear, -777.0).unwrap();
        let mut inside = 0;
        for (n, got) in got.data().iter().enumerate() {
            let at = own.centre(own.voxel(n)) + Vector3::from(v.data()[n].map(f64::from));
            match trilinear(&image, &source.index(&at)) {
                Some(b) => {
                    inside += 1;
                    assert!((f64::from(*got) - b).abs() < 1e-3, "{n}: {got} {b}");
                }
                None => assert_eq!(*got, -777.0, "{n}"),
            }
        }
        assert!(inside > 100 && inside < got.data().len() - 4, "{inside}");
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
