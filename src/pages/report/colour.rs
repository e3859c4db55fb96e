//! Colours and windows of the pictures. Planning is blue and fraction orange everywhere.

use super::canvas::{Rgb, level, mix};

/// Planning CT. With [`ORANGE`] it adds up to white, so that equal content looks grey.
pub(super) const BLUE: Rgb = [0, 108, 255];
/// Fraction CT.
pub(super) const ORANGE: Rgb = [255, 147, 0];
/// Text on white.
pub(super) const INK: Rgb = [31, 41, 55];
/// Lesser text on white.
pub(super) const FAINT: Rgb = [107, 114, 128];
/// Folded cells.
pub(super) const BLACK: Rgb = [0, 0, 0];

/// Brightness (0 to 1) of a CT number: soft tissue from -150 to 170 HU fills the lower 64 %, bone to 1400 HU the rest,
/// so that one picture shows both.
pub(super) fn tone(hu: f64) -> f64 {
    0.64 * ((hu + 150.0) / 320.0).clamp(0.0, 1.0) + 0.36 * ((hu - 170.0) / 1230.0).clamp(0.0, 1.0)
}

/// Steps of brightness: finer ones are noise, which takes a quarter of a picture's bytes.
const STEPS: f64 = 63.0;

/// A brightness 0 to 1 in steps that one does not see.
pub(super) fn stepped(tone: f64) -> f64 {
    (tone * STEPS).round() / STEPS
}

/// Colour of planning and fraction of brightness 0 to 1 laid over each other.
pub(super) fn fuse(planning: f64, fraction: f64) -> Rgb {
    let [planning, fraction] = [planning, fraction].map(stepped);
    std::array::from_fn(|c| level(planning * f64::from(BLUE[c]) + fraction * f64::from(ORANGE[c])))
}

/// A colour darkened to a share.
pub(super) fn shaded(colour: Rgb, share: f64) -> Rgb {
    colour.map(|c| level(f64::from(c) * share))
}

/// Grey of a brightness 0 to 1.
pub(super) fn grey(tone: f64) -> Rgb {
    [level(tone * 255.0); 3]
}

/// Blue for shrinkage, white for 1, red for growth on a logarithmic scale from 1/2 to 2; black where folded.
pub(super) fn jacobian(value: f64) -> Rgb {
    const STOPS: [Rgb; 7] =
        [[8, 62, 140], [56, 130, 196], [160, 204, 232], [255, 255, 255], [250, 190, 165], [222, 92, 74], [150, 8, 34]];
    if value <= 0.0 { BLACK } else { ramp(&STOPS, 0.5 + value.log2() / 2.0) }
}

/// Magnitude from 0 to 1: from cyan over green and yellow to red, bright enough for thin arrows over a dim CT.
pub(super) fn magnitude(share: f64) -> Rgb {
    const STOPS: [Rgb; 5] = [[76, 201, 240], [94, 224, 142], [250, 233, 92], [255, 159, 28], [255, 56, 84]];
    ramp(&STOPS, share)
}

/// From dark (0, early) to bright (1, late), even in brightness.
pub(super) fn heat(share: f64) -> Rgb {
    const STOPS: [Rgb; 5] = [[30, 20, 80], [110, 30, 130], [200, 55, 100], [248, 140, 60], [250, 230, 130]];
    ramp(&STOPS, share)
}

/// Linear interpolation between evenly spaced colours.
fn ramp(stops: &[Rgb], share: f64) -> Rgb {
    let at = share.clamp(0.0, 1.0) * (stops.len() - 1) as f64;
    let low = (at as usize).min(stops.len() - 2);
    mix(stops[low], stops[low + 1], at - low as f64)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn equal_brightness_fuses_to_grey() {
        for step in 0..=20 {
            let t = f64::from(step) / 20.0;
            let [r, g, b] = fuse(t, t);
            assert!(r.abs_diff(g) <= 1 && g.abs_diff(b) <= 1, "{t}: {r} {g} {b}");
        }
        assert_eq!((fuse(1.0, 0.0), fuse(0.0, 1.0)), (BLUE, ORANGE));
    }

    #[test]
    fn jacobian_colours_mean_what_the_legend_says() {
        assert_eq!(jacobian(1.0), [255; 3]);
        assert_eq!((jacobian(-1.0), jacobian(0.0)), (BLACK, BLACK));
        let ([r, _, b], [r2, _, b2]) = (jacobian(1.5), jacobian(0.6));
        assert!(r > b && b2 > r2);
        assert_eq!((jacobian(2.0), jacobian(9.0)), (jacobian(4.0), jacobian(2.0)));
    }

    #[test]
    fn tone_rises_with_hu() {
        let tones = [-1000.0, -160.0, -100.0, 40.0, 240.0, 700.0, 1400.0, 3000.0].map(tone);
        assert!(tones.windows(2).all(|w| w[0] <= w[1]) && tones[0] <= 0.0 && tones[7] >= 1.0, "{tones:?}");
    }
}
