//! Local rotations of the relaxation in single precision. Sums over links take a vector in four lanes, rotations several
//! elements at a time, so that the compiler can use vector registers.

use crate::geometry::wide_vector::{WideVector, cross, dot};
use crate::geometry::{LANES, Wide};

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

/// [`Turn`]s of several elements: components of each column.
pub(super) type WideTurn = [WideVector; 3];

/// The turns as one [`WideTurn`]; zeros where there are fewer than [`LANES`].
#[inline(always)]
pub(super) fn wide<'a>(turns: impl Iterator<Item = &'a Turn>) -> WideTurn {
    let mut out = WideTurn::default();
    for (l, turn) in turns.take(LANES).enumerate() {
        for (wide, column) in out.iter_mut().zip(turn) {
            (0..3).for_each(|a| wide[a].0[l] = column[a]);
        }
    }
    out
}

/// One of the turns.
#[inline(always)]
pub(super) fn narrow(turns: &WideTurn, lane: usize) -> Turn {
    turns.each_ref().map(|c| [c[0].0[lane], c[1].0[lane], c[2].0[lane], 0.0])
}

#[inline(always)]
fn add(sum: &mut WideVector, w: Wide, a: &WideVector) {
    for (s, a) in sum.iter_mut().zip(a) {
        *s = *s + w * *a;
    }
}

/// With the identity.
#[inline(always)]
fn whole(turn: &WideTurn) -> WideTurn {
    let mut out = *turn;
    (0..3).for_each(|c| out[c][c] = out[c][c] + Wide::all(1.0));
    out
}

/// Rotations (minus identity) nearest to the matrices with columns `m`, `steps` steps from the last ones (Mueller et al.
/// 2016, "A robust method to extract the rotational part of deformations"); each step is a Cayley transform, which needs no
/// sine.
#[inline(always)]
pub(super) fn nearest_rotation(m: &WideTurn, last: &WideTurn, steps: usize) -> WideTurn {
    let mut turn = *last;
    for _ in 0..steps {
        let r = whole(&turn);
        let (mut torque, mut grip) = (WideVector::default(), Wide::all(1e-9));
        for (r, m) in r.iter().zip(m) {
            add(&mut torque, Wide::all(1.0), &cross(r, m));
            grip = grip + dot(r, m);
        }
        // Half the step's rotation vector, at most half a radian.
        let half = Wide::all(0.5);
        let length = dot(&torque, &torque).sqrt().max(Wide::all(f32::MIN_POSITIVE));
        let scale = (half / grip.abs()).min(half / length);
        let half = torque.map(|t| t * scale);
        let gain = Wide::all(2.0) / (Wide::all(1.0) + dot(&half, &half));
        for (turn, r) in turn.iter_mut().zip(&r) {
            // R' r = r + gain (h x r + h x (h x r))
            let once = cross(&half, r);
            let twice = cross(&half, &once);
            for a in 0..3 {
                turn[a] = turn[a] + gain * (once[a] + twice[a]);
            }
        }
    }
    turn
}

/// `s M - I` from `M - I`.
pub(super) fn scaled(turn: &Turn, s: f32) -> Turn {
    let mut out = turn.map(|column| column.map(|c| s * c));
    (0..3).for_each(|c| out[c][c] += s - 1.0);
    out
}

/// Greatest strain that links give way to.
/// Half or twice as much moves no mean error by 0.003 mm.
const MOST_STRAIN: f32 = 0.3;

/// Rotations (minus identity) with `share` of the strain without change of volume that the links' moments `m` show;
/// `spread` is the inverse of their second moments, 0 where there is none.
#[inline(always)]
pub(super) fn strained(m: &WideTurn, spread: &[Wide; 6], rotation: &WideTurn, share: f32) -> WideTurn {
    let [xx, xy, xz, yy, yz, zz] = *spread;
    let columns = [[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]];
    let r = whole(rotation);
    // F = m spread, then R^T F.
    let mut e = [WideVector::default(); 3];
    for (c, s) in columns.iter().enumerate() {
        let mut f = WideVector::default();
        (0..3).for_each(|b| add(&mut f, s[b], &m[b]));
        (0..3).for_each(|a| e[a][c] = dot(&r[a], &f));
    }
    let mean = (e[0][0] + e[1][1] + e[2][2]) * Wide::all(1.0 / 3.0);
    let mixed = |a: usize, b: usize| (e[a][b] + e[b][a]) * Wide::all(0.5);
    let (x, y, z, p, q, t) = (e[0][0] - mean, e[1][1] - mean, e[2][2] - mean, mixed(0, 1), mixed(0, 2), mixed(1, 2));
    let size = (x * x + y * y + z * z + (p * p + q * q + t * t) * Wide::all(2.0)).sqrt();
    // Without a second moment all components are 0, and so is what is added.
    let most = Wide::all(MOST_STRAIN);
    let gain = Wide::all(share) * (most / size.max(most));
    let mut out = *rotation;
    for (out, d) in out.iter_mut().zip([[x, p, q], [p, y, t], [q, t, z]]) {
        (0..3).for_each(|b| add(out, gain * d[b], &r[b]));
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
            let found = nearest_rotation(&wide([columns(&(turn * stretch))].iter()), &WideTurn::default(), 800);
            let found = narrow(&found, 0);
            let found = Matrix3::from_fn(|a, b| f64::from(found[b][a])) + Matrix3::identity();
            assert!((found - turn).norm() < 2e-5, "{angle}: {}", (found - turn).norm());
            assert!((found.transpose() * found - Matrix3::identity()).norm() < 2e-5);
        }
    }
}
