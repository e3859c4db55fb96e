//! What the rules say of a registration.

use super::{Case, Outcome};
use crate::evaluate::rigidity::BoneRigidity;
use crate::evaluate::verdict::{Domain, Limits, Verdict, of_warnings};

/// The rules of [`crate::evaluate::verdict`] on what a run has measured and warned of: those that fail, those to be
/// reviewed, and those that pass.
pub fn judge(case: &Case, outcome: &Outcome, limits: &Limits) -> Vec<Verdict> {
    let grids = [case.planning.ct.grid(), case.fraction.ct.grid()];
    let voxel = grids.iter().flat_map(|grid| grid.spacing()).fold(0.0, f64::max);
    let (direction, jacobian) = ("planning to fraction", &outcome.jacobian_report);
    let mut all = Vec::new();
    if let Some(l) = outcome.landmarks.as_ref().filter(|l| l.after.n > 0) {
        all.extend(limits.landmarks(&l.after, voxel));
    }
    if let Some(bone) = least_rigid(&outcome.rigidity) {
        all.push(limits.rigidity(&bone.name, bone.rms_mm));
    }
    all.extend(limits.folds(direction, jacobian, grids[0].voxel_volume() / 1000.0, Domain::Tissue));
    all.push(limits.jumps(direction, jacobian.jumps_above_10));
    let back = &outcome.consistency.there_and_back_mm;
    if back.n > 0 {
        all.push(limits.consistency(
            "inverse consistency beyond 10 mm from bone contact and 5 mm from sliding surfaces",
            back.p95,
            voxel,
        ));
    }
    all.push(limits.no_inverse(outcome.inverse.unconverged_tissue, outcome.inverse.tissue()));
    if let Some((_, u)) = &outcome.uncertainty {
        all.push(limits.uncertainty("soft tissue", u.soft_tissue_mm.p95, u.above_2mm_ml));
        all.extend(u.lung.map(|lung| limits.uncertainty("lung", lung.mm.p95, lung.above_2mm_ml)));
    }
    if let Some(images) = &outcome.agreement {
        all.extend(limits.images(images));
    }
    all.extend(of_warnings(&outcome.warnings));
    all
}

/// The bone that the field bends most.
fn least_rigid(bones: &[BoneRigidity]) -> Option<&BoneRigidity> {
    bones.iter().max_by(|a, b| a.rms_mm.total_cmp(&b.rms_mm))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Rigid;

    #[test]
    fn the_bone_that_bends_most_is_judged() {
        let bent = |rms_mm: f64| {
            let name = format!("{rms_mm} mm");
            BoneRigidity { name, voxels: 100, best: Rigid::identity(), rms_mm, max_mm: rms_mm }
        };
        let bones = [bent(0.2), bent(0.7), bent(0.1)];
        assert_eq!(least_rigid(&bones).map(|bone| bone.name.as_str()), Some("0.7 mm"));
        assert!(least_rigid(&[]).is_none());
    }
}
