//! Ribs, sternum and the bones of shoulder and arm. Millimetres, LPS.
//!
//! The arms lie along the body with the elbows bent and the hands on the chest, so that humerus, radius and
//! ulna are all in the field of view of a head and neck scan.

use super::build::{bar, cap, chain, ell, on_side, plate};
use super::shape::{Shape, V3};
use super::solid::{BoneSolid, Solid};
use super::spine;

/// Centre of the left humeral head.
pub(super) const SHOULDER: [f64; 3] = [170.0, 12.0, -166.0];
/// Centre of the left elbow.
pub(super) const ELBOW: [f64; 3] = [205.0, -5.0, -427.0];
/// Centre of the left wrist.
pub(super) const WRIST: [f64; 3] = [110.0, -113.0, -238.0];

/// Angle, side and front end of each left rib's bony part; tubercle and head come from the vertebra.
const RIBS: [[[f64; 3]; 4]; 7] = [
    [[46.0, 30.0, -144.0], [59.0, 6.0, -156.0], [52.0, -24.0, -170.0], [37.0, -41.0, -178.0]],
    [[62.0, 52.0, -171.0], [88.0, 14.0, -189.0], [78.0, -36.0, -203.0], [47.0, -62.0, -210.0]],
    [[72.0, 70.0, -191.0], [105.0, 18.0, -213.0], [95.0, -42.0, -228.0], [55.0, -74.0, -235.0]],
    [[78.0, 78.0, -212.0], [117.0, 18.0, -237.0], [107.0, -46.0, -252.0], [66.0, -82.0, -259.0]],
    [[82.0, 82.0, -233.0], [125.0, 18.0, -262.0], [116.0, -46.0, -276.0], [80.0, -85.0, -283.0]],
    [[85.0, 83.0, -255.0], [130.0, 18.0, -287.0], [122.0, -44.0, -302.0], [94.0, -84.0, -309.0]],
    [[87.0, 84.0, -277.0], [133.0, 18.0, -312.0], [126.0, -42.0, -328.0], [106.0, -82.0, -335.0]],
];

/// Ribs on each side.
pub(super) const RIBS_EACH_SIDE: usize = RIBS.len();

/// Points along a Catmull-Rom curve through the knots.
fn smooth(knots: &[V3], per_span: usize) -> Vec<V3> {
    let get = |n: isize| knots[n.clamp(0, knots.len() as isize - 1) as usize];
    let mut out = Vec::new();
    for span in 0..knots.len() as isize - 1 {
        let [a, b, c, d] = [get(span - 1), get(span), get(span + 1), get(span + 2)];
        for step in 0..per_span {
            let t = step as f64 / per_span as f64;
            let (m, n) = ((c - a) * 0.5, (d - b) * 0.5);
            let (t2, t3) = (t * t, t * t * t);
            out.push(
                b * (2.0 * t3 - 3.0 * t2 + 1.0) + m * (t3 - 2.0 * t2 + t) + c * (3.0 * t2 - 2.0 * t3) + n * (t3 - t2),
            );
        }
    }
    out.push(get(knots.len() as isize - 1));
    out
}

/// Head of left rib `n + 1`, where it turns.
pub(super) fn rib_head(n: usize) -> [f64; 3] {
    let l = spine::levels()[n + 5];
    l.at(l.half_width + 4.0, l.half_depth * 0.6, l.half_height * 0.8)
}

fn rib(n: usize) -> Vec<Shape> {
    let l = spine::levels()[n + 5];
    let head = rib_head(n);
    let tubercle = l.at(31.0, l.half_depth + 14.0, 3.5);
    let mut knots = vec![V3::from(head), V3::from(tubercle)];
    knots.extend(RIBS[n].iter().map(|p| V3::from(*p)));
    let line = smooth(&knots, 5);
    let mut out = vec![ell(head, [4.2, 4.2, 4.2])];
    // Two strands one above the other make the flat section of a rib.
    for lift in [-2.6, 2.6] {
        let up = V3::new(0.0, 0.0, lift);
        let spread = |i: usize| if i < 5 { up * 0.3 } else { up };
        out.extend(
            (1..line.len()).map(|i| cap((line[i - 1] + spread(i - 1)).into(), (line[i] + spread(i)).into(), 3.5, 3.5)),
        );
    }
    out
}

/// Where the costal cartilages of the left side join: rib end and sternum edge.
pub(super) fn cartilages() -> Vec<Shape> {
    let at_sternum = [
        [24.0, -50.0, -186.0],
        [22.0, -71.0, -226.0],
        [18.0, -78.0, -246.0],
        [18.0, -82.0, -266.0],
        [18.0, -86.0, -284.0],
    ];
    let ends = RIBS.iter().map(|r| r[3]);
    ends.zip(at_sternum).map(|(a, b)| cap(a, b, 5.5, 5.5)).collect()
}

