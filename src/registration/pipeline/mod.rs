//! Rank 7: from a case and a configuration to an outcome.

mod by_skin;
mod carry;
mod case;
mod checks;
mod contact;
mod couch;
mod curve;
mod dose;
mod elements;
mod field_warnings;
mod fraction;
mod guides;
mod judge;
mod kind;
mod landmarks;
mod matching;
mod memory;
mod moved;
mod outcome;
mod planning;
mod pose;
mod posing;
mod probable;
mod region;
mod register;
mod sampled;
#[cfg(test)]
mod small;
mod study;
mod uncertainty;

pub use case::{Case, FractionScan, PlanningScan};
pub use checks::{check_fraction, check_grids, check_size, same_scan};
pub use curve::{CurvePoint, measure};
pub use dose::{DoseMethod, DoseReport, map_dose};
pub use guides::{GuideReached, OutlineAgreement};
pub use judge::judge;
pub use kind::{FractionKind, MisledTissue};
pub use memory::memory_estimate;
pub use outcome::{CARRYING, LINKING, Outcome, VolumeReached, is_placed, moves_most};
pub use planning::Planning;
pub use pose::pose;
pub use posing::{BoneMotion, Posing};
pub use probable::{CarriedStructure, polygons_above};
pub use register::{check_inputs, register, register_fraction};
pub use sampled::{DoseSamples, DoseSpread, correlation, sample, sample_set, sampled_field};
pub use study::carry_again;
