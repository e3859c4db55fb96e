//! DICOM: CT series, structure sets, dose and registrations, read and written. One file per object.
//!
//! Parsing and encoding is dicom-rs's; here is what the objects mean (DICOM PS3.3). DICOM's patient coordinates are LPS mm,
//! as everywhere inside the library, so positions pass through unchanged.

pub mod registration;
mod series;
pub mod write;

#[cfg(test)]
mod fixture;

pub use series::{Patient, Series, Slice, Study};
