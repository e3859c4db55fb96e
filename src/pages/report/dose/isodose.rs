//! Isodoses over a CT, and what two doses differ by.

use super::super::canvas::{Canvas, Rgb, mix};
use super::super::colour::{INK, grey, tone};
use super::super::pictures::displacement::{ceil_nice, short};
use super::super::pictures::legend::sheet;
use super::super::plane::{Plane, Region, hu_at, nearest, planes};
use super::page::DosePicture;
use crate::error::{Error, Result};
use crate::stats::percentile;
use crate::volume::{Mask, Volume, trilinear};
use nalgebra::Point3;

/// Isodoses, percent of the greatest dose, with their colours.
const LEVELS: [(f64, Rgb); 6] = [
    (95.0, [255, 56, 84]),
    (80.0, [255, 159, 28]),
    (65.0, [250, 233, 92]),
    (50.0, [94, 224, 142]),
    (30.0, [76, 201, 240]),
    (10.0, [120, 130, 255]),
];
/// Distance of the places whose dose is compared with a level, pixels.
const STEP: f64 = 4.0;

/// What isodoses are shares of, and the place that the planes go through.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Levels {
    /// 100 %, Gy.
    pub most: f64,
    /// LPS mm.
    pub through: Point3<f64>,
}

impl Levels {
    /// The greatest value of a dose, and where it is.
    pub fn of(dose: &Volume<f32>) -> Self {
        Self { most: f64::from(dose.extremes()[1].max(0.0)), through: greatest(dose) }
    }
}

/// Isodoses of `dose` in three planes, over `ct` where there is one; `steep` dose is surrounded by a white line.
///
/// # Errors
/// [`Error::Internal`] when the picture cannot be encoded.
pub fn isodoses(
    title: &str,
    dose: &Volume<f32>,
    ct: Option<&Volume<f32>>,
    Levels { most, through }: &Levels,
    steep: Option<&Mask>,
) -> Result<DosePicture> {
    let region = Region::of(ct.map_or(dose.grid(), Volume::grid));
    let rows = planes(&[region; 3], through).map(|plane| {
        let mut picture = backdrop(&plane, ct);
        if let Some(steep) = steep {
            border(&mut picture, &plane, steep, [255; 3]);
        }
        for (percent, colour) in LEVELS {
            lines(&mut picture, &plane, dose, most * percent / 100.0, colour);
        }
        plane.row(&picture, [0; 3], [255; 3], [0; 3])
    });
    let canvas = sheet(&rows, 2 + usize::from(steep.is_some()), |legend| {
        for (n, (percent, colour)) in LEVELS.into_iter().enumerate() {
            if n == LEVELS.len() / 2 {
                legend.next_line();
            }
            legend.swatch(colour, &format!("{} Gy ({percent} %)", short((most * percent).round() / 100.0)));
        }
        if steep.is_some() {
            legend.next_line();
            legend.swatch([255; 3], "border of steep dose: more than 1 % of the greatest per mm");
        }
    });
    let caption = format!(
        "Isodoses in shares of {most:.2} Gy; planes at {:.0}, {:.0}, {:.0} (LPS mm). The greatest dose here is {:.2} Gy.",
        through.x,
        through.y,
        through.z,
        dose.extremes()[1]
    );
    encoded(title, caption, &canvas)
}

/// `difference` (Gy, on the reference's grid) in three planes through the reference's maximum: blue less, red more; the
/// border of `steep` dose as a line.
///
/// # Errors
/// [`Error::Internal`] when the picture cannot be encoded.
pub fn differences(
    difference: &Volume<f32>,
    reference: &Volume<f32>,
    ct: Option<&Volume<f32>>,
    steep: &Mask,
) -> Result<DosePicture> {
    let mut all: Vec<f64> = difference.data().iter().filter(|d| **d != 0.0).map(|d| f64::from(d.abs())).collect();
    all.sort_by(f64::total_cmp);
    let (top, most) = (ceil_nice(percentile(&all, 99.0)), all.last().copied().unwrap_or(0.0));
    let region = Region::of(reference.grid());
    let rows = planes(&[region; 3], &greatest(reference)).map(|plane| {
        let mut picture = plane.paint(|p, _| {
            let shown = ct.and_then(|ct| hu_at(ct, &p)).filter(|hu| *hu > AIR_HU);
            let dim = shown.map_or([235; 3], |hu| grey(0.45 + 0.5 * tone(hu)));
            let share = hu_at(difference, &p).unwrap_or(0.0) / top;
            mix(dim, side(share), share.abs().clamp(0.0, 1.0).sqrt())
        });
        border(&mut picture, &plane, steep, INK);
        plane.row(&picture, [235; 3], INK, [235; 3])
    });
    let ticks: Vec<_> = (-2..=2).map(|n| (f64::from(n + 2) / 4.0, short(top * f64::from(n) / 2.0))).collect();
    let canvas = sheet(&rows, 1, |legend| {
        let colour = |share: f64| mix([235; 3], side(share - 0.5), (2.0 * share - 1.0).abs().sqrt());
        legend.bar("Gy", 420.0, colour, &ticks);
        legend.text(&format!("greatest {most:.2}"));
        legend.swatch(INK, "border of steep dose");
    });
    let caption = "Dose minus reference: blue less, red more; the scale ends at the 99th percentile. Inside the dark lines the reference \
                   changes by more than 1 % of its maximum per mm: there a difference may be a millimetre of the field rather than dose.";
    encoded("Difference", caption.into(), &canvas)
}

