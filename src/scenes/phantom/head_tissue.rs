//! Soft parts of head and neck, in painting order: later ones cover earlier ones. Millimetres, LPS.

use super::build::{block, both, cap, chain, ell, ell_turned, plate};
use super::head_bones::cavity;
use super::shape::Shape;
use super::solid::{Fill, Solid, SolidRole, SolidTissue};
use super::spine;

fn part(fill: Fill, shapes: impl IntoIterator<Item = Shape>) -> SolidTissue {
    SolidTissue { fill, solid: Solid::of(shapes) }
}

/// Muscles of head and neck, one tissue per muscle and side.
pub(super) fn muscles() -> Vec<SolidTissue> {
    let left: Vec<Vec<Shape>> = vec![
        // Sternocleidomastoid, levator scapulae, scalenes, longus colli.
        chain(&[
            [60.0, 24.0, 2.0, 8.0],
            [53.0, -4.0, -55.0, 11.0],
            [34.0, -30.0, -125.0, 10.0],
            [22.0, -50.0, -172.0, 6.0],
        ]),
        chain(&[[40.0, 8.0, -20.0, 8.0], [46.0, 24.0, -80.0, 10.0], [74.0, 62.0, -150.0, 9.0]]),
        chain(&[[30.0, -4.0, -50.0, 7.0], [36.0, 4.0, -100.0, 10.0], [48.0, 6.0, -150.0, 9.0]]),
        chain(&[[8.0, -22.0, -22.0, 4.5], [9.0, -23.0, -80.0, 5.5], [8.0, -8.0, -135.0, 5.0]]),
        // Semispinalis and erector spinae, splenius, trapezius, deep neck, suboccipital.
        chain(&[
            [17.0, 44.0, -8.0, 14.0],
            [17.0, 44.0, -70.0, 14.0],
            [18.0, 62.0, -130.0, 14.0],
            [22.0, 90.0, -190.0, 15.0],
            [26.0, 98.0, -300.0, 16.0],
        ]),
        chain(&[
            [46.0, 38.0, -6.0, 9.0],
            [35.0, 44.0, -60.0, 12.0],
            [28.0, 62.0, -120.0, 10.0],
            [8.0, 98.0, -185.0, 5.0],
        ]),
        chain(&[
            [9.0, 66.0, -20.0, 5.0],
            [26.0, 62.0, -70.0, 6.0],
            [56.0, 62.0, -115.0, 9.0],
            [100.0, 56.0, -136.0, 12.0],
            [150.0, 40.0, -136.0, 9.0],
        ]),
        chain(&[[13.0, 27.0, -42.0, 8.0], [14.0, 32.0, -110.0, 9.0], [14.0, 50.0, -150.0, 9.0]]),
        chain(&[[20.0, 34.0, -6.0, 8.0], [16.0, 28.0, -34.0, 8.0]]),
        // Sternohyoid, chewing muscles, temporalis, digastric, floor of the mouth.
        chain(&[[9.0, -56.0, -68.0, 4.0], [13.0, -53.0, -100.0, 4.5], [14.0, -50.0, -174.0, 4.0]]),
        chain(&[[60.0, -44.0, 17.0, 7.0], [57.0, -32.0, -8.0, 9.0], [54.0, -20.0, -32.0, 8.0]]),
        chain(&[[20.0, -30.0, 2.0, 8.0], [40.0, -17.0, -30.0, 9.0]]),
        chain(&[[22.0, -32.0, 14.0, 8.0], [44.0, -8.0, 10.0, 7.0]]),
        vec![
            ell_turned([64.0, -14.0, 50.0], [8.0, 34.0, 36.0], [0.0, -6.0, 8.0]),
            cap([61.0, -24.0, 30.0], [53.0, -28.0, 6.0], 8.0, 5.0),
        ],
        chain(&[[7.0, -88.0, -53.0, 5.0], [11.0, -56.0, -62.0, 4.5]]),
        vec![plate([[4.0, -86.0, -42.0], [38.0, -40.0, -40.0], [8.0, -50.0, -56.0]], 3.2)],
        // Lips and cheek.
        chain(&[[0.0, -98.0, -3.0, 5.5], [20.0, -91.0, -6.0, 5.0], [30.0, -80.0, -14.0, 5.0]]),
        chain(&[
            [0.0, -100.0, -22.0, 6.0],
            [19.0, -94.0, -22.0, 5.5],
            [32.0, -78.0, -16.0, 5.0],
            [41.0, -48.0, -12.0, 4.0],
        ]),
        vec![ell([13.0, -36.0, -42.0], [8.0, 12.0, 20.0]), cap([16.0, -24.0, 4.0], [19.0, -26.0, -70.0], 6.0, 6.0)],
    ];
    let mut out: Vec<SolidTissue> = Vec::new();
    for shapes in left {
        out.push(part(Fill::Muscle, shapes.iter().map(Shape::mirrored)));
        out.push(part(Fill::Muscle, shapes));
    }
    out.push(part(
        Fill::Muscle,
        [ell([0.0, -59.0, -17.0], [22.0, 27.0, 17.0]), ell([0.0, -44.0, -38.0], [19.0, 19.0, 20.0])],
    ));
    out
}

