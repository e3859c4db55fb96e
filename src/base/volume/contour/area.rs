//! Areas by the even-odd rule, and what is wrong with a drawing: polygons repeated, crossing, or cancelling each other.

use super::{Contours, Polygon, SAME_PLANE_MM, Structure, encloses, shoelace};
use crate::findings;
use crate::warning::Warning;
use rayon::prelude::*;

/// Points of a polygon drawn twice agree within this, mm.
const SAME_POINT_MM: f64 = 0.01;
/// Lines across a plane's polygons.
const LINES: usize = 512;
/// Polygons cross where lines and corners tell areas apart by more than this share.
const CROSSING: f64 = 0.02;
/// Less than this share of what polygons enclose is nothing: rings are thicker.
const NOTHING: f64 = 0.005;
/// Vertices of a polygon that are asked whether another encloses them.
const ASKED: usize = 15;

/// The polygons of one plane.
pub(super) struct Drawn {
    /// What the even-odd rule leaves, mm^2.
    pub area: f64,
    /// Whether a polygon crosses itself or another, so that the rule hardly does what was meant.
    pub crossing: bool,
    /// Whether they enclose something and yet leave nothing.
    pub cancelling: bool,
}

impl Drawn {
    /// Of the closed polygons of one plane.
    pub(super) fn of(polygons: &[&[[f64; 2]]]) -> Self {
        // A polygon inside an odd number of others is a hole.
        let around = |n: usize| (0..polygons.len()).filter(|&o| o != n && lies_in(polygons[n], polygons[o])).count();
        let (mut by_corners, mut outer, mut gross) = (0.0, 0.0, 0.0);
        for (n, points) in polygons.iter().enumerate() {
            let (area, around) = (shoelace(points).abs(), around(n));
            gross += area;
            outer += if around == 0 { area } else { 0.0 };
            by_corners += if around % 2 == 1 { -area } else { area };
        }
        let by_lines = by_lines(polygons);
        let crossing = (by_lines - by_corners).abs() > CROSSING * gross.max(by_lines);
        // Corners are exact where nothing crosses.
        let area = if crossing { by_lines } else { by_corners.max(0.0) };
        Self { area, crossing, cancelling: area < NOTHING * outer }
    }
}

/// Whether most of a polygon lies in another: single vertices may lie on its edge.
fn lies_in(points: &[[f64; 2]], other: &[[f64; 2]]) -> bool {
    let step = points.len().div_ceil(ASKED).max(1);
    let asked = points.iter().step_by(step);
    let inside = asked.clone().filter(|p| encloses(other, **p)).count();
    2 * inside > asked.count()
}

/// Area by the even-odd rule along lines across the polygons, whatever crosses what.
fn by_lines(polygons: &[&[[f64; 2]]]) -> f64 {
    let ys = || polygons.iter().flat_map(|p| p.iter()).map(|p| p[1]);
    let (low, high) = (ys().fold(f64::MAX, f64::min), ys().fold(f64::MIN, f64::max));
    let step = (high - low) / LINES as f64;
    if step.is_nan() || step <= 0.0 {
        return 0.0;
    }
    let mut crossings: Vec<Vec<f64>> = vec![Vec::new(); LINES];
    for polygon in polygons {
        for (a, b) in polygon.iter().zip(polygon.iter().cycle().skip(1)) {
            let (from, to) = (a[1].min(b[1]), a[1].max(b[1]));
            let line = |y: f64| ((y - low) / step - 0.5).ceil().clamp(0.0, LINES as f64) as usize;
            for (n, row) in crossings.iter_mut().enumerate().take(line(to)).skip(line(from)) {
                let y = low + (n as f64 + 0.5) * step;
                row.push(a[0] + (y - a[1]) / (b[1] - a[1]) * (b[0] - a[0]));
            }
        }
    }
    let length = |row: &mut Vec<f64>| {
        row.sort_by(f64::total_cmp);
        row.as_chunks::<2>().0.iter().map(|[from, to]| to - from).sum::<f64>()
    };
    step * crossings.iter_mut().map(length).sum::<f64>()
}

impl Structure {
    /// Drops polygons that are drawn twice; returns how many.
    fn drop_repeated(&mut self) -> usize {
        let before = self.polygons.len();
        let mut kept: Vec<Polygon> = Vec::with_capacity(before);
        for polygon in self.polygons.drain(..) {
            let twin =
                |k: &Polygon| (k.height - polygon.height).abs() <= SAME_PLANE_MM && same(&k.points, &polygon.points);
            if !kept.iter().any(twin) {
                kept.push(polygon);
            }
        }
        self.polygons = kept;
        before - self.polygons.len()
    }
}

/// Whether two polygons go through the same points, wherever they begin and whichever way they turn.
fn same(a: &[[f64; 2]], b: &[[f64; 2]]) -> bool {
    let n = a.len();
    let near = |p: &[f64; 2], q: &[f64; 2]| (p[0] - q[0]).abs() < SAME_POINT_MM && (p[1] - q[1]).abs() < SAME_POINT_MM;
    n == b.len()
        && (0..n)
            .filter(|&s| near(&a[0], &b[s]))
            .any(|s| (0..n).all(|k| near(&a[k], &b[(s + k) % n])) || (0..n).all(|k| near(&a[k], &b[(s + n - k) % n])))
}

