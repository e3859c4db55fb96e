//! Skull, mandible with teeth, hyoid. Millimetres about the atlanto-occipital joint, LPS.

use super::build::{block, both, cap, chain, ell, ell_turned, plate};
use super::shape::Shape;
use super::solid::{BoneSolid, Solid, SolidRole};

/// Tilt of the cranium, degrees: forehead up.
const TILT: [f64; 3] = [-13.0, 0.0, 0.0];

/// The cranial cavity, grown by `grow` mm: cerebrum, posterior and middle fossae.
pub(super) fn cavity(grow: f64) -> Vec<Shape> {
    let r = |x: f64, y: f64, z: f64| [x + grow, y + grow, z + grow];
    let mut out = vec![
        ell_turned([0.0, 26.0, 68.0], r(64.0, 81.0, 56.0), TILT),
        ell([0.0, 53.0, 29.0], r(57.0, 50.0, 31.0)),
        cap([0.0, 6.0, 22.0], [0.0, 14.0, 4.0], 13.0 + grow, 12.0 + grow),
    ];
    out.extend(both([ell([36.0, 0.0, 44.0], r(26.0, 28.0, 24.0))]));
    out
}

/// Places of the teeth on one side of an arch scaled by `width`, from the midline backwards.
fn arch(width: f64) -> Vec<[f64; 2]> {
    let row = [[4.0, -88.0], [11.0, -86.0], [17.5, -81.5], [21.5, -75.5], [24.0, -69.0], [26.0, -61.5], [27.5, -52.5]];
    row.iter().map(|[x, y]| [x * width, *y]).collect()
}

/// Teeth of one jaw: capsules from the root at `root` to the crown at `crown` (z, mm).
fn teeth(width: f64, root: f64, crown: f64) -> Vec<Shape> {
    let tooth = |(n, [x, y]): (usize, &[f64; 2])| {
        let r = if n < 3 { 2.6 } else { 3.6 };
        cap([*x, *y + 2.0, root], [*x, *y, crown], r * 0.8, r)
    };
    both(arch(width).iter().enumerate().map(tooth))
}

fn face() -> Vec<Shape> {
    let mut half = vec![
        ell([23.0, -58.0, 17.0], [19.0, 23.0, 22.0]),
        ell([50.0, -56.0, 21.0], [10.0, 10.0, 12.0]),
        cap([50.0, -60.0, 28.0], [51.0, -58.0, 54.0], 4.5, 4.5),
        cap([14.0, -28.0, 18.0], [15.0, -25.0, -6.0], 3.0, 2.5),
        cap([14.0, 4.0, 19.0], [50.0, 22.0, 22.0], 9.0, 11.0),
        ell([56.0, 26.0, 8.0], [11.0, 15.0, 19.0]),
        ell([19.0, 3.0, 1.0], [7.0, 11.0, 6.0]),
        cap([46.0, 12.0, 4.0], [40.0, 4.0, -17.0], 2.2, 1.2),
        ell([47.0, -34.0, 34.0], [6.0, 20.0, 22.0]),
    ];
    half.extend(chain(&[
        [52.0, -54.0, 21.0, 4.0],
        [63.0, -38.0, 21.0, 3.2],
        [66.0, -18.0, 22.0, 3.0],
        [61.0, 2.0, 23.0, 4.5],
    ]));
    half.extend(chain(&[[9.0, -66.0, 57.0, 5.5], [30.0, -67.0, 61.0, 5.0], [50.0, -58.0, 55.0, 4.5]]));
    half.extend(chain(&[[15.0, -72.0, 27.0, 4.0], [34.0, -72.0, 22.0, 4.0], [50.0, -60.0, 22.0, 4.5]]));
    half.extend(chain(&[
        [0.0, -86.0, -1.0, 6.0],
        [11.0, -84.0, -1.0, 6.0],
        [21.0, -74.0, -1.0, 6.0],
        [26.0, -52.0, -1.0, 6.0],
    ]));
    half.extend(chain(&[[3.0, -70.0, 54.0, 3.5], [4.0, -86.0, 36.0, 2.2]]));
    half.extend(chain(&[[12.0, -72.0, 44.0, 2.5], [13.0, -80.0, 10.0, 3.5]]));
    let mut out = both(half);
    out.extend([
        ell([0.0, -14.0, 25.0], [17.0, 18.0, 14.0]),
        cap([0.0, -2.0, 22.0], [0.0, -7.0, 4.0], 6.5, 4.5),
        ell([0.0, -58.0, 63.0], [34.0, 13.0, 20.0]),
        ell([0.0, 106.0, 26.0], [9.0, 6.0, 7.0]),
    ]);
    out
}

