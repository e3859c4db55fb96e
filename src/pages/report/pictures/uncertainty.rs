//! Map of uncertainty over a faint planning CT.

use super::super::canvas::Rgb;
use super::super::colour::{heat, shaded, tone};
use super::super::plane::nearest;
use super::legend::sheet;
use super::{Plate, Scene};
use crate::volume::Volume;
use nalgebra::Point3;

/// Air and everything outside the patient.
const BACKDROP: Rgb = [198, 203, 210];
/// Patient of whom nothing is known.
const NOT_KNOWN: Rgb = [120, 120, 128];
/// Brightness of the darkest tissue.
const SHADE: f64 = 0.8;
/// Upper end of the scale, mm: TG-132 asks for 2 to 3.
const TOP_MM: f64 = 3.0;

/// The map in the planes of the planning CT.
pub(super) fn draw(scene: &Scene<'_>, map: &Volume<f32>) -> Plate {
    let colour = |p: Point3<f64>, hu: f32| {
        if !nearest(&scene.outcome.body, &p).unwrap_or(false) {
            return BACKDROP;
        }
        let shade = SHADE + (1.0 - SHADE) * tone(f64::from(hu));
        match nearest(map, &p) {
            Some(mm) if mm >= 0.0 => shaded(heat(f64::from(mm) / TOP_MM), shade),
            _ => shaded(NOT_KNOWN, shade),
        }
    };
    let rows = scene.planning_rows(colour, BACKDROP);
    let ticks: Vec<_> = (0..=3).map(|mm| (f64::from(mm) / TOP_MM, mm.to_string())).collect();
    let canvas = sheet(&rows, 1, |legend| legend.bar("mm", 420.0, heat, &ticks));
    Plate {
        file: "uncertainty.png",
        title: "Uncertainty",
        caption: "How far the result may be trusted: one standard deviation, mm, on the planning CT. From the disagreement between \
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
    fn the_uncertain_side_is_brighter() {
        let (case, outcome, _) = example::small();
        let grid = outcome.jacobian.grid().clone();
        let map = Volume::from_fn(grid.clone(), |l| if grid.centre(grid.voxel(l)).x > 0.0 { 2.8 } else { 0.2 });
        let scene = Scene::new(&case, &outcome);
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
