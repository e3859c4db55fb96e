//! Vertebrae C1 to T7 along the cervical lordosis and the thoracic kyphosis. Millimetres, LPS.

use super::build::{both, cap, chain, ell};
use super::shape::{Shape, V3};
use super::solid::{BoneSolid, Solid, SolidRole};
use nalgebra::Matrix3;

/// Disc centres (y, z) from C2-C3 down to T7-T8.
pub(super) const DISCS: [[f64; 2]; 13] = [
    [-9.0, -44.0],
    [-10.0, -62.5],
    [-9.5, -80.5],
    [-7.0, -98.5],
    [-2.0, -116.5],
    [6.0, -135.0],
    [15.0, -153.5],
    [25.0, -172.5],
    [34.0, -192.0],
    [41.0, -212.0],
    [46.0, -232.5],
    [49.0, -253.5],
    [50.0, -275.0],
];

/// Names of C3 to T7, the vertebrae between the discs.
const NAMES: [&str; 12] = ["C3", "C4", "C5", "C6", "C7", "T1", "T2", "T3", "T4", "T5", "T6", "T7"];

/// Size and place of one vertebra.
#[derive(Debug, Clone, Copy)]
pub(super) struct SpineLevel {
    /// Centre of the body.
    pub(super) centre: V3,
    /// Unit vector upwards along the spine.
    pub(super) up: V3,
    /// Half width of the body.
    pub(super) half_width: f64,
    /// Half depth of the body.
    pub(super) half_depth: f64,
    /// Half height of the body.
    pub(super) half_height: f64,
    /// Whether it carries ribs.
    thoracic: bool,
    /// Length of the spinous process and how far it points down.
    spinous: [f64; 2],
}

impl SpineLevel {
    /// Point at `x` to the left, `back` behind and `up` above the body's centre.
    pub(super) fn at(&self, x: f64, back: f64, up: f64) -> [f64; 3] {
        let behind = V3::x().cross(&self.up) * -1.0;
        (self.centre + V3::x() * x + behind * back + self.up * up).into()
    }
}

/// The levels C3 to T7.
pub(super) fn levels() -> Vec<SpineLevel> {
    let widths = [10.5, 11.0, 11.5, 12.5, 13.5, 14.5, 14.0, 13.5, 13.5, 14.0, 14.5, 15.0];
    let depths = [7.8, 7.8, 8.0, 8.3, 8.6, 9.0, 9.5, 10.5, 11.5, 12.0, 12.5, 13.0];
    let spinous = [
        [11.0, 4.0],
        [11.0, 5.0],
        [13.0, 5.0],
        [19.0, 6.0],
        [27.0, 8.0],
        [29.0, 9.0],
        [28.0, 13.0],
        [26.0, 17.0],
        [25.0, 20.0],
        [24.0, 22.0],
        [23.0, 23.0],
        [23.0, 23.0],
    ];
    (0..NAMES.len())
        .map(|n| {
            let [upper, lower] = [DISCS[n], DISCS[n + 1]].map(|[y, z]| V3::new(0.0, y, z));
            let disc = if n < 5 { 5.0 } else { 4.2 };
            SpineLevel {
                centre: (upper + lower) / 2.0,
                up: (upper - lower).normalize(),
                half_width: widths[n],
                half_depth: depths[n],
                half_height: ((upper - lower).norm() - disc) / 2.0,
                thoracic: n >= 5,
                spinous: spinous[n],
            }
        })
        .collect()
}

/// Centre line of the vertebral canal from the foramen magnum down.
pub(super) fn canal() -> Vec<[f64; 3]> {
    let mut out = vec![[0.0, 14.0, 6.0], [0.0, 13.0, -12.0], [0.0, 10.0, -33.0]];
    out.extend(levels().iter().map(|l| l.at(0.0, l.half_depth + 8.5, 0.0)));
    let below = levels()[11];
    out.push(below.at(0.0, below.half_depth + 8.5, -25.0));
    out
}

/// A body: elliptic cylinder standing on the spine's curve.
fn body(l: &SpineLevel) -> Shape {
    let behind = V3::from(l.at(0.0, 1.0, 0.0)) - l.centre;
    let frame = Matrix3::from_rows(&[V3::x().transpose(), behind.transpose(), l.up.transpose()]);
    Shape::Cylinder { centre: l.centre, frame, radii: [l.half_width, l.half_depth], half: l.half_height }
}

