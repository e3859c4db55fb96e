//! Histogram of landmark residuals before and after registration.

use super::super::canvas::{Align, Canvas, Pen, Rgb};
use super::super::colour::{FAINT, INK};
use super::super::plane::WIDTH;
use super::Plate;
use crate::evaluate::landmark::LandmarkReport;

const BEFORE: Rgb = [176, 184, 196];
const AFTER: Rgb = [13, 118, 110];
const HEIGHT: usize = 520;
/// Left, top, right and bottom edge of the plot, pixels.
const PLOT: [f64; 4] = [80.0, 60.0, WIDTH as f64 - 20.0, HEIGHT as f64 - 80.0];

/// Number of landmarks by residual, before and after side by side.
pub(in crate::report) fn draw(report: &LandmarkReport) -> Plate {
    let before: Vec<f64> = report.each.iter().map(|r| r.before).collect();
    let after: Vec<f64> = report.each.iter().filter_map(|r| r.after).collect();
    let most = before.iter().chain(&after).fold(0.0f64, |a, &b| a.max(b));
    let width = bin_width(most);
    let bins = (most / width) as usize + 1;
    let counts = [histogram(&before, width, bins), histogram(&after, width, bins)];
    let tallest = counts.iter().flatten().copied().max().unwrap_or(1).max(1);
    let mut canvas = Canvas::new(WIDTH, HEIGHT, [255; 3]);
    let [left, top, right, bottom] = PLOT;
    let x = |mm: f64| left + (right - left) * mm / (bins as f64 * width);
    let y = |count: f64| bottom - (bottom - top) * count / tallest as f64;
    axes(&mut canvas, tallest, y);
    for (which, colour) in [BEFORE, AFTER].into_iter().enumerate() {
        for (bin, &count) in counts[which].iter().enumerate().filter(|(_, c)| **c > 0) {
            let (low, high) = (x(bin as f64 * width), x((bin + 1) as f64 * width));
            let half = (high - low) * 0.42;
            let start = low + (high - low) * 0.08 + which as f64 * half;
            canvas.rectangle([start, y(count as f64)], [start + half, bottom], colour);
        }
    }
    let pen = |align| Pen { size: 26.0, colour: INK, halo: None, align };
    let every = bins.div_ceil(12);
    for bin in (0..=bins).step_by(every) {
        canvas.text(&format!("{}", bin as f64 * width), [x(bin as f64 * width), bottom + 20.0], pen(Align::Centre));
    }
    canvas.text("residual, mm", [(left + right) / 2.0, bottom + 54.0], pen(Align::Centre));
    key(&mut canvas, report);
    Plate {
        file: "residuals.png",
        title: "Landmark residuals",
        caption: "Number of landmarks by their distance from the true position in the fraction.".to_owned(),
        canvas,
    }
}

/// Horizontal lines at whole counts, with their numbers.
fn axes(canvas: &mut Canvas, tallest: usize, y: impl Fn(f64) -> f64) {
    let [left, _, right, bottom] = PLOT;
    let pen = Pen { size: 26.0, colour: FAINT, halo: None, align: Align::Right };
    for count in (0..=tallest).step_by(tallest.div_ceil(5).max(1)) {
        let at = y(count as f64);
        canvas.line([left, at], [right, at], 1.0, [226, 229, 234]);
        canvas.text(&count.to_string(), [left - 14.0, at], pen);
    }
    canvas.line([left, bottom], [right, bottom], 2.0, INK);
}

/// Colours with the means.
fn key(canvas: &mut Canvas, report: &LandmarkReport) {
    let pen = Pen { size: 28.0, colour: INK, halo: None, align: Align::Left };
    let entries = [(BEFORE, "before", report.before.mean), (AFTER, "after", report.after.mean)];
    for (i, (colour, name, mean)) in entries.into_iter().enumerate() {
        let at = PLOT[0] + 400.0 * i as f64;
        canvas.rectangle([at, 14.0], [at + 26.0, 40.0], colour);
        canvas.text(&format!("{name}, mean {mean:.1} mm"), [at + 38.0, 27.0], pen);
    }
}

/// Bin width that gives at most about 24 bins.
fn bin_width(most: f64) -> f64 {
    [0.25, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0].into_iter().find(|w| most / w <= 24.0).unwrap_or(most / 24.0)
}

fn histogram(values: &[f64], width: f64, bins: usize) -> Vec<usize> {
    let mut counts = vec![0; bins];
    for v in values {
        counts[((v / width) as usize).min(bins - 1)] += 1;
    }
    counts
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bins_count_every_value_once() {
        assert_eq!(histogram(&[0.0, 0.4, 0.5, 1.9, 2.0], 0.5, 5), [2, 1, 0, 1, 1]);
        assert!((bin_width(11.0) - 0.5).abs() < 1e-12 && (bin_width(0.0) - 0.25).abs() < 1e-12);
    }
}
