//! Thesis Fig. 23 to 25: initiating structures and the sorting criteria that cure their artefacts.

use super::sheet::{Sheet, bone, stiff, variant};
use super::{Content, Figure, Panel};
use crate::chainmail::{Constraint, Node, Structures, Variant};
use crate::error::{Error, Result};
use crate::phantom::Anatomy;
use nalgebra::{Point3, Vector3};

fn panel(title: &str, sheet: &Sheet, structures: Structures, window: [[f64; 2]; 2]) -> Panel {
    Panel::new(title, Content::Mesh(sheet.close_up(&Variant { structures, ..variant() }, window)))
}

fn structure(size: [usize; 2], shift: f64, inside: impl Fn(usize, usize) -> bool) -> Sheet {
    Sheet::new(size, |i, j| if inside(i, j) { bone(0) } else { stiff() }).moved([shift, 0.0])
}

fn l(i: usize, j: usize) -> bool {
    matches!((i, j), (18..=21, 16..=46) | (18..=48, 16..=19))
}

fn u(i: usize, j: usize) -> bool {
    matches!((i, j), (14..=17 | 47..=50, 16..=46) | (14..=50, 16..=19))
}

/// Fig. 23.
pub(super) fn l_shape() -> Figure {
    let size = [65, 61];
    let rectangle = structure(size, 5.0, |i, j| (22..=40).contains(&i) && (22..=36).contains(&j));
    let l = structure(size, 5.0, l);
    let window = [[12.0, 10.0], [60.0, 54.0]];
    Figure {
        name: "fig23_l_shape",
        title: "Rectangle and L-shape moved to the right (thesis Fig. 23)",
        caption: "With timestamps only, elements inside the L take compression from one bar or shear from the other: a diagonal border. The second criterion averages both along each wave front.",
        panels: vec![
            panel("(a) rectangle, timestamps", &rectangle, Structures::None, [[10.0, 8.0], [58.0, 52.0]]),
            panel("(b) L, timestamps", &l, Structures::None, window),
            panel("(c) L, second criterion", &l, Structures::SecondCriterion, window),
        ],
    }
}

/// Tissue that can be pressed to half its length and hardly stretched: what the left bar hands on dies out at
/// another pace than what the right bar does, so that it shows where the two meet.
const UNEQUAL: Constraint = Constraint { min: 0.5, max: 1.1, shear: 0.2 };

fn u_sheet() -> Sheet {
    Sheet::new([65, 61], |i, j| if u(i, j) { bone(0) } else { (Node::Soft, UNEQUAL) }).moved([8.0, 0.0])
}

/// Fig. 24.
pub(super) fn u_shape() -> Figure {
    let sheet = u_sheet();
    let window = [[14.0, 14.0], [62.0, 50.0]];
    Figure {
        name: "fig24_u_shape",
        title: "U-shape moved to the right (thesis Fig. 24)",
        caption: "Tissue that can be pressed to half and stretched by a tenth. With the second criterion alone, what the two bars hand on meets at another place on every wave front, and the grid is ragged. With the third it meets in the middle on all of them: half as ragged (0.043 mm of bend along the bars, for 0.081), with a sharp border that stays.",
        panels: vec![
            panel("(a) second criterion", &sheet, Structures::SecondCriterion, window),
            panel("(b) second and third criterion", &sheet, Structures::ThirdCriterion, window),
        ],
    }
}

/// Centre of the body of the phantom's vertebra C7, LPS mm; the cut is along its end plates, that is along x and this.
const C7: [f64; 3] = [0.0, 2.0, -125.7];
const BACK: [f64; 3] = [0.0, 0.918, 0.397];
/// Spacing of the cut, mm.
const STEP: f64 = 1.1;

