//! Fusion of planning and fraction CT, before and after registration: planning blue, fraction orange, equal is grey.

use super::super::canvas::Canvas;
use super::super::colour::{BLUE, ORANGE, fuse, tone};
use super::super::plane::{Plane, hu_at};
use super::legend::{Legend, sheet};
use super::{Plate, Scene};
use nalgebra::Point3;

/// The planning CT as scanned (or with the couch shift alone) over the fraction CT.
pub(super) fn before(scene: &Scene<'_>) -> Plate {
    let shift = scene.shift_before.unwrap_or_default();
    let planning = |p: &Point3<f64>| hu_at(&scene.case.planning, &(p - shift));
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
        caption: format!("{how} Planes through {}.", scene.focus),
        canvas: panels(scene, planning),
    }
}

/// The deformed planning CT over the fraction CT.
pub(super) fn after(scene: &Scene<'_>) -> Plate {
    let planning = |p: &Point3<f64>| hu_at(&scene.outcome.planning_on_fraction, p);
    Plate {
        file: "fusion_after.png",
        title: "After registration",
        caption: "The planning CT deformed onto the fraction, same planes. Grey where both agree; one colour alone where \
                  they differ or where the other scan has no data."
            .to_owned(),
        canvas: panels(scene, planning),
    }
}

fn panels(scene: &Scene<'_>, planning: impl Fn(&Point3<f64>) -> Option<f64> + Sync) -> Canvas {
    let rows = scene.fraction.each_ref().map(|plane| plane.row(&fused(scene, plane, &planning), [0; 3], [255; 3], [0; 3]));
    sheet(&rows, 1, colours)
}

/// A plane of the fraction CT fused with `planning` (HU at a fraction position).
pub(super) fn fused(scene: &Scene<'_>, plane: &Plane, planning: impl Fn(&Point3<f64>) -> Option<f64> + Sync) -> Canvas {
    let brightness = |hu: Option<f64>| hu.map_or(0.0, tone);
    plane.paint(|p| fuse(brightness(planning(&p)), brightness(hu_at(&scene.case.fraction, &p))))
}

/// What the colours mean.
pub(super) fn colours(legend: &mut Legend<'_>) {
    legend.swatch(BLUE, "planning CT");
    legend.swatch(ORANGE, "fraction CT");
    legend.swatch([170; 3], "both agree");
}
