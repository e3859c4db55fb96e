//! DICOM: CT and MR series, structure sets, dose and registrations, read and written. One file per object.
//!
//! Parsing and encoding is dicom-rs's; here is what the objects mean (DICOM PS3.3). DICOM's patient
//! coordinates are LPS mm, as everywhere inside the library, so positions pass through unchanged.

mod about;
mod acquisitions;
mod beams;
mod beside;
mod bones;
mod charset;
mod counts;
mod ct;
mod dose;
mod elements;
mod find;
mod frame;
mod frames;
mod image;
mod keyhole;
mod kinds;
pub mod like;
mod modality;
mod mr;
mod open;
mod pixels;
mod place;
mod planes;
pub mod registration;
mod scan;
mod segmentation;
mod series;
mod settle;
mod stack;
mod structures;
mod summary;
mod terms;
mod walk;
pub mod write;

#[cfg(test)]
mod fixture;
#[cfg(test)]
mod round_trip;
#[cfg(test)]
mod tests;

pub use about::About;
pub use beams::Dose;
pub(super) use bones::plain;
pub use bones::{BoneLabels, BoneNames, labels_from_structures, organs_from_structures, outlines_from_structures};
pub use ct::read_series;
pub use dose::{read_dose, read_doses};
pub use find::{Catalogue, Group, Object, find};
pub use frame::{Framed, Role, check_frames, frame_of, same_frame};
pub(super) use image::read_dose as read_dose_image;
pub(super) use image::{checksum, load, load_scan, read_grid, read_image, read_scan};
pub use image::{describe_series, dose_at, missing_images};
pub use like::CarriedDose;
pub use modality::{require_ct, scan_of};
pub(super) use place::{folder_of, is_place, require};
pub use place::{is_dicom_path, is_listed, is_segmentation, is_structure_set};
pub use scan::Scan;
pub(super) use segmentation::{Segment, bone_or_name, on_grid, read_segmentation};
pub use series::{Patient, Series, Slice, Study};
pub use structures::{Roi, StructureSet, read_structure_set};
pub(super) use structures::{some_names, structure_notes};
pub use summary::{Entry, Summary, summary, summary_without};
