//! Carrying images and labels through a pull field, and points through a push field.

use super::super::PullField;
use super::super::PushField;
use super::walk::{WalkCorner, WalkHull, WalkPlaces, pulled, walked};
use crate::error::Result;
use crate::geometry::LANES;
use crate::volume::{LabelMap, Volume, cubic, trilinear_vector};
use nalgebra::Point3;

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
                |places, out| linear.fill(places, outside, out),
            )
        }
        Interpolation::Cubic => pulled(v, image.grid(), |index| cubic(image, index).map_or(outside, |v| v.0 as f32)),
    };
    Volume::new(v.grid().clone(), values)
}

/// Trilinear values with single-precision weights: the inner loop of a warp.
struct Linear<'a> {
    data: &'a [f32],
    hull: WalkHull,
}

impl<'a> Linear<'a> {
    fn new(image: &'a Volume<f32>) -> Self {
        Self { data: image.data(), hull: WalkHull::new(image.grid()) }
    }

    /// The values at places; `outside` where they have none.
    #[inline(always)]
    fn fill(&self, places: &WalkPlaces, outside: f32, out: &mut [f32]) {
        let WalkPlaces { low, t } = places;
        let (pairs, strides) = (&self.hull.quick, &self.hull.strides);
        let mut base = [0i32; LANES];
        let (mut within, mut in_line) = (true, self.hull.up[0] == 1);
        for l in 0..LANES {
            let [i, j, k] = [low[0][l], low[1][l], low[2][l]];
            within &= ((i as u32) < pairs[0]) & ((j as u32) < pairs[1]) & ((k as u32) < pairs[2]);
            base[l] = i.wrapping_add(j.wrapping_mul(strides[1] as i32)).wrapping_add(k.wrapping_mul(strides[2] as i32));
        }
        for l in 0..LANES {
            in_line &= base[l] == base[0].wrapping_add(l as i32);
        }
        if within
            && in_line
            && let Some(values) = self.line(base[0] as usize, t)
            && let Some(out) = out.first_chunk_mut()
        {
            *out = values;
            return;
        }
        for (l, o) in out.iter_mut().enumerate() {
            let place = places.at(l);
            let corner =
                if within { Some(WalkCorner { base: base[l] as usize, t: place.t }) } else { self.hull.corner(place) };
            *o = corner.and_then(|corner| self.between(corner)).unwrap_or(outside);
        }
    }

    /// The values of places whose corners follow each other along a row, as they do where displacements hardly change.
    #[inline(always)]
    fn line(&self, base: usize, t: &[[f32; LANES]; 3]) -> Option<[f32; LANES]> {
        let [_, up, above] = self.hull.up;
        let row = |n: usize| -> Option<[f32; LANES]> {
            let row: &[f32; LANES + 1] = self.data.get(n..)?.first_chunk()?;
            Some(std::array::from_fn(|l| row[l] + t[0][l] * (row[l + 1] - row[l])))
        };
        let between = |a: [f32; LANES], b: [f32; LANES], axis: usize| -> [f32; LANES] {
            std::array::from_fn(|l| a[l] + t[axis][l] * (b[l] - a[l]))
        };
        let low = between(row(base)?, row(base + up)?, 1);
        let high = between(row(base + above)?, row(base + above + up)?, 1);
        Some(between(low, high, 2))
    }

    /// The value between the voxels around a corner.
    #[inline(always)]
    fn between(&self, WalkCorner { base, t }: WalkCorner) -> Option<f32> {
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

/// A label map of the planning frame on the fraction grid; see [`resample_labels`](super::super::resample_labels).
///
/// # Errors
/// Only for internal inconsistency of grids.
pub fn warp_labels(pull: &PullField, labels: &LabelMap) -> Result<LabelMap> {
    super::super::resample_labels(&pull.displacement, labels)
}

/// Where the push field takes a planning point; `None` outside the planning grid.
pub fn push_point(push: &PushField, point: &Point3<f64>) -> Option<Point3<f64>> {
    let u = trilinear_vector(&push.displacement, &push.displacement.grid().index(point))?;
    Some(point + u)
}

#[cfg(test)]
#[expect(clippy::float_cmp, reason = "values that are exact by construction")]
mod tests {
    use super::super::walk::WalkPlace;
    use super::*;
    use crate::geometry::Grid;
    use crate::volume::trilinear;
    use nalgebra::Vector3;

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

    fn place(at: &Vector3<f64>) -> WalkPlace {
        let low = at.map(f64::floor);
        WalkPlace { low: [0, 1, 2].map(|a| low[a] as i32), t: [0, 1, 2].map(|a| (at[a] - low[a]) as f32) }
    }

    #[test]
    fn the_inner_loop_is_trilinear() {
        let (_, grid) = shifted([0.0; 3]);
        let image = Volume::from_fn(grid, |l| ((l * 7919) % 1000) as f32);
        let linear = Linear::new(&image);
        let at = |linear: &Linear<'_>, at: Vector3<f64>| linear.between(linear.hull.corner(place(&at))?);
        for n in 0..2000 {
            let index = Vector3::new(n as f64 * 0.0057, (n % 97) as f64 * 0.094, (n % 31) as f64 * 0.234);
            let (a, b) = (at(&linear, index), trilinear(&image, &index));
            match (a, b) {
                (Some(a), Some(b)) => assert!((f64::from(a) - b).abs() < 1e-3, "{index}: {a} {b}"),
                (a, b) => assert!(a.is_none() && b.is_none(), "{index}"),
            }
        }
        assert_eq!(at(&linear, Vector3::new(11.0, 9.0, 7.0)), image.data().last().copied());
        // On the edge by rounding, and beyond it.
        assert_eq!(at(&linear, Vector3::new(11.0005, -0.0005, 7.0)), Some(*image.at([11, 0, 7])));
        assert_eq!(at(&linear, Vector3::new(11.002, 3.0, 3.0)), None);
        let flat = Volume::filled(Grid::axis_aligned([1, 4, 4], [1.0; 3], [0.0; 3]).unwrap(), 5.0f32);
        assert_eq!(at(&Linear::new(&flat), Vector3::new(0.0, 3.0, 2.5)), Some(5.0));
        assert_eq!(at(&Linear::new(&flat), Vector3::new(0.5, 3.0, 2.5)), None);
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
    fn smooth_displacements_that_read_rows_at_once_change_nothing() {
        for size in [[43, 9, 7], [1, 9, 7], [8, 1, 1], [9, 2, 2]] {
            let grid = Grid::axis_aligned(size, [1.0, 2.0, 3.0], [5.0, -7.0, 11.0]).unwrap();
            let image = Volume::from_fn(grid.clone(), |l| ((l * 7919) % 1000) as f32);
            for bend in [0.0, 0.004, 0.05] {
                let v = Volume::from_fn(grid.clone(), |l| {
                    let [i, j, k] = grid.voxel(l).map(|c| c as f32);
                    [0.3 + bend * i, bend * (i + j) - 1.1, 1.9 - bend * k]
                });
                let got = resample(&v, &image, Interpolation::Linear, -777.0).unwrap();
                for (n, got) in got.data().iter().enumerate() {
                    let at = grid.centre(grid.voxel(n)) + Vector3::from(v.data()[n].map(f64::from));
                    match trilinear(&image, &grid.index(&at)) {
                        Some(b) => assert!((f64::from(*got) - b).abs() < 5e-3, "{size:?} {n}: {got} {b}"),
                        None => assert_eq!(*got, -777.0, "{size:?} {n}"),
                    }
                }
            }
        }
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
