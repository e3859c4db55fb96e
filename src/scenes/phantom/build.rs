//! Short builders for the anatomy tables: coordinates are LPS mm about the atlanto-occipital joint.

use super::shape::{Section, Shape, V3};
use nalgebra::{Matrix3, Rotation3};

/// Axis-aligned ellipsoid.
pub(super) fn ell(centre: [f64; 3], radii: [f64; 3]) -> Shape {
    Shape::Ellipsoid { centre: centre.into(), frame: Matrix3::identity(), radii: radii.into() }
}

/// Ellipsoid turned by a rotation vector in degrees.
pub(super) fn ell_turned(centre: [f64; 3], radii: [f64; 3], turn_deg: [f64; 3]) -> Shape {
    let turn = Rotation3::from_scaled_axis(V3::from(turn_deg.map(f64::to_radians)));
    Shape::Ellipsoid { centre: centre.into(), frame: turn.matrix().transpose(), radii: radii.into() }
}

/// Tapered capsule.
pub(super) fn cap(a: [f64; 3], b: [f64; 3], ra: f64, rb: f64) -> Shape {
    Shape::Capsule { a: a.into(), b: b.into(), ra, rb }
}

/// Chain of tapered capsules through `[x, y, z, r]`.
pub(super) fn chain(knots: &[[f64; 4]]) -> Vec<Shape> {
    let joint = |[x, y, z, _]: [f64; 4]| [x, y, z];
    knots.windows(2).map(|w| cap(joint(w[0]), joint(w[1]), w[0][3], w[1][3])).collect()
}

/// Flat bar along a line in the midplane: half width in x, half thickness across.
pub(super) fn bar(a: [f64; 3], b: [f64; 3], half_width: f64, half_thickness: f64) -> Shape {
    let (a, b) = (V3::from(a), V3::from(b));
    let along = (b - a).normalize();
    let frame = Matrix3::from_rows(&[V3::x().transpose(), along.cross(&V3::x()).transpose(), along.transpose()]);
    let half = V3::new(half_width, half_thickness, (b - a).norm() / 2.0);
    Shape::Block { centre: (a + b) / 2.0, frame, half, round: half_thickness * 0.7 }
}

/// Axis-aligned block.
pub(super) fn block(centre: [f64; 3], half: [f64; 3], round: f64) -> Shape {
    Shape::Block { centre: centre.into(), frame: Matrix3::identity(), half: half.into(), round }
}

/// Triangle plate of thickness `2 r`.
pub(super) fn plate(corners: [[f64; 3]; 3], r: f64) -> Shape {
    Shape::Plate { corners: corners.map(V3::from), r }
}

/// Loft from `[z, middle, half width, front, back, power]`, high z first, grown by `offset`.
pub(super) fn loft_of(rows: &[[f64; 6]], offset: f64) -> Shape {
    let sections = rows
        .iter()
        .map(|&[z, middle, half, front, back, power]| Section { z, middle, half, front, back, power })
        .collect();
    Shape::Loft { sections, x: 0.0, offset }
}

/// The shapes and their mirror images.
pub(super) fn both(shapes: impl IntoIterator<Item = Shape>) -> Vec<Shape> {
    shapes.into_iter().flat_map(|s| [s.mirrored(), s]).collect()
}

/// The shapes on one side: left as given (`1.0`), right mirrored (`-1.0`).
pub(super) fn on_side(side: f64, shapes: Vec<Shape>) -> Vec<Shape> {
    if side > 0.0 { shapes } else { shapes.iter().map(Shape::mirrored).collect() }
}
