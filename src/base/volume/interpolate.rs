//! Trilinear sampling at continuous indices, as ITK's linear interpolators do inside the image.

use super::Volume;
use crate::geometry::Grid;
use nalgebra::{Matrix3, RowVector3, Vector3};

/// Where a continuous index lies along an axis of `size` voxels: the voxel at or below it and the way to the next; `None`
/// outside the hull of the voxel centres.
#[inline(always)]
pub fn place(index: f64, size: usize) -> Option<(usize, f64)> {
    let last = size - 1;
    if !(index >= 0.0 && index <= last as f64) {
        return None;
    }
    let low = (index as usize).min(last);
    Some((low, index - low as f64))
}

/// Between which voxels of `coarse` those of `fine` lie, axis by axis: the one at or below, the next, and the way to it. Both grids
/// share their axes; beyond the outermost voxel centres these are held.
pub fn axis_pairs(coarse: &Grid, fine: &Grid) -> [Vec<(usize, usize, f64)>; 3] {
    let (base, step) = (coarse.index(&fine.origin()), coarse.inverse_step() * fine.step());
    std::array::from_fn(|a| {
        let last = coarse.size()[a] - 1;
        let pair = |i: usize| {
            let at = (base[a] + step[(a, a)] * i as f64).clamp(0.0, last as f64);
            let low = at as usize;
            (low, (low + 1).min(last), at - low as f64)
        };
        (0..fine.size()[a]).map(pair).collect()
    })
}

/// Storage position of the lower corner, the fractions, and the strides to the upper corner (0 at the far edge).
#[inline(always)]
fn cell(size: [usize; 3], index: &Vector3<f64>) -> Option<(usize, [f64; 3], [usize; 3])> {
    let mut base = 0;
    let mut fraction = [0.0; 3];
    let mut step = [0; 3];
    let mut stride = 1;
    for a in 0..3 {
        let (low, way) = place(index[a], size[a])?;
        base += low * stride;
        fraction[a] = way;
        step[a] = if low + 1 < size[a] { stride } else { 0 };
        stride *= size[a];
    }
    Some((base, fraction, step))
}

/// Trilinear value at a continuous index; `None` outside the hull of the voxel centres.
#[inline(always)]
pub fn trilinear(volume: &Volume<f32>, index: &Vector3<f64>) -> Option<f64> {
    let (b, [fx, fy, fz], [sx, sy, sz]) = cell(volume.grid().size(), index)?;
    let d = volume.data();
    let line = |at: usize| f64::from(d[at]) * (1.0 - fx) + f64::from(d[at + sx]) * fx;
    let face = |at: usize| line(at) * (1.0 - fy) + line(at + sy) * fy;
    Some(face(b) * (1.0 - fz) + face(b + sz) * fz)
}

/// Trilinear vector at a continuous index; `None` outside the hull of the voxel centres.
#[inline(always)]
pub fn trilinear_vector(volume: &Volume<[f32; 3]>, index: &Vector3<f64>) -> Option<Vector3<f64>> {
    let (b, [fx, fy, fz], [sx, sy, sz]) = cell(volume.grid().size(), index)?;
    let d = volume.data();
    let get = |at: usize| Vector3::from(d[at].map(f64::from));
    let line = |at: usize| get(at) * (1.0 - fx) + get(at + sx) * fx;
    let face = |at: usize| line(at) * (1.0 - fy) + line(at + sy) * fy;
    Some(face(b) * (1.0 - fz) + face(b + sz) * fz)
}

/// The eight voxels around a continuous index: storage positions, trilinear weights, and the weights' derivatives by the index.
#[derive(Debug, Clone, Copy)]
pub struct Surrounding {
    /// Storage positions.
    pub voxels: [usize; 8],
    /// They add up to 1.
    pub weights: [f64; 8],
    /// By index along each axis; 0 along an axis of one voxel.
    pub slopes: [[f64; 3]; 8],
}

