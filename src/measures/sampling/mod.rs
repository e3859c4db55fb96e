//! Rank 4: plausible registrations beside the one that was found: what an error of the field may look like.
//!
//! A [`PosePosterior`] holds the remaining uncertainty of the bones, the map of uncertainty that of soft tissue. A
//! [`TissueModel`] draws [`Drawn`] samples of both: bones stay rigid, tissue follows them and adds a random field of the
//! map's deviation. A [`SampleSet`] reads them at any place. What was measured: docs/decisions/samples.md.

mod beside;
mod draw;
mod model;
mod noise;
mod options;
mod posterior;
mod set;
mod strain;
mod unfold;

pub use draw::Drawn;
pub use model::{SampledPatient, TissueModel};
pub use options::{Correlation, SamplingOptions};
pub use posterior::{CurvatureBlock, PosePosterior, PosedBone};
pub use set::SampleSet;
pub use strain::Strain;
