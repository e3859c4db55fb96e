//! Outlines of bones on a plane.

use super::super::canvas::{Canvas, Rgb};
use super::super::plane::Plane;
use super::PictureScene;
use super::legend::Legend;
use crate::geometry::Grid;
use nalgebra::Vector3;

/// Planning's bones where they were.
const BEFORE: Rgb = [255; 3];
/// Planning's bones where the registration takes them.
pub(super) const AFTER: Rgb = [255, 225, 77];
/// Widths of the lines, pixels.
const WIDTHS: [f64; 2] = [1.3, 2.2];
/// Distance of the places whose labels are compared, mm, at least.
const FINEST_MM: f64 = 1.0;

/// Planning's bones before (thin, white) and after the registration (yellow) on a plane of the
/// fraction.
pub(super) fn outlines(scene: &PictureScene<'_>, plane: &Plane, picture: &mut Canvas) {
    outlines_at(scene, plane, &scene.shift_before.unwrap_or_default(), picture);
}

/// The same with planning's bones moved by `shift` before.
pub(super) fn outlines_at(scene: &PictureScene<'_>, plane: &Plane, shift: &Vector3<f64>, picture: &mut Canvas) {
    let (before, after) = (&scene.case.planning.bones.volume, &scene.outcome.bones_on_fraction.volume);
    let [thick, thin] = [(BEFORE, WIDTHS[0]), (AFTER, WIDTHS[1])].map(|(colour, width)| BonePen { colour, width });
    outline(before.grid(), |voxel| *before.at(voxel), plane, shift, picture, thick);
    outline(after.grid(), |voxel| after.at(voxel), plane, &Vector3::zeros(), picture, thin);
}

/// What the lines mean.
pub(super) fn legend(legend: &mut Legend<'_>) {
    legend.swatch(BEFORE, "bones before");
    legend.swatch(AFTER, "bones after");
}

/// How a border is drawn.
#[derive(Clone, Copy)]
struct BonePen {
    colour: Rgb,
    /// Dots.
    width: f64,
}

/// The borders between labels, with corners cut: from the middles between unequal neighbours of a
/// lattice.
fn outline(
    grid: &Grid,
    at: impl Fn([usize; 3]) -> u16,
    plane: &Plane,
    shift: &Vector3<f64>,
    picture: &mut Canvas,
    pen: BonePen,
) {
    let spacing = grid.spacing().into_iter().fold(f64::INFINITY, f64::min).max(FINEST_MM);
    let step = spacing * plane.scale;
    let [wide, high] = [plane.width, plane.height].map(|n| (n as f64 / step) as usize + 1);
    let label = |n: usize| {
        let p = plane.world((n % wide) as f64 * step, (n / wide) as f64 * step) - shift;
        grid.voxel_at(&p).map_or(0, &at)
    };
    let own: Vec<u16> = (0..wide * high).map(label).collect();
    for j in 0..high.saturating_sub(1) {
        for i in 0..wide.saturating_sub(1) {
            let n = i + wide * j;
            let [a, b, c, d] = [own[n], own[n + 1], own[n + wide], own[n + wide + 1]];
            if a == b && b == c && c == d {
                continue;
            }
            let (x, y) = (i as f64, j as f64);
            let sides = [
                (a != b, [x + 0.5, y]),
                (b != d, [x + 1.0, y + 0.5]),
                (c != d, [x + 0.5, y + 1.0]),
                (a != c, [x, y + 0.5]),
            ];
            let cuts: Vec<[f64; 2]> =
                sides.iter().filter(|(cut, _)| *cut).map(|(_, at)| at.map(|v| v * step)).collect();
            match cuts[..] {
                [from, to] => picture.line(from, to, pen.width, pen.colour),
                _ => {
                    let middle = [(x + 0.5) * step, (y + 0.5) * step];
                    cuts.iter().for_each(|cut| picture.line(*cut, middle, pen.width, pen.colour));
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::super::example;
    use super::*;
    use crate::volume::Volume;

    #[test]
    fn bones_are_outlined_where_they_were_and_where_they_are() {
        let (case, outcome, _) = example::small();
        let scene = PictureScene::new(&case, &outcome);
        let plane = &scene.fraction[2];
        let mut picture = Canvas::new(plane.width, plane.height, [0; 3]);
        outlines(&scene, plane, &mut picture);
        // Around each place of a border in the sagittal plane, or not.
        let near = |map: &Volume<u16>, colour: Rgb| {
            let (mut border, mut hit) = (0, 0);
            for y in (12..plane.height - 12).step_by(5) {
                for x in 12..plane.width - 12 {
                    let at = |dx: f64, dy: f64| {
                        let p = plane.world(x as f64 + dx, y as f64 + dy);
                        map.grid().voxel_at(&p).map_or(0, |v| *map.at(v))
                    };
                    if at(-1.0, 0.0) != at(1.0, 0.0) {
                        border += 1;
                        let around = (0..25 * 25).map(|n| picture.pixel(x + n % 25 - 12, y + n / 25 - 12));
                        let close = |p: Rgb| p.iter().zip(colour).all(|(a, b)| a.abs_diff(b) < 60);
                        hit += usize::from(around.into_iter().any(close));
                    }
                }
            }
            (border, hit)
        };
        // Where a bone stays, the line of before lies below that of after.
        for (map, colour, share) in
            [(&outcome.bones_on_fraction.to_map().volume, AFTER, 0.9), (&case.planning.bones.volume, BEFORE, 0.5)]
        {
            let (border, hit) = near(map, colour);
            assert!(border > 50 && hit as f64 >= share * border as f64, "{border} {hit}");
        }
        // Away from bone nothing is drawn.
        let [x, y] = plane.place(&nalgebra::Point3::new(0.0, -60.0, 0.0));
        assert_eq!(picture.pixel(x as usize, y as usize), [0; 3]);
    }
}
