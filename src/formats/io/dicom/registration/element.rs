//! What both kinds of registration hold: matrices, and elements read with errors that say what is missing.

use crate::error::{Error, Result};
use dicom_core::{Tag, VR};
use dicom_dictionary_std::tags;
use dicom_object::{InMemDicomObject, OpenFileOptions};
use nalgebra::Matrix4;
use std::path::Path;

pub(super) use super::super::write::element::{code, decimals, empty, integer, item, sequence, text};

/// How an error ends.
const REMEDY: &str = "export the registration again, or as a displacement field in NIfTI, MetaImage or NRRD";

/// The two elements of a matrix (PS3.3 C.20.2.1.1), rows after each other.
pub(super) fn matrix_item(matrix: &Matrix4<f64>) -> InMemDicomObject {
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
    pub fn open(&self, class: &str, kind: &str) -> Result<InMemDicomObject> {
        super::super::super::checksum::require_file(self.path)?;
        let file = OpenFileOptions::new()
            .open_file(self.path)
            .map_err(|e| self.damaged(format!("it cannot be read as DICOM: {e}")))?;
        let object = file.into_inner();
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
    pub fn text(&self, object: &InMemDicomObject, tag: Tag, name: &str) -> Result<String> {
        let value = object.get(tag).and_then(|e| e.to_str().ok()).map(|t| t.trim_matches(['\0', ' ']).to_owned());
        value.filter(|t| !t.is_empty()).ok_or_else(|| self.damaged(format!("it has no {name} {tag}")))
    }

    /// `N` finite numbers that must be there.
    pub fn numbers<const N: usize>(&self, object: &InMemDicomObject, tag: Tag, name: &str) -> Result<[f64; N]> {
        let values = object.get(tag).and_then(|e| e.to_multi_float64().ok()).unwrap_or_default();
        let found = values.len();
        let values: Option<[f64; N]> = values.try_into().ok();
        values
            .filter(|v| v.iter().all(|x| x.is_finite()))
            .ok_or_else(|| self.damaged(format!("its {name} {tag} is not {N} finite numbers (found {found} values)")))
    }

    /// The items of a sequence; none where it is missing.
    pub fn items<'o>(&self, object: &'o InMemDicomObject, tag: Tag) -> &'o [InMemDicomObject] {
        object.get(tag).and_then(|e| e.items()).unwrap_or_default()
    }

    /// A matrix of PS3.3 C.20.2.1.1 that keeps affine maps affine.
    pub fn matrix(&self, object: &InMemDicomObject) -> Result<Matrix4<f64>> {
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
