//! The loaded inputs of a registration.

use crate::evaluate::landmark::Landmark;
use crate::fit::BoneLandmark;
use crate::geometry::Rigid;
use crate::skeleton::Skeleton;
use crate::volume::{LabelMap, Outline, Volume};
use std::sync::Arc;

/// The planning side of a patient, loaded and converted to LPS mm: all fractions share it, and postures are made from it alone.
#[derive(Debug, Clone)]
pub struct PlanningScan {
    /// Planning CT, HU; an MR on the scale of [`crate::body::mr::tissue_scale`].
    pub ct: Volume<f32>,
    /// Labels of bones and organs on its grid.
    pub bones: LabelMap,
    /// Skeleton given by the user instead of the built one.
    pub skeleton: Option<Skeleton>,
    /// Structures that guide soft tissue to those of the same names in the fraction.
    pub guides: Vec<Outline>,
}

impl PlanningScan {
    /// Of a CT and its labels alone.
    pub fn new(ct: Volume<f32>, bones: LabelMap) -> Self {
        Self { ct, bones, skeleton: None, guides: Vec::new() }
    }
}

/// A fraction of the patient, with what is known of planning and this fraction; LPS mm.
#[derive(Debug, Clone)]
pub struct FractionScan {
    /// Fraction CT, HU; of a posture that was made, the artificial one.
    pub ct: Volume<f32>,
    /// Evaluation landmarks; they never enter the fit.
    pub landmarks: Vec<Landmark>,
    /// Landmarks on bones, which place the skeleton; see [`crate::fit::LandmarkUse`].
    pub bone_landmarks: Vec<BoneLandmark>,
    /// Labels of bones on the fraction's grid or another, which place the skeleton; bone landmarks take precedence over them.
    pub bones: Option<LabelMap>,
    /// Motion of all bones together, planning to fraction, near which the fit begins; bone landmarks take precedence over it.
    pub start: Option<Rigid>,
    /// Structures outlined in the fraction, for those of planning.
    pub guides: Vec<Outline>,
}

impl FractionScan {
    /// Of a CT alone.
    pub fn new(ct: Volume<f32>) -> Self {
        Self { ct, landmarks: Vec::new(), bone_landmarks: Vec::new(), bones: None, start: None, guides: Vec::new() }
    }
}

/// Everything that a registration needs: a patient's planning side and one fraction.
#[derive(Debug, Clone)]
pub struct Case {
    /// The planning side, which all fractions of a patient share.
    pub planning: Arc<PlanningScan>,
    /// The fraction.
    pub fraction: FractionScan,
}

impl Case {
    /// Of images and labels alone: planning CT and fraction CT in HU, bone labels on the planning grid.
    pub fn new(planning: Volume<f32>, bones: LabelMap, fraction: Volume<f32>) -> Self {
        Self { planning: PlanningScan::new(planning, bones).into(), fraction: FractionScan::new(fraction) }
    }

    /// The planning side, to be changed; where it is shared, this case gets one of its own.
    pub fn planning_mut(&mut self) -> &mut PlanningScan {
        Arc::make_mut(&mut self.planning)
    }
}
