//! What both kinds of registration hold: matrices, and elements read with errors that say what is missing.

use super::super::elements::{self, Item};
use super::super::open;
use crate::error::{Error, Result};
use crate::io::bytes::read_bytes;
use dicom_core::{Tag, VR};
use dicom_dictionary_std::tags;
use nalgebra::Matrix4;
use std::path::Path;

pub(super) use super::super::write::element::{code, decimals, empty, integer, item, sequence, text};

/// How an error ends.
const REMEDY: &str = "export the registration again, or as a displacement field in NIfTI, MetaImage or NRRD";

/// The two elements of a matrix (PS3.3 C.20.2.1.1), rows after each other.
pub(super) fn matrix_item(matrix: &Matrix4<f64>) -> Item {
    item([
        text(tags::FRAME_OF_REFERENCE_TRANSFORMATION_MATRIX_TYPE, VR::CS, "RIGID"),
        decimals(tags::FRAME_OF_REFERENCE_TRANSFORMATION_MATRIX, matrix.transpose().iter().copied()),
    ])
}

/// A file of registrations while it is read.
pub(super) struct Source<'a> {
    pub path: &'a Path,
}

impl Source<'_> {
    /// The data set of an object of class `class`, called `kind` in errors.
    pub fn open(&self, class: &str, kind: &str) -> Result<Item> {
        self.parse(&read_bytes(self.path)?, class, kind)
    }

    /// The same of bytes that are read.
    pub fn parse(&self, bytes: &[u8], class: &str, kind: &str) -> Result<Item> {
        let object = open::whole(self.path, bytes)?.into_inner();
        let found = self.text(&object, tags::SOP_CLASS_UID, "SOP Class UID")?;
        if found == class {
            return Ok(object);
        }
        let problem = format!("its SOP Class UID is {found}, it is no {kind} ({class})");
        Err(Error::input(self.path.display().to_string(), problem, "give a registration of that kind"))
    }

    /// An error about the file's content.
    pub fn damaged(&self, problem: String) -> Error {
        Error::read(self.path, problem, REMEDY)
    }

    /// A text that must be there.
    pub fn text(&self, object: &Item, tag: Tag, name: &str) -> Result<String> {
        let value = elements::text(object, tag);
        if value.is_empty() { Err(self.damaged(format!("it has no {name} {tag}"))) } else { Ok(value) }
    }

    /// `N` finite numbers that must be there.
    pub fn numbers<const N: usize>(&self, object: &Item, tag: Tag, name: &str) -> Result<[f64; N]> {
        elements::some(object, tag)
            .ok_or_else(|| self.damaged(format!("its {name} {tag} is not {N} finite numbers, or missing")))
    }

    /// The items of a sequence; none where it is missing.
    pub fn items<'o>(&self, object: &'o Item, tag: Tag) -> &'o [Item] {
        elements::items(object, tag)
    }

    /// A matrix of PS3.3 C.20.2.1.1 that keeps affine maps affine.
    pub fn matrix(&self, object: &Item) -> Result<Matrix4<f64>> {
        let name = "Frame of Reference Transformation Matrix";
        let values: [f64; 16] = self.numbers(object, tags::FRAME_OF_REFERENCE_TRANSFORMATION_MATRIX, name)?;
        let matrix = Matrix4::from_row_slice(&values);
        let last = [matrix[(3, 0)], matrix[(3, 1)], matrix[(3, 2)], matrix[(3, 3)] - 1.0];
        if last.iter().any(|v| v.abs() > 1e-9) {
            return Err(self.damaged(format!("the last row of its {name} is {:?}, not 0 0 0 1", &values[12..])));
        }
        Ok(matrix)
    }
}
