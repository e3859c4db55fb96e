//! Displacement arrows over the planning CT, coloured by magnitude.

use super::super::canvas::{Canvas, mix};
use super::super::colour::{grey, magnitude, stepped, tone};
use super::super::plane::{Plane, hu_at, nearest};
use super::legend::sheet;
use super::{PictureScene, Plate};
use crate::evaluate::jacobian::TISSUE_HU;
use crate::sampling::SampleSet;
use crate::stats::percentile;
use crate::volume::trilinear_vector;
use nalgebra::{Point3, Vector3};

/// Distance between arrows, pixels.
const SPACING: usize = 42;
/// The longest usual arrow, in distances between arrows.
const REACH: f64 = 1.6;

/// An arrow's foot, pixels, and its displacement, mm.
type Arrow = ([f64; 2], Vector3<f64>);

/// The in-plane part of the push field as arrows at the planning positions.
pub(super) fn draw(scene: &PictureScene<'_>) -> Plate {
    let field = &scene.outcome.push.displacement;
    let arrows = ArrowRows::of(scene, |p| trilinear_vector(field, &field.grid().index(p)));
    Plate {
        file: "displacement.png",
        title: "Displacement",
        caption: format!(
            "Where planning tissue goes: in-plane part as arrows, whole magnitude as colour, over the planning CT. Planes: \
             {}.",
            scene.focus
        ),
        canvas: arrows.sheet(scene, arrows.scale(scene)),
    }
}

