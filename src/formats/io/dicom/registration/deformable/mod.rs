//! Deformable Spatial Registration objects: displacement fields (PS3.3 A.39.2, C.20.3).
//!
//! The grid lies in the registered frame. A point x of it is taken to `Post (Pre x + d(x))` in the source frame, where d is
//! the vector grid, mm (C.20.3.1.1). The grid's third axis is rows x columns, so a grid that runs the other way is turned.

use super::element::{Source, code, item, matrix_item, sequence, text};
use super::{DerivedRegistration, Written, begun};
use crate::error::{Error, Result};
use crate::field::{PullField, PushField};
use crate::geometry::Grid;
use crate::io::bytes::{read_bytes, sha256};
use crate::io::dicom::find::Object;
use crate::io::dicom::series::Series;
use crate::io::dicom::write::{Frames, Origin, decimals, orientation, put, references, save};
use crate::io::{FieldFile, HeaderNotes, Loaded};
use crate::volume::Volume;
use dicom_core::value::PrimitiveValue;
use dicom_core::{DataElement, VR};
use dicom_dictionary_std::{tags, uids};
use dicom_object::InMemDicomObject;
use nalgebra::{Matrix3, Matrix4, Point3, Vector3};
use std::path::Path;

/// Bytes of one vector.
const VECTOR: u64 = 12;

/// A displacement field between two frames of reference.
#[derive(Debug, Clone)]
pub struct Deformable {
    /// Frame of Reference UID of the grid, whose points it takes.
    pub from: String,
    /// Frame of Reference UID where they arrive.
    pub to: String,
    /// On a grid of `from`: x goes to x + u(x), LPS mm. Matrices before and after the vectors are part of it.
    pub displacement: Volume<[f32; 3]>,
}

/// Writes a push field: the registered frame is planning's (`about.from`), and the fraction (`about.to`) is sampled.
///
/// # Errors
/// [`Error::Write`] when a vector is not finite, the grid takes more than 4 GB, the origin has no date, which this kind of
/// object must have, or the file cannot be written.
pub fn write_push(path: &Path, field: &PushField, about: &DerivedRegistration<'_>, origin: &Origin) -> Result<Written> {
    write_deformable(path, &field.displacement, about, origin)
}

/// Writes a pull field: the registered frame is the fraction's (`about.from`), and planning (`about.to`) is sampled.
///
/// # Errors
/// As [`write_push`].
pub fn write_pull(path: &Path, field: &PullField, about: &DerivedRegistration<'_>, origin: &Origin) -> Result<Written> {
    write_deformable(path, &field.displacement, about, origin)
}

/// Writes any field: it lies on a grid of `about.from`, the registered frame, and takes its points `x` to `x + u(x)` in
/// `about.to`, LPS mm.
///
/// # Errors
/// As [`write_push`].
pub fn write_deformable(
    path: &Path,
    field: &Volume<[f32; 3]>,
    about: &DerivedRegistration<'_>,
    origin: &Origin,
) -> Result<Written> {
    let grid = field.grid();
    if let Some(n) = field.data().iter().position(|u| !u.iter().all(|c| c.is_finite())) {
        let problem = format!("voxel {:?} has the displacement {:?}", grid.voxel(n), field.data()[n]);
        return Err(Error::write(path, problem, "give a field that is finite everywhere"));
    }
    if grid.len() as u64 * VECTOR > u64::from(u32::MAX) - 1 {
        let problem = format!("vectors on {:?} voxels take more than 4 GB", grid.size());
        return Err(Error::write(path, problem, "write the field on a coarser grid"));
    }
    let class = uids::DEFORMABLE_SPATIAL_REGISTRATION_STORAGE;
    let (mut object, written) = begun(path, class, about, about.from, origin)?;
    put(&mut object, [sequence(tags::DEFORMABLE_REGISTRATION_SEQUENCE, vec![registered(about.to, field)])]);
    save(path, object)?;
    Ok(written)
}

fn registered(source: &Series, field: &Volume<[f32; 3]>) -> InMemDicomObject {
    // Nothing is to be done before and after the vectors, and readers look for the matrices.
    let identity = || vec![matrix_item(&Matrix4::identity())];
    let mut object = item([
        text(tags::SOURCE_FRAME_OF_REFERENCE_UID, VR::UI, source.frame_of_reference.as_str()),
        sequence(tags::REGISTRATION_TYPE_CODE_SEQUENCE, vec![code("125024", "DCM", "Image Content-based Alignment")]),
        sequence(tags::PRE_DEFORMATION_MATRIX_REGISTRATION_SEQUENCE, identity()),
        sequence(tags::POST_DEFORMATION_MATRIX_REGISTRATION_SEQUENCE, identity()),
        sequence(tags::DEFORMABLE_REGISTRATION_GRID_SEQUENCE, vec![vectors(field)]),
    ]);
    let images = references(source);
    if !images.is_empty() {
        object.put(sequence(tags::REFERENCED_IMAGE_SEQUENCE, images));
    }
    object
}

