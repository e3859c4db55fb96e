//! Fusion of planning and fraction, before and after registration: planning blue, fraction orange, equal is grey; of two
//! modalities, whose brightness means nothing between them, a checkerboard.

use super::super::canvas::{Canvas, Rgb};
use super::super::colour::{BLUE, ORANGE, fuse, grey, stepped, tone};
use super::super::plane::{Plane, nearest};
use super::super::searched::{SearchedPlace, searched};
use super::legend::{Legend, sheet};
use super::scene::Overlay;
use super::{PictureScene, Plate, bones};
use crate::view::ViewReport;
use crate::volume::Volume;
use nalgebra::{Point3, Vector3};
use std::ops::RangeInclusive;

/// The planning CT as scanned (or with the couch shift alone) over the fraction CT.
pub(super) fn before(scene: &PictureScene<'_>) -> Plate {
    let shift = scene.shift_before.unwrap_or_default();
    let how = match scene.shift_before {
        None => "Both scans at their scanner positions, nothing moved.".to_owned(),
        Some(s) => format!(
            "The scans have hardly any volume in common as scanned, so the planning CT is moved by the couch shift alone \
             ({:.1}, {:.1}, {:.1} mm).",
            s.x, s.y, s.z
        ),
    };
    Plate {
        file: "fusion_before.png",
        title: "Before registration",
        caption: format!("{how} Planes: {}.", scene.focus),
        canvas: panels(scene, &scene.case.planning.ct, &shift, &shift),
    }
}

/// The planning CT moved by the couch shift alone; nothing where that is the picture before already, or hardly a shift.
pub(super) fn couch(scene: &PictureScene<'_>) -> Option<Plate> {
    let s = scene.outcome.couch.shift();
    if scene.shift_before.is_some() || s.norm() < LEAST_SHIFT_MM {
        return None;
    }
    Some(Plate {
        file: "fusion_couch.png",
        title: "Couch shift alone",
        caption: format!(
            "The planning CT moved as a whole by the couch shift ({:.1}, {:.1}, {:.1} mm), same planes: what does not agree here is left \
             for the deformation.",
            s.x, s.y, s.z
        ),
        canvas: panels(scene, &scene.case.planning.ct, &s, &s),
    })
}

/// Pictures of other places that a search has weighed, by rank.
const PLACES: [(&str, &str); 3] = [
    ("fusion_place_2.png", "Second place of the search"),
    ("fusion_place_3.png", "Third place of the search"),
    ("fusion_place_4.png", "Fourth place of the search"),
];
/// A place of less evidence than this is not drawn, percent of the best one's.
const RIVAL_PERCENT: f64 = 50.0;

/// The planning CT moved as a whole to each other place that a search has weighed and that is a rival.
pub(super) fn places(scene: &PictureScene<'_>) -> Vec<Plate> {
    let all = searched(scene.outcome);
    let rivals = PLACES.iter().zip(all.iter().skip(1)).filter(|(_, place)| place.evidence_percent >= RIVAL_PERCENT);
    let plate = |(&(file, title), place): (&(&'static str, &'static str), &SearchedPlace)| {
        let s = place.shift_mm;
        Plate {
            file,
            title,
            caption: format!(
                "The planning CT moved as a whole by ({:.1}, {:.1}, {:.1}) mm, as {} proposed; {:.0} % of the evidence of the best place. \
                 Same planes: bones that lie on each other here speak for it.",
                s.x,
                s.y,
                s.z,
                place.proposed_by.join(", "),
                place.evidence_percent
            ),
            canvas: panels(scene, &scene.case.planning.ct, &s, &s),
        }
    };
    rivals.map(plate).collect()
}

/// The pictures of [`places`] among others, by their file.
pub(in crate::report) fn is_of_a_place(file: &str) -> bool {
    PLACES.iter().any(|(own, _)| *own == file)
}

/// A smaller shift is not seen, mm.
pub(in crate::report) const LEAST_SHIFT_MM: f64 = 0.5;

/// The deformed planning CT over the fraction CT.
pub(super) fn after(scene: &PictureScene<'_>) -> Plate {
    Plate {
        file: "fusion_after.png",
        title: "After registration",
        caption: match scene.overlay() {
            Overlay::Colours => "The planning CT deformed onto the fraction, same planes. Grey where both agree; one colour alone where \
                                 they differ or where the other scan has no data. A cone-beam CT is shown on planning's scale."
                .to_owned(),
            Overlay::Checks => "The planning CT deformed onto the fraction, same planes: skin and bones continue from square to square where \
                                both agree."
                .to_owned(),
        },
        canvas: panels(
            scene,
            &scene.outcome.planning_on_fraction,
            &Vector3::zeros(),
            &scene.shift_before.unwrap_or_default(),
        ),
    }
}

