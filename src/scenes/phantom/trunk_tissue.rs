//! Soft parts of trunk and arms, in painting order. Millimetres, LPS.

use super::build::{both, cap, chain, ell, ell_turned, loft_of, plate};
use super::shape::Shape;
use super::solid::{Fill, Solid, SolidRole, SolidTissue};
use super::spine;
use super::trunk_bones::{ELBOW, WRIST, cartilages};

/// Inner wall of the chest.
const CHEST: [[f64; 6]; 9] = [
    [-134.0, 20.0, 34.0, 4.0, 36.0, 2.0],
    [-148.0, 20.0, 49.0, -8.0, 46.0, 2.1],
    [-165.0, 20.0, 63.0, -22.0, 57.0, 2.2],
    [-185.0, 20.0, 80.0, -40.0, 68.0, 2.2],
    [-210.0, 20.0, 97.0, -57.0, 75.0, 2.3],
    [-235.0, 20.0, 109.0, -68.0, 79.0, 2.3],
    [-262.0, 18.0, 118.0, -76.0, 80.0, 2.3],
    [-290.0, 18.0, 123.0, -81.0, 82.0, 2.3],
    [-350.0, 18.0, 126.0, -84.0, 82.0, 2.3],
];

/// Space between the lungs.
const MEDIASTINUM: [[f64; 6]; 6] = [
    [-120.0, 0.0, 23.0, -90.0, 70.0, 2.5],
    [-170.0, 0.0, 27.0, -100.0, 70.0, 2.5],
    [-205.0, 0.0, 31.0, -100.0, 70.0, 2.3],
    [-235.0, -10.0, 38.0, -100.0, 66.0, 2.0],
    [-262.0, -20.0, 50.0, -105.0, 70.0, 2.0],
    [-350.0, -25.0, 66.0, -110.0, 70.0, 2.0],
];

fn part(fill: Fill, shapes: impl IntoIterator<Item = Shape>) -> SolidTissue {
    SolidTissue { fill, solid: Solid::of(shapes) }
}

/// Muscles of chest wall, shoulder and arm, one tissue per muscle and side.
pub(super) fn muscles() -> Vec<SolidTissue> {
    let left: Vec<Vec<Shape>> = vec![
        // Pectoralis major and minor.
        vec![
            plate([[20.0, -82.0, -206.0], [32.0, -104.0, -274.0], [148.0, -26.0, -192.0]], 7.0),
            plate([[20.0, -66.0, -186.0], [60.0, -54.0, -166.0], [148.0, -26.0, -186.0]], 6.5),
            cap([148.0, -26.0, -190.0], [178.0, -4.0, -206.0], 8.0, 4.0),
        ],
        vec![plate([[56.0, -82.0, -230.0], [92.0, -74.0, -262.0], [143.0, -22.0, -160.0]], 3.6)],
        // Deltoid, biceps, triceps.
        chain(&[[178.0, -22.0, -150.0, 9.0], [204.0, -14.0, -185.0, 15.0], [200.0, 0.0, -262.0, 10.0]]),
        chain(&[[190.0, 32.0, -150.0, 11.0], [206.0, 24.0, -190.0, 17.0], [200.0, 4.0, -258.0, 9.0]]),
        chain(&[[200.0, 6.0, -146.0, 11.0], [215.0, 4.0, -190.0, 12.0], [208.0, 2.0, -262.0, 7.0]]),
        chain(&[[170.0, -18.0, -206.0, 9.0], [180.0, -20.0, -270.0, 18.0], [196.0, -28.0, -400.0, 17.0]]),
        chain(&[[174.0, 36.0, -214.0, 12.0], [188.0, 32.0, -270.0, 19.0], [206.0, 20.0, -410.0, 16.0]]),
        // Supraspinatus, infraspinatus, subscapularis, teres and latissimus, rhomboid and trapezius.
        chain(&[[92.0, 80.0, -164.0, 6.0], [124.0, 56.0, -152.0, 8.0], [168.0, 20.0, -144.0, 4.0]]),
        vec![
            plate([[90.0, 100.0, -194.0], [98.0, 106.0, -270.0], [150.0, 46.0, -176.0]], 6.0),
            cap([120.0, 84.0, -190.0], [176.0, 36.0, -164.0], 8.0, 4.0),
        ],
        vec![
            plate([[82.0, 80.0, -176.0], [92.0, 92.0, -268.0], [140.0, 24.0, -178.0]], 5.5),
            cap([140.0, 22.0, -176.0], [166.0, -8.0, -172.0], 7.0, 4.0),
        ],
        vec![
            plate([[98.0, 98.0, -290.0], [138.0, 56.0, -292.0], [160.0, 30.0, -236.0]], 9.0),
            cap([150.0, 36.0, -240.0], [174.0, 2.0, -212.0], 10.0, 5.0),
        ],
        vec![plate([[10.0, 110.0, -190.0], [10.0, 116.0, -290.0], [88.0, 98.0, -186.0]], 3.6)],
        vec![plate([[12.0, 92.0, -160.0], [12.0, 108.0, -210.0], [86.0, 92.0, -240.0]], 3.2)],
        // Serratus and forearm.
        vec![plate([[88.0, 92.0, -270.0], [126.0, 40.0, -290.0], [110.0, 60.0, -200.0]], 4.0)],
        vec![cap(ELBOW, [128.0, -92.0, -272.0], 30.0, 17.0), cap([128.0, -92.0, -272.0], WRIST, 17.0, 11.0)],
        vec![ell_turned([86.0, -98.0, -200.0], [27.0, 7.0, 38.0], [-8.0, 28.0, 0.0])],
    ];
    let mut out: Vec<SolidTissue> = Vec::new();
    for shapes in left {
        out.push(part(Fill::Muscle, shapes.iter().map(Shape::mirrored)));
        out.push(part(Fill::Muscle, shapes));
    }
    out
}

