//! Pictures of an evaluated field: fusion, Jacobian map, mapped contours, residuals, Jacobian-volume histogram.

use super::super::canvas::{Canvas, Rgb, mix};
use super::super::chart::{COLOURS, Curve, chart};
use super::super::colour::{BLACK, BLUE, INK, ORANGE, fuse, grey, jacobian, shaded, tone};
use super::super::pictures::{LEAST_SHIFT_MM, in_the_patient, legend::sheet, residuals};
use super::super::plane::{Plane, Region, cell_at, hu_at, nearest, planes};
use super::{Assessed, Drawable, EvaluationPicture};
use crate::error::{Error, Result};
use crate::evaluate::Maps;
use crate::evaluate::jacobian::TISSUE_HU;
use crate::evaluate::regularity::BIN;
use crate::volume::{Volume, trilinear_vector};
use nalgebra::Point3;

/// The picture that all fields share.
pub(super) const BEFORE: &str = "1_before.png";
pub(super) const BACKDROP: Rgb = [198, 203, 210];

/// Encodes a canvas.
pub(super) fn encoded(
    which: usize,
    file: &str,
    title: String,
    caption: String,
    canvas: &Canvas,
) -> Result<EvaluationPicture> {
    let mut png = Vec::new();
    canvas.write_png(&mut png).map_err(|e| Error::Internal(format!("{file}: {e}")))?;
    Ok(EvaluationPicture { file: format!("{}_{file}.png", which + 1), title, caption, png })
}

/// All pictures that the inputs of a field allow.
pub(super) fn draw(which: usize, field: &Assessed, drawable: &Drawable<'_>) -> Result<Vec<EvaluationPicture>> {
    let mut all = Vec::new();
    let s = &drawable.subject;
    let name = &field.name;
    if let (Some(planning), Some(fraction)) = (s.planning, s.fraction) {
        all.extend(fusions(which, field, Scans { planning, fraction }, &s.pair.pull.displacement)?);
    }
    if let Some(planning) = s.planning {
        let canvas = jacobians(planning, &drawable.maps);
        let caption = "Volume after over before of planning to fraction, on the planning CT: red grows, blue shrinks, white keeps \
                       its volume, black is folded. Outlines of bones where they were given.";
        let canvas = match s.bones {
            Some(bones) => outlined(canvas, &bones.volume),
            None => canvas,
        };
        all.push(encoded(which, "jacobian", format!("{name}: Jacobian map"), caption.into(), &sheet_of(canvas))?);
    }
    if let (Some(fraction), Some(mapped), Some(reference)) =
        (s.fraction, &drawable.maps.structures, s.structures_fraction)
    {
        let canvas = contours(fraction, &mapped.volume, &reference.volume);
        let caption = "Outlines on the fraction: mapped from planning blue, drawn on the fraction orange.";
        all.push(encoded(which, "contours", format!("{name}: contours"), caption.into(), &canvas)?);
    }
    if let Some(landmarks) = field.assessment.landmarks.as_ref().filter(|l| l.after.n > 0) {
        let caption = "Number of landmarks by their distance from the true position in the fraction.";
        let title = format!("{name}: landmark residuals");
        all.push(encoded(which, "residuals", title, caption.into(), &residuals::draw(landmarks).canvas)?);
    }
    if let Some((direction, r)) = field.assessment.regularity.first() {
        let curves: Vec<Curve> = r
            .histograms
            .iter()
            .take(COLOURS.len())
            .enumerate()
            .map(|(n, h)| Curve {
                name: h.name.clone(),
                colour: COLOURS[n],
                width: if n == 0 { 5.0 } else { 3.0 },
                points: h.cumulative().iter().enumerate().map(|(b, share)| [b as f64 * BIN, 100.0 * share]).collect(),
            })
            .collect();
        let canvas = chart("Jacobian", [0.0, 2.5], &curves);
        let caption = format!(
            "Share of the volume whose Jacobian ({}) is at least this, as a dose-volume histogram.",
            direction.name()
        );
        all.push(encoded(which, "jacobian_volume", format!("{name}: Jacobian-volume histogram"), caption, &canvas)?);
    }
    Ok(all)
}

/// Distance of the points that stand for the patient, mm.
const POINTS_MM: f64 = 4.0;
/// Rim around them, mm.
const RIM_MM: f64 = 10.0;