/// The planes of the fraction CT fused with a planning CT moved by `shift`; the outlines of planning's bones are moved by
/// `before`.
fn panels(scene: &PictureScene<'_>, planning: &Volume<f32>, shift: &Vector3<f64>, before: &Vector3<f64>) -> Canvas {
    let planes = scene.fraction.iter().zip(&scene.fraction_hu);
    let rows: Vec<Canvas> = planes
        .map(|(plane, fraction)| {
            let mut picture = fused(scene.overlay(), plane, &plane.hu_moved(planning, shift), fraction);
            outline(scene, plane, &mut picture);
            bones::outlines_at(scene, plane, before, &mut picture);
            plane.row(&picture, [0; 3], [255; 3], [0; 3])
        })
        .collect();
    let limited = limited(scene).is_some();
    sheet(&rows, 1 + usize::from(limited), |legend| {
        colours(scene.overlay(), legend);
        bones::legend(legend);
        if limited {
            legend.next_line();
            legend.swatch(EDGE, "edge of what was measured");
        }
    })
}

/// Edge of what the fraction CT measured.
const EDGE: Rgb = [94, 224, 142];

/// What limits the fraction's view inside its grid, if anything.
fn limited<'a>(scene: &'a PictureScene<'_>) -> Option<&'a ViewReport> {
    let view = &scene.outcome.kind.as_ref()?.view;
    (view.circle.is_some() || view.blank != [[0; 2]; 3]).then_some(view)
}

/// Draws where the fraction's view ends.
fn outline(scene: &PictureScene<'_>, plane: &Plane, picture: &mut Canvas) {
    let Some(view) = limited(scene) else { return };
    let grid = scene.case.fraction.ct.grid();
    let shown = |x: usize, y: usize| view.shows(grid, &plane.world(x as f64, y as f64));
    for (top, left) in
        (1..plane.height).step_by(SQUARE).flat_map(|y| (1..plane.width).step_by(SQUARE).map(move |x| (y, x)))
    {
        // The view's edge is straight or a wide circle: it crosses no square whose corners lie on one side.
        let corners =
            [(0, 0), (SQUARE, 0), (0, SQUARE), (SQUARE, SQUARE)].map(|(x, y)| shown(left - 1 + x, top - 1 + y));
        if corners.iter().all(|c| *c == corners[0]) {
            continue;
        }
        for y in (top..(top + SQUARE).min(plane.height)).filter(|y| y % DASH.1 < DASH.0) {
            for x in (left..(left + SQUARE).min(plane.width)).filter(|x| (x + y) % DASH.1 < DASH.0) {
                let here = shown(x, y);
                if here != shown(x - 1, y) || here != shown(x, y - 1) {
                    picture.rectangle([x as f64 - 1.0, y as f64 - 1.0], [x as f64 + 1.0, y as f64 + 1.0], EDGE);
                }
            }
        }
    }
}

/// Side of the squares that are looked through for the edge, pixels.
const SQUARE: usize = 8;

/// Length of a dash, and from one to the next, pixels.
const DASH: (usize, usize) = (8, 12);

/// The same in a window for lung: where planning's planes show some.
pub(super) fn lung(scene: &PictureScene<'_>) -> Option<Plate> {
    let planning: Vec<Vec<f32>> =
        scene.fraction.iter().map(|plane| plane.hu(&scene.outcome.planning_on_fraction)).collect();
    let shown = scene.fraction.iter().zip(&planning);
    let pixels = shown.flat_map(|(plane, hu)| hu.iter().enumerate().map(move |(n, hu)| (plane, n, *hu)));
    let at = |plane: &Plane, n: usize| plane.world((n % plane.width) as f64, (n / plane.width) as f64);
    let lung =
        pixels.clone().filter(|(plane, n, hu)| LUNG_HU.contains(hu) && in_patient(scene, &at(plane, *n))).count();
    if lung as f64 <= LEAST_LUNG * pixels.count() as f64 {
        return None;
    }
    let planes = scene.fraction.iter().zip(planning.iter().zip(&scene.fraction_hu));
    let rows: Vec<Canvas> = planes
        .map(|(plane, (planning, fraction))| {
            let mut picture = plane.paint(|_, n| fuse(tone_of_lung(planning[n]), tone_of_lung(fraction[n])));
            bones::outlines(scene, plane, &mut picture);
            plane.row(&picture, [0; 3], [255; 3], [0; 3])
        })
        .collect();
    Some(Plate {
        file: "fusion_lung.png",
        title: "After registration, lung window",
        caption: "The same planes from -950 to 50 HU: vessels and the lung's border.".to_owned(),
        canvas: sheet(&rows, 1, |legend| {
            colours(Overlay::Colours, legend);
            bones::legend(legend);
        }),
    })
}

