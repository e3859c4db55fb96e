//! How the grey values of one scan lie to those of another.

/// Gains beyond these are no difference of scanners or protocols.
const GAIN: [f64; 2] = [0.7, 1.4];

/// How one value follows from another: `gain` times it, and `offset`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Line {
    /// Of the first per unit of the second.
    pub gain: f64,
    /// Of the first where the second is 0.
    pub offset: f64,
}

/// Gain and offset of the second value of each pair that fit the first best, by least squares; the gain is held to what
/// scanners differ by. `None` where the second hardly varies: then it tells nothing.
pub fn gain_and_offset(pairs: impl Iterator<Item = (f64, f64)>) -> Option<Line> {
    let mut s = [0f64; 5];
    for (p, f) in pairs {
        s = [s[0] + 1.0, s[1] + f, s[2] + p, s[3] + f * f, s[4] + f * p];
    }
    let variance = s[3] - s[1] * s[1] / s[0].max(1.0);
    (variance > 1.0).then(|| {
        let gain = ((s[4] - s[1] * s[2] / s[0]) / variance).clamp(GAIN[0], GAIN[1]);
        Line { gain, offset: (s[2] - gain * s[1]) / s[0] }
    })
}

#[cfg(test)]
mod tests {
    use super::{Line, gain_and_offset};

    #[test]
    fn lines_are_found_and_held_to_what_scanners_differ_by() {
        let line = |gain: f64| gain_and_offset((0..50).map(|n| f64::from(n * 3 - 40)).map(|f| (gain * f + 12.0, f)));
        let Line { gain, offset } = line(0.9).unwrap();
        assert!((gain - 0.9).abs() < 1e-12 && (offset - 12.0).abs() < 1e-9, "{gain} {offset}");
        // Held at 1.4, the line still goes through the middle of both: f is 33.5 there.
        let Line { gain, offset } = line(2.0).unwrap();
        assert!((gain - 1.4).abs() < 1e-12 && (offset - (12.0 + 0.6 * 33.5)).abs() < 1e-9, "{gain} {offset}");
        assert_eq!(gain_and_offset([(3.0, 5.0); 9].into_iter()), None);
        assert_eq!(gain_and_offset(std::iter::empty()), None);
    }
}