/// Denser than soft tissue and couches, HU.
const BONE_HU: f32 = 200.0;
/// Fewer points of bone have no middle.
const LEAST_BONE: usize = 50;

/// The three planes through the middle of the bones in a CT (of its tissue where it shows none), moved to where they show
/// enough of the patient. They depend on the CT alone, so that those of several fields are the same.
pub(super) fn middle_planes(ct: &Volume<f32>) -> [Plane; 3] {
    let (grid, scan) = (ct.grid(), Region::of(ct.grid()));
    let every = grid.spacing().map(|s| ((POINTS_MM / s).round() as usize).max(1));
    let along = |a: usize| (0..grid.size()[a]).step_by(every[a]);
    let above = |least: f32| -> Vec<Point3<f64>> {
        let rows = along(2).flat_map(|k| along(1).map(move |j| (j, k)));
        let voxels = rows.flat_map(|(j, k)| along(0).map(move |i| [i, j, k]));
        voxels.filter(|v| *ct.at(*v) > least).map(|v| grid.centre(v)).collect()
    };
    let (tissue, bone) = (above(TISSUE_HU), above(BONE_HU));
    let dense = if bone.len() < LEAST_BONE { &tissue } else { &bone };
    let Some(region) = Region::around(tissue.iter().copied()) else {
        return planes(&[scan; 3], &grid.middle());
    };
    let middle = [0, 1, 2].map(|a| {
        let mut all: Vec<f64> = dense.iter().map(|p| p[a]).collect();
        let half = all.len() / 2;
        *all.select_nth_unstable_by(half, f64::total_cmp).1
    });
    planes(&[region.grown(RIM_MM).within(scan); 3], &in_the_patient(&tissue, &middle.into(), POINTS_MM))
}

/// Two scans, HU.
#[derive(Clone, Copy)]
struct Scans<'a> {
    planning: &'a Volume<f32>,
    fraction: &'a Volume<f32>,
}

/// Before (of the first field, for all have the same), one shift alone, and after.
fn fusions(
    which: usize,
    field: &Assessed,
    scans: Scans<'_>,
    pull: &Volume<[f32; 3]>,
) -> Result<Vec<EvaluationPicture>> {
    let name = &field.name;
    let mut all = Vec::new();
    if which == 0 {
        let caption = "Planning CT (blue) over the fraction (orange), both where the scanners put them.";
        all.push(encoded(which, "before", "Before".into(), caption.into(), &fusion(scans, |y| *y))?);
    }
    if let Some(shift) = field.assessment.shift.as_ref().filter(|s| s.mm.norm() >= LEAST_SHIFT_MM) {
        let mm = shift.mm;
        let caption = format!(
            "Planning CT moved as a whole by the {} ({:.1}, {:.1}, {:.1} mm): what is coloured here is left for the \
             deformation.",
            shift.of, mm.x, mm.y, mm.z
        );
        all.push(encoded(which, "shift", format!("{name}: one shift alone"), caption, &fusion(scans, |y| y - mm))?);
    }
    let after = fusion(scans, |y| y + trilinear_vector(pull, &pull.grid().index(y)).unwrap_or_default());
    let caption = "Planning CT mapped by the field (blue) over the fraction (orange); grey where both agree.";
    all.push(encoded(which, "fusion", format!("{name}: after"), caption.into(), &after)?);
    Ok(all)
}

/// The fraction's planes over planning where `from` takes their places.
fn fusion(Scans { planning, fraction }: Scans<'_>, from: impl Fn(&Point3<f64>) -> Point3<f64> + Sync) -> Canvas {
    let rows = middle_planes(fraction).map(|plane| {
        let picture = plane
            .paint(|y, _| fuse(hu_at(planning, &from(&y)).map_or(0.0, tone), hu_at(fraction, &y).map_or(0.0, tone)));
        plane.row(&picture, [0; 3], [255; 3], [0; 3])
    });
    sheet(&rows, 1, |legend| {
        legend.swatch(BLUE, "planning CT");
        legend.swatch(ORANGE, "fraction");
        legend.swatch([170; 3], "both agree");
    })
}

/// Pictures of the three planes, before they become a sheet.
type PictureRows = [(Plane, Canvas); 3];