/// Whether a point of the fraction shows the patient as planning has him: neither foam nor the blur of his skin is lung.
fn in_patient(scene: &PictureScene<'_>, p: &Point3<f64>) -> bool {
    let there = nearest(&scene.outcome.pull.displacement, p).map(|v| p + Vector3::from(v.map(f64::from)));
    there.and_then(|x| nearest(&scene.outcome.body, &x)).unwrap_or(false)
}

/// Lung, HU; the noise of a scanner's air reaches to -900.
const LUNG_HU: RangeInclusive<f32> = -900.0..=-500.0;
/// Least share of the planes that is lung.
const LEAST_LUNG: f64 = 0.08;

/// Brightness (0 to 1) in the window for lung.
fn tone_of_lung(hu: f32) -> f64 {
    ((f64::from(hu) + 950.0) / 1000.0).clamp(0.0, 1.0)
}

/// Side of a square, mm.
const CHECK_MM: f64 = 20.0;

/// CT numbers of planning and fraction at a plane's pixels, fused.
pub(super) fn fused(overlay: Overlay, plane: &Plane, planning: &[f32], fraction: &[f32]) -> Canvas {
    let square = |p: &Point3<f64>| p.iter().map(|c| (c / CHECK_MM).floor() as i64).sum::<i64>().rem_euclid(2) == 0;
    plane.paint(|p, n| match overlay {
        Overlay::Colours => fuse(tone(f64::from(planning[n])), tone(f64::from(fraction[n]))),
        Overlay::Checks => grey(stepped(tone(f64::from(if square(&p) { planning[n] } else { fraction[n] })))),
    })
}

/// What the colours mean.
pub(super) fn colours(overlay: Overlay, legend: &mut Legend<'_>) {
    if overlay == Overlay::Checks {
        legend.swatch([170; 3], &format!("planning and fraction in turns, {CHECK_MM} mm"));
        return;
    }
    legend.swatch(BLUE, "planning CT");
    legend.swatch(ORANGE, "fraction");
    legend.swatch([170; 3], "both agree");
}

#[cfg(test)]
mod tests {
    use super::super::super::example::{self, Layout};
    use super::*;
    use crate::pipeline::FractionKind;

    /// Red minus blue of a pixel: positive is orange, negative is blue, zero is grey.
    fn tint(panel: &Canvas, [x, y]: [f64; 2]) -> i32 {
        let [r, _, b] = panel.pixel(x as usize, y as usize);
        i32::from(r) - i32::from(b)
    }

    #[test]
    fn equal_scans_fuse_to_grey_everywhere() {
        let (mut case, outcome, _) = example::small();
        case.fraction.ct = case.planning.ct.clone();
        let scene = PictureScene::new(&case, &outcome);
        for plane in &scene.fraction {
            let hu = [&case.planning.ct, &case.fraction.ct].map(|ct| plane.hu(ct));
            let panel = fused(scene.overlay(), plane, &hu[0], &hu[1]);
            let (mut worst, mut brightest) = (0, 0);
            for y in 0..plane.height {
                for x in 0..plane.width {
                    worst = worst.max(tint(&panel, [x as f64, y as f64]).abs());
                    brightest = brightest.max(panel.pixel(x, y)[0]);
                }
            }
            assert!(worst <= 1 && brightest > 150, "{worst} {brightest}");
        }
    }