fn clavicle() -> Vec<Shape> {
    chain(&[
        [23.0, -47.0, -171.0, 8.5],
        [36.0, -48.0, -167.0, 6.5],
        [62.0, -42.0, -159.0, 5.6],
        [95.0, -24.0, -149.0, 5.4],
        [130.0, 0.0, -140.0, 5.8],
        [163.0, 14.0, -134.0, 6.2],
    ])
}

fn scapula() -> Vec<Shape> {
    let (top, tip, neck) = ([80.0, 84.0, -162.0], [97.0, 101.0, -277.0], [138.0, 34.0, -172.0]);
    let mut out = vec![
        plate([top, tip, neck], 2.3),
        cap(tip, neck, 3.8, 5.0),
        ell([145.0, 23.0, -168.0], [8.0, 14.0, 17.0]),
        plate([[86.0, 90.0, -184.0], [124.0, 60.0, -168.0], [124.0, 74.0, -148.0]], 2.4),
    ];
    out.extend(chain(&[
        [84.0, 92.0, -182.0, 3.5],
        [124.0, 76.0, -147.0, 4.6],
        [156.0, 46.0, -137.0, 5.5],
        [178.0, 24.0, -135.0, 5.2],
        [180.0, 4.0, -136.5, 4.6],
    ]));
    out.extend(chain(&[[142.0, 18.0, -159.0, 7.0], [138.0, -8.0, -160.0, 5.5], [145.0, -22.0, -166.0, 4.5]]));
    out
}

fn humerus() -> Vec<Shape> {
    let mut out = vec![ell(SHOULDER, [22.5, 22.5, 22.5]), ell([186.0, 12.0, -173.0], [10.0, 13.0, 15.0])];
    out.extend(chain(&[
        [176.0, 12.0, -180.0, 17.0],
        [180.0, 10.0, -212.0, 12.0],
        [192.0, 3.0, -320.0, 11.0],
        [203.0, -4.0, -410.0, 11.0],
    ]));
    out.push(cap([184.0, -4.0, -424.0], [225.0, -4.0, -424.0], 8.0, 8.0));
    out
}

/// Points of the forearm: `along` from elbow (0) to wrist (1), `up` mm towards the thumb's side.
fn forearm(along: f64, up: f64) -> [f64; 3] {
    let (e, w) = (V3::from(ELBOW), V3::from(WRIST));
    let side = (w - e).cross(&V3::y()).normalize() * -up;
    (e + (w - e) * along + side).into()
}

fn radius() -> Vec<Shape> {
    let (head, shaft, end) = (forearm(0.06, 8.0), forearm(0.8, 10.0), forearm(1.0, 9.0));
    vec![cap(head, shaft, 7.0, 7.0), cap(shaft, end, 7.0, 11.0)]
}

fn ulna() -> Vec<Shape> {
    let (olecranon, shaft, end) = (forearm(-0.05, -6.0), forearm(0.1, -8.0), forearm(0.98, -13.0));
    vec![cap(olecranon, shaft, 11.0, 8.0), cap(shaft, end, 7.5, 6.0)]
}

/// All bones of the trunk and arms; left before right.
pub(super) fn bones() -> Vec<BoneSolid> {
    let mut out = Vec::new();
    let sides = [(1.0, "left"), (-1.0, "right")];
    for n in 0..RIBS.len() {
        for (side, word) in sides {
            let solid = Solid::of(on_side(side, rib(n)));
            out.push(BoneSolid::new(format!("rib_{word}_{}", n + 1), solid).filled(1.4, 850.0, 240.0));
        }
    }
    let sternum = [
        bar([0.0, -46.0, -178.0], [0.0, -70.0, -224.0], 25.0, 5.5),
        bar([0.0, -72.0, -228.0], [0.0, -89.0, -330.0], 17.0, 5.5),
    ];
    out.push(BoneSolid::new("sternum", Solid::of(sternum)).filled(1.3, 650.0, 200.0));
    for (side, word) in sides {
        let mut add = |name: &str, shapes: Vec<Shape>, cortex: f64, marrow: f64| {
            let solid = Solid::of(on_side(side, shapes));
            out.push(BoneSolid::new(format!("{name}_{word}"), solid).filled(cortex, 1200.0, marrow));
        };
        add("clavicula", clavicle(), 2.2, 330.0);
        add("scapula", scapula(), 1.6, 260.0);
        add("humerus", humerus(), 3.2, 170.0);
        add("radius", radius(), 2.6, 180.0);
        add("ulna", ulna(), 2.6, 180.0);
    }
    out
}
