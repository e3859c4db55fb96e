//! How rigidly a field moves each bone: its departure from the bone's own best rigid motion.

use crate::field::PushField;
use crate::geometry::Rigid;
use crate::volume::LabelMap;
use nalgebra::{Matrix3, Point3, Rotation3, Translation3, UnitQuaternion, Vector3};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// Departure of a field from rigid motion inside one bone.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct BoneRigidity {
    /// Bone name.
    pub name: String,
    /// Voxels measured.
    pub voxels: usize,
    /// The rigid motion that fits the field best in the bone (least squares), planning to fraction, LPS mm.
    pub best: Rigid,
    /// Root mean square departure from it, mm.
    pub rms_mm: f64,
    /// Largest departure, mm.
    pub max_mm: f64,
}

/// Rigidity of each bone of `rigid` (label and name) that occurs in `bones`, which lies on the planning grid.
pub fn evaluate(push: &PushField, bones: &LabelMap, rigid: &[(u16, String)]) -> Vec<BoneRigidity> {
    let mut bone_of = vec![None; usize::from(u16::MAX) + 1];
    for (b, (label, _)) in rigid.iter().enumerate() {
        bone_of[usize::from(*label)] = Some(b);
    }
    let mut voxels: Vec<Vec<usize>> = vec![Vec::new(); rigid.len()];
    for (l, label) in bones.volume.data().iter().enumerate().filter(|(_, label)| **label > 0) {
        if let Some(b) = bone_of[usize::from(*label)] {
            voxels[b].push(l);
        }
    }
    let measure = |((_, name), voxels): (&(u16, String), &Vec<usize>)| departure(push, name, voxels);
    rigid.par_iter().zip(&voxels).filter(|(_, v)| !v.is_empty()).map(measure).collect()
}

/// Rigidity over the voxels of one bone, of which there is at least one.
fn departure(push: &PushField, name: &str, voxels: &[usize]) -> BoneRigidity {
    let grid = push.displacement.grid();
    let pairs = || {
        voxels.iter().map(|&l| {
            let x = grid.centre(grid.voxel(l));
            (x, x + Vector3::from(push.displacement.data()[l].map(f64::from)))
        })
    };
    let best = best_rigid(pairs());
    let (mut sum, mut max) = (0.0, 0.0f64);
    for (x, y) in pairs() {
        let off = (best * x - y).norm();
        sum += off * off;
        max = max.max(off);
    }
    let rms_mm = (sum / voxels.len() as f64).sqrt();
    BoneRigidity { name: name.to_owned(), voxels: voxels.len(), best, rms_mm, max_mm: max }
}

/// The rigid transform that takes the first of each pair to the second in the sense of least squares.
///
/// Kabsch, Acta Cryst. A 32 (1976) 922, with the sign that keeps it a rotation. The identity for no pairs.
pub fn best_rigid(pairs: impl Iterator<Item = (Point3<f64>, Point3<f64>)> + Clone) -> Rigid {
    let n = pairs.clone().count();
    if n == 0 {
        return Rigid::identity();
    }
    let (mut from, mut to) = (Vector3::zeros(), Vector3::zeros());
    for (x, y) in pairs.clone() {
        from += x.coords;
        to += y.coords;
    }
    let (from, to) = (from / n as f64, to / n as f64);
    let mut covariance = Matrix3::zeros();
    for (x, y) in pairs {
        covariance += (y.coords - to) * (x.coords - from).transpose();
    }
    let rotation = nearest_rotation(&covariance);
    Rigid::from_parts(Translation3::from(to - rotation * from), rotation)
}

/// The rotation `R` with the greatest trace of `R^T covariance`; the identity where nothing determines it.
fn nearest_rotation(covariance: &Matrix3<f64>) -> UnitQuaternion<f64> {
    let svd = covariance.svd(true, true);
    let (Some(u), Some(v_t)) = (svd.u, svd.v_t) else { return UnitQuaternion::identity() };
    // Fewer than two independent directions (a point or a line of voxels) leave the rotation open.
    if svd.singular_values[1] <= 1e-9 * svd.singular_values[0].max(f64::MIN_POSITIVE) {
        return UnitQuaternion::identity();
    }
    let sign = (u * v_t).determinant().signum();
    let rotation = u * Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, sign)) * v_t;
    UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(rotation))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::{Grid, about};
    use crate::volume::Volume;
    use proptest::prelude::*;
    use std::collections::BTreeMap;

    fn scene(map: impl Fn(Point3<f64>) -> Point3<f64> + Sync) -> Vec<BoneRigidity> {
        let grid = Grid::axis_aligned([10, 8, 6], [1.0, 1.5, 3.0], [-300.0, 20.0, 5.0]).unwrap();
        let displacement = Volume::from_fn(grid.clone(), |l| {
            let x = grid.centre(grid.voxel(l));
            (map(x) - x).map(|c| c as f32).into()
        });
        let push = PushField { displacement, computed: Volume::filled(grid.clone(), true) };
        let volume = Volume::from_fn(grid.clone(), |l| if grid.voxel(l)[0] < 5 { 3 } else { 7u16 });
        let bones = LabelMap { volume, names: BTreeMap::new() };
        evaluate(&push, &bones, &[(7, "right".into()), (3, "left".into()), (4, "absent".into())])
    }

    proptest! {
        #[test]
        fn rigid_motion_has_no_departure(turn in prop::array::uniform3(-1.5f64..1.5), shift in prop::array::uniform3(-30.0f64..30.0)) {
            let motion = about(&Point3::new(-290.0, 30.0, 0.0), turn.into(), shift.into());
            let r = scene(|x| motion * x);
            prop_assert_eq!(r.iter().map(|b| (b.name.as_str(), b.voxels)).collect::<Vec<_>>(), [("right", 240), ("left", 240)]);
            for b in r {
                prop_assert!(b.max_mm < 1e-5 && b.rms_mm < 1e-5, "{:?}", b);
                prop_assert!((b.best.to_homogeneous() - motion.to_homogeneous()).abs().max() < 1e-4);
            }
        }
    }

    #[test]
    fn stretch_departs_by_hand_values() {
        // x stretches by 10 percent about the bone's middle: departure 0.1 |x - middle|, middle at 2 of 0..=4 mm.
        let r = scene(|x| Point3::new(x.x * 1.1, x.y, x.z));
        assert!((r[1].max_mm - 0.2).abs() < 1e-5, "{r:?}");
        assert!((r[1].rms_mm - 0.1 * 2.0f64.sqrt()).abs() < 1e-5);
    }

    #[test]
    fn a_mirror_image_is_not_a_rigid_motion() {
        let r = scene(|x| Point3::new(-x.x, x.y, x.z));
        assert!(r[0].best.rotation.to_rotation_matrix().matrix().determinant() > 0.999);
        assert!(r[0].rms_mm > 1.0);
    }
}
