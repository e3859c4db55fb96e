//! Writing: derived CT series, structure sets and doses as planning systems import them.
//!
//! Nothing here asks a clock or draws a number at random: the same input gives the same files.

mod common;
mod ct;
mod dose;
pub(super) mod element;
mod plane;
mod segmentation;
mod structures;
mod uid;

pub use common::{CAUTION, Origin, When};
pub use ct::{DerivedCt, ct_series, write_ct};
pub use dose::{DerivedDose, no_plan, write_dose};
pub use segmentation::DerivedSegmentation;
pub use structures::{DerivedStructures, write_structures};
pub use uid::uid_of;

pub(super) use common::{NewSeries, frame, instances, put, references, save};
pub(super) use element::decimals;
pub(super) use plane::{Frames, orientation};
pub(super) use segmentation::write_segmentation;
