//! The mean over a voxel: a scanner neither misses a shell of bone that is thinner than a voxel nor hits it.

use super::shape::V3;

/// Voxels that are wider in a slice, mm, come from no scanner: they show what lies in their middle.
const WIDEST_MM: f64 = 2.5;
/// An edge up to this is fine enough to be told by its middle, mm: a shell is no thinner.
const FINE_MM: f64 = 1.3;
/// Depth below a bone's surface to which its shell reaches, mm.
const SHELL_MM: f64 = 3.0;

/// Places over a voxel's volume, about its middle.
#[derive(Debug, Clone)]
pub(super) struct Voxel {
    offsets: Vec<V3>,
    /// From where to where the distance of a middle to a bone's surface lets the voxel show its shell, mm.
    shell_mm: [f64; 2],
}

impl Voxel {
    /// A voxel of these edges, mm, where tissues mix over `edge` mm at their borders.
    pub(super) fn new(spacing: [f64; 3], edge: f64) -> Self {
        let scanned = spacing[..2].iter().all(|edge| *edge <= WIDEST_MM);
        let along = |a: usize| -> &[f64] { if scanned && spacing[a] > FINE_MM { &[-0.25, 0.25] } else { &[0.0] } };
        let mut offsets = Vec::new();
        for z in along(2) {
            for y in along(1) {
                offsets.extend(along(0).iter().map(|x| V3::new(x * spacing[0], y * spacing[1], z * spacing[2])));
            }
        }
        let half = 0.5 * V3::from(spacing).norm();
        Self { offsets, shell_mm: [-(half + SHELL_MM), half + 0.5 * edge] }
    }

    /// The places to take the mean over, where a bone's surface is `to_bone` mm from the middle; none where its middle tells all.
    pub(super) fn places(&self, to_bone: f64) -> &[V3] {
        let [deepest, farthest] = self.shell_mm;
        if self.offsets.len() > 1 && deepest < to_bone && to_bone < farthest { &self.offsets } else { &[] }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_mean_over_a_voxel_near_bone_is_taken_over_its_volume() {
        let voxel = Voxel::new([2.0, 2.0, 3.0], 1.8);
        let places = voxel.places(1.0);
        assert_eq!(places.len(), 8);
        // Their mean is the middle; their spread along an axis is that of two halves.
        assert!(places.iter().sum::<V3>().norm() < 1e-12);
        let squares = places.iter().fold(V3::zeros(), |s, o| s + o.component_mul(o)) / 8.0;
        assert!((squares - V3::new(0.25, 0.25, 0.5625)).norm() < 1e-12, "{squares}");
        // Far from bone, deep in it, and in fine voxels the middle tells all.
        assert!(voxel.places(3.1).is_empty() && voxel.places(-6.0).is_empty());
        assert!(Voxel::new([1.0, 1.0, 1.0], 1.0).places(0.0).is_empty());
        assert_eq!(Voxel::new([1.0, 1.0, 3.0], 1.0).places(0.0).len(), 2);
        assert!(Voxel::new([3.0; 3], 2.5).places(0.0).is_empty());
    }
}
