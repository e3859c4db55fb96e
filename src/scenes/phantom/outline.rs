//! The skin's surface, and the couch with its head support.

use super::build::{block, both, cap, chain, ell, ell_turned, loft_of};
use super::shape::{Shape, V3};
use super::texture::smoothstep;
use super::trunk_bones::{ELBOW, WRIST};

/// Face and upper neck: height, widest place, half width, front, back, power.
const FACE: [[f64; 6]; 13] = [
    [88.0, 22.0, 44.0, -66.0, 80.0, 2.2],
    [74.0, 18.0, 60.0, -79.0, 90.0, 2.4],
    [60.0, 15.0, 72.0, -83.0, 100.0, 2.9],
    [48.0, 12.0, 72.0, -82.0, 100.0, 2.8],
    [30.0, 8.0, 73.0, -84.0, 95.0, 2.8],
    [12.0, 4.0, 72.0, -94.0, 88.0, 2.5],
    [-4.0, 0.0, 70.0, -103.0, 80.0, 2.3],
    [-12.0, -2.0, 68.0, -104.0, 76.0, 2.2],
    [-24.0, -4.0, 65.0, -107.0, 70.0, 2.1],
    [-40.0, -6.0, 61.0, -112.0, 66.0, 2.0],
    [-50.0, -5.0, 58.0, -112.0, 62.0, 2.0],
    [-58.0, 0.0, 56.0, -97.0, 60.0, 2.0],
    [-66.0, 2.0, 54.0, -66.0, 60.0, 2.0],
];

/// Neck and trunk.
const TRUNK: [[f64; 6]; 14] = [
    [-20.0, 15.0, 60.0, -58.0, 76.0, 2.1],
    [-50.0, 8.0, 60.0, -62.0, 68.0, 2.1],
    [-75.0, 5.0, 59.0, -67.0, 66.0, 2.1],
    [-95.0, 6.0, 59.0, -66.0, 68.0, 2.1],
    [-115.0, 10.0, 63.0, -60.0, 76.0, 2.1],
    [-130.0, 15.0, 74.0, -57.0, 87.0, 2.1],
    [-142.0, 18.0, 94.0, -60.0, 96.0, 2.2],
    [-155.0, 20.0, 124.0, -66.0, 105.0, 2.4],
    [-170.0, 20.0, 148.0, -74.0, 112.0, 2.5],
    [-190.0, 18.0, 160.0, -86.0, 118.0, 2.6],
    [-220.0, 14.0, 162.0, -102.0, 121.0, 2.6],
    [-260.0, 10.0, 160.0, -116.0, 122.0, 2.6],
    [-300.0, 10.0, 158.0, -122.0, 122.0, 2.6],
    [-420.0, 10.0, 156.0, -122.0, 122.0, 2.6],
];

/// Shapes of the outline with the width over which each blends into the rest, mm.
pub(super) fn skin() -> Vec<(f64, Shape)> {
    let cranium = ell_turned([0.0, 26.0, 69.0], [76.5, 94.0, 68.0], [-13.0, 0.0, 0.0]);
    let mut out = vec![(0.0, loft_of(&TRUNK, 0.0)), (10.0, loft_of(&FACE, 0.0)), (9.0, cranium)];
    let mut blend = |width: f64, shapes: Vec<Shape>| out.extend(shapes.into_iter().map(|s| (width, s)));
    blend(9.0, vec![ell([0.0, 53.0, 29.0], [70.0, 63.0, 44.0])]);
    blend(9.0, vec![cap([0.0, -82.0, 48.0], [0.0, -102.0, 20.0], 7.0, 10.0)]);
    blend(5.0, both([ell([8.5, -98.0, 17.0], [7.0, 9.0, 7.0])]));
    blend(5.0, both([ell_turned([77.0, 20.0, 26.0], [4.5, 15.0, 27.0], [-12.0, 0.0, 18.0])]));
    blend(22.0, both([cap([58.0, 28.0, -140.0], [170.0, 12.0, -174.0], 26.0, 48.0)]));
    blend(18.0, both([cap([78.0, 70.0, -170.0], [150.0, 42.0, -160.0], 36.0, 34.0)]));
    blend(16.0, both([cap([90.0, -2.0, -160.0], [142.0, 4.0, -160.0], 33.0, 33.0)]));
    blend(14.0, both([cap([172.0, 12.0, -175.0], ELBOW, 52.0, 41.0)]));
    blend(8.0, both([cap(ELBOW, WRIST, 40.0, 24.0)]));
    blend(10.0, both([ell_turned([86.0, -98.0, -198.0], [34.0, 12.0, 48.0], [-8.0, 28.0, 0.0])]));
    blend(4.0, both(chain(&[[112.0, -100.0, -222.0, 11.0], [104.0, -100.0, -196.0, 9.0]])));
    out
}

/// Blended union (polynomial smooth minimum).
pub(super) fn blend(d: f64, next: f64, width: f64) -> f64 {
    if width <= 0.0 || (d - next).abs() >= width {
        return d.min(next);
    }
    let h = 1.0 - (d - next).abs() / width;
    d.min(next) - h * h * width * 0.25
}

/// Height (y) of the couch top below the lean patient, mm.
const COUCH_TOP: f64 = 123.0;

/// The treatment couch and head support: HU of each part with its solid, in painting order.
#[derive(Debug, Clone)]
pub(super) struct OutlineCouch {
    top: f64,
    parts: Vec<(f64, Shape)>,
    support: Shape,
}

impl OutlineCouch {
    /// The couch below a patient with so thick a layer of fat, mm.
    pub(super) fn new(fat: f64) -> Self {
        let y = COUCH_TOP + fat;
        let parts = vec![
            (-150.0, block([0.0, y + 22.0, -60.0], [262.0, 22.0, 400.0], 14.0)),
            (-955.0, block([0.0, y + 22.0, -60.0], [259.5, 19.5, 400.0], 12.0)),
            (60.0, block([0.0, y + 2.0, 30.0], [150.0, 2.0, 130.0], 1.0)),
            (120.0, block([118.0, y - 6.0, -8.0], [9.0, 7.0, 16.0], 2.0)),
            (120.0, block([-118.0, y - 6.0, -8.0], [9.0, 7.0, 16.0], 2.0)),
        ];
        Self { top: y, parts, support: block([0.0, y - 28.0, 10.0], [82.0, 28.0, 106.0], 12.0) }
    }

    /// HU at a point that is not patient; `skin` gives the distance to the resting patient's skin in mm.
    pub(super) fn hu(&self, p: &V3, skin: impl Fn() -> f64, edge: f64) -> f64 {
        if p.y < self.top - 58.0 {
            return -1000.0;
        }
        let mut hu = -1000.0;
        let mut paint = |value: f64, d: f64| hu += (value - hu) * smoothstep(0.5 * edge, -0.5 * edge, d);
        for (value, shape) in &self.parts {
            paint(*value, shape.distance(p));
        }
        // The support is hollowed to the patient's form with some room; a thin shell covers the foam.
        let outside = self.support.distance(p);
        if outside < edge {
            let hollow = outside.max(3.0 - skin());
            paint(-120.0, hollow);
            paint(-935.0, hollow + 1.6);
        }
        hu
    }
}
