//! Structures of the planning CT as bits of each voxel, before and after the registration.

use crate::error::Result;
use crate::io::embed::PageGrid;
use crate::pipeline::{Case, Outcome};
use crate::volume::Volume;
use crate::volume::contour::{Contours, Structure};
use nalgebra::{Point3, Vector3};
use rayon::prelude::*;
use serde_json::{Value, json};

/// Structures that are shown: bits of a number of the page.
const MOST: usize = 30;

/// The structures that have an outline, at most [`MOST`].
fn shown(contours: &Contours) -> impl Iterator<Item = &Structure> {
    contours.structures.iter().filter(|s| !s.polygons.is_empty()).take(MOST)
}

/// Names and colours, in the order of the bits, and how many structures there are in all.
pub(super) fn about(contours: Option<&Contours>) -> Value {
    let all = contours.into_iter().flat_map(shown);
    let one = all.map(|s| json!({ "name": s.name, "colour": s.colour.unwrap_or([94, 224, 142]) }));
    one.collect()
}

/// For each voxel of `page` the structures that it lies in, where planning was (moved by `shift`)
/// and where the registration takes them.
///
/// # Errors
/// [`crate::error::Error::Internal`] when no grid can be made of the planning CT.
pub(super) fn bits(
    case: &Case,
    outcome: &Outcome,
    contours: &Contours,
    page: &PageGrid,
    shift: &Vector3<f64>,
) -> Result<[Vec<i32>; 2]> {
    let planning = drawn(contours, PageGrid::of(&[&case.planning.ct])?);
    let at = |p: Point3<f64>| planning.grid().voxel_at(&p).map_or(0, |voxel| *planning.at(voxel));
    let [before, after] =
        page.of_field(&outcome.pull.displacement, |p, v| [at(p - shift), at(p + Vector3::from(v.map(f64::from)))]);
    Ok([before, after])
}

/// The structures on voxels of the planning CT.
fn drawn(contours: &Contours, page: PageGrid) -> Volume<i32> {
    let grid = page.grid();
    let mut bits = Volume::filled(grid.clone(), 0);
    let slice = grid.size()[0] * grid.size()[1];
    for (bit, structure) in shown(contours).enumerate() {
        let spacing = contours.spacing_of(structure, grid.spacing()[2]);
        let solid = contours.solid(structure, spacing);
        let corners = structure.polygons.iter().flat_map(|o| o.points.iter().map(|p| contours.world(*p, o.height)));
        let Some((low, high)) = corners.fold(None, |box_, p| {
            let (low, high) = box_.unwrap_or((p, p));
            Some((low.inf(&p), high.sup(&p)))
        }) else {
            continue;
        };
        let rim = Vector3::repeat(spacing);
        let [first, last] = [low - rim, high + rim].map(|p| grid.index_within(&p).map(|i| i as usize));
        bits.data_mut().par_chunks_mut(slice).enumerate().for_each(|(k, plane)| {
            if !(first.z..=last.z + 1).contains(&k) {
                return;
            }
            for j in first.y..=(last.y + 1).min(grid.size()[1] - 1) {
                for i in first.x..=(last.x + 1).min(grid.size()[0] - 1) {
                    if solid.depth(&grid.centre([i, j, k])) > 0.0 {
                        plane[i + j * grid.size()[0]] |= 1 << bit;
                    }
                }
            }
        });
    }
    bits
}

#[cfg(test)]
mod tests {
    use super::super::super::example;
    use super::*;
    use crate::volume::contour::Polygon;
    use nalgebra::Matrix3;

    #[test]
    fn structures_are_where_they_were_and_where_the_field_takes_them() {
        let (case, outcome, _) = example::small();
        // Boxes around the upper bone, which moves; the second within the first.
        let square = |r: f64| vec![[-r, 25.0 - r], [r, 25.0 - r], [r, 25.0 + r], [-r, 25.0 + r]];
        let tube = |name: &str, r: f64| Structure {
            name: name.into(),
            colour: None,
            polygons: (0..6).map(|k| Polygon { height: 21.0 + 6.0 * f64::from(k), points: square(r) }).collect(),
        };
        let none = Structure { name: "none".into(), colour: None, polygons: Vec::new() };
        let contours = Contours { axes: Matrix3::identity(), structures: vec![none, tube("a", 20.0), tube("b", 8.0)] };
        assert_eq!(about(Some(&contours)).as_array().unwrap().len(), 2);
        let page = PageGrid::of(&[&case.fraction.ct]).unwrap();
        let [before, after] = bits(&case, &outcome, &contours, &page, &Vector3::zeros()).unwrap();
        let at = |bits: &[i32], p: Point3<f64>| bits[page.grid().linear(page.grid().voxel_at(&p).unwrap())];
        let places = [(0.0, 0b11), (14.0, 0b01), (30.0, 0)];
        for (x, meant) in places {
            let p = Point3::new(x, 25.0, 40.0);
            assert_eq!(at(&before, p), meant, "{x}");
            let moved = outcome.bone_fits[1].transform * p;
            assert!((moved - p).norm() > 5.0);
            assert_eq!(at(&after, moved), meant, "{x} moved to {moved}");
        }
    }
}
