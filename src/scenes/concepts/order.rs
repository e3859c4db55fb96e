//! Thesis Fig. 14 and 15: processing order in tissue with a rigid inclusion.

use super::sheet::{RIGID, Sheet, bone, soft, variant};
use super::{Content, Figure, Mesh, Panel};
use crate::chainmail::{Front, Node, Order, Variant};

const SIZE: [usize; 2] = [71, 71];

/// One element pulled upwards beside a rigid block.
fn sheet() -> Sheet {
    Sheet::new(SIZE, |i, j| match (i, j) {
        (26, 35) => bone(0),
        (38..=46, 26..=52) => (Node::Soft, RIGID),
        _ => soft(),
    })
    .moved([0.0, 14.0])
}

fn by(order: Order) -> Variant {
    Variant { order, ..variant() }
}

/// Fig. 14, with the round fronts that we prefer beside it.
pub(super) fn heat_maps() -> Figure {
    let sheet = sheet();
    let panel = |title, o| Panel::new(title, Content::Heat(sheet.heat(&o)));
    Figure {
        name: "fig14_processing_order",
        title: "Processing order in heterogeneous tissue (thesis Fig. 14)",
        caption: "A single element is moved upwards beside a rigid block; early elements are dark, late ones bright, elements that do not move are blank. Stiff tissue is fast (t = length x shear): the block is processed as soon as it is reached.",
        panels: vec![
            panel("(a) constraint violation", by(Order::ConstraintViolation)),
            panel("(b) timestamps", by(Order::Timestamps)),
            panel("(c) timestamps, round fronts", Variant { front: Front::Round, ..by(Order::Timestamps) }),
        ],
    }
}

/// Fig. 15.
pub(super) fn grids() -> Figure {
    let sheet = sheet();
    let close = |mesh: Mesh| Content::Mesh(Mesh { window: [[30.0, 40.0], [60.0, 70.0]], ..mesh });
    let (violation, timestamps) = (sheet.mesh(&by(Order::ConstraintViolation)), sheet.mesh(&by(Order::Timestamps)));
    Figure {
        name: "fig15_processing_order_grids",
        title: "Deformed grids by processing order (thesis Fig. 15)",
        caption: "The motion of Fig. 14; the blue outline is the block before. The block moves as one, and the deformed region is a rhombus around initiator and block. In this even material both orders take the paths of least loss and give one grid.",
        panels: vec![
            Panel::new("(a) constraint violation", Content::Mesh(violation.clone())),
            Panel::new("(b) close-up", close(violation)),
            Panel::new("(c) timestamps", close(timestamps)),
        ],
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_rigid_block_keeps_its_shape_and_fronts_are_rhombic_or_round() {
        let sheet = sheet();
        for order in [Order::ConstraintViolation, Order::Timestamps] {
            let mesh = sheet.mesh(&by(order));
            let shift = |i: usize, j: usize| mesh.place[i + SIZE[0] * j][1] - j as f64;
            let first = shift(38, 26);
            assert!(first > 5.0 && (38..=46).all(|i| (26..=52).all(|j| (shift(i, j) - first).abs() < 1e-4)));
        }
        // Left of the initiator tissue is even, and its own links take half the time: 10 mm away along the axis 9.5 soft
        // links; on the diagonal 20 links less a half, or 10 longer ones less a half.
        let late = |front, i: usize, j: usize| {
            let o = Variant { front, ..by(Order::Timestamps) };
            sheet.wave(&o).time[sheet.node(i, j)]
        };
        let ratio = |front| late(front, 16, 25) / late(front, 16, 35);
        assert!((ratio(Front::Rhombus) - 19.5 / 9.5).abs() < 1e-6, "{}", ratio(Front::Rhombus));
        assert!((ratio(Front::Round) - 2f64.sqrt()).abs() < 0.03, "{}", ratio(Front::Round));
    }
}
