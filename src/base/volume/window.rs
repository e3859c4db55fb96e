//! A window of grey values.

/// HU in a window, beyond it at its edges; below it at a scale, where what is thin has its contrast there.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Window {
    /// Lower edge, HU.
    pub low: f32,
    /// Upper edge, HU.
    pub high: f32,
    /// Scale at which HU below the window count down to air's: 0 for not at all, more where lung's vessels are contrast.
    pub thin: f32,
}

/// Air, HU: nothing is less dense.
const AIR_HU: f32 = -1000.0;

impl Window {
    /// A value in the window; what is no number stays none.
    #[inline(always)]
    pub fn of(&self, hu: f32) -> f32 {
        match hu {
            hu if hu.is_nan() => hu,
            hu if hu < self.low => self.low + self.thin * (hu.max(AIR_HU) - self.low),
            hu => hu.min(self.high),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn edges_hold_and_what_is_thin_counts_at_its_scale() {
        let window = Window { low: -250.0, high: 300.0, thin: 0.3 };
        for (hu, to) in [(40.0, 40.0), (900.0, 300.0), (-850.0, -430.0), (-3000.0, -475.0)] {
            assert!((window.of(hu) - to).abs() < 1e-4, "{hu}: {}", window.of(hu));
        }
        let closed = Window { thin: 0.0, ..window };
        assert!((closed.of(-850.0) + 250.0).abs() < 1e-6 && window.of(f32::NAN).is_nan());
    }
}