/// The grid and its vectors (PS3.3 C.20.3.1.2, C.20.3.1.3).
fn vectors(field: &Volume<[f32; 3]>) -> InMemDicomObject {
    let grid = field.grid();
    let frames = Frames::of(grid);
    let size: Vec<u32> = grid.size().iter().map(|n| *n as u32).collect();
    let values = frames.order().flat_map(|k| frames.values(field.data(), k)).flatten().copied();
    item([
        decimals(tags::IMAGE_POSITION_PATIENT, grid.centre([0, 0, frames.first()]).coords.iter().copied()),
        decimals(tags::IMAGE_ORIENTATION_PATIENT, orientation(grid)),
        DataElement::new(tags::GRID_DIMENSIONS, VR::UL, PrimitiveValue::U32(size.into())),
        DataElement::new(tags::GRID_RESOLUTION, VR::FD, PrimitiveValue::F64(grid.spacing().to_vec().into())),
        DataElement::new(tags::VECTOR_GRID_DATA, VR::OF, PrimitiveValue::F32(values.collect())),
    ])
}

/// Reads a displacement field from a Deformable Spatial Registration. Matrices before and after the vectors are affine, so
/// they become part of the vectors exactly, between them too.
///
/// # Errors
/// [`Error::Read`] when the file cannot be read or lacks what it must hold; [`Error::Input`] when it is of another class,
/// holds several registrations, or vectors that are undefined.
pub fn read_deformable(path: impl AsRef<Path>) -> Result<Deformable> {
    let path = path.as_ref();
    parse(path, &read_bytes(path)?)
}

/// The same with what is told of a field's file, and the frames of reference that it joins.
///
/// # Errors
/// As [`read_deformable`].
pub(in super::super::super) fn read_field(path: &Path) -> Result<(FieldFile, [String; 2])> {
    let bytes = read_bytes(path)?;
    let (sha256, parsed) = rayon::join(|| sha256(&bytes), || parse(path, &bytes));
    let Deformable { from, to, displacement } = parsed?;
    let header = HeaderNotes::plain("DICOM Deformable Spatial Registration", displacement.grid(), "float32", "");
    let loaded = Loaded { value: displacement, path: path.to_owned(), sha256, header, warnings: Vec::new() };
    Ok((loaded, [from, to]))
}

fn parse(path: &Path, bytes: &[u8]) -> Result<Deformable> {
    let source = Source { path };
    let class = uids::DEFORMABLE_SPATIAL_REGISTRATION_STORAGE;
    let object = source.parse(bytes, class, "Deformable Spatial Registration")?;
    let from = source.text(&object, tags::FRAME_OF_REFERENCE_UID, "Frame of Reference UID")?;
    let item = the_one(&source, &object)?;
    let to = source.text(item, tags::SOURCE_FRAME_OF_REFERENCE_UID, "Source Frame of Reference UID")?;
    let before = matrix(&source, item, tags::PRE_DEFORMATION_MATRIX_REGISTRATION_SEQUENCE)?;
    let after = matrix(&source, item, tags::POST_DEFORMATION_MATRIX_REGISTRATION_SEQUENCE)?;
    let [grid_item] = source.items(item, tags::DEFORMABLE_REGISTRATION_GRID_SEQUENCE) else {
        return Err(source.damaged("it has not one deformation grid".into()));
    };
    let grid = grid(&source, grid_item)?;
    let vectors = floats(&source, grid_item, &grid)?;
    let undefined = vectors.iter().filter(|d| d.iter().any(|c| !c.is_finite())).count();
    if undefined > 0 {
        let problem = format!("{undefined} of its {} vectors are undefined (NaN)", vectors.len());
        let remedy = "export the registration on a grid that it covers whole";
        return Err(Error::input(source.path.display().to_string(), problem, remedy));
    }
    let displacement = |n: usize| -> [f32; 3] {
        let x = grid.centre(grid.voxel(n));
        let moved = before.transform_point(&x) + Vector3::from(vectors[n].map(f64::from));
        (after.transform_point(&moved) - x).map(|c| c as f32).into()
    };
    let identity = before == Matrix4::identity() && after == Matrix4::identity();
    let displacement = if identity { Volume::new(grid, vectors)? } else { Volume::from_fn(grid.clone(), displacement) };
    Ok(Deformable { from, to, displacement })
}