    #[test]
    fn an_mr_is_shown_in_turns_with_planning_and_never_in_colours() {
        let (case, mut outcome, _) = example::small();
        let view = ViewReport { measured_percent: 100.0, ..ViewReport::default() };
        outcome.kind =
            Some(FractionKind { view, grey: None, corrected: false, misled: None, mr: Some([-200.0, 300.0]) });
        let scene = PictureScene::new(&case, &outcome);
        let plane = &scene.fraction[0];
        let panel = fused(scene.overlay(), plane, &vec![170.0; plane.width * plane.height], &scene.fraction_hu[0]);
        let pixels = || (0..plane.height).flat_map(|y| (0..plane.width).map(move |x| [x, y]));
        assert!(pixels().all(|[x, y]| tint(&panel, [x as f64, y as f64]) == 0));
        // Planning is as bright all over, and shown in half of the squares.
        let bright = pixels().filter(|&[x, y]| panel.pixel(x, y)[0] >= 160).count() as f64;
        let share = bright / (plane.width * plane.height) as f64;
        assert!((0.4..0.75).contains(&share), "{share}");
    }

    #[test]
    fn a_shifted_scan_shows_blue_where_it_left_and_orange_where_it_went() {
        let (mut case, outcome, _) = example::small();
        // The fraction lies 8 mm to the patient's left: 2 voxels.
        let [ni, ..] = case.planning.ct.grid().size();
        let shifted: Vec<f32> = (0..case.planning.ct.data().len())
            .map(|l| if l % ni >= 2 { case.planning.ct.data()[l - 2] } else { -1000.0 })
            .collect();
        case.fraction.ct = crate::volume::Volume::new(case.planning.ct.grid().clone(), shifted).unwrap();
        let scene = PictureScene::new(&case, &outcome);
        let axial = &scene.fraction_through(&Point3::new(0.0, 10.0, 0.0))[0];
        let hu = [&case.planning.ct, &case.fraction.ct].map(|ct| axial.hu(ct));
        let panel = fused(scene.overlay(), axial, &hu[0], &hu[1]);
        // Skin at x = -84 (patient right, image left) is now air; x = 88 is now tissue; the inside agrees but for the gradient.
        let at = |x: f64| tint(&panel, axial.place(&Point3::new(x, 10.0, 0.0)));
        assert!(at(-80.0) < -20 && at(88.0) > 20, "{} {}", at(-80.0), at(88.0));
        assert!(at(0.0).abs() < 6, "{}", at(0.0));
        assert!(axial.place(&Point3::new(-80.0, 0.0, 0.0))[0] < axial.place(&Point3::new(88.0, 0.0, 0.0))[0]);
    }

    #[test]
    fn far_scanner_origins_are_brought_together_by_the_couch_shift_and_it_says_so() {
        let layout = |offset| Layout { size: [40, 32, 20], spacing: [6.0, 6.0, 9.0], offset };
        let (case, outcome, _) = example::scene(layout([500.0, -20.0, 300.0]));
        let (near_case, near_outcome, _) = example::scene(layout([0.0; 3]));
        let (far, near) = (PictureScene::new(&case, &outcome), PictureScene::new(&near_case, &near_outcome));
        assert_eq!(far.shift_before, Some(outcome.couch.shift()));
        assert_eq!(near.shift_before, None);
        assert!(before(&far).caption.contains("couch shift alone (500.0, -20.0, 300.0 mm)"));
        assert!(before(&near).caption.contains("scanner positions"));
        // Apart from the numbers written on it, the picture is the same, but for a step of brightness.
        let panel = |s: &PictureScene<'_>| {
            let shift = s.shift_before.unwrap_or_default();
            fused(s.overlay(), &s.fraction[0], &s.fraction[0].hu_moved(&s.case.planning.ct, &shift), &s.fraction_hu[0])
        };
        assert!(panel(&far).difference(&panel(&near)) <= 5);
    }

    #[test]
    fn registration_turns_colour_to_grey() {
        let (case, outcome, _) = example::small();
        let scene = PictureScene::new(&case, &outcome);
        let colour = |planning: &crate::volume::Volume<f32>| {
            let plane = &scene.fraction[2];
            let panel = fused(scene.overlay(), plane, &plane.hu(planning), &scene.fraction_hu[2]);
            (0..plane.height)
                .flat_map(|y| (0..plane.width).map(move |x| [x as f64, y as f64]))
                .map(|at| tint(&panel, at).unsigned_abs() as usize)
                .sum::<usize>()
        };
        let (before, after) = (colour(&case.planning.ct), colour(&outcome.planning_on_fraction));
        // What is left is linear interpolation at the edges of 4 mm voxels.
        assert!(after * 2 < before, "{before} {after}");
    }
}
