//! Grey values that follow the change of volume: what is squeezed gets denser, and no mass is made or lost.

use crate::volume::Volume;
use nalgebra::{Matrix3, Vector3};
use rayon::prelude::*;

/// What the scaling did.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Scaled {
    /// Voxels whose value was scaled.
    pub scaled: usize,
    /// Voxels left as they were, since the field folds there.
    pub folded: usize,
}

/// Scales HU of an image that the displacement `v` on the same grid has pulled (voxel y shows what was at y + v(y)):
/// `HU' = (HU + 1000) det(I + grad v) - 1000`.
///
/// HU + 1000 is proportional to the attenuation, and that of soft tissue to its density within a few percent; the determinant is
/// the tissue's volume before over after, so HU + 1000 integrates to what it did before. Central differences, one-sided at the
/// grid's edge.
pub fn scale_by_volume(image: &mut Volume<f32>, v: &Volume<[f32; 3]>) -> Scaled {
    let grid = v.grid().clone();
    let size = grid.size();
    let strides = grid.strides();
    let data = v.data();
    let plane = strides[2];
    let inverse = *grid.inverse_step();
    let counts: Vec<Scaled> = image
        .data_mut()
        .par_chunks_mut(plane)
        .enumerate()
        .map(|(k, values)| {
            let mut count = Scaled::default();
            for (n, value) in values.iter_mut().enumerate() {
                let l = k * plane + n;
                let at = grid.voxel(l);
                let column = |a: usize| {
                    let low = if at[a] > 0 { l - strides[a] } else { l };
                    let high = if at[a] + 1 < size[a] { l + strides[a] } else { l };
                    let steps = ((high - low) / strides[a]).max(1) as f64;
                    Vector3::from_fn(|c, _| f64::from(data[high][c]) - f64::from(data[low][c])) / steps
                };
                let slope = Matrix3::from_columns(&[column(0), column(1), column(2)]) * inverse;
                let det = (Matrix3::identity() + slope).determinant();
                if det > 0.0 {
                    *value = ((f64::from(*value) + 1000.0) * det - 1000.0) as f32;
                    count.scaled += 1;
                } else {
                    count.folded += 1;
                }
            }
            count
        })
        .collect();
    counts.iter().fold(Scaled::default(), |a, b| Scaled { scaled: a.scaled + b.scaled, folded: a.folded + b.folded })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::field::{Interpolation, resample};
    use crate::geometry::Grid;

    #[test]
    fn mass_stays_and_uniform_growth_thins() {
        let turn = nalgebra::Rotation3::from_euler_angles(0.3, 0.1, -0.2).into_inner();
        let grid = Grid::new([60, 50, 40], [1.0, 1.5, 2.0], nalgebra::Point3::new(3.0, 5.0, -7.0), turn).unwrap();
        let middle = grid.middle();
        // A blob in air, and a smooth pull field that vanishes at the edge.
        let blob = |p: &nalgebra::Point3<f64>| (1000.0 * (-(p - middle).norm_squared() / 150.0).exp() - 1000.0) as f32;
        let image = Volume::from_fn(grid.clone(), |l| blob(&grid.centre(grid.voxel(l))));
        let pull = |p: &nalgebra::Point3<f64>| {
            let d = p - middle;
            d * (-0.3 * (-d.norm_squared() / 200.0).exp())
        };
        let v = Volume::from_fn(grid.clone(), |l| pull(&grid.centre(grid.voxel(l))).map(|c| c as f32).into());
        let mut warped = resample(&v, &image, Interpolation::Cubic, -1000.0).unwrap();
        let mass = |i: &Volume<f32>| i.data().iter().map(|h| f64::from(*h) + 1000.0).sum::<f64>();
        assert!(mass(&warped) > 1.1 * mass(&image));
        let done = scale_by_volume(&mut warped, &v);
        assert!((mass(&warped) / mass(&image) - 1.0).abs() < 0.01, "{} {}", mass(&warped), mass(&image));
        assert_eq!(done, Scaled { scaled: grid.len(), folded: 0 });
        // Growth by 2 along one axis halves HU + 1000; a mirror is left alone.
        let along = |s: f64| Volume::from_fn(grid.clone(), |l| [0.0, (s * grid.centre(grid.voxel(l)).y) as f32, 0.0]);
        let mut flat = Volume::filled(grid.clone(), 40.0f32);
        scale_by_volume(&mut flat, &along(-0.5));
        assert!(flat.data().iter().all(|h| (h - (0.5 * 1040.0 - 1000.0)).abs() < 0.05));
        let before = flat.clone();
        assert_eq!(scale_by_volume(&mut flat, &along(-1.5)).folded, grid.len());
        assert_eq!(flat, before);
    }
}
