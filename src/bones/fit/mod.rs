//! Rank 5: the pose of the skeleton that best explains the fraction CT.

pub use attempts::{fit_pose, fit_pose_weighed};
pub use given::{BoneLandmark, GivenMotion, LandmarkUse, from_landmarks, given};
pub use labels::{contradictions, from_labels};
pub use planning::BoneSamples;
pub use prior::BeyondRange;
pub use search::Hypothesis;
pub use similarity::Measure;
pub use skin::{SkinPoint, TurnedBySkin, turn_by_skin};
pub use start::FitStart;
pub use stop::Stop;
pub use weighed::{Place, Weighed, level_apart, levels_apart, lies_at};

use crate::geometry::Rigid;
use crate::skeleton::Pose;
use crate::warning::Warning;
use nalgebra::{DMatrix, Point3};
use serde::{Deserialize, Serialize};

/// How well one bone's position is known after the fit.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct BoneFit {
    /// Bone name.
    pub name: String,
    /// Planning to fraction, LPS mm.
    pub transform: Rigid,
    /// Share (0 to 1) of the bone's sample points that fall inside the fraction image.
    pub visible: f64,
    /// Similarity (1 best, 0 none) after couch shift alone; `None` when nothing is visible.
    pub similarity_before: Option<f64>,
    /// Similarity after the fit.
    pub similarity_after: Option<f64>,
    /// Why the last optimisation that moved this bone stopped.
    pub stop: Stop,
    /// How far the optimisation's next step would have moved the bone, mm: next to nothing where it has settled.
    #[serde(default)]
    pub unsettled_mm: f64,
    /// One standard deviation of the bone's position (mm, worst direction at its centroid), from the cost's curvature.
    pub position_sd_mm: f64,
    /// One standard deviation of the bone's rotation (degrees, worst axis), from the cost's curvature.
    pub rotation_sd_deg: f64,
    /// How far the bone's joint lies beyond its soft range. Earlier reports lack it.
    #[serde(default)]
    pub beyond_range: BeyondRange,
    /// Mean displacement of the bone's points, mm.
    pub motion_mm: f64,
    /// What tells how the bone moves.
    pub determined_by: DeterminedBy,
}

impl BoneFit {
    /// Whether the last optimisation that moved this bone used up its iterations.
    pub fn hit_limit(&self) -> bool {
        matches!(self.stop, Stop::IterationLimit(_))
    }
}

/// What tells how a bone moves.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum DeterminedBy {
    /// The fraction CT.
    Image,
    /// Its motion came with the inputs.
    Given,
    /// It follows its joints.
    Joint,
    /// The skin around it: its joint turns until that lies where the fraction shows it.
    Skin,
}

impl DeterminedBy {
    /// The word that reports have for it.
    pub fn name(self) -> &'static str {
        match self {
            Self::Image => "image",
            Self::Given => "given",
            Self::Joint => "joint",
            Self::Skin => "skin",
        }
    }
}
mod accept;
mod around;
mod attempts;
mod coarse;
mod evaluation;
mod given;
#[cfg(test)]
mod hanging;
mod labels;
mod level;
mod lie;
mod limbs;
mod mirror;
mod planning;
mod prior;
mod probable;
mod problem;
mod relation;
mod rivals;
mod samples;
mod scale;
mod schedule;
mod search;
mod shape;
mod similarity;
mod skin;
mod solver;
mod start;
mod stop;
#[cfg(test)]
mod tests;
mod tissue;
mod tried;
mod weighed;

/// How finely a pass of the fit looks; in settings a pair.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(from = "(f64, usize)", into = "(f64, usize)")]
pub struct Resolution {
    /// Blur of both images, sigma, mm.
    pub blur_mm: f64,
    /// Samples of each bone.
    pub samples: usize,
}

impl From<(f64, usize)> for Resolution {
    fn from((blur_mm, samples): (f64, usize)) -> Self {
        Self { blur_mm, samples }
    }
}

impl From<Resolution> for (f64, usize) {
    fn from(r: Resolution) -> Self {
        (r.blur_mm, r.samples)
    }
}

/// How the pose is fitted.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct FitOptions {
    /// How planning and fraction HU are compared.
    pub measure: Measure,
    /// What landmarks on bones do, when there are any.
    pub bone_landmarks: LandmarkUse,
    /// Each pass bone by bone.
    pub outward: Vec<Resolution>,
    /// Each pass of all bones together.
    pub levels: Vec<Resolution>,
    /// Iteration limit of each optimisation.
    pub max_iterations: u64,
    /// Share of its contrast that the image has to explain of a whole bone; no setting.
    #[serde(skip)]
    pub least_explained: f64,
}

/// Of a planning MR, whose own noise nothing explains, a whole bone at its true place explains 0.32 to 0.68 in another MR.
pub const LEAST_EXPLAINED_OF_MR: f64 = 0.3;

impl Default for FitOptions {
    fn default() -> Self {
        Self {
            measure: Measure::Correlation,
            bone_landmarks: LandmarkUse::Start,
            outward: [(4.0, 3000), (2.0, 4000)].map(Resolution::from).into(),
            levels: [(2.0, 4000), (0.8, 12000)].map(Resolution::from).into(),
            max_iterations: 50,
            least_explained: schedule::LEAST_EXPLAINED,
        }
    }
}

/// The fitted pose with what is known about each bone.
#[derive(Debug, Clone)]
pub struct FitResult {
    /// Planning to fraction, one per bone in the order of the skeleton.
    pub transforms: Vec<Rigid>,
    /// The same as joint motions.
    pub pose: Pose,
    /// How well each bone is known.
    pub bones: Vec<BoneFit>,
    /// Couch shift and scanner-origin offset: the common motion of all bones that started the fit.
    pub common: Rigid,
    /// Share of the bone contrast that the common motion explains.
    pub common_share: f64,
    /// What the image and the joints leave open of all bones together; nothing where their motions were given.
    pub open: Option<FitCurvature>,
    /// What the user should know.
    pub warnings: Vec<Warning>,
}

/// The cost around the fitted pose.
#[derive(Debug, Clone)]
pub struct FitCurvature {
    /// Second derivatives, per mm^2: of each bone the rotation vector times its radius, then its shift, about its centre.
    pub matrix: DMatrix<f64>,
    /// Centre of each bone's samples in planning, LPS mm.
    pub centres: Vec<Point3<f64>>,
    /// Root mean square distance of its samples from there, mm.
    pub radii: Vec<f64>,
}
