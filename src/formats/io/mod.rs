//! Rank 8: files <-> domain types. NIfTI, MetaImage and NRRD images, label names, fields, landmarks, skeletons, poses,
//! checksums.
//!
//! Inside the library every position is LPS mm; this room converts at the file boundary. Formats are told apart by
//! the first bytes of a file when reading and by its extension when writing. Every write goes to a temporary file in
//! the same folder that is renamed when complete, so that no half-written result is ever seen.

mod atomic;
pub mod auto;
mod bytes;
pub mod checksum;
mod contours;
mod density;
pub mod dicom;
pub mod embed;
mod field;
mod folder;
mod gaps;
mod guard;
mod gzip;
mod head;
mod held;
mod identity;
mod image;
pub mod inspect;
mod json;
mod keyed;
mod kinds;
mod labels;
mod landmarks;
mod load;
pub mod merge;
mod metaimage;
mod names;
mod nifti;
mod nrrd;
mod organs;
mod outlines;
pub mod points;
pub mod pose;
pub mod postures;
mod raster;
pub mod samples;
mod segments;
mod series_path;
mod sheet;
pub mod skeleton;
mod text;
pub mod transform;
mod values;
mod voxels;

#[cfg(test)]
mod tests;

pub use atomic::{check_place, open_folder, write_file};
pub use contours::{ContourFile, contour_json, parse_contours, read_contour_file, read_contours, write_contours};
pub use density::read_density;
pub use field::{
    FieldFile, FieldFrames, direction, frames_of, read_field, read_field_between, write_field, write_pull, write_push,
};
pub use folder::{Planned, RunFolder};
pub use guard::{check_files, recorded_file};
pub use head::read_grid;
pub use held::{at_work, is_lock};
pub use identity::{path_as_text, relative_to, same_file, whole_path};
pub use image::{Stored, WriteOptions, read_dose, read_image, read_scan, write_image, write_map, write_mask};
pub use json::{is_json, json, read_json, write_json};
pub use labels::{
    check_labels, names_beside, read_bones, read_label_map, read_label_map_on, read_label_names, read_labels,
    read_organs, read_structures, write_label_spans, write_labels,
};
pub use landmarks::{read_bone_landmarks, read_landmarks};
pub use organs::add_organs;
pub use outlines::read_outlines;
pub use raster::{ExtensionNote, GeometrySource, HeaderNotes};
pub use series_path::split_choice;
pub use sheet::{Sheet, plain_cell};
pub use transform::read_bone_transforms;

use crate::warning::Warning;
use std::path::PathBuf;

/// What was read from a file, with what is worth knowing about the file.
#[derive(Debug, Clone)]
pub struct Loaded<T> {
    /// The image, label map or field; LPS mm.
    pub value: T,
    /// The file.
    pub path: PathBuf,
    /// SHA-256 of the file's bytes, hexadecimal.
    pub sha256: String,
    /// What its header said.
    pub header: HeaderNotes,
    /// Legal but unusual findings.
    pub warnings: Vec<Warning>,
}