fn cervical(l: &SpineLevel) -> (Vec<Shape>, Vec<Shape>) {
    let (w, d, h) = (l.half_width, l.half_depth, l.half_height);
    let [length, drop] = l.spinous;
    let half = vec![
        cap(l.at(w - 2.5, 1.0, h - 2.0), l.at(w - 1.5, 1.0, h + 1.5), 2.4, 1.6),
        cap(l.at(w - 2.0, 0.0, -1.0), l.at(w + 11.0, 1.0, -3.0), 4.5, 3.0),
        cap(l.at(w - 3.0, 4.0, 1.0), l.at(w + 6.0, 12.0, 0.0), 4.0, 4.0),
        cap(l.at(w + 6.5, 13.0, -h - 2.5), l.at(w + 6.5, 10.5, h + 2.5), 5.4, 5.4),
        cap(l.at(w + 5.0, 15.0, -1.0), l.at(1.0, d + 19.5, -3.0), 3.6, 3.2),
        cap(l.at(0.0, d + 19.0, -3.0), l.at(2.5, d + 19.5 + length, -3.0 - drop), 3.2, 2.6),
    ];
    let foramen = vec![cap(l.at(w + 5.5, 2.0, -12.0), l.at(w + 5.5, 2.0, 12.0), 2.6, 2.6)];
    (both(half), both(foramen))
}

fn thoracic(l: &SpineLevel) -> (Vec<Shape>, Vec<Shape>) {
    let (d, h) = (l.half_depth, l.half_height);
    let [length, drop] = l.spinous;
    let mut half = vec![
        cap(l.at(9.0, d - 2.0, h * 0.5), l.at(11.0, d + 11.0, h * 0.4), 4.0, 4.2),
        cap(l.at(11.5, d + 13.5, -h - 2.0), l.at(11.5, d + 11.5, h + 2.5), 4.4, 4.2),
        cap(l.at(11.0, d + 13.0, 1.0), l.at(30.0, d + 23.0, 3.0), 4.8, 4.4),
        cap(l.at(11.0, d + 14.0, 0.0), l.at(0.0, d + 20.0, -4.0), 4.2, 3.8),
    ];
    half.push(cap(l.at(0.0, d + 19.0, -4.0), l.at(0.0, d + 19.0 + length, -4.0 - drop), 4.0, 3.2));
    (both(half), Vec::new())
}

fn atlas() -> BoneSolid {
    let mut half =
        vec![ell([19.0, 2.0, -12.5], [8.5, 11.0, 7.5]), cap([24.0, 3.0, -13.0], [37.0, 5.0, -14.0], 5.5, 3.6)];
    half.extend(chain(&[[17.0, -6.0, -13.0, 4.2], [9.0, -14.0, -13.0, 4.0], [0.0, -17.5, -13.0, 4.2]]));
    half.extend(chain(&[
        [20.0, 9.0, -12.0, 4.2],
        [18.0, 21.0, -12.0, 3.4],
        [9.0, 31.0, -12.0, 3.6],
        [0.0, 34.0, -12.0, 4.2],
    ]));
    let foramen = both([cap([28.0, 3.0, -30.0], [28.0, 3.0, 0.0], 2.8, 2.8)]);
    BoneSolid::new("vertebrae_C1", Solid::of(both(half)).with(SolidRole::Cut, foramen))
}

fn axis() -> BoneSolid {
    let half = vec![
        ell([16.0, 1.0, -25.5], [8.5, 9.5, 5.0]),
        cap([17.0, 6.0, -39.5], [16.0, 3.0, -28.0], 5.2, 5.2),
        cap([15.0, 0.0, -31.0], [26.0, 3.0, -34.0], 4.2, 3.2),
        cap([15.0, 9.0, -33.0], [1.0, 27.0, -36.0], 4.2, 4.4),
        cap([1.5, 26.0, -36.0], [4.5, 39.0, -41.0], 4.6, 3.8),
    ];
    let mut shapes = both(half);
    shapes.push(cap([0.0, -8.0, -24.0], [0.0, -7.0, -9.0], 5.8, 4.6));
    let frame = Matrix3::identity();
    shapes.push(Shape::Cylinder { centre: V3::new(0.0, -9.0, -32.0), frame, radii: [10.0, 8.0], half: 9.4 });
    BoneSolid::new("vertebrae_C2", Solid::of(shapes))
}

/// All vertebrae, from C1 down.
pub(super) fn vertebrae() -> Vec<BoneSolid> {
    let mut out = vec![atlas(), axis()];
    for (l, name) in levels().iter().zip(NAMES) {
        let (mut add, cut) = if l.thoracic { thoracic(l) } else { cervical(l) };
        add.push(body(l));
        let solid = Solid::of(add).with(SolidRole::Cut, cut);
        out.push(BoneSolid::new(format!("vertebrae_{name}"), solid).filled(1.5, 800.0, 290.0));
    }
    out
}
