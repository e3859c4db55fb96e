//! Rotation vectors: left Jacobian of the exponential map and its inverse (Sola, Deray and Atchuthan 2018, arXiv:1812.01537).

use nalgebra::{Matrix3, Vector3};

/// Below this angle (radians) series replace quotients.
const SMALL: f64 = 1e-4;

/// Left Jacobian: `exp(phi + d) = exp(J d) exp(phi)` to first order.
pub fn left_jacobian(phi: &Vector3<f64>) -> Matrix3<f64> {
    let a = phi.norm();
    let x = phi.cross_matrix();
    let (b, c) = if a < SMALL {
        (0.5 - a * a / 24.0, 1.0 / 6.0 - a * a / 120.0)
    } else {
        ((1.0 - a.cos()) / (a * a), (a - a.sin()) / (a * a * a))
    };
    Matrix3::identity() + x * b + x * x * c
}

/// Inverse of [`left_jacobian`], for angles below 180 degrees.
pub fn left_jacobian_inverse(phi: &Vector3<f64>) -> Matrix3<f64> {
    let a = phi.norm();
    let x = phi.cross_matrix();
    let c = if a < SMALL { 1.0 / 12.0 + a * a / 720.0 } else { 1.0 / (a * a) - 1.0 / (2.0 * a * (0.5 * a).tan()) };
    Matrix3::identity() - x * 0.5 + x * x * c
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::UnitQuaternion;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn jacobian_matches_differences(v in prop::array::uniform3(-1.6f64..1.6), scale in prop::sample::select(vec![1.0, 1e-3, 1e-6])) {
            let phi = Vector3::from(v) * scale;
            let j = left_jacobian(&phi);
            for a in 0..3 {
                let mut d = Vector3::zeros();
                d[a] = 1e-6;
                let plus = UnitQuaternion::from_scaled_axis(phi + d);
                let minus = UnitQuaternion::from_scaled_axis(phi - d);
                let world = (plus * minus.inverse()).scaled_axis() / 2e-6;
                prop_assert!((world - j.column(a)).norm() < 1e-6);
            }
            prop_assert!((j * left_jacobian_inverse(&phi) - Matrix3::identity()).norm() < 1e-9);
        }
    }
}
