//! What holds for every interpolation alike.

use super::lanes::{NOWHERE, Sampler};
use super::*;
use crate::geometry::wide_vector::WideVector;
use crate::geometry::{Grid, LANES, Wide};
use crate::volume::Volume;
use nalgebra::{Point3, Rotation3, Vector3};
use proptest::prelude::*;

/// Values at the voxels, without order.
fn random(n: usize, seed: u32) -> f32 {
    let bits = (n as u32 ^ seed).wrapping_mul(2_654_435_761).rotate_left(13).wrapping_mul(40_503) >> 8;
    bits as f32 / 8_388_608.0 - 1.0
}

fn image(size: [usize; 3], value: impl Fn([f64; 3]) -> f64 + Sync) -> Volume<f32> {
    let grid = Grid::axis_aligned(size, [1.0; 3], [0.0; 3]).unwrap();
    Volume::from_fn(grid.clone(), |n| value(grid.voxel(n).map(|c| c as f64)) as f32)
}

/// Value and, where it has one, slope at an index; `None` outside.
type Interpolated = Option<(f64, Option<Vector3<f64>>)>;

/// An interpolation of an image, with its name.
type Named<'a> = (&'static str, Box<dyn Fn(&Vector3<f64>) -> Interpolated + 'a>);

/// Every interpolation of single places of an image; those of fields take it for each component.
fn all(image: &Volume<f32>) -> Vec<Named<'_>> {
    let grid = image.grid();
    let field = Volume::new(grid.clone(), image.data().iter().map(|v| [*v, 2.0 * v, -v]).collect()).unwrap();
    let same = field.clone();
    let cell = |index: &Vector3<f64>| {
        let Surrounding { voxels, .. } = Surrounding::of(grid, index)?;
        let low = grid.voxel(voxels[0]);
        let way = std::array::from_fn(|a| index[a] - low[a] as f64);
        let (value, slope) = corners(voxels.map(|v| f64::from(image.data()[v])), way);
        Some((value, Some(slope)))
    };
    vec![
        ("trilinear", Box::new(|i| Some((trilinear(image, i)?, None)))),
        (
            "trilinear_vector",
            Box::new(move |i| {
                let v = trilinear_vector(&field, i)?;
                assert!((v.y - 2.0 * v.x).abs() < 1e-6 && (v.z + v.x).abs() < 1e-6);
                Some((v.x, None))
            }),
        ),
        (
            "Surrounding",
            Box::new(move |i| {
                let around = Surrounding::of(grid, i)?;
                assert!((around.weights.iter().sum::<f64>() - 1.0).abs() < 1e-12);
                Some((around.value(same.data()).x, Some(around.slope(same.data()).row(0).transpose())))
            }),
        ),
        ("corners", Box::new(cell)),
        ("cubic", Box::new(|i| cubic(image, i).map(|(value, slope)| (value, Some(slope))))),
    ]
}

