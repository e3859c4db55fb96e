//! Rigid transforms: nalgebra's isometries with the few constructions that anatomy needs.

use nalgebra::{Isometry3, Matrix3, Matrix4, Point3, Rotation3, Translation3, UnitQuaternion, Vector3};

/// A rotation and a translation, world to world, LPS mm.
pub type Rigid = Isometry3<f64>;

/// Rotation by `rotation` (rotation vector, radians) about `centre`, then translation by `shift` (mm).
pub fn about(centre: &Point3<f64>, rotation: Vector3<f64>, shift: Vector3<f64>) -> Rigid {
    let q = UnitQuaternion::from_scaled_axis(rotation);
    Rigid::from_parts(Translation3::from(centre.coords + shift - q * centre.coords), q)
}

/// The rigid transform of a 4x4 matrix whose upper left block is a rotation within `1e-4`; `None` otherwise.
pub fn rigid_from_matrix(m: &Matrix4<f64>) -> Option<Rigid> {
    let r: Matrix3<f64> = m.fixed_view::<3, 3>(0, 0).into_owned();
    let off = (r.transpose() * r - Matrix3::identity()).abs().max();
    if !(off <= 1e-4 && r.determinant() > 0.0 && m.iter().all(|v| v.is_finite())) {
        return None;
    }
    let q = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix(&r));
    Some(Rigid::from_parts(Translation3::new(m[(0, 3)], m[(1, 3)], m[(2, 3)]), q))
}

/// The rotation of each transform as a matrix.
pub fn rotation_matrices(transforms: &[Rigid]) -> Vec<Matrix3<f64>> {
    transforms.iter().map(|t| t.rotation.to_rotation_matrix().into_inner()).collect()
}

/// Angle of a transform's rotation in degrees.
pub fn rotation_angle_deg(t: &Rigid) -> f64 {
    t.rotation.angle().to_degrees()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn centre_of_rotation_only_shifts() {
        let c = Point3::new(10.0, -20.0, 30.0);
        let t = about(&c, Vector3::new(0.1, 0.7, -0.3), Vector3::new(1.0, 2.0, 3.0));
        assert!((t * c - (c + Vector3::new(1.0, 2.0, 3.0))).norm() < 1e-12);
        let back = rigid_from_matrix(&t.to_homogeneous()).unwrap();
        assert!((back.to_homogeneous() - t.to_homogeneous()).abs().max() < 1e-12);
        assert!(rigid_from_matrix(&(Matrix4::identity() * 1.1)).is_none());
    }
}