/// Chest wall, lungs, mediastinum with vessels, trachea, cartilages. They cover the muscles.
pub(super) fn organs() -> Vec<SolidTissue> {
    let column: Vec<[f64; 4]> = spine::levels()
        .iter()
        .map(|l| [0.0, l.centre.y + 4.0, l.centre.z, 22.0])
        .chain([[0.0, 54.0, -350.0, 22.0]])
        .collect();
    let arches: Vec<[f64; 4]> = column.iter().map(|[x, y, z, _]| [*x, y + 34.0, *z, 25.0]).collect();
    let inside = Solid::of([loft_of(&CHEST, 0.0)]);
    let lungs = inside
        .clone()
        .with(SolidRole::Cut, chain(&column))
        .with(SolidRole::Cut, chain(&arches))
        .with(SolidRole::Cut, [loft_of(&MEDIASTINUM, 0.0)]);
    let mut out = vec![
        SolidTissue { fill: Fill::Fat, solid: inside },
        SolidTissue { fill: Fill::Lung, solid: lungs },
        part(Fill::Even(110.0), both(cartilages())),
    ];
    out.extend(vessels());
    out.push(part(Fill::Even(80.0), windpipe(2.2)));
    out.push(part(
        Fill::Organ(36.0),
        chain(&[
            [5.0, -4.0, -150.0, 6.0],
            [7.0, 10.0, -185.0, 6.0],
            [8.0, 22.0, -230.0, 6.5],
            [9.0, 26.0, -300.0, 7.0],
        ]),
    ));
    out.push(part(Fill::Air, windpipe(0.0)));
    out.push(part(Fill::Air, [cap([7.0, 10.0, -186.0], [8.0, 19.0, -220.0], 1.6, 1.6)]));
    out
}

/// Lower trachea and main bronchi.
fn windpipe(wall: f64) -> Vec<Shape> {
    let mut out =
        chain(&[[0.0, -20.0, -150.0, 8.5 + wall], [0.0, -6.0, -185.0, 8.5 + wall], [2.0, 4.0, -218.0, 8.5 + wall]]);
    out.extend(both([cap([3.0, 4.0, -219.0], [42.0, 16.0, -250.0], 6.5 + wall, 5.0 + wall)]));
    out
}

/// Great vessels and the upper heart, with contrast.
fn vessels() -> Vec<SolidTissue> {
    let veins = [
        chain(&[[-25.0, -36.0, -184.0, 8.0], [-27.0, -36.0, -225.0, 9.0], [-27.0, -34.0, -300.0, 10.0]]),
        chain(&[[28.0, -36.0, -166.0, 6.5], [0.0, -40.0, -182.0, 6.0], [-25.0, -37.0, -188.0, 7.0]]),
        both(chain(&[
            [28.0, -34.0, -164.0, 6.5],
            [60.0, -28.0, -166.0, 5.0],
            [112.0, -18.0, -174.0, 4.5],
            [150.0, -8.0, -196.0, 4.0],
        ])),
        chain(&[[-28.0, -34.0, -164.0, 6.5], [-25.0, -36.0, -186.0, 7.0]]),
    ];
    let arteries = [
        chain(&[
            [-9.0, -40.0, -275.0, 15.0],
            [-12.0, -42.0, -235.0, 14.0],
            [2.0, -32.0, -215.0, 13.0],
            [17.0, -6.0, -214.0, 12.0],
            [24.0, 22.0, -230.0, 11.5],
            [24.0, 34.0, -300.0, 11.0],
        ]),
        chain(&[[-4.0, -34.0, -210.0, 7.0], [-16.0, -28.0, -185.0, 6.0], [-23.0, -18.0, -158.0, 4.5]]),
        chain(&[[10.0, -22.0, -208.0, 4.0], [20.0, -20.0, -180.0, 3.8], [23.0, -18.0, -158.0, 3.6]]),
        both(chain(&[
            [22.0, -10.0, -176.0, 4.5],
            [36.0, 2.0, -158.0, 4.2],
            [62.0, -4.0, -158.0, 4.0],
            [110.0, -6.0, -172.0, 3.8],
            [152.0, 4.0, -196.0, 3.4],
            [172.0, 8.0, -260.0, 3.2],
        ])),
        chain(&[[17.0, -4.0, -210.0, 4.2], [22.0, -10.0, -176.0, 4.2]]),
    ];
    vec![
        part(Fill::Even(170.0), veins.into_iter().flatten()),
        part(Fill::Organ(150.0), [ell([14.0, -36.0, -308.0], [52.0, 44.0, 50.0])]),
        part(
            Fill::Even(215.0),
            chain(&[
                [16.0, -46.0, -275.0, 14.0],
                [16.0, -34.0, -246.0, 13.0],
                [30.0, -4.0, -246.0, 10.0],
                [50.0, 14.0, -252.0, 8.0],
            ]),
        ),
        part(
            Fill::Even(215.0),
            chain(&[[14.0, -24.0, -246.0, 10.0], [-24.0, -14.0, -250.0, 9.0], [-48.0, 10.0, -256.0, 7.0]]),
        ),
        part(Fill::Even(240.0), arteries.into_iter().flatten()),
    ]
}

/// The chest wall between the ribs: muscle, but under the shoulder's muscles.
pub(super) fn chest_wall() -> SolidTissue {
    part(Fill::Muscle, [loft_of(&CHEST, 10.5)])
}
