//! Spatial Registration objects: rigid transforms between frames of reference (PS3.3 A.39.1, C.20.2).

use super::element::{Source, code, empty, item, matrix_item, sequence, text};
use super::{DerivedRegistration, Written, begun};
use crate::error::{Error, Result};
use crate::geometry::{Rigid, rigid_from_matrix};
use crate::io::dicom::series::Series;
use crate::io::dicom::write::{Origin, put, references, save};
use dicom_core::VR;
use dicom_dictionary_std::{tags, uids};
use dicom_object::InMemDicomObject;
use nalgebra::Matrix4;
use std::path::Path;

/// Matrices closer than this are the same: mm, or parts of a direction.
const SAME: f64 = 1e-6;

/// A rigid transform between two frames of reference.
#[derive(Debug, Clone, PartialEq)]
pub struct RigidRegistration {
    /// Frame of Reference UID whose points it takes.
    pub from: String,
    /// Frame of Reference UID where they arrive.
    pub to: String,
    /// The transform, LPS mm.
    pub rigid: Rigid,
}

/// Writes a rigid transform that takes points of `about.from` to `about.to`.
///
/// The frame of reference of the object is that of `about.to`, and its images are listed with the identity, as readers expect.
///
/// # Errors
/// [`Error::Write`] when the origin has no date, which this kind of object must have, or the file cannot be written.
pub fn write_rigid(path: &Path, rigid: &Rigid, about: &DerivedRegistration<'_>, origin: &Origin) -> Result<Written> {
    let (mut object, written) = begun(path, uids::SPATIAL_REGISTRATION_STORAGE, about, about.to, origin)?;
    let items = vec![
        registered(about.to, &Matrix4::identity(), ["125021", "Frame of Reference Identity"]),
        registered(about.from, &rigid.to_homogeneous(), ["125024", "Image Content-based Alignment"]),
    ];
    put(&mut object, [sequence(tags::REGISTRATION_SEQUENCE, items)]);
    save(path, object)?;
    Ok(written)
}

fn registered(series: &Series, matrix: &Matrix4<f64>, [value, meaning]: [&str; 2]) -> InMemDicomObject {
    let registration = item([
        sequence(tags::REGISTRATION_TYPE_CODE_SEQUENCE, vec![code(value, "DCM", meaning)]),
        sequence(tags::MATRIX_SEQUENCE, vec![matrix_item(matrix)]),
        empty(tags::FRAME_OF_REFERENCE_TRANSFORMATION_COMMENT, VR::LO),
    ]);
    let mut object = item([
        text(tags::FRAME_OF_REFERENCE_UID, VR::UI, series.frame_of_reference.as_str()),
        sequence(tags::MATRIX_REGISTRATION_SEQUENCE, vec![registration]),
    ]);
    let images = references(series);
    if !images.is_empty() {
        object.put(sequence(tags::REFERENCED_IMAGE_SEQUENCE, images));
    }
    object
}

/// Reads the rigid transforms of a Spatial Registration, each from a source frame of reference to the object's own; the
/// object's own frame with the identity is passed over. Two scans may claim one frame: then its points are moved within it.
///
/// # Errors
/// [`Error::Read`] when the file cannot be read or lacks what it must hold; [`Error::Input`] when it is of another class, a
/// matrix is not rigid, or an item tells its images and no frame of reference.
pub fn read_rigid(path: impl AsRef<Path>) -> Result<Vec<RigidRegistration>> {
    let source = Source { path: path.as_ref() };
    let object = source.open(uids::SPATIAL_REGISTRATION_STORAGE, "Spatial Registration")?;
    let to = source.text(&object, tags::FRAME_OF_REFERENCE_UID, "Frame of Reference UID")?;
    let items = source.items(&object, tags::REGISTRATION_SEQUENCE);
    let (mut found, mut own) = (Vec::new(), 0);
    for (n, item) in items.iter().enumerate() {
        let refuse = |problem: String, remedy: &str| {
            Error::input(source.path.display().to_string(), format!("registration {}: {problem}", n + 1), remedy)
        };
        let matrix = product(&source, item)?;
        let Ok(from) = source.text(item, tags::FRAME_OF_REFERENCE_UID, "Frame of Reference UID") else {
            let problem = "it names its images and no frame of reference".to_owned();
            return Err(refuse(problem, "export the registration with the frames of reference of both images"));
        };
        let unit = (matrix - Matrix4::identity()).abs().max() <= SAME;
        if from == to && unit {
            own += 1;
            continue;
        }
        let Some(rigid) = rigid_from_matrix(&matrix) else {
            let problem = format!("its matrix scales or shears: {matrix}");
            return Err(refuse(problem, "give a rigid registration of two frames of reference"));
        };
        found.push(RigidRegistration { from, to: to.clone(), rigid });
    }
    if found.is_empty() && own > 1 {
        // Two scans of one frame that lie on each other.
        found.push(RigidRegistration { from: to.clone(), to, rigid: Rigid::identity() });
    }
    if found.is_empty() {
        return Err(source.damaged("it registers no other frame of reference than its own".into()));
    }
    Ok(found)
}

/// The matrices of an item as one. Readers do not agree on which of several comes first: the product must not depend on it.
fn product(source: &Source<'_>, item: &InMemDicomObject) -> Result<Matrix4<f64>> {
    let [registration] = source.items(item, tags::MATRIX_REGISTRATION_SEQUENCE) else {
        return Err(source.damaged("an item of its Registration Sequence has not one Matrix Registration".into()));
    };
    let matrices = source.items(registration, tags::MATRIX_SEQUENCE);
    let matrices = matrices.iter().map(|m| source.matrix(m)).collect::<Result<Vec<_>>>()?;
    if matrices.is_empty() {
        return Err(source.damaged("an item of its Registration Sequence has no matrix".into()));
    }
    let [one, other]: [Matrix4<f64>; 2] = [matrices.iter().product(), matrices.iter().rev().product()];
    if (one - other).abs().max() > SAME {
        let problem = format!("{} matrices follow each other, and their order matters", matrices.len());
        let remedy = "export the registration with a single matrix: readers do not agree on the order";
        return Err(Error::input(source.path.display().to_string(), problem, remedy));
    }
    Ok(one)
}

#[cfg(test)]
mod tests;
