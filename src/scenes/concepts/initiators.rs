//! Thesis Fig. 19 and 20: several initiators.

use super::sheet::{Sheet, bone, soft, variant};
use super::{Content, Curves, Figure, Panel, Series};
use crate::chainmail::{Carry, Combination, Variant};

/// Weight of the left of two bones at the ends of a chain, by the share of the way to the right one.
fn weight(exponent: f64) -> Vec<[f64; 2]> {
    const LENGTH: usize = 81;
    let chain = Sheet::new([LENGTH, 1], |i, _| match i {
        0 => bone(0),
        80 => bone(1),
        _ => soft(),
    })
    .moved([1.0, 0.0])
    .moved([0.0, 0.0]);
    let o = Variant { carry: Carry::Rigid, combination: Combination::Superposition, exponent, ..variant() };
    let time = chain.wave(&o).time;
    // Both halves are reached at the same pace: time from the left is the whole less that from the right.
    let middle = 2.0 * time[chain.node(LENGTH / 2, 0)];
    let left = |i: usize| if i <= LENGTH / 2 { time[chain.node(i, 0)] } else { middle - time[chain.node(i, 0)] };
    chain.displacement(&o).iter().enumerate().map(|(i, u)| [4.0 * left(i) / middle, u[0]]).collect()
}

/// Fig. 19.
pub(super) fn weights() -> Figure {
    let series = [1.0, 2.0, 4.0, 8.0].iter().enumerate().map(|(colour, &n)| Series {
        name: format!("n = {n}"),
        colour,
        marks: false,
        points: weight(n),
    });
    let curves = Curves { x: "time from the left initiator".into(), y: "its weight".into(), series: series.collect() };
    Figure {
        name: "fig19_weights",
        title: "Weights of superposition (thesis Fig. 19)",
        caption: "Displacement between an initiator that moves by 1 (at time 0) and one that does not (at time 4): the weight of eq. 5.8. With greater n it nears the step of prioritisation.",
        panels: vec![Panel::new("", Content::Curves(curves))],
    }
}

/// Fig. 20.
pub(super) fn grids() -> Figure {
    let sheet = |apart: f64| {
        Sheet::new([61, 41], |i, j| match (i, j) {
            (23, 20) => bone(0),
            (37, 20) => bone(1),
            _ => soft(),
        })
        .moved([-apart, 0.0])
        .moved([apart, 0.0])
    };
    let panel = |title, apart: f64, combination| {
        let o = Variant { combination, exponent: 1.0, ..variant() };
        Panel::new(title, Content::Mesh(sheet(apart).mesh(&o)))
    };
    Figure {
        name: "fig20_two_initiators",
        title: "Two initiators torn apart and pushed together (thesis Fig. 20)",
        caption: "Prioritisation overstretches the links at the border of the two regions, or folds them; superposition (n = 1) spreads the conflict over all tissue between.",
        panels: vec![
            panel("(a) prioritisation, apart", 5.0, Combination::Prioritisation),
            panel("(b) prioritisation, together", -5.0, Combination::Prioritisation),
            panel("(c) superposition, apart", 5.0, Combination::Superposition),
            panel("(d) superposition, together", -5.0, Combination::Superposition),
        ],
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn weights_follow_eq_5_8() {
        for n in [1.0, 2.0, 4.0] {
            for [t, w] in weight(n).into_iter().filter(|[t, _]| (0.0..4.0).contains(t) && *t > 0.0) {
                let expected = (4.0 - t).powf(n) / (t.powf(n) + (4.0 - t).powf(n));
                assert!((w - expected).abs() < 1e-4, "n = {n}, t = {t}: {w} for {expected}");
            }
        }
    }

    #[test]
    fn prioritisation_folds_where_superposition_does_not() {
        // Least length of a link along x in the row of the initiators.
        let least = |panel: &Panel| {
            let Content::Mesh(mesh) = &panel.content else { panic!("a grid") };
            let x = |i: usize| mesh.place[i + mesh.size[0] * 20][0];
            (24..36).map(|i| x(i + 1) - x(i)).fold(f64::MAX, f64::min)
        };
        let figure = grids();
        assert!(least(&figure.panels[1]) < 0.0 && least(&figure.panels[3]) > 0.0);
        let longest = |panel: &Panel| {
            let Content::Mesh(mesh) = &panel.content else { panic!("a grid") };
            let x = |i: usize| mesh.place[i + mesh.size[0] * 20][0];
            (23..37).map(|i| x(i + 1) - x(i)).fold(0.0, f64::max)
        };
        assert!(longest(&figure.panels[0]) > 1.5 * longest(&figure.panels[2]));
    }
}
