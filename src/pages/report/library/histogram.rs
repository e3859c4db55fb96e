//! How far each bone moves: a histogram for each, all with the same bins.

use super::super::canvas::{Align, Canvas, Pen, Rgb};
use super::super::colour::{FAINT, INK, ORANGE};
use super::PostureRecord;
use std::collections::BTreeMap;

/// Columns of panels, and a panel's size, pixels.
const COLUMNS: usize = 4;
const PANEL: [usize; 2] = [260, 130];
/// Bins of a histogram.
const BINS: usize = 12;
const LINE: Rgb = [226, 229, 234];

/// A round number of mm that holds all motions.
fn round_up(mm: f64) -> f64 {
    let power = 10f64.powf(mm.max(0.1).log10().floor());
    [1.0, 2.0, 3.0, 5.0, 10.0].map(|s| s * power).into_iter().find(|v| *v >= mm).unwrap_or(10.0 * power)
}

/// How many of the values lie in each bin from 0 to `most`.
fn bins(values: &[f64], most: f64) -> [usize; BINS] {
    let mut out = [0; BINS];
    values.iter().for_each(|v| out[((v / most * BINS as f64) as usize).min(BINS - 1)] += 1);
    out
}

/// One panel for each bone, in the order of their names.
pub(super) fn draw(records: &[PostureRecord]) -> Canvas {
    let mut motions: BTreeMap<&str, Vec<f64>> = BTreeMap::new();
    for (bone, mm) in records.iter().flat_map(|r| &r.motion_mm) {
        motions.entry(bone).or_default().push(*mm);
    }
    let most = round_up(motions.values().flatten().copied().fold(0.0, f64::max));
    let rows = motions.len().div_ceil(COLUMNS).max(1);
    let mut canvas = Canvas::new(COLUMNS * PANEL[0], rows * PANEL[1], [255; 3]);
    for (n, (bone, values)) in motions.iter().enumerate() {
        let corner = [n % COLUMNS * PANEL[0], n / COLUMNS * PANEL[1]].map(|v| v as f64);
        panel(&mut canvas, corner, bone, values, most);
    }
    canvas
}

fn panel(canvas: &mut Canvas, [x, y]: [f64; 2], bone: &str, values: &[f64], most: f64) {
    let pen = |colour, align, size| Pen { size, colour, halo: None, align };
    let (left, right, top, bottom) = (x + 12.0, x + PANEL[0] as f64 - 16.0, y + 34.0, y + PANEL[1] as f64 - 26.0);
    let mean = values.iter().sum::<f64>() / values.len().max(1) as f64;
    canvas.text(bone, [left, y + 16.0], pen(INK, Align::Left, 15.0));
    canvas.text(&format!("{mean:.1} mm"), [right, y + 16.0], pen(FAINT, Align::Right, 15.0));
    let counts = bins(values, most);
    let tallest = counts.iter().copied().max().unwrap_or(1).max(1) as f64;
    let wide = (right - left) / BINS as f64;
    for (n, count) in counts.iter().enumerate() {
        let from = left + n as f64 * wide;
        let height = (bottom - top) * *count as f64 / tallest;
        canvas.rectangle([from + 1.0, bottom - height], [from + wide - 1.0, bottom], ORANGE);
    }
    canvas.line([left, bottom], [right, bottom], 1.0, LINE);
    let at = left + (right - left) * (mean / most).min(1.0);
    canvas.line([at, top], [at, bottom], 1.5, INK);
    canvas.text("0", [left, bottom + 12.0], pen(FAINT, Align::Left, 13.0));
    canvas.text(&format!("{most} mm"), [right, bottom + 12.0], pen(FAINT, Align::Right, 13.0));
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_value_is_in_the_bin_that_holds_it() {
        let counts = bins(&[0.0, 0.9, 1.1, 11.9, 12.0], 12.0);
        assert_eq!((counts[0], counts[1], counts[11]), (2, 1, 2));
        assert!((round_up(11.2) - 20.0).abs() < 1e-9 && (round_up(4.2) - 5.0).abs() < 1e-9);
        assert!((round_up(0.0) - 0.1).abs() < 1e-9);
    }
}