/// Glands, eyes, brain, cord, larynx and vessels.
pub(super) fn organs() -> Vec<SolidTissue> {
    let canal = |r: f64| {
        let knots: Vec<[f64; 4]> = spine::canal().iter().map(|&[x, y, z]| [x, y, z, r]).collect();
        chain(&knots)
    };
    let mut out = vec![
        part(Fill::Even(14.0), cavity(0.5)),
        part(Fill::Brain, cavity(-2.0)),
        part(
            Fill::Even(60.0),
            [block([0.0, 40.0, 92.0], [0.9, 78.0, 34.0], 0.8), block([0.0, 66.0, 46.0], [34.0, 34.0, 0.9], 0.8)],
        ),
        part(Fill::Organ(34.0), chain(&[[0.0, 4.0, 38.0, 13.0], [0.0, 6.0, 20.0, 12.0], [0.0, 14.0, 0.0, 7.5]])),
        part(
            Fill::Even(8.0),
            both([
                cap([9.0, -4.0, 76.0], [13.0, 44.0, 78.0], 5.0, 7.0),
                cap([16.0, 44.0, 76.0], [34.0, 16.0, 52.0], 5.0, 3.0),
            ]),
        ),
        part(
            Fill::Even(8.0),
            [block([0.0, 20.0, 64.0], [2.2, 12.0, 8.0], 2.0), ell([0.0, 28.0, 26.0], [7.0, 6.0, 8.0])],
        ),
        part(Fill::Even(12.0), canal(8.2)),
        part(Fill::Even(42.0), canal(5.0)),
        part(
            Fill::Organ(-6.0),
            both([ell([58.0, 4.0, -14.0], [10.0, 13.0, 20.0]), ell([62.0, -16.0, -4.0], [6.0, 16.0, 11.0])]),
        ),
        part(Fill::Organ(58.0), both([ell([35.0, -40.0, -54.0], [9.0, 14.0, 9.0])])),
        part(
            Fill::Organ(126.0),
            both([
                ell([15.0, -37.0, -116.0], [8.0, 10.0, 20.0]),
                cap([0.0, -46.0, -120.0], [12.0, -42.0, -120.0], 4.0, 5.0),
            ]),
        ),
        part(
            Fill::Organ(46.0),
            both([ell([42.0, -10.0, -50.0], [5.0, 6.0, 8.0]), ell([44.0, 6.0, -95.0], [4.5, 5.0, 7.0])]),
        ),
        part(Fill::Even(46.0), both([ell([32.0, -66.0, 40.0], [12.4, 12.4, 12.4])])),
        part(Fill::Even(10.0), both([ell([32.0, -66.0, 40.0], [11.0, 11.0, 11.0])])),
        part(Fill::Even(85.0), both([ell([32.0, -75.0, 40.0], [4.6, 2.2, 4.6])])),
        part(
            Fill::Even(48.0),
            both([
                cap([31.0, -54.0, 40.0], [17.0, -33.0, 37.0], 2.2, 2.4),
                cap([43.0, -66.0, 40.0], [22.0, -36.0, 38.0], 1.8, 1.8),
                cap([22.0, -66.0, 40.0], [17.0, -38.0, 38.0], 1.8, 1.8),
            ]),
        ),
    ];
    out.extend(throat());
    out.extend(vessels());
    out
}