/// Of an object's header: the frame of reference whose points it takes, the one where they arrive, and its grid.
pub(in crate::io::dicom) fn describe_deformable(object: &Object) -> Result<(String, String, Grid)> {
    let (source, set): (_, &InMemDicomObject) = (Source { path: &object.path }, &object.header);
    let item = the_one(&source, set)?;
    let to = source.text(item, tags::SOURCE_FRAME_OF_REFERENCE_UID, "Source Frame of Reference UID")?;
    let [grid_item] = source.items(item, tags::DEFORMABLE_REGISTRATION_GRID_SEQUENCE) else {
        return Err(source.damaged("it has not one deformation grid".into()));
    };
    Ok((source.text(set, tags::FRAME_OF_REFERENCE_UID, "Frame of Reference UID")?, to, grid(&source, grid_item)?))
}

/// The one registration that has a grid; others must do nothing.
fn the_one<'o>(source: &Source<'_>, object: &'o InMemDicomObject) -> Result<&'o InMemDicomObject> {
    let items = source.items(object, tags::DEFORMABLE_REGISTRATION_SEQUENCE);
    let has_grid = |i: &&InMemDicomObject| !source.items(i, tags::DEFORMABLE_REGISTRATION_GRID_SEQUENCE).is_empty();
    let (with, without): (Vec<_>, Vec<_>) = items.iter().partition(has_grid);
    for item in &without {
        for tag in
            [tags::PRE_DEFORMATION_MATRIX_REGISTRATION_SEQUENCE, tags::POST_DEFORMATION_MATRIX_REGISTRATION_SEQUENCE]
        {
            if (matrix(source, item, tag)? - Matrix4::identity()).abs().max() > 1e-6 {
                let problem =
                    "a matrix stands in a registration of its own, and it is not told how it belongs to the grid";
                let remedy = "export matrices and grid as one registration, or only the grid";
                return Err(Error::input(source.path.display().to_string(), problem, remedy));
            }
        }
    }
    match with[..] {
        [one] => Ok(one),
        [] => Err(source.damaged("it has no deformation grid".into())),
        _ => {
            let problem = format!("it holds {} deformation grids", with.len());
            let remedy = "export each registration as an object of its own";
            Err(Error::input(source.path.display().to_string(), problem, remedy))
        }
    }
}

/// The matrix of a sequence, or the identity where there is none.
fn matrix(source: &Source<'_>, item: &InMemDicomObject, tag: dicom_core::Tag) -> Result<Matrix4<f64>> {
    match source.items(item, tag) {
        [] => Ok(Matrix4::identity()),
        [one] => source.matrix(one),
        more => Err(source.damaged(format!("{} matrices stand where one may", more.len()))),
    }
}

fn grid(source: &Source<'_>, item: &InMemDicomObject) -> Result<Grid> {
    let position: [f64; 3] = source.numbers(item, tags::IMAGE_POSITION_PATIENT, "Image Position")?;
    let o: [f64; 6] = source.numbers(item, tags::IMAGE_ORIENTATION_PATIENT, "Image Orientation")?;
    let size: [f64; 3] = source.numbers(item, tags::GRID_DIMENSIONS, "Grid Dimensions")?;
    let spacing = source.numbers(item, tags::GRID_RESOLUTION, "Grid Resolution")?;
    let (row, column) = (Vector3::new(o[0], o[1], o[2]), Vector3::new(o[3], o[4], o[5]));
    let direction = Matrix3::from_columns(&[row, column, row.cross(&column)]);
    Grid::new(size.map(|n| n as usize), spacing, Point3::from(position), direction)
        .map_err(|e| source.damaged(format!("its deformation grid is none: {e}")))
}

/// The vectors of a grid.
fn floats(source: &Source<'_>, item: &InMemDicomObject, grid: &Grid) -> Result<Vec<[f32; 3]>> {
    let value = item.get(tags::VECTOR_GRID_DATA).and_then(|e| e.value().primitive());
    let values: Vec<f32> = match value {
        Some(PrimitiveValue::F32(values)) => values.to_vec(),
        // Of unknown value representation: little-endian, as all syntaxes in which that occurs.
        Some(PrimitiveValue::U8(bytes)) => bytes.as_chunks::<4>().0.iter().map(|b| f32::from_le_bytes(*b)).collect(),
        _ => Vec::new(),
    };
    if values.len() / 3 != grid.len() || !values.len().is_multiple_of(3) {
        let problem = format!("its vector grid has {} numbers, not 3 for each of {:?}", values.len(), grid.size());
        return Err(source.damaged(problem));
    }
    Ok(values.as_chunks::<3>().0.to_vec())
}

#[cfg(test)]
mod tests;
