//! Curves over an axis: dose-volume and Jacobian-volume histograms.

use super::canvas::{Align, Canvas, Pen, Rgb, text_width};
use super::colour::{FAINT, INK};
use super::plane::WIDTH;

/// Colours that stay apart, also for the colour-blind (Tol, "bright" and "muted").
pub(super) const COLOURS: [Rgb; 10] = [
    [68, 119, 170],
    [238, 102, 119],
    [34, 136, 51],
    [204, 187, 68],
    [102, 204, 238],
    [170, 51, 119],
    [136, 34, 85],
    [153, 153, 51],
    [17, 119, 51],
    [90, 90, 90],
];

/// A curve with its name.
pub(super) struct Curve {
    pub(super) name: String,
    pub(super) colour: Rgb,
    /// Line width, pixels.
    pub(super) width: f64,
    /// Points in units of the axes, x rising.
    pub(super) points: Vec<[f64; 2]>,
}

/// Height of the plot with its axes, pixels.
const HEIGHT: usize = 620;
/// Height of a line of the key, pixels.
const LINE: usize = 44;
const LEFT: f64 = 96.0;
const TEXT: f64 = 26.0;

/// What lies between two curves.
pub(super) struct Band {
    pub(super) colour: Rgb,
    /// `x`, lower and upper `y`, in units of the axes, x rising.
    pub(super) points: Vec<[f64; 3]>,
}

/// How much of a band's colour shows.
const BAND: f64 = 0.25;

/// The curves over `x` from `range[0]` to `range[1]`, `y` from 0 to 100 %, with a key below.
pub(super) fn chart(title: &str, range: [f64; 2], curves: &[Curve]) -> Canvas {
    chart_with_bands(title, range, curves, &[])
}

/// As [`chart`], with bands behind the curves.
pub(super) fn chart_with_bands(title: &str, range: [f64; 2], curves: &[Curve], bands: &[Band]) -> Canvas {
    let key = key_lines(curves);
    let mut canvas = Canvas::new(WIDTH, HEIGHT + LINE * (key.len() + 1), [255; 3]);
    let (right, top, bottom) = (WIDTH as f64 - 30.0, 60.0, HEIGHT as f64 - 60.0);
    let x = |v: f64| LEFT + (right - LEFT) * (v - range[0]) / (range[1] - range[0]).max(1e-9);
    let y = |v: f64| bottom - (bottom - top) * v / 100.0;
    let pen = |colour, align| Pen { size: TEXT, colour, halo: None, align };
    for percent in [0.0, 20.0, 40.0, 60.0, 80.0, 100.0] {
        canvas.line([LEFT, y(percent)], [right, y(percent)], 1.0, [226, 229, 234]);
        canvas.text(&format!("{percent} %"), [LEFT - 12.0, y(percent)], pen(FAINT, Align::Right));
    }
    let step = tick(range[1] - range[0]);
    let mut at = (range[0] / step).ceil() * step;
    while at <= range[1] + 1e-9 {
        canvas.line([x(at), top], [x(at), bottom], 1.0, [226, 229, 234]);
        canvas.text(&format!("{}", (at * 1e4).round() / 1e4), [x(at), bottom + 22.0], pen(FAINT, Align::Centre));
        at += step;
    }
    canvas.line([LEFT, bottom], [right, bottom], 2.0, INK);
    canvas.text(title, [(LEFT + right) / 2.0, bottom + 54.0], pen(INK, Align::Centre));
    canvas.text("share of the volume", [14.0, 26.0], pen(INK, Align::Left));
    for band in bands {
        for pair in band.points.windows(2) {
            let [[u, low, high], [v, next_low, next_high]] = [pair[0], pair[1]];
            let columns = x(u.max(range[0])).round() as i64..x(v.min(range[1])).round() as i64;
            for column in columns {
                let way = ((column as f64 - x(u)) / (x(v) - x(u)).max(1e-9)).clamp(0.0, 1.0);
                let [low, high] =
                    [[low, next_low], [high, next_high]].map(|[a, b]| (a + (b - a) * way).clamp(0.0, 100.0));
                for row in y(high).round() as i64..=y(low).round() as i64 {
                    canvas.blend(column, row, band.colour, BAND);
                }
            }
        }
    }
    for curve in curves {
        for pair in curve.points.windows(2) {
            if pair[1][0] >= range[0] && pair[0][0] <= range[1] {
                let ends = [pair[0], pair[1]].map(|[u, v]| [x(u.clamp(range[0], range[1])), y(v.clamp(0.0, 100.0))]);
                canvas.line(ends[0], ends[1], curve.width, curve.colour);
            }
        }
    }
    for (line, entries) in key.iter().enumerate() {
        let mut at = LEFT;
        let middle = (HEIGHT + LINE * (line + 1)) as f64;
        for curve in entries {
            canvas.line([at, middle], [at + 40.0, middle], curve.width.max(3.0), curve.colour);
            canvas.text(&curve.name, [at + 52.0, middle], pen(INK, Align::Left));
            at += entry_width(curve);
        }
    }
    canvas
}

fn entry_width(curve: &Curve) -> f64 {
    text_width(&curve.name, TEXT) + 90.0
}

/// The curves line by line, as many as fit.
fn key_lines(curves: &[Curve]) -> Vec<Vec<&Curve>> {
    let mut lines: Vec<Vec<&Curve>> = Vec::new();
    let mut room = 0.0;
    for curve in curves {
        if room < entry_width(curve) {
            lines.push(Vec::new());
            room = WIDTH as f64 - LEFT;
        }
        room -= entry_width(curve);
        if let Some(line) = lines.last_mut() {
            line.push(curve);
        }
    }
    lines
}

/// A round distance between ticks that gives at most 10.
fn tick(span: f64) -> f64 {
    let power = 10f64.powf((span.max(1e-6) / 10.0).log10().floor());
    [1.0, 2.0, 5.0, 10.0].into_iter().map(|m| m * power).find(|s| span / s <= 10.0).unwrap_or(10.0 * power)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_curve_is_where_its_numbers_are() {
        let curve =
            Curve { name: "cord".into(), colour: [200, 0, 0], width: 6.0, points: vec![[0.0, 50.0], [70.0, 50.0]] };
        let canvas = chart("dose, Gy", [0.0, 70.0], &[curve]);
        let red = |x: usize, y: usize| canvas.pixel(x, y) == [200, 0, 0];
        // Half way between top (60) and bottom (560).
        assert!(red(500, 310) && !red(500, 270) && !red(500, 350));
        assert!((tick(70.0) - 10.0).abs() < 1e-9 && (tick(3.0) - 0.5).abs() < 1e-9);
    }
}
