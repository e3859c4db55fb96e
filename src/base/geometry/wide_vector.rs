//! Vectors of three, several at a time, component by component.

use super::Wide;

/// [`LANES`](super::LANES) vectors.
pub type WideVector = [Wide; 3];

/// `a + b`.
#[inline(always)]
pub fn plus(a: &WideVector, b: &WideVector) -> WideVector {
    [a[0] + b[0], a[1] + b[1], a[2] + b[2]]
}

/// `a - b`.
#[inline(always)]
pub fn minus(a: &WideVector, b: &WideVector) -> WideVector {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

/// The inner product.
#[inline(always)]
pub fn dot(a: &WideVector, b: &WideVector) -> Wide {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// The cross product.
#[inline(always)]
pub fn cross(a: &WideVector, b: &WideVector) -> WideVector {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}
