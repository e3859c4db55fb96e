//! Map of uncertainty over a faint planning CT.

use super::super::canvas::{Rgb, mix};
use super::super::colour::{grey, heat, tone};
use super::super::plane::{nearest, nearest_held};
use super::displacement::short;
use super::legend::sheet;
use super::{PictureScene, Plate};
use crate::volume::Spans;
use nalgebra::Point3;
use rayon::prelude::*;

/// Air and everything outside the patient.
const BACKDROP: Rgb = [198, 203, 210];
/// Brightness of soft tissue, for the legend.
const LEGEND_TONE: f64 = 0.4;
/// Patient of whom nothing is known: hatched in two colours, of which neither the scale nor a CT has the green.
const NOT_KNOWN: [Rgb; 2] = [[255, 255, 255], [0, 140, 60]];
/// Width of a stripe of it, mm.
const STRIPE_MM: f64 = 4.0;
/// Upper end of the scale, mm: twice the looser of the limits that are marked. One scale for all runs, so that one map can be
/// set beside another, and a far-off corner does not darken the rest.
const TOP_MM: f64 = 6.0;
/// Marks on it, mm: TG-132's 2 to 3.
const MARKS_MM: [f64; 4] = [0.0, 2.0, 3.0, TOP_MM];
/// How much of a colour lies over the CT, where the map is 0 and from the looser limit on.
const COVER: [f64; 2] = [0.15, 0.8];

/// Upper end of the scale for the map, and its greatest value, mm.
pub(in crate::report) fn scale(map: &Spans<f32>) -> [f64; 2] {
    let greatest = map.held().par_iter().copied().reduce(|| 0.0, f32::max);
    [TOP_MM, f64::from(greatest)]
}

/// Colour of a value over tissue of a brightness: what is sure looks like the CT.
fn over(mm: f64, tone: f64) -> Rgb {
    let cover = COVER[0] + (COVER[1] - COVER[0]) * (mm / MARKS_MM[2]).clamp(0.0, 1.0);
    mix(grey(0.25 + 0.75 * tone), heat(mm / TOP_MM), cover)
}

/// Which of two stripes a place lies in, by its distance across them in widths of one: in every plane they run aslant.
fn stripe(across: f64) -> usize {
    usize::from(across.rem_euclid(2.0) >= 1.0)
}

/// The map in the planes of the planning CT.
pub(super) fn draw(scene: &PictureScene<'_>, map: &Spans<f32>) -> Plate {
    let [_, greatest] = scale(map);
    let colour = |p: Point3<f64>, hu: f32| {
        if !nearest(&scene.outcome.body, &p).unwrap_or(false) {
            return BACKDROP;
        }
        match nearest_held(map, &p) {
            Some(mm) if mm >= 0.0 => over(f64::from(mm), tone(f64::from(hu))),
            _ => NOT_KNOWN[stripe((p.x + p.y + p.z) / STRIPE_MM)],
        }
    };
    let rows = scene.planning_rows(colour, BACKDROP);
    let ticks: Vec<_> = MARKS_MM.iter().map(|mm| (mm / TOP_MM, short(*mm))).collect();
    let canvas = sheet(&rows, 1, |legend| {
        legend.bar("mm", 330.0, |share| over(share * TOP_MM, LEGEND_TONE), &ticks);
        legend.hatched(NOT_KNOWN, "unknown, > 30 mm");
        legend.text(&format!("greatest known {greatest:.1} mm"));
    });
    Plate {
        file: "uncertainty.png",
        title: "Uncertainty",
        caption: "Estimated error, mm, on the planning CT: on posed CTs two thirds of errors were smaller. TG-132's 2 and 3 mm are marked; the scale ends at 6. From the disagreement between \
                  bones alone and bones with images, and from what of the images still differs; where images say nothing, from \
                  the distance to the nearest bone. Green and white stripes: unknown, above 30 mm."
            .to_owned(),
        canvas,
    }
}

#[cfg(test)]
mod tests {
    use super::super::super::example;
    use super::*;
    use crate::volume::Volume;

    #[test]
    fn the_scale_is_one_for_all_runs_and_the_greatest_is_told() {
        let grid = crate::geometry::Grid::axis_aligned([100, 10, 10], [1.0; 3], [0.0; 3]).unwrap();
        let map = Volume::from_fn(grid, |l| match l % 1000 {
            0 => 25.0,
            n if n < 500 => -1.0,
            _ => 0.7,
        });
        let [top, greatest] = scale(&Spans::of_volume(&map));
        assert!((top - 6.0).abs() < 1e-6 && (greatest - 25.0).abs() < 1e-9, "{top} {greatest}");
    }

    #[test]
    fn what_is_sure_looks_like_the_ct_and_what_is_not_is_coloured() {
        let (case, outcome, _) = example::small();
        let grid = outcome.jacobian.grid().clone();
        let map = Volume::from_fn(grid.clone(), |l| if grid.centre(grid.voxel(l)).x > 0.0 { 2.8 } else { 0.2 });
        let scene = PictureScene::new(&case, &outcome);
        let plate = draw(&scene, &Spans::of_volume(&map));
        let axial = &scene.planning[0];
        let left = (super::super::super::plane::WIDTH - axial.width) / 2;
        let pixel = |x: f64| {
            let [u, v] = axial.place(&Point3::new(x, -40.0, axial.at()));
            plate.canvas.pixel(u as usize + left, v as usize)
        };
        let tint = |x: f64| {
            let pixel = pixel(x).map(i32::from);
            pixel.iter().max().unwrap() - pixel.iter().min().unwrap()
        };
        // What is not known looks like nothing on the scale, nor like a CT, whatever its brightness.
        let apart = |a: Rgb, b: Rgb| a.iter().zip(b).map(|(a, b)| a.abs_diff(b)).max().unwrap();
        for step in 0..=100 {
            let of_scale = over(TOP_MM * f64::from(step) / 100.0, LEGEND_TONE);
            assert!(NOT_KNOWN.iter().all(|colour| apart(*colour, of_scale) > 60), "{of_scale:?}");
            assert!(apart(NOT_KNOWN[1], grey(f64::from(step) / 100.0)) > 60);
        }
        assert_eq!([0.5, 1.5, 2.5, -0.5].map(stripe), [0, 1, 0, 1]);
        let (width, height) = (plate.canvas.width(), plate.canvas.height());
        let far = Volume::filled(grid, 29.9);
        let legend = draw(&scene, &Spans::of_volume(&far)).canvas;
        let edge = (height - 40..height - 10).flat_map(|y| (width - 12..width).map(move |x| (x, y)));
        assert!(edge.into_iter().all(|(x, y)| legend.pixel(x, y) == [255; 3]), "the legend ends before the picture");
        assert!(tint(40.0) > 80 && tint(-40.0) < 40, "{:?} {:?}", pixel(40.0), pixel(-40.0));
        assert_eq!(pixel(110.0), BACKDROP);
    }
}