/// What each of some samples adds to the push field, drawn at one scale.
pub(super) fn of_samples(scene: &PictureScene<'_>, samples: &SampleSet, files: &[&'static str]) -> Vec<Plate> {
    let field = &scene.outcome.push.displacement;
    let one = |n: usize| {
        let added = |x: &Point3<f64>| {
            let u = trilinear_vector(field, &field.grid().index(x))?;
            Some(samples.one(n, x, &(x + u)))
        };
        ArrowRows::of(scene, added)
    };
    let all: Vec<ArrowRows> = (0..files.len()).map(one).collect();
    let scales = all.iter().map(|rows| rows.scale(scene));
    let scale = scales.fold(ArrowScale { top: 0.0, zoom: f64::MAX }, |a, b| ArrowScale {
        top: a.top.max(b.top),
        zoom: a.zoom.min(b.zoom),
    });
    let plate = |(n, (rows, file)): (usize, (&ArrowRows, &&'static str))| Plate {
        file,
        title: "What a sample adds",
        caption: format!("Sample {} minus the registration that was found, over the planning CT.", n + 1),
        canvas: rows.sheet(scene, scale),
    };
    all.iter().zip(files).enumerate().map(plate).collect()
}

/// Greatest length that has a colour of its own, mm, and how much longer than true arrows are drawn.
#[derive(Clone, Copy)]
struct ArrowScale {
    top: f64,
    zoom: f64,
}

/// Arrows on the planes of a scene.
struct ArrowRows(Vec<Vec<Arrow>>);

impl ArrowRows {
    /// Of a field on each plane of planning.
    fn of(scene: &PictureScene<'_>, field: impl Fn(&Point3<f64>) -> Option<Vector3<f64>>) -> Self {
        Self(scene.planning.iter().map(|plane| arrows(scene, plane, &field)).collect())
    }

    /// By which these arrows are legible.
    fn scale(&self, scene: &PictureScene<'_>) -> ArrowScale {
        let top = ceil_nice(high_percentile(self.0.iter().flatten().map(|(_, u)| u.norm()), 99.0));
        let rows = self.0.iter().zip(&scene.planning);
        let in_plane = rows.flat_map(|(list, plane)| list.iter().map(move |(_, u)| in_plane(plane, u)));
        ArrowScale { top, zoom: zoom(high_percentile(in_plane, 95.0) * scene.planning[0].scale) }
    }

    /// A plane a row, with its legend.
    fn sheet(&self, scene: &PictureScene<'_>, ArrowScale { top, zoom }: ArrowScale) -> Canvas {
        let scale = scene.planning[0].scale;
        let planes = scene.planning.iter().zip(&scene.planning_hu).zip(&self.0);
        let rows: Vec<Canvas> = planes
            .map(|((plane, hu), list)| {
                let mut panel = plane.paint(|_, n| grey(0.75 * stepped(tone(f64::from(hu[n])))));
                for (foot, u) in list {
                    let [dx, dy] = plane.vector(&(u * zoom));
                    let colour = magnitude(u.norm() / top);
                    let tip = [foot[0] + dx, foot[1] + dy];
                    panel.line(*foot, tip, 5.5, mix(colour, [0; 3], 0.85));
                    panel.arrow(*foot, tip, 3.2, colour);
                }
                plane.row(&panel, [0; 3], [255; 3], [0; 3])
            })
            .collect();
        let key_mm = floor_nice(110.0 / (scale * zoom));
        sheet(&rows, 1, |legend| {
            let ticks: Vec<_> = (0..=4).map(|i| (f64::from(i) / 4.0, short(top * f64::from(i) / 4.0))).collect();
            legend.bar("mm", 420.0, magnitude, &ticks);
            let long = key_mm * scale * zoom;
            legend.canvas.arrow([legend.x, legend.y], [legend.x + long, legend.y], 3.2, [31, 41, 55]);
            legend.x += long + 14.0;
            let size = if (zoom - 1.0).abs() < 1e-9 { String::new() } else { format!(", drawn x {zoom}") };
            legend.text(&format!("{key_mm} mm{size}"));
        })
    }
}

/// Arrows of `field` on a regular raster, in tissue only.
fn arrows(scene: &PictureScene<'_>, plane: &Plane, field: impl Fn(&Point3<f64>) -> Option<Vector3<f64>>) -> Vec<Arrow> {
    let mut out = Vec::new();
    for y in (SPACING / 2..plane.height).step_by(SPACING) {
        for x in (SPACING / 2..plane.width).step_by(SPACING) {
            let foot = [x as f64, y as f64];
            let p: Point3<f64> = plane.world(foot[0], foot[1]);
            let tissue = hu_at(&scene.case.planning.ct, &p).is_some_and(|hu| hu > f64::from(TISSUE_HU));
            if tissue && nearest(&scene.outcome.body, &p) == Some(true) {
                out.extend(field(&p).map(|u| (foot, u)));
            }
        }
    }
    out
}

/// Length of the in-plane part, mm.
fn in_plane(plane: &Plane, u: &Vector3<f64>) -> f64 {
    let [x, y] = plane.vector(u);
    x.hypot(y) / plane.scale
}

/// Factor that gives arrows of `pixels` a length that neither hides the picture nor vanishes.
fn zoom(pixels: f64) -> f64 {
    let limit = REACH * SPACING as f64 / pixels.max(1e-6);
    [5.0, 2.0, 1.0, 0.5, 0.2].into_iter().find(|z| *z <= limit).unwrap_or(0.1)
}

fn high_percentile(values: impl Iterator<Item = f64>, p: f64) -> f64 {
    let mut values: Vec<f64> = values.collect();
    values.sort_by(f64::total_cmp);
    percentile(&values, p)
}

/// The least number that reaches `value` and has short quarters.
pub(in crate::report) fn ceil_nice(value: f64) -> f64 {
    let power = 10f64.powf(value.max(0.1).log10().floor());
    [1.0, 1.2, 1.6, 2.0, 2.4, 3.2, 4.0, 6.0, 8.0, 10.0]
        .into_iter()
        .map(|m| m * power)
        .find(|v| *v >= value)
        .unwrap_or(10.0 * power)
}

/// A number without trailing zeros.
pub(in crate::report) fn short(value: f64) -> String {
    format!("{}", (value * 1e4).round() / 1e4)
}

/// The greatest of 1, 2, 5 (times a power of ten) up to `value`.
fn floor_nice(value: f64) -> f64 {
    let power = 10f64.powf(value.max(1e-3).log10().floor());
    [5.0, 2.0, 1.0].into_iter().map(|m| m * power).find(|v| *v <= value).unwrap_or(power)
}

#[cfg(test)]
mod tests {
    use super::super::super::example;
    use super::*;

    #[test]
    fn arrows_stand_in_tissue_and_carry_the_field() {
        let (case, mut outcome, _) = example::small();
        outcome.push.displacement = outcome.push.displacement.map(|_| [3.0, 4.0, 12.0]);
        let scene = PictureScene::new(&case, &outcome);
        let axial = &scene.planning[0];
        let field = &scene.outcome.push.displacement;
        let arrows = arrows(&scene, axial, |p| trilinear_vector(field, &field.grid().index(p)));
        assert!(arrows.len() > 50);
        for (foot, u) in &arrows {
            assert!((u.norm() - 13.0).abs() < 1e-6 && (in_plane(axial, u) - 5.0).abs() < 1e-6);
            let p = axial.world(foot[0], foot[1]);
            assert!((p.x / 93.0).powi(2) + (p.y / 83.0).powi(2) < 1.0 || p.x.abs() < 20.0, "outside the head: {p}");
        }
    }

    #[test]
    fn nice_numbers() {
        let close = |a: f64, b: f64| assert!((a - b).abs() < 1e-9, "{a} {b}");
        close(ceil_nice(23.0), 24.0);
        close(ceil_nice(7.9), 8.0);
        close(ceil_nice(0.0), 0.1);
        close(floor_nice(23.0), 20.0);
        close(floor_nice(0.7), 0.5);
        close(zoom(67.0), 1.0);
        close(zoom(68.0), 0.5);
        close(zoom(0.0), 5.0);
        assert_eq!([short(0.1 * 3.0), short(6.0)], ["0.3", "6"]);
    }
}