impl Surrounding {
    /// `None` outside the hull of the voxel centres.
    pub fn of(grid: &Grid, index: &Vector3<f64>) -> Option<Self> {
        let (size, strides) = (grid.size(), grid.strides());
        let (mut base, mut t, mut up) = (0, [0.0; 3], [0; 3]);
        for a in 0..3 {
            let (low, way) = place(index[a], size[a])?;
            // The last voxel ends a pair.
            let first = low.min(size[a].saturating_sub(2));
            base += first * strides[a];
            t[a] = way + (low - first) as f64;
            up[a] = if size[a] > 1 { strides[a] } else { 0 };
        }
        let part = |c: usize, a: usize| if c >> a & 1 == 1 { t[a] } else { 1.0 - t[a] };
        let slope = |c: usize, a: usize| {
            let sign = if up[a] == 0 { 0.0 } else { [-1.0, 1.0][c >> a & 1] };
            sign * part(c, (a + 1) % 3) * part(c, (a + 2) % 3)
        };
        Some(Self {
            voxels: std::array::from_fn(|c| base + (0..3).map(|a| (c >> a & 1) * up[a]).sum::<usize>()),
            weights: std::array::from_fn(|c| part(c, 0) * part(c, 1) * part(c, 2)),
            slopes: std::array::from_fn(|c| std::array::from_fn(|a| slope(c, a))),
        })
    }

    /// The value there of a field on the grid.
    pub fn value(&self, field: &[[f32; 3]]) -> Vector3<f64> {
        self.voxels.iter().zip(self.weights).map(|(&v, w)| Vector3::from(field[v].map(f64::from)) * w).sum()
    }

    /// The derivative there of a field on the grid, by the index.
    pub fn slope(&self, field: &[[f32; 3]]) -> Matrix3<f64> {
        let of = |(&v, s): (&usize, &[f64; 3])| Vector3::from(field[v].map(f64::from)) * RowVector3::from(*s);
        self.voxels.iter().zip(&self.slopes).map(of).sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn reproduces_a_linear_function(at in prop::array::uniform3(0.0f64..4.0)) {
            let grid = Grid::axis_aligned([5, 5, 5], [1.0; 3], [0.0; 3]).unwrap();
            let f = |v: [f64; 3]| 2.0 * v[0] - 3.0 * v[1] + 0.5 * v[2] + 7.0;
            let v = Volume::from_fn(grid.clone(), |l| f(grid.voxel(l).map(|c| c as f64)) as f32);
            let got = trilinear(&v, &Vector3::from(at)).unwrap();
            prop_assert!((got - f(at)).abs() < 1e-4);
            let w = Volume::from_fn(grid.clone(), |l| [f(grid.voxel(l).map(|c| c as f64)) as f32; 3]);
            prop_assert!((trilinear_vector(&w, &Vector3::from(at)).unwrap().z - f(at)).abs() < 1e-4);
        }
    }

    #[test]
    fn what_surrounds_a_place_gives_value_and_slope() {
        let grid = Grid::axis_aligned([5, 4, 1], [1.0; 3], [0.0; 3]).unwrap();
        let data: Vec<[f32; 3]> = (0..grid.len()).map(|n| [n as f32, (n * n % 7) as f32, 1.0]).collect();
        let volume = Volume::new(grid.clone(), data).unwrap();
        for at in [[0.3, 1.6, 0.0], [4.0, 3.0, 0.0], [0.0, 2.5, 0.0]].map(Vector3::from) {
            let around = Surrounding::of(&grid, &at).unwrap();
            assert!((around.value(volume.data()) - trilinear_vector(&volume, &at).unwrap()).norm() < 1e-12);
            let slope = around.slope(volume.data());
            for a in 0..2 {
                let mut d = Vector3::zeros();
                d[a] = if at[a] > 2.0 { -1e-4 } else { 1e-4 };
                let moved = trilinear_vector(&volume, &(at + d)).unwrap() - trilinear_vector(&volume, &at).unwrap();
                assert!((slope * d - moved).norm() < 1e-10);
            }
            assert_eq!(slope.column(2), Vector3::zeros());
        }
        assert!(Surrounding::of(&grid, &Vector3::new(4.1, 0.0, 0.0)).is_none());
    }

    #[test]
    fn outside_is_none_and_the_far_corner_is_inside() {
        let v = Volume::filled(Grid::axis_aligned([3, 3, 1], [1.0; 3], [0.0; 3]).unwrap(), 5.0f32);
        assert_eq!(trilinear(&v, &Vector3::new(2.0, 2.0, 0.0)), Some(5.0));
        assert_eq!(trilinear(&v, &Vector3::new(2.01, 2.0, 0.0)), None);
        assert_eq!(trilinear(&v, &Vector3::new(f64::NAN, 0.0, 0.0)), None);
    }
}
