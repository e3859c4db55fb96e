//! Writing: the 348-byte header, extensions, and the values behind them.
//!
//! Not the crate's writer: it renames files with dots in their names and knows no parallel compression.

use super::super::values::{Contents, Meaning};
use super::super::voxels::Element;
use super::geometry::Fields;
use crate::error::{Error, Result};
use crate::field::FieldFormat;
use std::path::Path;

/// Everything before the values: header, extender and extension.
///
/// # Errors
/// [`Error::Write`] when an axis has more than 32767 voxels, which NIfTI-1 cannot express.
pub(in super::super) fn header(path: &Path, contents: &Contents<'_>) -> Result<Vec<u8>> {
    let fields = Fields::of_grid(contents.grid);
    let vectors = contents.values.components() == 3;
    let element = contents.values.element();
    let mut dim = [1i16; 8];
    dim[0] = if vectors { 5 } else { 3 };
    for (to, from) in dim[1..4].iter_mut().zip(fields.size) {
        *to = i16::try_from(from).map_err(|_| {
            Error::write(
                path,
                format!("NIfTI-1 holds at most 32767 voxels along an axis, not {from}"),
                "write .nrrd or .mha instead",
            )
        })?;
    }
    if vectors {
        dim[5] = 3;
    }
    let extension = contents.extension.as_deref().map(extension_bytes).unwrap_or_default();
    let offset = 352 + extension.len();
    // Intent, NiftyReg's field type (1 displacement, 0 deformation) and name.
    let (intent, kind, name): (i16, f32, &[u8]) = match contents.meaning {
        Meaning::Scalar => (0, 0.0, b""),
        Meaning::Labels => (1002, 0.0, b""),
        Meaning::Field(FieldFormat::Dispvect) => (1006, 0.0, b""),
        Meaning::Field(FieldFormat::NiftyregDisplacement) => (1007, 1.0, b"NREG_TRANS"),
        Meaning::Field(FieldFormat::NiftyregDeformation) => (1007, 0.0, b"NREG_TRANS"),
        Meaning::Field(_) => (1007, 0.0, b""),
    };

    let mut h = Vec::with_capacity(offset);
    h.extend(348i32.to_le_bytes());
    h.resize(38, 0);
    h.extend([b'r', 0]);
    put_i16(&mut h, &dim);
    put_f32(&mut h, &[kind, 0.0, 0.0]);
    put_i16(&mut h, &[intent, datatype(element), 8 * element.size() as i16, 0]);
    put_f32(&mut h, &fields.pixdim);
    put_f32(&mut h, &[1.0; 4]);
    put_f32(&mut h, &[offset as f32, 1.0, 0.0]);
    // slice_end, slice_code, then xyzt_units = mm.
    h.extend([0, 0, 0, 2]);
    h.resize(148, 0);
    h.extend(clip(contents.description, 79).bytes());
    h.resize(252, 0);
    put_i16(&mut h, &[fields.qform_code, fields.sform_code]);
    put_f32(&mut h, &fields.quaternion);
    put_f32(&mut h, &fields.offset);
    fields.rows.iter().for_each(|row| put_f32(&mut h, row));
    h.extend(name);
    h.resize(344, 0);
    h.extend(b"n+1\0");
    h.extend([u8::from(!extension.is_empty()), 0, 0, 0]);
    h.extend(extension);
    Ok(h)
}

fn put_i16(out: &mut Vec<u8>, values: &[i16]) {
    values.iter().for_each(|v| out.extend(v.to_le_bytes()));
}

fn put_f32(out: &mut Vec<u8>, values: &[f32]) {
    values.iter().for_each(|v| out.extend(v.to_le_bytes()));
}

/// One extension of code 0, padded to a multiple of 16 bytes with spaces, which XML parsers skip (NULs they do not).
fn extension_bytes(text: &str) -> Vec<u8> {
    let size = (8 + text.len()).next_multiple_of(16);
    let mut out = Vec::with_capacity(size);
    out.extend((size as i32).to_le_bytes());
    out.extend(0i32.to_le_bytes());
    out.extend(text.bytes());
    out.resize(size, b' ');
    out
}

fn datatype(element: Element) -> i16 {
    match element {
        Element::U8 => 2,
        Element::I16 => 4,
        Element::I32 => 8,
        Element::F32 => 16,
        Element::F64 => 64,
        Element::I8 => 256,
        Element::U16 => 512,
        Element::U32 => 768,
        Element::I64 => 1024,
        Element::U64 => 1280,
    }
}

/// The longest beginning of at most `most` bytes that ends between characters.
fn clip(text: &str, most: usize) -> &str {
    let end = (0..=most.min(text.len())).rev().find(|&n| text.is_char_boundary(n)).unwrap_or(0);
    &text[..end]
}