/// The skull: vault, base, face and upper teeth.
pub(super) fn skull() -> BoneSolid {
    let mut cut = cavity(0.0);
    cut.extend(both([
        cap([33.0, -80.0, 40.0], [19.0, -34.0, 38.0], 18.0, 4.0),
        ell([24.0, -57.0, 17.0], [15.5, 19.5, 18.0]),
        cap([44.0, 14.0, 22.0], [84.0, 15.0, 23.0], 3.2, 3.8),
        ell([57.0, 27.0, 7.0], [5.0, 7.0, 9.0]),
        ell([9.0, -66.0, 62.0], [8.0, 4.0, 9.0]),
        ell([8.5, -14.0, 25.0], [7.5, 11.0, 8.5]),
    ]));
    cut.extend([
        ell([0.0, -60.0, 21.0], [13.0, 32.0, 17.0]),
        cap([0.0, -96.0, 16.0], [0.0, -70.0, 18.0], 10.0, 10.0),
        cap([0.0, 15.0, -30.0], [0.0, 14.0, 12.0], 15.5, 14.5),
    ]);
    let extra = [block([0.0, -56.0, 18.0], [0.35, 18.0, 16.0], 0.3), block([0.0, -58.0, 2.6], [20.0, 24.0, 1.3], 1.2)];
    let solid = Solid::default()
        .with(SolidRole::Add, cavity(6.5))
        .with(SolidRole::Add, face())
        .with(SolidRole::Cut, cut)
        .with(SolidRole::Extra, extra)
        .with(SolidRole::Tooth, teeth(1.0, -4.0, -9.6));
    BoneSolid::new("skull", solid).filled(2.0, 1250.0, 520.0)
}

/// The mandible: condyles, coronoids, rami, body, lower teeth.
pub(super) fn mandible() -> BoneSolid {
    let (neck, notch, coronoid) = ([51.0, -2.0, 4.0], [50.0, -16.0, -8.0], [50.0, -29.0, 6.0]);
    let (angle, front) = ([46.0, -8.0, -36.0], [46.0, -37.0, -24.0]);
    let low = [
        [46.0, -8.0, -36.0, 4.2],
        [42.0, -40.0, -43.0, 5.0],
        [30.0, -68.0, -47.0, 5.2],
        [14.0, -88.0, -48.0, 5.4],
        [0.0, -95.0, -48.0, 6.0],
    ];
    let high = [
        [46.0, -37.0, -24.0, 4.0],
        [36.0, -50.0, -24.0, 4.6],
        [28.0, -68.0, -24.0, 4.6],
        [15.0, -84.0, -24.0, 4.6],
        [0.0, -89.0, -24.0, 4.6],
    ];
    let mut half = vec![
        ell([51.0, -1.0, 9.0], [9.0, 5.0, 5.0]),
        cap([51.0, -2.0, 6.0], [50.0, -8.0, -10.0], 4.0, 4.0),
        plate([neck, notch, angle], 3.4),
        plate([notch, front, angle], 3.6),
        plate([coronoid, front, notch], 2.8),
    ];
    half.extend(chain(&low));
    half.extend(chain(&high));
    let xyz = |[x, y, z, _]: [f64; 4]| [x, y, z];
    for n in 0..4 {
        half.push(plate([xyz(low[n]), xyz(low[n + 1]), xyz(high[n])], 4.6));
        half.push(plate([xyz(high[n]), xyz(high[n + 1]), xyz(low[n + 1])], 4.6));
    }
    let solid = Solid::of(both(half)).with(SolidRole::Tooth, teeth(0.97, -22.0, -15.4));
    BoneSolid::new("mandible", solid).filled(2.2, 1350.0, 380.0)
}

/// The hyoid: body and greater horns.
pub(super) fn hyoid() -> BoneSolid {
    let half = chain(&[
        [0.0, -51.0, -67.0, 4.2],
        [11.0, -49.0, -67.0, 4.0],
        [19.0, -37.0, -65.0, 3.0],
        [25.0, -23.0, -63.0, 2.4],
    ]);
    BoneSolid::new("hyoid", Solid::of(both(half))).filled(1.4, 700.0, 280.0)
}