proptest! {
    #[test]
    fn linear_functions_are_reproduced_with_their_slope(at in prop::array::uniform3(1.0f64..6.0)) {
        let f = |v: [f64; 3]| 2.0 * v[0] - 3.0 * v[1] + 0.5 * v[2] + 7.0;
        for (name, of) in all(&image([8; 3], f)) {
            let (value, slope) = of(&Vector3::from(at)).unwrap();
            prop_assert!((value - f(at)).abs() < 1e-4, "{}: {} for {}", name, value, f(at));
            if let Some(slope) = slope {
                prop_assert!((slope - Vector3::new(2.0, -3.0, 0.5)).norm() < 1e-4, "{}: {:?}", name, slope);
            }
        }
    }

    /// Within a cell, also of images that are one voxel thin and at the hull's edge.
    #[test]
    fn slopes_are_those_of_the_values(size in prop::array::uniform3(1usize..6), way in prop::array::uniform3(0.02f64..0.98),
                                      cell in prop::array::uniform3(0usize..5), seed in any::<u32>()) {
        let mut values = image(size, |_| 0.0);
        values.data_mut().iter_mut().enumerate().for_each(|(n, v)| *v = random(n, seed));
        let at: [f64; 3] = std::array::from_fn(|a| match size[a] {
            1 => 0.0,
            n => (cell[a] % (n - 1)) as f64 + way[a],
        });
        for (name, of) in all(&values) {
            let Some(slope) = of(&Vector3::from(at)).unwrap().1 else { continue };
            for a in (0..3).filter(|&a| size[a] > 1) {
                let step = Vector3::ith(a, 1e-3);
                let value = |sign: f64| of(&(Vector3::from(at) + step * sign)).unwrap().0;
                // Cubic values are of single precision.
                prop_assert!((slope[a] - (value(1.0) - value(-1.0)) / 2e-3).abs() < 2e-3, "{}: {:?}", name, at);
            }
        }
    }

    #[test]
    fn voxel_centres_keep_their_values_and_nothing_lies_outside(size in prop::array::uniform3(1usize..6), seed in any::<u32>()) {
        let mut values = image(size, |_| 0.0);
        values.data_mut().iter_mut().enumerate().for_each(|(n, v)| *v = random(n, seed));
        let grid = values.grid().clone();
        let last = Vector3::from(size.map(|n| (n - 1) as f64));
        for (name, of) in all(&values) {
            for n in 0..grid.len() {
                let (value, _) = of(&Vector3::from(grid.voxel(n).map(|c| c as f64))).unwrap();
                prop_assert!((value - f64::from(values.data()[n])).abs() < 1e-6, "{}: voxel {}", name, n);
            }
            for a in 0..3 {
                let beyond = Vector3::ith(a, 1e-9);
                prop_assert!(of(&(last + beyond * 1e3)).is_none() && of(&(-beyond)).is_none(), "{}", name);
                prop_assert!(of(&(last + Vector3::ith(a, f64::NAN))).is_none(), "{}", name);
            }
        }
    }

    /// Eight places of a row at once, in and beyond the grid, next to each other in storage or not, with and without slope: the
    /// field that goes on with its edge values, and its slope.
    #[test]
    fn lanes_are_the_continued_field(size in prop::array::uniform3(1usize..14), axis in prop::array::uniform3(-1.0f64..1.0),
                                     start in prop::array::uniform3(-6.0f64..16.0), along in prop::array::uniform3(-1.2f64..1.2),
                                     straight in any::<bool>(), seed in any::<u32>()) {
        let turn = Rotation3::from_scaled_axis(axis.into()).into_inner();
        let grid = Grid::new(size, [1.0, 1.5, 2.0], Point3::new(-3.0, 5.0, 8.0), turn).unwrap();
        let field = Volume::from_fn(grid.clone(), |l| [3 * l, 3 * l + 1, 3 * l + 2].map(|n| random(n, seed)));
        let sampler = Sampler::new(&field);
        let along = if straight { Vector3::x() } else { Vector3::from(along) };
        let start = Vector3::from(start);
        let block = Sampler::block(&start, &along);
        let v: WideVector = std::array::from_fn(|a| Wide(std::array::from_fn(|l| 0.3 * random(100 + 8 * a + l, seed))));
        let cells = sampler.cells(&block, &v);
        let (alone, with_slope) = (sampler.value(&block, &v), sampler.at(&block, &cells));
        let last = Vector3::from(size.map(|n| (n - 1) as f64));
        for l in 0..LANES {
            let moved = Vector3::from_fn(|a, _| f64::from(v[a].0[l]));
            let at = start + along * l as f64 + grid.inverse_step() * moved;
            let held = at.zip_map(&last, |i, last| i.clamp(0.0, last));
            let around = Surrounding::of(&grid, &held).unwrap();
            let (value, slope) = (around.value(field.data()), around.slope(field.data()));
            for c in 0..3 {
                prop_assert_eq!(alone[c].0[l].to_bits(), with_slope.value[c].0[l].to_bits());
                prop_assert!((f64::from(alone[c].0[l]) - value[c]).abs() < 1e-4, "lane {}", l);
            }
            // On a border of two cells either's slope will do; beyond the edge there is none.
            let off = (0..3).all(|a| (held[a] - held[a].round()).abs() > 1e-3 && (at[a] - held[a]).abs() < 1e-9);
            for (a, column) in with_slope.slope.iter().enumerate().filter(|_| off) {
                let lane = Vector3::from_fn(|c, _| f64::from(column[c].0[l]));
                prop_assert!((lane - slope.column(a)).norm() < 1e-3, "lane {}, axis {}", l, a);
            }
        }
    }
}

proptest! {
    #[test]
    fn cubic_reproduces_quadratics_with_their_gradient(at in prop::array::uniform3(1.5f64..6.0)) {
        let f = |[x, y, z]: [f64; 3]| x * x - 0.5 * y * y + 0.3 * x * z + y;
        let [x, y, z] = at;
        let (value, g) = cubic(&image([9; 3], f), &Vector3::from(at)).unwrap();
        prop_assert!((value - f(at)).abs() < 1e-3);
        prop_assert!((g - Vector3::new(2.0 * x + 0.3 * z, 1.0 - y, 0.3 * x)).norm() < 1e-3);
    }
}

#[test]
fn what_is_no_number_comes_to_lie_at_the_edge() {
    let grid = Grid::axis_aligned([4, 3, 5], [1.0; 3], [0.0; 3]).unwrap();
    let field = Volume::from_fn(grid, |l| [l as f32; 3]);
    let sampler = Sampler::new(&field);
    for start in [f64::NAN, f64::INFINITY, -1e30, 1e12] {
        let block = Sampler::block(&Vector3::repeat(start), &Vector3::x());
        for v in [0.0, f32::NAN, f32::INFINITY, -1e30] {
            let v = [Wide::all(v); 3];
            assert!(sampler.value(&block, &v).iter().all(|c| c.0.iter().all(|c| c.is_finite())));
            assert!(sampler.land(&block, &v).iter().all(|n| *n == NOWHERE || *n < field.data().len()));
        }
    }
}

#[test]
fn axis_pairs_hold_the_outermost_voxels() {
    let coarse = Grid::axis_aligned([3, 1, 2], [4.0; 3], [0.0; 3]).unwrap();
    let fine = Grid::axis_aligned([6, 2, 3], [2.0; 3], [-2.0, 0.0, 1.0]).unwrap();
    let [x, y, z] = axis_pairs(&coarse, &fine);
    assert_eq!(x, [(0, 1, 0.0), (0, 1, 0.0), (0, 1, 0.5), (1, 2, 0.0), (1, 2, 0.5), (2, 2, 0.0)]);
    assert_eq!(y, [(0, 0, 0.0); 2]);
    assert_eq!(z, [(0, 1, 0.25), (0, 1, 0.75), (1, 1, 0.0)]);
}