/// Fig. 25.
pub(super) fn vertebra() -> Result<Figure> {
    let size = [65, 61];
    let anatomy = Anatomy::new(0.5, 0.0);
    let body = anatomy.sample(&Point3::from(C7)).label;
    if body == 0 {
        return Err(Error::Internal("the phantom has no vertebra at the place of the figure".into()));
    }
    let inside = |i: usize, j: usize| {
        // As an axial CT is shown: the back at the bottom.
        let (x, back) = ((i as f64 - 32.0) * STEP, (38.0 - j as f64) * STEP);
        let place = Point3::from(C7) + Vector3::x() * x + Vector3::from(BACK) * back;
        anatomy.sample(&place).label == body
    };
    let sheet = structure(size, 6.0, inside);
    let window = [[17.0, 11.0], [57.0, 44.0]];
    Ok(Figure {
        name: "fig25_vertebra",
        title: "Vertebra of the phantom moved to the right (thesis Fig. 25)",
        caption: "A cut along the end plates of C7. Timestamps alone leave borders as in the L, which the second criterion softens. The canal is too small for what the third adds: here it gives what the second gives.",
        panels: vec![
            panel("(a) timestamps", &sheet, Structures::None, window),
            panel("(b) second criterion", &sheet, Structures::SecondCriterion, window),
            panel("(c) second and third", &sheet, Structures::ThirdCriterion, window),
        ],
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Mean second difference of the displacement across the diagonal inside the L: how sharp the border is.
    fn border(structures: Structures) -> f64 {
        let sheet = structure([65, 61], 5.0, l);
        let d = sheet.displacement(&Variant { structures, ..variant() });
        let at = |i: usize, j: usize| d[i + 65 * j][0];
        let bend = |i: usize, j: usize| (at(i - 1, j + 1) - 2.0 * at(i, j) + at(i + 1, j - 1)).abs();
        (24..34).map(|i| bend(i, i - 2)).sum::<f64>() / 10.0
    }

    #[test]
    fn the_second_criterion_softens_the_border_inside_the_l() {
        let (plain, second) = (border(Structures::None), border(Structures::SecondCriterion));
        // Beyond the diagonal one bar is 0.25 mm per link nearer: the slope turns by twice that.
        assert!((plain - 0.5).abs() < 1e-4 && second < 0.65 * plain, "{plain} {second}");
    }

    /// Mean second difference along the bars of the displacement inside the U, mm: what differs from wave front to
    /// wave front.
    fn raggedness(structures: Structures) -> f64 {
        let d = u_sheet().displacement(&Variant { structures, ..variant() });
        let at = |i: usize, j: usize| d[i + 65 * j][0];
        let inside: Vec<_> = (21..44).flat_map(|j| (18..46).map(move |i| (i, j))).collect();
        let bend = |&(i, j): &(usize, usize)| (at(i, j - 1) - 2.0 * at(i, j) + at(i, j + 1)).abs();
        inside.iter().map(bend).sum::<f64>() / inside.len() as f64
    }

    #[test]
    fn the_third_criterion_lets_what_both_bars_of_the_u_hand_on_meet_at_one_place() {
        let (second, third) = (raggedness(Structures::SecondCriterion), raggedness(Structures::ThirdCriterion));
        assert!(second > 1.7 * third, "{second} {third}");
        assert!((second - 0.081).abs() < 5e-4 && (third - 0.043).abs() < 5e-4, "as the caption says: {second} {third}");
    }

    #[test]
    fn the_vertebra_has_a_canal() {
        let figure = vertebra().unwrap();
        let Content::Mesh(mesh) = &figure.panels[0].content else { panic!("a grid") };
        let count = mesh.rigid.iter().filter(|&&r| r).count();
        assert!((300..1800).contains(&count), "{count} elements of bone");
        let bone = |i: usize, j: usize| mesh.rigid[i + 65 * j];
        // Body, canal behind it, and a pedicle on either side.
        assert!(bone(32, 38) && !bone(32, 26) && (15..30).any(|i| bone(i, 26)) && (35..50).any(|i| bone(i, 26)));
    }
}