impl Contours {
    /// Drops polygons that are drawn twice (the even-odd rule would empty them), and names these and polygons that cross
    /// or cancel.
    pub fn tidy(&mut self) -> Vec<Warning> {
        let dropped: Vec<usize> = self.structures.par_iter_mut().map(Structure::drop_repeated).collect();
        let mut all = Vec::new();
        for (s, dropped) in self.structures.iter().zip(dropped) {
            if dropped > 0 {
                let message =
                    format!("structure {:?}: {dropped} contours are drawn twice; one of each is kept", s.name);
                all.push(Warning::new(findings::CONTOURS_REPEATED, message));
            }
            let heights = s.heights();
            let drawn: Vec<Drawn> = heights.par_iter().map(|h| s.drawn(*h)).collect();
            let named = |which: &dyn Fn(&Drawn) -> bool| {
                let at: Vec<f64> = heights.iter().zip(&drawn).filter(|(_, d)| which(d)).map(|(h, _)| *h).collect();
                let first = at.first()?;
                Some(format!(
                    "structure {:?}, {} of {} planes, the first at {first:.1} mm",
                    s.name,
                    at.len(),
                    drawn.len()
                ))
            };
            if let Some(place) = named(&|d| d.crossing && !d.cancelling) {
                let message = format!(
                    "{place}: a contour crosses itself or another; what is enclosed twice counts as outside, which may not \
                     be what was drawn"
                );
                all.push(Warning::new(findings::CONTOURS_CROSS, message));
            }
            if let Some(place) = named(&|d| d.cancelling) {
                let message = format!("{place}: contours cancel each other, what is enclosed twice counts as outside");
                all.push(Warning::new(findings::CONTOURS_CANCEL, message));
            }
        }
        all
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::circle;
    use super::*;
    use nalgebra::Matrix3;

    fn boxed(low: f64, high: f64) -> Vec<[f64; 2]> {
        vec![[low, low], [high, low], [high, high], [low, high]]
    }

    fn drawn(polygons: &[Vec<[f64; 2]>]) -> Drawn {
        Drawn::of(&polygons.iter().map(Vec::as_slice).collect::<Vec<_>>())
    }

    #[test]
    fn areas_are_never_negative_whatever_crosses() {
        // The first corner of each lies in the other: both were holes, and the area was below 0.
        let crossing = drawn(&[boxed(0.0, 10.0), vec![[8.0, 5.0], [20.0, 5.0], [20.0, 15.0], [-2.0, 15.0]]]);
        assert!(crossing.crossing && crossing.area > 100.0, "{}", crossing.area);
        let bow = drawn(&[vec![[0.0, 0.0], [10.0, 10.0], [10.0, 0.0], [0.0, 10.0]]]);
        assert!(bow.crossing && (bow.area - 50.0).abs() < 0.2, "{}", bow.area);
        let loops = drawn(&[[circle([0.0, 0.0], 9.0, 60), circle([0.0, 0.0], 9.0, 60)].concat()]);
        assert!(loops.crossing || loops.cancelling);
        let ring = drawn(&[circle([3.0, 0.0], 9.0, 300), circle([3.0, 0.0], 8.8, 300)]);
        assert!(!ring.crossing && !ring.cancelling, "a thin ring is a ring: {}", ring.area);
        // A hole that touches the edge, two boxes with a common side, and a slit from the edge to a hole.
        for fine in [
            vec![boxed(0.0, 10.0), vec![[0.0, 2.0], [5.0, 2.0], [5.0, 6.0], [0.0, 6.0]]],
            vec![boxed(0.0, 10.0), vec![[10.0, 0.0], [20.0, 0.0], [20.0, 10.0], [10.0, 10.0]]],
            vec![vec![
                [0.0, 0.0],
                [9.0, 0.0],
                [9.0, 9.0],
                [0.0, 9.0],
                [0.0, 3.0],
                [3.0, 3.0],
                [3.0, 6.0],
                [6.0, 6.0],
                [6.0, 3.0],
                [0.0, 3.0],
            ]],
        ] {
            let d = drawn(&fine);
            assert!(!d.crossing && !d.cancelling && d.area > 70.0, "{fine:?}: {}", d.area);
        }
        assert!(drawn(&[boxed(0.0, 10.0), boxed(0.001, 9.999)]).cancelling);
    }

    #[test]
    fn what_is_drawn_twice_is_dropped_and_what_crosses_is_named() {
        let plane = |height: f64, points: Vec<[f64; 2]>| Polygon { height, points };
        let mut turned = boxed(0.0, 8.0);
        turned.rotate_left(2);
        let mut reversed = boxed(0.0, 8.0);
        reversed.reverse();
        let structure = |name: &str, polygons: Vec<Polygon>| Structure { name: name.into(), colour: None, polygons };
        let mut contours = Contours {
            axes: Matrix3::identity(),
            structures: vec![
                structure("twice", vec![plane(0.0, boxed(0.0, 8.0)), plane(0.0, turned), plane(0.01, reversed)]),
                structure("crossing", vec![plane(0.0, boxed(0.0, 8.0)), plane(0.0, boxed(4.0, 12.0))]),
                structure("nothing", vec![plane(0.0, boxed(0.0, 8.0)), plane(0.0, boxed(0.0, 8.02))]),
                structure(
                    "fine",
                    vec![plane(0.0, boxed(0.0, 8.0)), plane(2.0, boxed(0.0, 8.0)), plane(2.0, boxed(2.0, 4.0))],
                ),
            ],
        };
        let found = contours.tidy();
        let codes: Vec<&str> = found.iter().map(|w| w.code.as_str()).collect();
        assert_eq!(codes, ["contours-repeated", "contours-cross", "contours-cancel"], "{found:?}");
        assert!(found[0].message.contains("\"twice\"") && found[0].message.contains("2 contours"), "{found:?}");
        assert_eq!(contours.structures[0].polygons.len(), 1);
        assert!((contours.structures[0].volume(2.0) - 128.0).abs() < 1e-9);
    }
}
