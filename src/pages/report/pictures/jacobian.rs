//! Jacobian map over a faint planning CT: red growth, blue shrinkage, white no change, black folded.

use super::super::canvas::Rgb;
use super::super::colour::{BLACK, jacobian, shaded, tone};
use super::super::plane::{cell_at, nearest};
use super::legend::sheet;
use super::{PictureScene, Plate};
use crate::evaluate::jacobian::TISSUE_HU;
use nalgebra::Point3;

/// Air and everything outside the patient: darker than white, which means no change.
const BACKDROP: Rgb = [198, 203, 210];
/// Brightness of the darkest tissue: the CT shows through, and no change still looks white.
const SHADE: f64 = 0.86;

/// The Jacobian map in the planes of the planning CT.
pub(super) fn draw(scene: &PictureScene<'_>) -> Plate {
    let outcome = scene.outcome;
    let colour = |p: Point3<f64>, hu: f32| {
        if !nearest(&outcome.body, &p).unwrap_or(false) {
            return BACKDROP;
        }
        match cell_at(&outcome.jacobian, &p) {
            Some(value) if hu > TISSUE_HU => {
                let shade = SHADE + (1.0 - SHADE) * tone(f64::from(hu));
                shaded(jacobian(f64::from(value)), shade)
            }
            _ => BACKDROP,
        }
    };
    let rows = scene.planning_rows(colour, BACKDROP);
    let ticks: Vec<_> =
        ["1/2", "0.7", "1", "1.4", "2"].iter().enumerate().map(|(i, t)| (i as f64 / 4.0, (*t).to_owned())).collect();
    let canvas = sheet(&rows, 1, |legend| {
        legend.bar("shrinks", 420.0, |share| jacobian((2.0 * share - 1.0).exp2()), &ticks);
        legend.text("grows");
        legend.swatch(BLACK, "folded");
    });
    Plate {
        file: "jacobian.png",
        title: "Jacobian map",
        caption:
            "Volume of each cell after over before deformation, on the planning CT: red grows, blue shrinks, white \
                  keeps its volume, black is folded. Logarithmic scale; tissue above -500 HU inside the body."
                .to_owned(),
        canvas,
    }
}

#[cfg(test)]
mod tests {
    use super::super::super::example;
    use super::*;
    use crate::volume::{Spans, Volume};

    #[test]
    fn folded_cells_are_black_and_growth_is_red() {
        let (case, mut outcome, _) = example::small();
        let grid = outcome.jacobian.grid().clone();
        // Left half grows, right half shrinks, one slab is folded.
        outcome.jacobian = Spans::of_volume(&Volume::from_fn(grid.clone(), |l| match grid.centre(grid.voxel(l)) {
            p if p.z > 30.0 => -1.0,
            p if p.x > 0.0 => 1.8,
            _ => 0.6,
        }));
        let scene = PictureScene::new(&case, &outcome);
        let picture = draw(&scene).canvas;
        // The coronal row lies below the axial one.
        let coronal = &scene.planning[1];
        let pixel = |x: f64, z: f64| {
            let [u, v] = coronal.place(&Point3::new(x, coronal.at(), z));
            let left = (picture_width() - coronal.width) / 2;
            picture.pixel(u as usize + left, v as usize + scene.planning[0].height + 6)
        };
        assert_eq!(pixel(40.0, 50.0), BLACK);
        let ([r, _, b], [r2, _, b2]) = (pixel(50.0, -10.0), pixel(-50.0, -10.0));
        assert!(r > b + 60 && b2 > r2 + 60, "{r} {b} {r2} {b2}");
        assert_eq!(pixel(110.0, 0.0), BACKDROP);
    }

    fn picture_width() -> usize {
        super::super::super::plane::WIDTH
    }
}
