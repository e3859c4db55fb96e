//! Landmarks drawn on the fusion after registration: where they are and where the field takes them.

use super::super::canvas::{Align, Canvas, Pen, Rgb, text_width};
use super::super::plane::{KINDS, Plane};
use super::fusion::{colours, fused};
use super::legend::sheet;
use super::{PictureScene, Plate, bones};
use crate::evaluate::landmark::{LandmarkReport, LandmarkResidual};
use nalgebra::Point3;

/// Landmarks up to this far from a plane are drawn on it, mm.
const SLAB_MM: f64 = 6.0;
const TRUE: Rgb = [60, 255, 80];
const MAPPED: Rgb = [255, 60, 200];

/// Planes that pass the most landmarks, with true and mapped positions.
pub(super) fn draw(scene: &PictureScene<'_>, report: &LandmarkReport) -> Plate {
    let known: Vec<(usize, &LandmarkResidual)> =
        report.each.iter().enumerate().filter(|(_, r)| r.mapped.is_some()).collect();
    let through = densest(&known);
    let rows = scene.fraction_through(&through).map(|plane| {
        let [planning, mut fraction] =
            [&scene.outcome.planning_on_fraction, &scene.case.fraction.ct].map(|ct| plane.hu(ct));
        scene.on_plannings_scale(&mut fraction);
        let mut panel = fused(scene.overlay(), &plane, &planning, &fraction);
        bones::outlines(scene, &plane, &mut panel);
        let shown: Vec<_> = known.iter().filter(|(_, r)| distance(&plane, &r.landmark.fraction) <= SLAB_MM).collect();
        let mut taken = Vec::new();
        for (_, residual) in &shown {
            taken.extend(mark(&mut panel, &plane, residual));
        }
        for (number, residual) in &shown {
            label(&mut panel, &(number + 1).to_string(), plane.place(&residual.landmark.fraction), &mut taken);
        }
        plane.row(&panel, [0; 3], [255; 3], [0; 3])
    });
    let canvas = sheet(&rows, 2, |legend| {
        colours(scene.overlay(), legend);
        bones::legend(legend);
        legend.next_line();
        let y = legend.y;
        let mut entry = |draw: fn(&mut Canvas, [f64; 2]), text: &str| {
            draw(legend.canvas, [legend.x + 14.0, y]);
            legend.x += 36.0;
            legend.text(text);
        };
        entry(true_mark, "position in the fraction");
        entry(mapped_mark, "planning position moved by the field");
    });
    Plate {
        file: "landmarks.png",
        title: "Landmarks",
        caption: format!(
            "Landmarks within {SLAB_MM} mm of the planes that pass most of them, on the fusion after registration; numbers as in \
             the table. The line between both marks is the in-plane residual."
        ),
        canvas,
    }
}

/// The point whose axial, coronal and sagittal planes each have the most landmarks within the slab.
fn densest(known: &[(usize, &LandmarkResidual)]) -> Point3<f64> {
    let mut through = Point3::origin();
    for kind in KINDS {
        let a = kind.across();
        let at = |r: &LandmarkResidual| r.landmark.fraction[a];
        let near = |c: f64| known.iter().filter(|(_, r)| (at(r) - c).abs() <= SLAB_MM).count();
        // Of equal counts the first: a fixed choice.
        through[a] = known
            .iter()
            .map(|(_, r)| at(r))
            .fold((0.0, 0), |best, c| if near(c) > best.1 { (c, near(c)) } else { best })
            .0;
    }
    through
}

fn distance(plane: &Plane, p: &Point3<f64>) -> f64 {
    (p[plane.kind.across()] - plane.at()).abs()
}

/// Draws both positions of a landmark and the line between them; where they are.
fn mark(panel: &mut Canvas, plane: &Plane, residual: &LandmarkResidual) -> Vec<[f64; 2]> {
    let Some(mapped) = residual.mapped else { return Vec::new() };
    let (to, from) = (plane.place(&residual.landmark.fraction), plane.place(&mapped));
    panel.line(from, to, 5.0, [0; 3]);
    panel.line(from, to, 2.5, [255, 240, 80]);
    true_mark(panel, to);
    mapped_mark(panel, from);
    vec![to, from]
}

/// Writes a number beside its mark, on the side that is farthest from everything drawn so far.
fn label(panel: &mut Canvas, number: &str, mark: [f64; 2], taken: &mut Vec<[f64; 2]>) {
    const SIZE: f64 = 26.0;
    let aside = 17.0 + text_width(number, SIZE) / 2.0;
    let sides = [[aside, -16.0], [aside, 16.0], [-aside, -16.0], [-aside, 16.0], [0.0, -26.0], [0.0, 26.0]];
    let room =
        |at: [f64; 2]| taken.iter().map(|t| (t[0] - at[0]).hypot(t[1] - at[1])).fold(f64::INFINITY, f64::min).min(40.0);
    let mut best = (f64::NEG_INFINITY, mark);
    for [dx, dy] in sides {
        let at = [mark[0] + dx, mark[1] + dy];
        // Earlier sides win unless a later one has clearly more room.
        if room(at) > best.0 + 3.0 {
            best = (room(at), at);
        }
    }
    panel.text(number, best.1, Pen { size: SIZE, colour: [255; 3], halo: Some([0; 3]), align: Align::Centre });
    taken.push(best.1);
}

fn true_mark(canvas: &mut Canvas, at: [f64; 2]) {
    canvas.ring(at, 9.0, 5.0, [0; 3]);
    canvas.ring(at, 9.0, 2.5, TRUE);
}

fn mapped_mark(canvas: &mut Canvas, at: [f64; 2]) {
    for (width, colour) in [(6.0, [0; 3]), (3.0, MAPPED)] {
        canvas.line([at[0] - 7.0, at[1] - 7.0], [at[0] + 7.0, at[1] + 7.0], width, colour);
        canvas.line([at[0] - 7.0, at[1] + 7.0], [at[0] + 7.0, at[1] - 7.0], width, colour);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn labels_keep_clear_of_marks() {
        let mut panel = Canvas::new(200, 100, [0; 3]);
        // Two marks side by side: the left one's number goes to the left.
        let mut taken = vec![[100.0, 50.0], [125.0, 45.0], [125.0, 62.0]];
        label(&mut panel, "7", [100.0, 50.0], &mut taken);
        assert!(taken[3][0] < 100.0, "{taken:?}");
    }
}
