//! What a registration found.

use super::{FractionKind, GuideReached};
use crate::chainmail::{LinkReport, Pruning};
use crate::evaluate::agreement::Agreement;
use crate::evaluate::contact::ContactReport;
use crate::evaluate::couch::CouchMatch;
use crate::evaluate::jacobian::JacobianReport;
use crate::evaluate::landmark::LandmarkReport;
use crate::evaluate::rigidity::BoneRigidity;
use crate::evaluate::uncertainty::UncertaintyReport;
use crate::field::{ConsistencyReport, InverseReport, PullField, PushField};
use crate::fit::{BoneFit, DeterminedBy, Weighed};
use crate::sampling::PosePosterior;
use crate::skeleton::{Bone, Pose, Skeleton};
use crate::volume::{LabelMap, LabelSpans, Mask, Spans, Volume};
use crate::warning::Warning;
use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

/// Name of the stage of [`Runtime::times`](crate::runtime::Runtime::times) that makes the chain mail, and the bones' surfaces beside it.
pub const LINKING: &str = "link elements";
/// Name of the stage that carries the motion: what a study compares the time of, with [`LINKING`].
pub const CARRYING: &str = "propagate to soft tissue";

/// An organ whose volume was asked to change.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct VolumeReached {
    /// Its name.
    pub organ: String,
    /// Volume after over before that was asked for.
    pub factor: f64,
    /// Volume after over before in the field: mean Jacobian of its cells; `None` where the organ has no cells.
    pub reached: Option<f64>,
}

/// Share of a bone that the fraction shows, at least, where the image is to tell how it moves.
const LEAST_VISIBLE: f64 = 0.5;

/// Whether a bone's motion is known: given by the user, or found in an image that shows half of it.
pub fn is_placed(bone: &BoneFit) -> bool {
    match bone.determined_by {
        DeterminedBy::Given => true,
        DeterminedBy::Joint | DeterminedBy::Skin => false,
        DeterminedBy::Image => bone.visible >= LEAST_VISIBLE,
    }
}

/// The bone that moves most: by `own_mm` (see [`Outcome::own_motion_mm`]), of those that [`is_placed`]; its place in the
/// list. The one definition for tables, pictures and the terminal.
pub fn moves_most(bones: &[BoneFit], own_mm: &[f64]) -> Option<usize> {
    let placed = bones.iter().zip(own_mm).enumerate().filter(|(_, (bone, _))| is_placed(bone));
    placed.max_by(|a, b| a.1.1.total_cmp(b.1.1)).map(|(n, _)| n)
}

/// Result of a registration, in memory.
#[derive(Debug, Clone)]
pub struct Outcome {
    /// The skeleton used.
    pub skeleton: Skeleton,
    /// Its fitted pose.
    pub pose: Pose,
    /// Mean motion of all that the scans show, at the middle of the planning scan, planning to fraction, LPS mm: difference of
    /// scanner origins and couch included. Fields fade to it.
    pub common_shift: Vector3<f64>,
    /// The couch shift, matched on the bones that the settings name, and what it leaves of each bone.
    pub couch: CouchMatch,
    /// Each bone's fit, in the order of the skeleton.
    pub bone_fits: Vec<BoneFit>,
    /// Where else the bones were tried, and what the search proposed; nothing where no image placed them, or of a run read from
    /// its folder.
    pub weighed: Weighed,
    /// The patient in the planning CT: inside the skin, cavities included.
    pub body: Mask,
    /// Planning to fraction.
    pub push: PushField,
    /// Fraction to planning.
    pub pull: PullField,
    /// The planning CT on the fraction grid; -1000 HU where nothing maps.
    pub planning_on_fraction: Volume<f32>,
    /// The bone labels on the fraction grid.
    pub bones_on_fraction: LabelSpans,
    /// Jacobian map of the push field on the planning grid; -1 folded, 1 where not computed.
    pub jacobian: Spans<f32>,
    /// Jacobian characteristics.
    pub jacobian_report: JacobianReport,
    /// How rigidly the field moves each bone.
    pub rigidity: Vec<BoneRigidity>,
    /// Bones that overlap or come apart, and skin on skin.
    pub contact: ContactReport,
    /// Fraction voxels where the pushed patient lies on himself, when there are any.
    pub skin_contact: Option<Mask>,
    /// Volumes that were asked to change.
    pub volume_changes: Vec<VolumeReached>,
    /// Structures that guided.
    pub guides: Vec<GuideReached>,
    /// What kind of image the fraction is; `None` where images took no part in soft tissue.
    pub kind: Option<FractionKind>,
    /// Uncertainty on the planning grid, mm, [`crate::evaluate::uncertainty::UNKNOWN`] outside the patient; when the settings ask for it and a fraction was registered.
    pub uncertainty: Option<(Spans<f32>, UncertaintyReport)>,
    /// What the fit leaves open of the bones; where a map of uncertainty was made.
    pub posterior: Option<PosePosterior>,
    /// How far the images agree before, with the couch shift and after; where a fraction was registered.
    pub agreement: Option<Agreement>,
    /// Waves that were pruned, and the most that this can change; where a bound is known.
    pub pruning: Option<Pruning>,
    /// Chain-mail links of the result.
    pub links: LinkReport,
    /// Quality of the inverse.
    pub inverse: InverseReport,
    /// Planning to fraction and back through both fields.
    pub consistency: ConsistencyReport,
    /// Landmark residuals, when landmarks were given.
    pub landmarks: Option<LandmarkReport>,
    /// What the user should know.
    pub warnings: Vec<Warning>,
    /// Regions of influence, when the settings ask for them: the label of the bone that reaches each voxel first.
    pub regions: Option<LabelMap>,
}

impl Outcome {
    /// Motion of each bone's centroid apart from the couch shift, mm, in the order of the skeleton.
    pub fn own_motion_mm(&self) -> Vec<f64> {
        own_motion_mm(&self.skeleton.bones, &self.bone_fits, &self.couch.shift())
    }
}

fn own_motion_mm(bones: &[Bone], fits: &[BoneFit], couch: &Vector3<f64>) -> Vec<f64> {
    let moved = |(bone, fit): (&Bone, &BoneFit)| (fit.transform * bone.centroid - bone.centroid - couch).norm();
    bones.iter().zip(fits).map(moved).collect()
}

#[cfg(test)]
mod tests {
    use super::super::small::{fitted, skeleton};
    use super::*;
    use crate::geometry::Rigid;

    #[test]
    fn a_bone_is_placed_by_an_image_that_shows_half_of_it() {
        let seen = |visible: f64, determined_by: DeterminedBy| {
            is_placed(&BoneFit { visible, determined_by, ..fitted("hyoid", Rigid::identity()) })
        };
        assert!(seen(0.5, DeterminedBy::Image) && !seen(0.49, DeterminedBy::Image));
        assert!(seen(0.0, DeterminedBy::Given) && !seen(1.0, DeterminedBy::Joint));
    }

    #[test]
    fn the_couch_is_no_motion_of_a_bones_own() {
        let couch = Vector3::new(30.0, -4.0, 12.0);
        let fits = [couch, couch + Vector3::new(0.0, 3.0, 4.0)]
            .map(|shift| fitted("", Rigid::translation(shift.x, shift.y, shift.z)));
        let own = own_motion_mm(&skeleton().bones, &fits, &couch);
        assert!(own[0].abs() < 1e-12 && (own[1] - 5.0).abs() < 1e-12, "{own:?}");
        assert_eq!(moves_most(&fits, &own), Some(1));
    }
}
