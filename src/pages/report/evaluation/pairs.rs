//! Two fields of one case set against each other: where they differ, and landmark by landmark.

use super::super::canvas::{Align, Canvas, Pen, Rgb};
use super::super::colour::{FAINT, INK, heat, shaded, tone};
use super::super::pictures::displacement::{ceil_nice, short};
use super::super::pictures::legend::sheet;
use super::super::plane::{WIDTH, nearest};
use super::pictures::{BACKDROP, encoded, middle_planes};
use super::{Assessed, EvaluationPicture};
use crate::error::Result;
use crate::evaluate::FieldPair;
use crate::stats::percentile;
use crate::volume::{Mask, Volume, trilinear_vector};
use nalgebra::Point3;

/// A measured field with what it is compared by.
pub struct Compared {
    /// What it is called and what was measured.
    pub field: Assessed,
    /// Both directions of it.
    pub pair: FieldPair,
    /// Where it was measured, in the planning frame.
    pub measured: Mask,
}

/// The pictures of the field at place `which` of a report against the first one: the distance between them over the
/// planning CT, where there is one, and their landmarks' residuals, where there are any.
///
/// # Errors
/// [`crate::Error::Internal`] when a picture cannot be encoded.
pub fn draw_pair(
    which: usize,
    first: &Compared,
    other: &Compared,
    planning: Option<&Volume<f32>>,
) -> Result<Vec<EvaluationPicture>> {
    let names = [&first.field.name, &other.field.name];
    let mut all = Vec::new();
    if let Some(planning) = planning {
        let (canvas, [p99, greatest]) = distance(planning, first, other);
        let caption = format!(
            "Distance between the two fields, planning to fraction, over the planning CT: 99 % of what is shown is below {p99:.2} mm, \
             the greatest {greatest:.2} mm."
        );
        all.push(encoded(
            which,
            "difference",
            format!("{}: difference from {}", names[1], names[0]),
            caption,
            &canvas,
        )?);
    }
    let points = pairs(&first.field, &other.field);
    if !points.is_empty() {
        let better = points.iter().filter(|p| p[1] < p[0]).count();
        let caption = format!(
            "Each landmark's residual under both fields. Below the line {} is nearer to the truth: {better} of {} landmarks.",
            names[1],
            points.len()
        );
        let title = format!("{}: landmarks against {}", names[1], names[0]);
        all.push(encoded(which, "paired", title, caption, &scatter(&points, names))?);
    }
    Ok(all)
}

/// The distance in three planes, and its 99th percentile and greatest value in them.
fn distance(planning: &Volume<f32>, first: &Compared, other: &Compared) -> (Canvas, [f64; 2]) {
    let [u, v] = [&first.pair, &other.pair].map(|pair| &pair.push.displacement);
    let at = |p: &Point3<f64>| -> Option<f64> {
        let inside = nearest(&first.measured, p) == Some(true);
        let [a, b] = [u, v].map(|field| trilinear_vector(field, &field.grid().index(p)));
        if inside { Some((a? - b?).norm()) } else { None }
    };
    let planes = middle_planes(planning);
    let mut all: Vec<f64> = Vec::new();
    for plane in &planes {
        let places = (0..plane.height).step_by(3).flat_map(|y| (0..plane.width).step_by(3).map(move |x| (x, y)));
        all.extend(places.filter_map(|(x, y)| at(&plane.world(x as f64 + 0.5, y as f64 + 0.5))));
    }
    all.sort_by(f64::total_cmp);
    let (p99, greatest) = (percentile(&all, 99.0), all.last().copied().unwrap_or(0.0));
    let top = ceil_nice(p99);
    let rows = planes.map(|plane| {
        let hu = plane.hu(planning);
        let picture = plane.paint(|p, n| match at(&p) {
            Some(mm) => shaded(heat(mm / top), 0.5 + 0.5 * tone(f64::from(hu[n]))),
            None => BACKDROP,
        });
        plane.row(&picture, BACKDROP, INK, BACKDROP)
    });
    let ticks: Vec<_> = (0..=4).map(|n| (f64::from(n) / 4.0, short(top * f64::from(n) / 4.0))).collect();
    let canvas = sheet(&rows, 1, |legend| {
        legend.bar("mm", 420.0, heat, &ticks);
        legend.text(&format!("greatest {greatest:.1} mm"));
    });
    (canvas, [p99, greatest])
}

/// Residuals of the landmarks that both fields reach, mm.
fn pairs(first: &Assessed, other: &Assessed) -> Vec<[f64; 2]> {
    let (Some(a), Some(b)) = (&first.assessment.landmarks, &other.assessment.landmarks) else { return Vec::new() };
    let both = a.each.iter().zip(&b.each).filter(|(a, b)| a.landmark == b.landmark);
    both.filter_map(|(a, b)| Some([a.after?, b.after?])).collect()
}

const HEIGHT: usize = 900;
/// Left, top and size of the square, pixels.
const SQUARE: [f64; 3] = [180.0, 70.0, 720.0];
const DOT: Rgb = [13, 118, 110];

/// A point for each pair on equal axes, with the line of equality.
fn scatter(points: &[[f64; 2]], names: [&String; 2]) -> Canvas {
    let most = points.iter().flatten().copied().fold(0.0, f64::max);
    let top = ceil_nice(most);
    let mut canvas = Canvas::new(WIDTH, HEIGHT, [255; 3]);
    let [left, up, size] = SQUARE;
    let (x, y) = (|mm: f64| left + size * mm / top, |mm: f64| up + size * (1.0 - mm / top));
    let pen = |align, colour| Pen { size: 26.0, colour, halo: None, align };
    for n in 0..=4 {
        let mm = top * f64::from(n) / 4.0;
        canvas.line([x(mm), y(0.0)], [x(mm), y(top)], 1.0, [226, 229, 234]);
        canvas.line([x(0.0), y(mm)], [x(top), y(mm)], 1.0, [226, 229, 234]);
        canvas.text(&short(mm), [x(mm), y(0.0) + 22.0], pen(Align::Centre, FAINT));
        canvas.text(&short(mm), [left - 14.0, y(mm)], pen(Align::Right, FAINT));
    }
    canvas.line([x(0.0), y(0.0)], [x(top), y(top)], 2.0, FAINT);
    canvas.line([x(0.0), y(0.0)], [x(top), y(0.0)], 2.0, INK);
    canvas.line([x(0.0), y(0.0)], [x(0.0), y(top)], 2.0, INK);
    for [a, b] in points {
        let at = [x(*a), y(*b)];
        canvas.line(at, at, 13.0, [255; 3]);
        canvas.line(at, at, 10.0, DOT);
    }
    canvas.text(&format!("residual of {}, mm", names[0]), [left + size / 2.0, y(0.0) + 62.0], pen(Align::Centre, INK));
    canvas.text(&format!("residual of {}, mm", names[1]), [14.0, 30.0], pen(Align::Left, INK));
    canvas
}
