//! A line plot with axes, ticks and a key: for any curves over one variable.

use super::canvas::{Align, Canvas, Pen, Rgb, text_width};
use super::colour::{FAINT, INK};
use crate::concepts::{Curves, Series};

/// Colours of lines, told apart also in grey; the last one stands out.
const LINES: [Rgb; 12] = [
    [13, 90, 167],
    [214, 88, 20],
    [15, 133, 110],
    [122, 62, 160],
    [190, 30, 75],
    [120, 120, 120],
    [196, 154, 10],
    [86, 180, 233],
    [128, 72, 28],
    [226, 120, 180],
    [112, 138, 40],
    [20, 20, 20],
];
/// The colour of what is to be seen first.
pub(super) const STANDS_OUT: usize = LINES.len() - 1;
/// Share of the picture's height that the key may take before its letters become smaller, and their least size.
const KEY: f64 = 0.25;
const SMALLEST: f64 = 11.0;

/// Draws the curves on white; every length scales with `width`.
pub(super) fn draw(curves: &Curves, width: usize, height: usize) -> Canvas {
    let mut canvas = Canvas::new(width, height, [255; 3]);
    let named: Vec<&Series> = curves.series.iter().filter(|s| !s.name.is_empty()).collect();
    // Width of an entry of the key, entries beside each other, and the height above the plot.
    let key = |size: f64| {
        let entry = named.iter().map(|s| text_width(&s.name, size)).fold(0.0, f64::max) + 3.2 * size;
        let columns = (((width as f64 - 5.2 * size) / entry) as usize).max(1);
        (entry, columns, 1.4 * (named.len().div_ceil(columns) as f64 + 1.5) * size)
    };
    let mut size = (width as f64 * 0.034).clamp(SMALLEST, 26.0);
    while size > SMALLEST && key(size).2 > KEY * height as f64 {
        size = (0.95 * size).max(SMALLEST);
    }
    let (entry, columns, head) = key(size);
    let [left, top, right, bottom] = [4.2 * size, head, width as f64 - size, height as f64 - 3.4 * size];
    let (xs, ys) = (Axis::over(curves, 0), Axis::over(curves, 1));
    let x = |v: f64| left + (right - left) * xs.share(v);
    let y = |v: f64| bottom - (bottom - top) * ys.share(v);
    let pen = |colour, align| Pen { size, colour, halo: None, align };
    for tick in ys.ticks() {
        canvas.line([left, y(tick)], [right, y(tick)], 1.0, [226, 229, 234]);
        canvas.text(&ys.label(tick), [left - 0.4 * size, y(tick)], pen(FAINT, Align::Right));
    }
    for tick in xs.ticks() {
        canvas.line([x(tick), bottom], [x(tick), bottom + 0.3 * size], 1.0, INK);
        canvas.text(&xs.label(tick), [x(tick), bottom + size], pen(FAINT, Align::Centre));
    }
    canvas.line([left, bottom], [right, bottom], 1.5, INK);
    canvas.text(&curves.x, [(left + right) / 2.0, bottom + 2.5 * size], pen(INK, Align::Centre));
    for series in &curves.series {
        let colour = LINES[series.colour % LINES.len()];
        for w in series.points.windows(2) {
            canvas.line([x(w[0][0]), y(w[0][1])], [x(w[1][0]), y(w[1][1])], 0.13 * size, colour);
        }
        for p in series.points.iter().filter(|_| series.marks) {
            canvas.ring([x(p[0]), y(p[1])], 0.3 * size, 0.2 * size, colour);
        }
    }
    // Above the plot, where no line can be: the key, then the name of the vertical axis.
    for (n, series) in named.iter().enumerate() {
        let (x, y) = (left + (n % columns) as f64 * entry, (0.8 + 1.4 * (n / columns) as f64) * size);
        canvas.line([x, y], [x + 1.4 * size, y], 0.2 * size, LINES[series.colour % LINES.len()]);
        canvas.text(&series.name, [x + 1.8 * size, y], pen(INK, Align::Left));
    }
    canvas.text(&curves.y, [left, top - size], pen(INK, Align::Left));
    canvas
}

/// A round range that holds all values.
struct Axis {
    low: f64,
    high: f64,
    step: f64,
}

impl Axis {
    fn over(curves: &Curves, coordinate: usize) -> Self {
        let values = || curves.series.iter().flat_map(|s| &s.points).map(|p| p[coordinate]).filter(|v| v.is_finite());
        let (low, high) = values().fold((f64::MAX, f64::MIN), |(a, b), v| (a.min(v), b.max(v)));
        if low > high {
            return Self { low: 0.0, high: 1.0, step: 0.5 };
        }
        let range = (high - low).max(1e-9);
        let power = 10f64.powf((range / 5.0).log10().floor());
        let step = [1.0, 2.0, 5.0, 10.0].map(|s| s * power).into_iter().find(|s| range / s <= 6.0).unwrap_or(power);
        Self { low: (low / step + 1e-9).floor() * step, high: (high / step - 1e-9).ceil() * step, step }
    }

    fn share(&self, v: f64) -> f64 {
        (v - self.low) / (self.high - self.low).max(1e-12)
    }

    fn ticks(&self) -> impl Iterator<Item = f64> + '_ {
        let count = ((self.high - self.low) / self.step).round() as usize;
        (0..=count).map(|n| self.low + n as f64 * self.step)
    }

    fn label(&self, v: f64) -> String {
        let digits = (-self.step.log10() + 1e-9).ceil().clamp(0.0, 6.0) as usize;
        // Rounded first, so that zero has no sign.
        format!("{:.digits$}", if v.abs() < 1e-9 * self.step { 0.0 } else { v })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    fn curves(points: &[[f64; 2]]) -> Curves {
        let series = vec![Series { name: "a".into(), colour: 0, points: points.to_vec(), marks: false }];
        Curves { x: "x".into(), y: "y".into(), series }
    }

    #[test]
    fn axes_are_round_and_hold_every_value() {
        for (low, high, expected) in [(0.0, 1.0, (0.0, 1.0)), (-575.0, 362.0, (-600.0, 400.0)), (3.0, 3.0, (3.0, 3.0))]
        {
            let axis = Axis::over(&curves(&[[low, 0.0], [high, 0.0]]), 0);
            assert!(axis.low <= low && axis.high >= high - 1e-6, "{} {}", axis.low, axis.high);
            assert!((axis.low - expected.0).abs() < 1e-6 && (axis.high - expected.1).abs() < 1e-6);
        }
        assert_eq!(Axis::over(&curves(&[[0.0, 0.0], [1.0, 0.0]]), 0).label(0.2), "0.2");
    }

    #[test]
    fn a_rising_line_goes_up_and_nothing_panics_without_points() {
        let canvas = draw(&curves(&[[0.0, 0.0], [1.0, 1.0]]), 400, 300);
        let ink = |x: usize| (0..300).find(|&y| canvas.pixel(x, y) == LINES[0]);
        let (a, b) = (ink(100).unwrap(), ink(220).unwrap());
        assert!(a > b, "{a} {b}");
        draw(&curves(&[]), 100, 80);
    }
}
