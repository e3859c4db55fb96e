//! Thesis Fig. 17 and 18: how a rotation decays.

use super::sheet::{Sheet, bone, soft, variant};
use super::{Content, Curves, Figure, Panel, Series};
use crate::chainmail::{Carry, Variant};

const KINDS: [(&str, Carry); 2] =
    [("(a) constraint-based", Carry::ConstraintBased), ("(b) linear decay", Carry::LinearDecay)];

/// Angle (degrees) of each element of a chain that starts at the rotation point, by its distance in mm.
fn decay_curve(initiator: usize, degrees: f64, carry: Carry) -> Vec<[f64; 2]> {
    const LENGTH: usize = 81;
    let chain = Sheet::new([LENGTH, 1], |i, _| if i == initiator { bone(0) } else { soft() }).turned(degrees, [0.0; 2]);
    let wave = chain.wave(&Variant { carry, ..variant() });
    (1..LENGTH).map(|i| [i as f64, f64::from(wave.angle[chain.node(i, 0)]).to_degrees()]).collect()
}

/// Fig. 17.
pub(super) fn decay() -> Figure {
    const TIPS: [(usize, f64); 3] = [(7, 75.0), (30, 40.0), (55, 20.0)];
    let panel = |(title, carry): (&str, Carry)| {
        let series = TIPS.iter().enumerate().map(|(colour, &(at, degrees))| Series {
            name: format!("{degrees:.0}\u{b0} at {at} mm"),
            colour,
            marks: false,
            points: decay_curve(at, degrees, carry),
        });
        let curves = Curves {
            x: "distance from rotation point, mm".into(),
            y: "angle, degrees".into(),
            series: series.collect(),
        };
        Panel::new(title, Content::Curves(curves))
    };
    Figure {
        name: "fig17_angle_decay",
        title: "Decay of the angle along a chain (thesis Fig. 17)",
        caption: "Three initial rotations. Constraint-based decay is steeper towards the rotation point, flatter away from it, and changes its slope where one direction is resolved before the other; linear decay is uniform.",
        panels: KINDS.map(panel).into(),
    }
}

/// Fig. 18.
pub(super) fn grids() -> Figure {
    let sheet =
        Sheet::new([57, 57], |i, j| if (i, j) == (32, 25) { bone(0) } else { soft() }).turned(20.0, [10.0, 25.0]);
    let panel =
        |(title, carry): (&str, Carry)| Panel::new(title, Content::Mesh(sheet.mesh(&Variant { carry, ..variant() })));
    Figure {
        name: "fig18_rotation_grids",
        title: "Deformed grids of a rotation by 20 degrees (thesis Fig. 18)",
        caption: "A single element turns about a point to its left, in even tissue. The constraint-based approach leaves irregularities where one direction's violation is resolved before the other's.",
        panels: KINDS.map(panel).into(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn linear_decay_is_uniform_and_constraint_based_decay_is_not() {
        let slopes = |carry| {
            let curve = decay_curve(30, 40.0, carry);
            let slope = |a: usize| (curve[a][1] - curve[a - 1][1]).abs();
            // Two links towards the rotation point, two away from it; the initiator is point 29 of the curve.
            [slope(26), slope(34)]
        };
        let [towards, away] = slopes(Carry::LinearDecay);
        assert!((towards - away).abs() < 1e-3 && towards > 0.5, "{towards} {away}");
        let [towards, away] = slopes(Carry::ConstraintBased);
        assert!(towards > 1.1 * away && away > 0.0, "{towards} {away}");
    }
}