/// Less is not shown as grey, HU.
const AIR_HU: f64 = -800.0;

/// Red above 0, blue below.
fn side(value: f64) -> Rgb {
    if value < 0.0 { [8, 62, 140] } else { [150, 8, 34] }
}

fn encoded(title: &str, caption: String, canvas: &Canvas) -> Result<DosePicture> {
    let mut png = Vec::new();
    canvas.write_png(&mut png).map_err(|e| Error::Internal(format!("{title}: {e}")))?;
    Ok(DosePicture { title: title.into(), caption, png })
}

/// Where the dose is greatest.
fn greatest(dose: &Volume<f32>) -> Point3<f64> {
    let most = (0..dose.data().len()).max_by(|&a, &b| dose.data()[a].total_cmp(&dose.data()[b])).unwrap_or(0);
    dose.grid().centre(dose.grid().voxel(most))
}

/// The CT in grey; black without one.
fn backdrop(plane: &Plane, ct: Option<&Volume<f32>>) -> Canvas {
    match ct {
        Some(ct) => {
            let hu = plane.hu(ct);
            plane.paint(|_, n| grey(0.85 * tone(f64::from(hu[n]))))
        }
        None => Canvas::new(plane.width, plane.height, [0; 3]),
    }
}

/// The line where `dose` has this value: between the places of a lattice, linearly.
fn lines(picture: &mut Canvas, plane: &Plane, dose: &Volume<f32>, level: f64, colour: Rgb) {
    let [wide, high] = [plane.width, plane.height].map(|n| (n as f64 / STEP) as usize + 1);
    let value = |n: usize| {
        let p = plane.world((n % wide) as f64 * STEP, (n / wide) as f64 * STEP);
        trilinear(dose, &dose.grid().index(&p)).unwrap_or(0.0) - level
    };
    let own: Vec<f64> = (0..wide * high).map(value).collect();
    for j in 0..high.saturating_sub(1) {
        for i in 0..wide.saturating_sub(1) {
            let n = i + wide * j;
            let corners = [(n, [0.0, 0.0]), (n + 1, [1.0, 0.0]), (n + wide + 1, [1.0, 1.0]), (n + wide, [0.0, 1.0])];
            let cuts: Vec<[f64; 2]> = (0..4)
                .filter_map(|side| {
                    let ((a, p), (b, q)) = (corners[side], corners[(side + 1) % 4]);
                    let (u, v) = (own[a], own[b]);
                    ((u < 0.0) != (v < 0.0)).then(|| {
                        let t = u / (u - v);
                        let at = |axis: usize, base: usize| (base as f64 + p[axis] + t * (q[axis] - p[axis])) * STEP;
                        [at(0, i), at(1, j)]
                    })
                })
                .collect();
            cuts.chunks_exact(2).for_each(|ends| picture.line(ends[0], ends[1], 2.6, colour));
        }
    }
}

/// Draws the border of a mask.
fn border(picture: &mut Canvas, plane: &Plane, mask: &Mask, colour: Rgb) {
    plane.borders(picture, &plane.each(|p| nearest(mask, p) == Some(true)), colour, [0.9, 0.6]);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Grid;

    #[test]
    fn an_isodose_lies_where_the_dose_has_its_value() {
        let grid = Grid::axis_aligned([41, 41, 11], [2.0; 3], [-40.0, -40.0, -10.0]).unwrap();
        // 60 Gy in the middle, 1 Gy less per mm.
        let dose = Volume::from_fn(grid.clone(), |l| (60.0 - grid.centre(grid.voxel(l)).coords.norm()).max(0.0) as f32);
        let [axial, ..] = planes(&[Region::of(&grid); 3], &greatest(&dose));
        let mut picture = Canvas::new(axial.width, axial.height, [0; 3]);
        lines(&mut picture, &axial, &dose, 40.0, [255; 3]);
        let bright = |x: f64, y: f64| {
            let [u, v] = axial.place(&Point3::new(x, y, 0.0));
            picture.pixel(u as usize, v as usize)[0] > 128
        };
        for turn in 0..12 {
            let (sin, cos) = (f64::from(turn) * 0.5).sin_cos();
            assert!(bright(20.0 * cos, 20.0 * sin), "{turn}");
            assert!(!bright(17.0 * cos, 17.0 * sin) && !bright(23.0 * cos, 23.0 * sin), "{turn}");
        }
        let shown = isodoses("isodoses", &dose, None, &Levels::of(&dose), None).unwrap();
        assert!(
            shown.png.len() > 1000 && shown.caption.contains("60.00 Gy") && shown.caption.contains("at 0, 0, 0"),
            "{}",
            shown.caption
        );
    }
}
