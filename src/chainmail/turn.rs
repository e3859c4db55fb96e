//! Local rotations of the relaxation in single precision, four lanes wide so that the compiler can use vector registers.

/// A vector of three in four lanes; the last is free.
pub(super) type Lanes = [f32; 4];

/// Columns of a rotation minus identity: small turns keep their digits.
pub(super) type Turn = [Lanes; 3];

/// `sum += w a`.
#[inline(always)]
pub(super) fn add_scaled(sum: &mut Lanes, w: f32, a: &Lanes) {
    for (s, a) in sum.iter_mut().zip(a) {
        *s += w * a;
    }
}

fn cross(a: &Lanes, b: &Lanes) -> Lanes {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0], 0.0]
}

fn dot(a: &Lanes, b: &Lanes) -> f32 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// Rotation (minus identity) nearest to the matrix with columns `m`, two steps from the last one (Mueller et al. 2016,
/// "A robust method to extract the rotational part of deformations"); each step is a Cayley transform, which needs no
/// sine.
pub(super) fn nearest_rotation(m: &Turn, last: &Turn) -> Turn {
    let mut turn = *last;
    for _ in 0..2 {
        let (mut torque, mut grip) = ([0.0; 4], 1e-9);
        for c in 0..3 {
            let mut r = turn[c];
            r[c] += 1.0;
            add_scaled(&mut torque, 1.0, &cross(&r, &m[c]));
            grip += dot(&r, &m[c]);
        }
        // Half the step's rotation vector, at most half a radian.
        let length = dot(&torque, &torque).sqrt();
        let scale = (0.5 / f32::abs(grip)).min(0.5 / length.max(f32::MIN_POSITIVE));
        let half = torque.map(|t| t * scale);
        let gain = 2.0 / (1.0 + dot(&half, &half));
        for (c, turn) in turn.iter_mut().enumerate() {
            let mut r = *turn;
            r[c] += 1.0;
            // R' r = r + gain (h x r + h x (h x r))
            let once = cross(&half, &r);
            let twice = cross(&half, &once);
            for a in 0..3 {
                turn[a] += gain * (once[a] + twice[a]);
            }
        }
    }
    turn
}

/// Greatest strain that links give way to.
const MOST_STRAIN: f32 = 0.3;

/// Rotation (minus identity) with `share` of the strain without change of volume that the links' moment `m` shows;
/// `spread` is the inverse of their second moment.
pub(super) fn strained(m: &Turn, spread: &[f32; 6], rotation: &Turn, share: f32) -> Turn {
    let [xx, xy, xz, yy, yz, zz] = *spread;
    if xx <= 0.0 || share <= 0.0 {
        return *rotation;
    }
    let columns = [[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]];
    let mut r = *rotation;
    (0..3).for_each(|c| r[c][c] += 1.0);
    // F = m spread, then R^T F.
    let mut e = [[0f32; 3]; 3];
    for (c, s) in columns.iter().enumerate() {
        let mut f = [0.0; 4];
        (0..3).for_each(|b| add_scaled(&mut f, s[b], &m[b]));
        (0..3).for_each(|a| e[a][c] = dot(&r[a], &f));
    }
    let mean = (e[0][0] + e[1][1] + e[2][2]) / 3.0;
    let part = |a: usize, b: usize| 0.5 * (e[a][b] + e[b][a]) - if a == b { mean } else { 0.0 };
    let (x, y, z, p, q, t) = (part(0, 0), part(1, 1), part(2, 2), part(0, 1), part(0, 2), part(1, 2));
    let size = (x * x + y * y + z * z + 2.0 * (p * p + q * q + t * t)).sqrt();
    let gain = share * (MOST_STRAIN / size.max(MOST_STRAIN));
    let mut out = *rotation;
    for (c, d) in [[x, p, q], [p, y, t], [q, t, z]].iter().enumerate() {
        (0..3).for_each(|b| add_scaled(&mut out[c], gain * d[b], &r[b]));
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Matrix3, Rotation3, Vector3};

    fn columns(m: &Matrix3<f64>) -> Turn {
        std::array::from_fn(|c| [m[(0, c)] as f32, m[(1, c)] as f32, m[(2, c)] as f32, 0.0])
    }

    #[test]
    fn the_rotation_of_a_stretched_turn_is_found_and_stays_a_rotation() {
        for angle in [0.0, 1e-4, 0.3, 1.5, 3.0] {
            let turn = Rotation3::new(Vector3::new(0.6, -0.48, 0.64) * angle).into_inner();
            let stretch = Matrix3::new(1.3, 0.1, 0.0, 0.1, 0.8, 0.05, 0.0, 0.05, 1.1);
            let mut found = Turn::default();
            for _ in 0..400 {
                found = nearest_rotation(&columns(&(turn * stretch)), &found);
            }
            let found = Matrix3::from_fn(|a, b| f64::from(found[b][a])) + Matrix3::identity();
            assert!((found - turn).norm() < 2e-5, "{angle}: {}", (found - turn).norm());
            assert!((found.transpose() * found - Matrix3::identity()).norm() < 2e-5);
        }
    }
}
