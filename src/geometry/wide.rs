//! Several numbers at a time: plain arrays whose operations the compiler makes into vector instructions.

use std::ops::{Add, Div, Mul, Sub};

/// Numbers at a time.
pub const LANES: usize = 8;

/// [`LANES`] numbers.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Wide(pub [f32; LANES]);

impl Wide {
    /// The same number in all lanes.
    pub fn all(value: f32) -> Self {
        Self([value; LANES])
    }

    /// The first numbers of a slice; zeros beyond its end.
    #[inline(always)]
    pub fn of(values: &[f32]) -> Self {
        match values.first_chunk::<LANES>() {
            Some(chunk) => Self(*chunk),
            None => Self(std::array::from_fn(|l| values.get(l).copied().unwrap_or_default())),
        }
    }

    /// The larger of two, lane by lane.
    #[inline(always)]
    pub fn max(self, other: Self) -> Self {
        Self(std::array::from_fn(|l| if self.0[l] > other.0[l] { self.0[l] } else { other.0[l] }))
    }

    /// The square root, lane by lane.
    #[inline(always)]
    pub fn sqrt(self) -> Self {
        Self(self.0.map(f32::sqrt))
    }

    /// The magnitude, lane by lane.
    #[inline(always)]
    pub fn abs(self) -> Self {
        Self(self.0.map(f32::abs))
    }

    /// The smaller of two, lane by lane.
    #[inline(always)]
    pub fn min(self, other: Self) -> Self {
        Self(std::array::from_fn(|l| if self.0[l] < other.0[l] { self.0[l] } else { other.0[l] }))
    }
}

/// Runs `work` compiled for the vector instructions that this machine has; what it calls must be inlined into it.
///
/// The result is the same on every machine: wider registers neither fuse nor reorder floating-point operations.
#[inline(always)]
pub fn vectorised<R>(work: impl FnOnce() -> R) -> R {
    pulp::Arch::new().dispatch(work)
}

impl Add for Wide {
    type Output = Self;
    #[inline(always)]
    fn add(self, other: Self) -> Self {
        Self(std::array::from_fn(|l| self.0[l] + other.0[l]))
    }
}

impl Sub for Wide {
    type Output = Self;
    #[inline(always)]
    fn sub(self, other: Self) -> Self {
        Self(std::array::from_fn(|l| self.0[l] - other.0[l]))
    }
}

impl Mul for Wide {
    type Output = Self;
    #[inline(always)]
    fn mul(self, other: Self) -> Self {
        Self(std::array::from_fn(|l| self.0[l] * other.0[l]))
    }
}

impl Div for Wide {
    type Output = Self;
    #[inline(always)]
    fn div(self, other: Self) -> Self {
        Self(std::array::from_fn(|l| self.0[l] / other.0[l]))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use pulp::Simd as _;

    /// The same operations, once for this machine's instructions and once for any machine's.
    #[test]
    fn wider_registers_change_no_bit() {
        #[inline(always)]
        fn work(a: &[f32], b: &[f32]) -> (Vec<f32>, f32) {
            let each = a.chunks(LANES).zip(b.chunks(LANES)).flat_map(|(a, b)| {
                let (a, b) = (Wide::of(a), Wide::of(b));
                ((a * b + a) / (b.abs() + Wide::all(0.1)).sqrt() - b.max(a).min(a * a)).0
            });
            let each: Vec<f32> = each.collect();
            let sum = a.iter().zip(b).fold(0.0, |sum, (a, b)| sum + a * b);
            (each, sum)
        }
        let numbers = |seed: u32| -> Vec<f32> {
            (0..1003u32).map(|n| (n.wrapping_mul(2_654_435_761).wrapping_add(seed) >> 8) as f32 / 7e5 - 12.0).collect()
        };
        let (a, b) = (numbers(1), numbers(99_991));
        let bits = |(each, sum): (Vec<f32>, f32)| (each.iter().map(|v| v.to_bits()).collect::<Vec<_>>(), sum.to_bits());
        let plain = bits(pulp::Scalar.vectorize(|| work(&a, &b)));
        assert_eq!(bits(vectorised(|| work(&a, &b))), plain);
        assert_eq!(bits(work(&a, &b)), plain);
    }
}
