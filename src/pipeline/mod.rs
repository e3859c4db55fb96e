//! Rank 7: from a case and a configuration to an outcome.

mod carry;
mod case;
mod contact;
mod dose;
mod outcome;
mod pose;
mod register;
mod study;
mod uncertainty;

pub use case::{Case, InputFile};
pub use dose::{DoseMethod, DoseReport, map_dose};
pub use outcome::{Outcome, VolumeReached};
pub use pose::{BoneMotion, pose};
pub use register::register;
pub use study::{CARRYING, carry_again};
