//! Places that are worth a look, and those with names.

use super::super::pictures::focus;
use super::super::plane::Region;
use crate::geometry::Grid;
use crate::pipeline::{Case, Outcome};
use crate::volume::{LabelMap, Mask, trilinear_vector};
use crate::warning::counted;
use nalgebra::{Point3, Vector3};
use serde_json::{Value, json};
use std::cmp::Reverse;
use std::collections::BTreeSet;

/// A place in the fraction to look at, and why.
pub(super) struct ViewerPlace {
    what: String,
    more: String,
    /// LPS mm.
    at: Point3<f64>,
}

impl ViewerPlace {
    pub(super) fn json(self) -> Value {
        json!({ "what": self.what, "more": self.more, "at": self.at.coords.as_slice() })
    }
}

/// Folded cells that lie closer are one place, mm.
const APART_MM: f64 = 15.0;
/// Places of one kind, at most.
const MOST: usize = 8;

/// Where warnings and figures have a place: overlapping bones, folded cells, skin on skin, the
/// least certain tissue.
pub(super) fn places(case: &Case, outcome: &Outcome) -> Vec<ViewerPlace> {
    let mut places = Vec::new();
    for o in outcome.contact.overlaps.iter().take(MOST) {
        let more = format!("{:.1} mm", o.depth_mm);
        places.push(ViewerPlace { what: format!("{} overlaps {}", o.bones[0], o.bones[1]), more, at: o.at });
    }
    places.extend(folds(case, outcome));
    if let Some(at) = outcome.skin_contact.as_ref().and_then(middle_voxel) {
        places.push(ViewerPlace {
            what: "skin passes through skin".into(),
            more: format!("{:.1} ml", outcome.contact.skin_ml),
            at,
        });
    }
    if let Some((mm, at)) = least_certain(outcome) {
        places.push(ViewerPlace { what: "largest uncertainty".into(), more: format!("{mm:.1} mm"), at });
    }
    places
}

/// A place of the planning CT in the fraction.
fn pushed(outcome: &Outcome, p: &Point3<f64>) -> Option<Point3<f64>> {
    let field = &outcome.push.displacement;
    trilinear_vector(field, &field.grid().index(p)).map(|u| p + u)
}

/// Folded cells in the fraction, those of one kind that lie close to each other as one place with
/// their number: first those of tissue, then those between bones, the largest places first.
fn folds(case: &Case, outcome: &Outcome) -> Vec<ViewerPlace> {
    let (map, grid) = (&outcome.jacobian, outcome.jacobian.grid());
    let [_, nj, nk] = grid.size();
    let mut found: Vec<(Point3<f64>, BTreeSet<u16>, usize)> = Vec::new();
    for row in 0..nj * nk {
        let (span, values) = map.row(row);
        for (i, _) in span.zip(values).filter(|(_, j)| **j <= 0.0) {
            let p = grid.world(&Vector3::new(i as f64 + 0.5, (row % nj) as f64 + 0.5, (row / nj) as f64 + 0.5));
            let bones = bones_of(&case.planning.bones, [i, row % nj, row / nj]);
            let near = |(q, own, _): &(Point3<f64>, BTreeSet<u16>, usize)| (p - q).norm() < APART_MM && *own == bones;
            if let Some(known) = found.iter().position(near) {
                found[known].2 += 1;
            } else if found.len() < 64 * MOST {
                found.push((p, bones, 1));
            }
        }
    }
    found.sort_by_key(|(_, bones, cells)| (!bones.is_empty(), Reverse(*cells)));
    let place = |(p, bones, cells): (Point3<f64>, BTreeSet<u16>, usize)| {
        let name = |label| case.planning.bones.names.get(label).map_or("?", String::as_str);
        let names: Vec<&str> = bones.iter().map(name).collect();
        let what =
            if names.is_empty() { "field folds".into() } else { format!("field folds between {}", names.join(", ")) };
        let more = counted(cells, "cell", "cells");
        Some(ViewerPlace { what, more, at: pushed(outcome, &p)? })
    };
    found.into_iter().take(MOST).filter_map(place).collect()
}

/// The labels of a cell's corners, where there are several; none elsewhere.
fn bones_of(bones: &LabelMap, cell: [usize; 3]) -> BTreeSet<u16> {
    let (grid, data) = (bones.volume.grid(), bones.volume.data());
    let first = grid.linear(cell);
    let labels =
        grid.cell_corners().into_iter().filter_map(|by| data.get(first + by).copied()).filter(|label| *label > 0);
    let labels: BTreeSet<u16> = labels.collect();
    if labels.len() > 1 { labels } else { BTreeSet::new() }
}

/// The voxel of a mask that is in the middle of their order in storage.
fn middle_voxel(mask: &Mask) -> Option<Point3<f64>> {
    let n = mask.data().iter().enumerate().filter(|(_, set)| **set).map(|(n, _)| n).nth(mask.count() / 2)?;
    Some(mask.grid().centre(mask.grid().voxel(n)))
}

/// The greatest uncertainty that is known, mm, and where.
fn least_certain(outcome: &Outcome) -> Option<(f32, Point3<f64>)> {
    let (map, _) = outcome.uncertainty.as_ref()?;
    let [_, nj, nk] = map.grid().size();
    let of_row = |row: usize| {
        let (span, values) = map.row(row);
        span.zip(values).map(move |(i, mm)| ([i, row % nj, row / nj], mm))
    };
    let (voxel, mm) = (0..nj * nk).flat_map(of_row).max_by(|a, b| a.1.total_cmp(b.1))?;
    let at = pushed(outcome, &map.grid().centre(voxel))?;
    (*mm > 0.0).then_some((*mm, at))
}

/// Each bone's centre in the fraction and its motion apart from the couch shift, mm.
pub(super) fn bones(outcome: &Outcome) -> Value {
    let fits = outcome.skeleton.bones.iter().zip(&outcome.bone_fits).zip(outcome.own_motion_mm());
    let one = fits.map(|((bone, fit), mm)| {
        let at = fit.transform * bone.centroid;
        json!({ "name": bone.name, "mm": mm, "at": at.coords.as_slice() })
    });
    one.collect()
}

/// Each landmark: where it is, where the field takes it, and how far apart these are.
pub(super) fn landmarks(outcome: &Outcome) -> Value {
    let each = outcome.landmarks.iter().flat_map(|report| &report.each);
    let one = each.map(|r| {
        json!({
            "name": r.landmark.name,
            "fraction": r.landmark.fraction.coords.as_slice(),
            "mapped": r.mapped.map(|p| [p.x, p.y, p.z]),
            "before": r.before,
            "after": r.after,
        })
    });
    one.collect()
}

/// Where the crosshair is first: where the pictures' planes meet.
pub(super) fn start(case: &Case, outcome: &Outcome) -> Value {
    let grids = [case.planning.ct.grid(), case.fraction.ct.grid()];
    let focus = focus(outcome, grids.map(|grid| Some(Region::of(grid))), grids.map(Grid::middle));
    json!(focus.to.coords.as_slice())
}
