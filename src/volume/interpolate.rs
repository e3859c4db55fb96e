//! Trilinear sampling at continuous indices, as ITK's linear interpolators do inside the image.

use super::Volume;
use nalgebra::Vector3;

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

/// Storage position of the lower corner, the fractions, and the strides to the upper corner (0 at the far edge).
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
pub fn trilinear(volume: &Volume<f32>, index: &Vector3<f64>) -> Option<f64> {
    let (b, [fx, fy, fz], [sx, sy, sz]) = cell(volume.grid().size(), index)?;
    let d = volume.data();
    let line = |at: usize| f64::from(d[at]) * (1.0 - fx) + f64::from(d[at + sx]) * fx;
    let face = |at: usize| line(at) * (1.0 - fy) + line(at + sy) * fy;
    Some(face(b) * (1.0 - fz) + face(b + sz) * fz)
}

/// Trilinear vector at a continuous index; `None` outside the hull of the voxel centres.
pub fn trilinear_vector(volume: &Volume<[f32; 3]>, index: &Vector3<f64>) -> Option<Vector3<f64>> {
    let (b, [fx, fy, fz], [sx, sy, sz]) = cell(volume.grid().size(), index)?;
    let d = volume.data();
    let get = |at: usize| Vector3::from(d[at].map(f64::from));
    let line = |at: usize| get(at) * (1.0 - fx) + get(at + sx) * fx;
    let face = |at: usize| line(at) * (1.0 - fy) + line(at + sy) * fy;
    Some(face(b) * (1.0 - fz) + face(b + sz) * fz)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Grid;
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
    fn outside_is_none_and_the_far_corner_is_inside() {
        let v = Volume::filled(Grid::axis_aligned([3, 3, 1], [1.0; 3], [0.0; 3]).unwrap(), 5.0f32);
        assert_eq!(trilinear(&v, &Vector3::new(2.0, 2.0, 0.0)), Some(5.0));
        assert_eq!(trilinear(&v, &Vector3::new(2.01, 2.0, 0.0)), None);
        assert_eq!(trilinear(&v, &Vector3::new(f64::NAN, 0.0, 0.0)), None);
    }
}
