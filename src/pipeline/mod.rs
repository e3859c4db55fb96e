//! Rank 7: from a case and a configuration to an outcome.

mod case;
mod dose;
mod outcome;
mod register;

pub use case::{Case, InputFile};
pub use dose::{DoseMethod, DoseReport, map_dose};
pub use outcome::Outcome;
pub use register::register;
