//! Several numbers at a time: plain arrays whose operations the compiler makes into vector instructions.

use std::ops::{Add, Mul, Sub};

/// Numbers at a time.
pub(super) const LANES: usize = 8;

/// [`LANES`] numbers.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Lanes(pub(super) [f32; LANES]);

impl Lanes {
    /// The same number in all lanes.
    pub(super) fn all(value: f32) -> Self {
        Self([value; LANES])
    }

    /// The first numbers of a slice; zeros beyond its end.
    #[inline(always)]
    pub(super) fn of(values: &[f32]) -> Self {
        match values.first_chunk::<LANES>() {
            Some(chunk) => Self(*chunk),
            None => Self(std::array::from_fn(|l| values.get(l).copied().unwrap_or_default())),
        }
    }

    /// The smaller of two, lane by lane.
    #[inline(always)]
    pub(super) fn min(self, other: Self) -> Self {
        Self(std::array::from_fn(|l| if self.0[l] < other.0[l] { self.0[l] } else { other.0[l] }))
    }
}

impl Add for Lanes {
    type Output = Self;
    #[inline(always)]
    fn add(self, other: Self) -> Self {
        Self(std::array::from_fn(|l| self.0[l] + other.0[l]))
    }
}

impl Sub for Lanes {
    type Output = Self;
    #[inline(always)]
    fn sub(self, other: Self) -> Self {
        Self(std::array::from_fn(|l| self.0[l] - other.0[l]))
    }
}

impl Mul for Lanes {
    type Output = Self;
    #[inline(always)]
    fn mul(self, other: Self) -> Self {
        Self(std::array::from_fn(|l| self.0[l] * other.0[l]))
    }
}
