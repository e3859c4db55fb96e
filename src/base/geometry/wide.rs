//! Several numbers at a time: plain arrays whose operations the compiler makes into vector instructions.

use std::ops::{Add, Div, Mul, Sub};

/// Numbers at a time.
pub const LANES: usize = 8;

/// [`LANES`] numbers.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Wide(pub [f32; LANES]);

// Plain loops: closures handed to the library are sometimes called instead of inlined, which costs tenfold here.
impl Wide {
    /// The same number in all lanes.
    pub fn all(value: f32) -> Self {
        Self([value; LANES])
    }

    /// The larger of two, lane by lane.
    #[inline(always)]
    pub fn max(mut self, other: Self) -> Self {
        for l in 0..LANES {
            self.0[l] = if self.0[l] > other.0[l] { self.0[l] } else { other.0[l] };
        }
        self
    }

    /// The square root, lane by lane.
    #[inline(always)]
    pub fn sqrt(mut self) -> Self {
        for l in 0..LANES {
            self.0[l] = self.0[l].sqrt();
        }
        self
    }

    /// The magnitude, lane by lane.
    #[inline(always)]
    pub fn abs(mut self) -> Self {
        for l in 0..LANES {
            self.0[l] = self.0[l].abs();
        }
        self
    }

    /// The smaller of two, lane by lane.
    #[inline(always)]
    pub fn min(mut self, other: Self) -> Self {
        for l in 0..LANES {
            self.0[l] = if self.0[l] < other.0[l] { self.0[l] } else { other.0[l] };
        }
        self
    }
}

/// Runs `work` compiled for the vector instructions that this machine has; what it calls must be inlined into it.
///
/// The result is the same on every machine: wider registers neither fuse nor reorder floating-point operations.
#[inline(always)]
pub fn vectorised<R>(work: impl FnOnce() -> R) -> R {
    pulp::Arch::new().dispatch(work)
}

/// Name of the vector instructions that [`vectorised`] uses on this machine.
pub fn simd() -> &'static str {
    #[cfg(target_arch = "x86_64")]
    if matches!(pulp::Arch::new(), pulp::Arch::V3(_)) {
        return "x86-64-v3 (AVX2, FMA)";
    }
    if cfg!(target_arch = "x86_64") { "SSE2" } else { "the target's own vector instructions" }
}

impl Add for Wide {
    type Output = Self;
    #[inline(always)]
    fn add(mut self, other: Self) -> Self {
        for l in 0..LANES {
            self.0[l] += other.0[l];
        }
        self
    }
}

impl Sub for Wide {
    type Output = Self;
    #[inline(always)]
    fn sub(mut self, other: Self) -> Self {
        for l in 0..LANES {
            self.0[l] -= other.0[l];
        }
        self
    }
}

impl Mul for Wide {
    type Output = Self;
    #[inline(always)]
    fn mul(mut self, other: Self) -> Self {
        for l in 0..LANES {
            self.0[l] *= other.0[l];
        }
        self
    }
}

impl Div for Wide {
    type Output = Self;
    #[inline(always)]
    fn div(mut self, other: Self) -> Self {
        for l in 0..LANES {
            self.0[l] /= other.0[l];
        }
        self
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
            let each = a.as_chunks().0.iter().zip(b.as_chunks().0).flat_map(|(a, b)| {
                let (a, b) = (Wide(*a), Wide(*b));
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
