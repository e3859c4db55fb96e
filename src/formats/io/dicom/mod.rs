//! DICOM: CT series, structure sets, dose and registrations, read and written. One file per object.
//!
//! Parsing and encoding is dicom-rs's; here is what the objects mean (DICOM PS3.3). DICOM's patient coordinates are LPS mm,
//! as everywhere inside the library, so positions pass through unchanged.

mod ct;
mod dose;
mod elements;
mod find;
mod frames;
mod open;
mod pixels;
mod place;
mod planes;
pub mod registration;
mod series;
mod stack;
mod structures;
pub mod write;

#[cfg(test)]
mod fixture;
#[cfg(test)]
mod round_trip;

pub use ct::read_series;
pub use dose::{Dose, read_dose, read_doses};
pub use find::{Catalogue, Group, Object, find};
pub use series::{Patient, Series, Slice, Study};
pub use structures::{Roi, StructureSet, read_structure_set};
