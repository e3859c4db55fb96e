//! What is said of a field.

use crate::evaluate::jacobian::JacobianReport;
use crate::field::{InverseReport, PushField};
use crate::findings;
use crate::warning::{Warning, counted};

/// Findings about the field.
pub(super) fn field_warnings(push: &PushField, jacobian: &JacobianReport, inverse: &InverseReport) -> Vec<Warning> {
    let mut out = Vec::new();
    if jacobian.body.folded > 0 {
        out.push(Warning::new(
            findings::FOLDED,
            format!(
                "of {} tissue cells outside bone contact and sliding interfaces {} folded; see the Jacobian map",
                jacobian.body.cells,
                counted(jacobian.body.folded, "is", "are")
            ),
        ));
    }
    if jacobian.contact.folded > 0 {
        out.push(Warning::new(
            findings::BONES_MEET,
            format!(
                "of {} cells between touching bones {} folded: rigid bones slide or collide there",
                jacobian.contact.cells,
                counted(jacobian.contact.folded, "is", "are")
            ),
        ));
    }
    if jacobian.interface.folded > 0 {
        out.push(Warning::new(
            findings::SLIDING,
            format!(
                "of {} cells of declared sliding interfaces {} folded: motion may be discontinuous there",
                jacobian.interface.cells,
                counted(jacobian.interface.folded, "is", "are")
            ),
        ));
    }
    if inverse.unconverged_tissue > 0 {
        out.push(Warning::new(
            findings::INVERSE,
            format!(
                "{} no exact pre-image (largest residual {:.2} mm); {} of them, missed by more than a voxel, \
                 show nothing of the planning scan",
                counted(
                    inverse.unconverged_tissue,
                    "tissue voxel of the fraction has",
                    "tissue voxels of the fraction have"
                ),
                inverse.unconverged_max_mm,
                inverse.strayed
            ),
        ));
    }
    if push.computed.count() == 0 {
        out.push(Warning::new(
            findings::NO_TISSUE,
            "the planning CT shows no tissue above the least HU inside the patient",
        ));
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::evaluate::jacobian::JacobianStats;
    use crate::geometry::Grid;
    use crate::volume::Volume;

    /// Codes of what is said.
    fn told(jacobian: &JacobianReport, inverse: &InverseReport, computed: bool) -> Vec<String> {
        let grid = Grid::axis_aligned([4; 3], [1.0; 3], [0.0; 3]).unwrap();
        let displacement = Volume::filled(grid.clone(), [0.0; 3]);
        let push = PushField { displacement, computed: Volume::filled(grid, computed) };
        field_warnings(&push, jacobian, inverse).into_iter().map(|w| w.code).collect()
    }

    #[test]
    fn each_fault_of_a_field_is_told_by_itself() {
        let (none, folded) = (JacobianReport::default(), JacobianStats { cells: 90, folded: 1, ..Default::default() });
        let of = |jacobian: JacobianReport| told(&jacobian, &InverseReport::default(), true);
        assert_eq!(of(none.clone()), [""; 0]);
        assert_eq!(of(JacobianReport { body: folded, ..none.clone() }), ["folded"]);
        assert_eq!(of(JacobianReport { contact: folded, ..none.clone() }), ["bones-meet"]);
        assert_eq!(of(JacobianReport { interface: folded, ..none.clone() }), ["sliding"]);
        // Air that has no pre-image is nobody's.
        let inverse = |unconverged: usize, unconverged_tissue: usize| {
            told(&none, &InverseReport { unconverged, unconverged_tissue, ..Default::default() }, true)
        };
        assert_eq!((inverse(5, 0), inverse(5, 1)), (vec![], vec!["inverse".to_owned()]));
        assert_eq!(told(&none, &InverseReport::default(), false), ["no-tissue"]);
    }
}
