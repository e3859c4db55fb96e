//! NIfTI-1, single files: `.nii`, `.nii.gz`. RAS in the file, LPS inside; the conversion is here and nowhere else.
//!
//! Geometry comes from the sform where its code is positive, else from the qform; the qform is checked against the sform.
//! Specification: nifti1.h of the NIfTI Data Format Working Group.

mod geometry;
mod read;
mod write;

pub(super) use read::{parse, promised};
pub(super) use write::header;