fn jacobians(planning: &Volume<f32>, maps: &Maps) -> PictureRows {
    middle_planes(planning).map(|plane| {
        let hu = plane.hu(planning);
        let picture = plane.paint(|p, n| {
            let hu = f64::from(hu[n]);
            // Couch and mask are no patient: what is not measured is not shown either.
            let patient = nearest(&maps.measured, &p) == Some(true);
            match cell_at(&maps.jacobian, &p) {
                Some(j) if patient && hu > -500.0 => {
                    let shade = 0.86 + 0.14 * tone(hu);
                    shaded(jacobian(f64::from(j)), shade)
                }
                _ => BACKDROP,
            }
        });
        (plane, picture)
    })
}

fn sheet_of(rows: PictureRows) -> Canvas {
    let rows = rows.map(|(plane, picture)| plane.row(&picture, BACKDROP, INK, BACKDROP));
    let ticks: Vec<_> =
        ["1/2", "0.7", "1", "1.4", "2"].iter().enumerate().map(|(i, t)| (i as f64 / 4.0, (*t).to_owned())).collect();
    sheet(&rows, 1, |legend| {
        legend.bar("shrinks", 420.0, |share| jacobian((2.0 * share - 1.0).exp2()), &ticks);
        legend.text("grows");
        legend.swatch(BLACK, "folded");
    })
}

/// Outlines of labels over pictures of their frame.
fn outlined(rows: PictureRows, labels: &Volume<u16>) -> PictureRows {
    rows.map(|(plane, mut picture)| {
        outline(&mut picture, &plane, labels, mix(INK, [255; 3], 0.25));
        (plane, picture)
    })
}

/// Draws the borders of labels in one colour.
fn outline(picture: &mut Canvas, plane: &Plane, labels: &Volume<u16>, colour: Rgb) {
    plane.borders(picture, &plane.each(|p| nearest(labels, p).unwrap_or(0)), colour, [0.9, 0.5]);
}

fn contours(fraction: &Volume<f32>, mapped: &Volume<u16>, reference: &Volume<u16>) -> Canvas {
    let rows = middle_planes(fraction).map(|plane| {
        let hu = plane.hu(fraction);
        let mut picture = plane.paint(|_, n| grey(0.8 * tone(f64::from(hu[n]))));
        outline(&mut picture, &plane, reference, ORANGE);
        outline(&mut picture, &plane, mapped, mix(BLUE, [255; 3], 0.3));
        plane.row(&picture, [0; 3], [255; 3], [0; 3])
    });
    sheet(&rows, 1, |legend| {
        legend.swatch(mix(BLUE, [255; 3], 0.3), "mapped from planning");
        legend.swatch(ORANGE, "fraction");
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Grid;

    #[test]
    fn the_planes_go_through_the_patient_wherever_he_lies_in_the_scan() {
        let grid = Grid::axis_aligned([100, 80, 60], [4.0; 3], [0.0; 3]).unwrap();
        // A body in a corner of the scan, a thin arm far from it.
        let ct = Volume::from_fn(grid.clone(), |l| {
            let [i, j, k] = grid.voxel(l);
            let body = i < 40 && j < 30 && k < 20;
            let arm = i < 90 && j < 4 && k < 4;
            if body || arm { 40.0 } else { -1000.0 }
        });
        let [axial, coronal, sagittal] = middle_planes(&ct);
        for (plane, high) in [(&axial, 80.0), (&coronal, 120.0), (&sagittal, 160.0)] {
            assert!((4.0..high).contains(&plane.at()), "{:?} {}", plane.kind, plane.at());
        }
        // Bones draw the planes to themselves.
        let spine = Volume::from_fn(grid.clone(), |l| {
            let [i, j, _] = grid.voxel(l);
            if (20..24).contains(&i) && (12..16).contains(&j) && ct.data()[l] > 0.0 { 400.0 } else { ct.data()[l] }
        });
        let [_, coronal, sagittal] = middle_planes(&spine);
        assert!((48.0..=60.0).contains(&coronal.at()) && (80.0..=92.0).contains(&sagittal.at()));
        let empty = Volume::filled(grid.clone(), -1000.0);
        assert!((middle_planes(&empty)[0].at() - grid.middle().z).abs() < 1e-9);
    }
}
