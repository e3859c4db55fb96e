//! Map of uncertainty over a faint planning CT.

use super::super::canvas::Rgb;
use super::super::colour::{heat, shaded, tone};
use super::super::plane::nearest;
use super::displacement::{ceil_nice, short};
use super::legend::sheet;
use super::{PictureScene, Plate};
use crate::stats::percentile;
use crate::volume::Volume;
use nalgebra::Point3;
use rayon::prelude::*;

/// Air and everything outside the patient.
const BACKDROP: Rgb = [198, 203, 210];
/// Patient of whom nothing is known.
const NOT_KNOWN: Rgb = [120, 120, 128];
/// Brightness of the darkest tissue: the CT shows through.
const SHADE: f64 = 0.5;
/// Share of what is known that the scale spans, percent.
const SPANNED: f64 = 99.0;
/// Values that tell that share, about.
const ENOUGH: usize = 200_000;

/// Upper end of a scale for the map, mm, which few values exceed, and the greatest value.
pub(in crate::report) fn scale(map: &Volume<f32>) -> [f64; 2] {
    let greatest = map.data().par_iter().copied().reduce(|| 0.0, f32::max);
    let every = map.data().len().div_ceil(ENOUGH);
    let mut known: Vec<f64> =
        map.data().iter().step_by(every).filter(|mm| **mm >= 0.0).map(|mm| f64::from(*mm)).collect();
    known.sort_by(f64::total_cmp);
    [ceil_nice(percentile(&known, SPANNED)), f64::from(greatest)]
}

/// The map in the planes of the planning CT.
pub(super) fn draw(scene: &PictureScene<'_>, map: &Volume<f32>) -> Plate {
    let [top, greatest] = scale(map);
    let colour = |p: Point3<f64>, hu: f32| {
        if !nearest(&scene.outcome.body, &p).unwrap_or(false) {
            return BACKDROP;
        }
        let shade = SHADE + (1.0 - SHADE) * tone(f64::from(hu));
        match nearest(map, &p) {
            Some(mm) if mm >= 0.0 => shaded(heat(f64::from(mm) / top), shade),
            _ => shaded(NOT_KNOWN, shade),
        }
    };
    let rows = scene.planning_rows(colour, BACKDROP);
    let ticks: Vec<_> = (0..=4).map(|n| (f64::from(n) / 4.0, short(top * f64::from(n) / 4.0))).collect();
    let canvas = sheet(&rows, 1, |legend| {
        legend.bar("mm", 420.0, heat, &ticks);
        legend.text(&format!("greatest {greatest:.1} mm"));
    });
    Plate {
        file: "uncertainty.png",
        title: "Uncertainty",
        caption: "How far the result may be trusted: one standard deviation, mm, on the planning CT; the scale ends at the 99th percentile. From the disagreement between \
                  bones alone and bones with images, and from what of the images still differs; where images say nothing, from \
                  the distance to the nearest bone. Grey: not known."
            .to_owned(),
        canvas,
    }
}

#[cfg(test)]
mod tests {
    use super::super::super::example;
    use super::*;

    #[test]
    fn the_scale_leaves_out_what_is_not_known_and_the_rare() {
        let grid = crate::geometry::Grid::axis_aligned([100, 10, 10], [1.0; 3], [0.0; 3]).unwrap();
        let map = Volume::from_fn(grid, |l| match l % 1000 {
            0 => 25.0,
            n if n < 500 => -1.0,
            _ => 0.7,
        });
        let [top, greatest] = scale(&map);
        assert!((top - 0.8).abs() < 1e-6 && (greatest - 25.0).abs() < 1e-9, "{top} {greatest}");
    }

    #[test]
    fn the_uncertain_side_is_brighter() {
        let (case, outcome, _) = example::small();
        let grid = outcome.jacobian.grid().clone();
        let map = Volume::from_fn(grid.clone(), |l| if grid.centre(grid.voxel(l)).x > 0.0 { 2.8 } else { 0.2 });
        let scene = PictureScene::new(&case, &outcome);
        let plate = draw(&scene, &map);
        let axial = &scene.planning[0];
        let left = (super::super::super::plane::WIDTH - axial.width) / 2;
        let pixel = |x: f64| {
            let [u, v] = axial.place(&Point3::new(x, -40.0, axial.at()));
            plate.canvas.pixel(u as usize + left, v as usize).iter().map(|c| u32::from(*c)).sum::<u32>()
        };
        assert!(pixel(40.0) > pixel(-40.0) + 150, "{} {}", pixel(40.0), pixel(-40.0));
        assert_eq!(pixel(110.0), BACKDROP.iter().map(|c| u32::from(*c)).sum::<u32>());
    }
}