fn throat() -> Vec<SolidTissue> {
    let shield = both([
        plate([[0.0, -58.0, -76.0], [0.0, -56.0, -96.0], [21.0, -30.0, -78.0]], 1.8),
        plate([[0.0, -56.0, -96.0], [21.0, -30.0, -78.0], [19.0, -30.0, -100.0]], 1.8),
    ]);
    let ring = Solid::of([cap([0.0, -37.0, -104.0], [0.0, -36.0, -110.0], 12.5, 12.5)])
        .with(SolidRole::Cut, [cap([0.0, -37.0, -90.0], [0.0, -36.0, -130.0], 9.0, 9.0)]);
    vec![
        part(Fill::Muscle, [cap([0.0, -40.0, -74.0], [0.0, -38.0, -100.0], 15.0, 13.0)]),
        part(Fill::Even(170.0), shield),
        SolidTissue { fill: Fill::Even(190.0), solid: ring },
        part(
            Fill::Even(90.0),
            [
                cap([0.0, -36.0, -108.0], [0.0, -33.0, -118.0], 10.5, 10.5),
                cap([0.0, -33.0, -118.0], [0.0, -20.0, -150.0], 10.0, 10.0),
            ],
        ),
        part(
            Fill::Organ(36.0),
            chain(&[[1.0, -19.0, -104.0, 6.0], [3.0, -17.0, -118.0, 6.0], [5.0, -4.0, -150.0, 6.0]]),
        ),
    ]
}

/// Carotid arteries and jugular veins with contrast.
fn vessels() -> Vec<SolidTissue> {
    let artery = [
        [23.0, -18.0, -158.0, 3.6],
        [25.0, -22.0, -120.0, 3.6],
        [29.0, -22.0, -75.0, 4.2],
        [30.0, -16.0, -40.0, 3.2],
        [27.0, -8.0, 4.0, 3.0],
    ];
    let vein =
        [[38.0, 0.0, 0.0, 4.5], [39.0, -12.0, -50.0, 6.0], [35.0, -20.0, -110.0, 6.5], [28.0, -32.0, -160.0, 7.0]];
    let external =
        [[31.0, -24.0, -70.0, 2.6], [38.0, -26.0, -50.0, 2.4], [50.0, -6.0, -20.0, 2.2], [54.0, -4.0, 0.0, 2.0]];
    vec![
        part(Fill::Even(165.0), both(chain(&vein))),
        part(Fill::Even(230.0), both(chain(&artery))),
        part(Fill::Even(220.0), both(chain(&external))),
    ]
}

/// Airway and sinuses, with what stands in them.
pub(super) fn airway() -> Vec<SolidTissue> {
    let nose =
        both([cap([6.0, -108.0, 11.0], [6.0, -88.0, 18.0], 3.4, 4.0), ell([7.0, -62.0, 19.0], [5.5, 26.0, 15.0])]);
    let mut air = nose;
    air.extend(both([
        ell([24.0, -57.0, 17.0], [14.6, 18.6, 17.0]),
        ell([9.0, -66.0, 62.0], [7.5, 3.5, 8.5]),
        ell([8.5, -14.0, 25.0], [7.0, 10.5, 8.0]),
        ell([57.0, 27.0, 7.0], [4.6, 6.6, 8.6]),
        cap([66.0, 14.0, 22.0], [90.0, 15.0, 23.0], 3.0, 4.0),
    ]));
    air.extend([
        ell([0.0, -33.0, 10.0], [11.0, 9.0, 12.0]),
        ell([0.0, -29.0, -8.0], [12.0, 5.5, 16.0]),
        ell([0.0, -27.0, -34.0], [14.0, 5.5, 22.0]),
        cap([0.0, -28.0, -50.0], [0.0, -33.0, -68.0], 6.0, 6.5),
        ell([0.0, -62.0, -1.8], [17.0, 22.0, 1.8]),
    ]);
    air.extend(both([ell([13.0, -27.0, -66.0], [5.0, 5.0, 9.0])]));
    air.extend(chain(&[
        [0.0, -36.0, -74.0, 7.0],
        [0.0, -38.0, -90.0, 3.6],
        [0.0, -38.0, -96.0, 5.0],
        [0.0, -36.0, -110.0, 8.5],
        [0.0, -20.0, -150.0, 8.5],
    ]));
    let conchae = both([
        cap([8.0, -80.0, 10.0], [8.5, -42.0, 11.0], 3.6, 3.2),
        cap([7.5, -74.0, 22.0], [8.0, -42.0, 22.0], 2.8, 2.4),
    ]);
    vec![
        part(Fill::Air, air),
        part(Fill::Even(40.0), conchae),
        // Septal cartilage, epiglottis and uvula.
        part(Fill::Even(75.0), [ell([0.0, -73.0, 18.0], [1.3, 26.0, 16.0])]),
        part(
            Fill::Even(60.0),
            [
                plate([[-7.0, -38.0, -58.0], [7.0, -38.0, -58.0], [0.0, -44.0, -74.0]], 1.4),
                cap([0.0, -34.0, -2.0], [0.0, -33.0, -14.0], 4.0, 2.5),
            ],
        ),
    ]
}
