//! A few evenly distributed points on the surface of each bone (thesis 4.2.3: 5 to 6).

use crate::chainmail::Tissue;
use nalgebra::Point3;

/// A point on a bone's surface.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ControlPoint {
    /// Position of the bone in the skeleton.
    pub bone: u16,
    /// Where it is in planning, LPS mm.
    pub planning: Point3<f64>,
}

/// At most `most` surface voxels of each bone, far apart: the first lies farthest from the bone's centroid, each further
/// one farthest from those before it. Of equally far voxels the first in storage is taken.
pub fn control_points(tissue: &Tissue<'_>, bones: usize, most: usize) -> Vec<ControlPoint> {
    let mut out = Vec::new();
    for (bone, surface) in surfaces(tissue, bones).iter().enumerate() {
        let count = surface.len().max(1) as f64;
        let centroid = Point3::from(surface.iter().map(|p| p.coords).sum::<nalgebra::Vector3<f64>>() / count);
        let mut far: Vec<f64> = surface.iter().map(|p| (p - centroid).norm_squared()).collect();
        for n in 0..most.min(surface.len()) {
            let mut best = 0;
            for (at, d) in far.iter().enumerate() {
                if *d > far[best] {
                    best = at;
                }
            }
            let chosen = surface[best];
            // The first choice was by distance from the centroid; from now on points count.
            for (d, p) in far.iter_mut().zip(surface) {
                let own = (p - chosen).norm_squared();
                *d = if n == 0 { own } else { d.min(own) };
            }
            out.push(ControlPoint { bone: bone as u16, planning: chosen });
        }
    }
    out
}

/// Centres of each bone's voxels that have a face neighbour which is not the same bone.
fn surfaces(tissue: &Tissue<'_>, bones: usize) -> Vec<Vec<Point3<f64>>> {
    let grid = tissue.ct.grid();
    let (size, strides) = (grid.size(), grid.strides());
    let mut out = vec![Vec::new(); bones];
    for v in 0..grid.len() {
        let Some(bone) = tissue.bone(v) else { continue };
        let at = grid.voxel(v);
        let inner = (0..3).all(|a| {
            at[a] > 0
                && at[a] + 1 < size[a]
                && tissue.bone(v - strides[a]) == Some(bone)
                && tissue.bone(v + strides[a]) == Some(bone)
        });
        if !inner {
            out[usize::from(bone)].push(grid.centre(at));
        }
    }
    out
}
