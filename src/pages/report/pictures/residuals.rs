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
    let edges = edges(before.iter().chain(&after).copied());
    let bins = edges.len() - 1;
    let counts = [histogram(&before, &edges), histogram(&after, &edges)];
    let tallest = counts.iter().flatten().copied().max().unwrap_or(1).max(1);
    let mut canvas = Canvas::new(WIDTH, HEIGHT, [255; 3]);
    let [left, top, right, bottom] = PLOT;
    let x = |edge: usize| left + (right - left) * edge as f64 / bins as f64;
    let y = |count: f64| bottom - (bottom - top) * count / tallest as f64;
    axes(&mut canvas, tallest, y);
    for (which, colour) in [BEFORE, AFTER].into_iter().enumerate() {
        for (bin, &count) in counts[which].iter().enumerate().filter(|(_, c)| **c > 0) {
            let (low, high) = (x(bin), x(bin + 1));
            let half = (high - low) * 0.42;
            let start = low + (high - low) * 0.08 + which as f64 * half;
            canvas.rectangle([start, y(count as f64)], [start + half, bottom], colour);
        }
    }
    let pen = |align| Pen { size: 26.0, colour: INK, halo: None, align };
    for (n, edge) in edges.iter().enumerate() {
        canvas.text(&format!("{edge}"), [x(n), bottom + 20.0], pen(Align::Centre));
    }
    canvas.text("residual, mm", [(left + right) / 2.0, bottom + 54.0], pen(Align::Centre));
    key(&mut canvas, report);
    Plate {
        file: "residuals.png",
        title: "Landmark residuals",
        caption:
            "Number of landmarks by their distance from the true position in the fraction; bins widen to the right."
                .to_owned(),
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

/// Edges of bins, mm: narrow where the registration leaves residuals, wide where they were before.
const EDGES: [f64; 14] = [0.0, 0.1, 0.2, 0.5, 1.0, 2.0, 3.0, 5.0, 7.5, 10.0, 15.0, 20.0, 30.0, 50.0];

/// The edges around all values; beyond the last one the bin is open and ends at the greatest value.
fn edges(values: impl Iterator<Item = f64>) -> Vec<f64> {
    let (least, most) = values.fold((f64::INFINITY, 0.0f64), |(l, m), v| (l.min(v), m.max(v)));
    let from = EDGES.partition_point(|e| *e <= least).max(1) - 1;
    let to = EDGES.partition_point(|e| *e <= most).max(1);
    let mut edges = EDGES[from.min(to - 1)..(to + 1).min(EDGES.len())].to_vec();
    if edges.last().is_none_or(|last| *last <= most) {
        edges.push(most.ceil().max(1.0) + 1.0);
    }
    edges
}

fn histogram(values: &[f64], edges: &[f64]) -> Vec<usize> {
    let mut counts = vec![0; edges.len() - 1];
    for v in values {
        let bin = edges.partition_point(|e| e <= v).max(1) - 1;
        counts[bin.min(edges.len() - 2)] += 1;
    }
    counts
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bins_fit_the_values_and_count_each_once() {
        let values = [0.12, 0.3, 0.5, 8.0, 9.9];
        let own = edges(values.into_iter());
        assert_eq!(own, [0.1, 0.2, 0.5, 1.0, 2.0, 3.0, 5.0, 7.5, 10.0]);
        assert_eq!(histogram(&values, &own), [1, 1, 1, 0, 0, 0, 0, 2]);
        let wide = edges([0.0, 80.5].into_iter());
        assert_eq!((wide[0], wide[wide.len() - 1]), (0.0, 82.0));
        assert_eq!(histogram(&[0.0, 80.5], &wide).iter().sum::<usize>(), 2);
        assert_eq!((edges(std::iter::empty()).len(), edges([0.0].into_iter())), (2, vec![0.0, 0.1]));
    }
}
