//! Reading: the one file that names the `nifti` crate, which parses the header in either byte order.
//!
//! The crate's own way from file to array is not used: it stops after the first gzip member, trusts lengths in the
//! header, and converts in three passes on one thread. Values are decoded by `voxels`, as for the other formats.

use super::super::gzip::{GzipContent, problem};
use super::super::kinds;
use super::super::raster::{ExtensionNote, HeaderNotes, Raster, VectorKind};
use super::super::text::plain_text;
use super::super::voxels::{Element, Layout};
use super::geometry::{Fields, Placed};
use crate::error::{Error, Result};
use crate::findings;
use crate::warning::Warning;
use ::nifti::{Endianness, NiftiHeader, NiftiType};
use std::collections::BTreeMap;
use std::io;
use std::path::Path;

/// Bytes of a NIfTI-1 header.
const HEADER: usize = 348;
/// Farthest position of the first value: extensions are kilobytes, and what lies before the values is inflated, too.
const FARTHEST: f32 = (1 << 26) as f32;
/// Intent codes of nifti1.h.
const DISPVECT: i16 = 1006;
const VECTOR: i16 = 1007;

/// Parses a NIfTI-1 file's header and keeps its values as bytes.
///
/// # Errors
/// [`Error::Read`] when it is no NIfTI-1 single file, damaged, or of a type that holds no plain numbers;
/// [`Error::Input`] when its geometry cannot be used.
pub(in super::super) fn parse<'a>(path: &Path, raw: &'a [u8]) -> Result<Raster<'a>> {
    let damaged = |e: io::Error| Error::read(path, problem(&e), "copy or export the file again");
    let compressed = raw.starts_with(&[0x1f, 0x8b]);
    let mut content = GzipContent::new(raw);
    let header = header(path, content.first(HEADER).map_err(damaged)?)?;
    let sizes = sizes(path, &header)?;
    let element = element(path, &header)?;
    let scaling = scaling(path, &header)?;
    let offset = voxel_offset(path, &header)?;
    let placed = place(path, &header, &sizes)?;
    let values = sizes.iter().try_fold(1usize, |n, &s| n.checked_mul(s));
    let end =
        values.and_then(|n| n.checked_mul(element.size())).and_then(|n| n.checked_add(offset)).ok_or_else(|| {
            Error::read(
                path,
                format!("sizes {sizes:?} are too large"),
                "the header is damaged: copy or export the file again",
            )
        })?;
    content.first(end).map_err(damaged)?;
    let bytes = content.checked().map_err(damaged)?;
    let big_endian = header.endianness == Endianness::Big;
    let Placed { grid, source, disagreement_mm, mut warnings } = placed;
    let extensions = extensions(&bytes[..offset.min(bytes.len())], big_endian, &mut warnings);
    let notes = HeaderNotes {
        format: "NIfTI-1".into(),
        sizes: sizes.clone(),
        datatype: element.name().into(),
        big_endian,
        compressed,
        scaling,
        geometry: source,
        sform_code: Some(header.sform_code),
        qform_code: Some(header.qform_code),
        disagreement_mm,
        intent_code: Some(header.intent_code),
        intent_name: text(&header.intent_name),
        description: text(&header.descrip),
        extensions: extensions.iter().map(|(code, data)| ExtensionNote { code: *code, bytes: data.len() }).collect(),
    };
    let components = values.unwrap_or_default() / grid.len();
    let vectors = vector_kind(&header, &sizes);
    Ok(Raster {
        grid,
        components,
        layout: Layout::Planar,
        vectors,
        element,
        bytes,
        offset,
        notes,
        extensions,
        names: BTreeMap::new(),
        warnings,
    })
}

/// The most bytes of a file that its header accounts for, compression that fails included.
pub(in super::super) fn promised(path: &Path, raw: &[u8]) -> Result<u64> {
    let mut content = GzipContent::new(raw);
    let head = content.first(HEADER).map_err(|e| Error::read(path, problem(&e), "copy or export the file again"))?;
    let header = header(path, head)?;
    let need = sizes(path, &header)?.iter().fold(8u64, |n, &s| n.saturating_mul(s as u64));
    Ok(need.saturating_add(voxel_offset(path, &header)? as u64))
}

fn header(path: &Path, bytes: &[u8]) -> Result<NiftiHeader> {
    let not_nifti = |problem: &str| {
        let remedy = "give a NIfTI-1 file (.nii, .nii.gz), a MetaImage (.mha) or an NRRD (.nrrd), or the \
            folder of a DICOM series";
        Error::read(path, problem, remedy)
    };
    if let Some(other) = kinds::told(bytes) {
        return Err(Error::read(path, format!("it is {}, no NIfTI-1 file", other.what), other.remedy));
    }
    let first = bytes.first_chunk::<4>().copied().unwrap_or_default();
    if [i32::from_le_bytes(first), i32::from_be_bytes(first)].contains(&540) {
        return Err(Error::read(path, "it is a NIfTI-2 file", "convert it to NIfTI-1"));
    }
    if bytes.len() < HEADER {
        return Err(not_nifti(&format!("it holds {} bytes, fewer than a NIfTI-1 header", bytes.len())));
    }
    if [i32::from_le_bytes(first), i32::from_be_bytes(first)].contains(&(HEADER as i32)) && bytes[344..348] == [0; 4] {
        let remedy = "convert header and image to one .nii file, and check left and right: ANALYZE does not tell them";
        return Err(Error::read(path, "it is an ANALYZE 7.5 header, without a NIfTI-1 magic number", remedy));
    }
    let header = NiftiHeader::from_reader(bytes).map_err(|_| not_nifti("it has no NIfTI-1 magic number"))?;
    if header.sizeof_hdr != HEADER as i32 {
        return Err(not_nifti(&format!("its header length is {}, not 348", header.sizeof_hdr)));
    }
    if header.magic != *b"n+1\0" {
        return Err(Error::read(path, "it is the header of a .hdr/.img pair", "convert the pair to one .nii file"));
    }
    Ok(header)
}

/// Sizes of all axes, at least three.
fn sizes(path: &Path, header: &NiftiHeader) -> Result<Vec<usize>> {
    let rank = usize::from(header.dim[0]);
    let used = header.dim.get(1..=rank).unwrap_or_default();
    if used.is_empty() || used.iter().any(|&n| n == 0 || n > i16::MAX as u16) {
        let dim = header.dim.map(|n| n as i16);
        return Err(Error::read(
            path,
            format!("dim {dim:?} is no image size"),
            "the header is damaged: copy or export the file again",
        ));
    }
    let mut sizes: Vec<usize> = used.iter().map(|&n| usize::from(n)).collect();
    sizes.resize(rank.max(3), 1);
    Ok(sizes)
}

fn element(path: &Path, header: &NiftiHeader) -> Result<Element> {
    Ok(match header.data_type() {
        Ok(NiftiType::Uint8) => Element::U8,
        Ok(NiftiType::Int8) => Element::I8,
        Ok(NiftiType::Uint16) => Element::U16,
        Ok(NiftiType::Int16) => Element::I16,
        Ok(NiftiType::Uint32) => Element::U32,
        Ok(NiftiType::Int32) => Element::I32,
        Ok(NiftiType::Uint64) => Element::U64,
        Ok(NiftiType::Int64) => Element::I64,
        Ok(NiftiType::Float32) => Element::F32,
        Ok(NiftiType::Float64) => Element::F64,
        other => {
            let name = other.map_or_else(|_| "unknown".into(), |t| format!("{t:?}"));
            let problem = format!("its values are of type {} ({name}), not integers or floats", header.datatype);
            return Err(Error::read(path, problem, "convert it to int16 or float32"));
        }
    })
}

/// Slope and offset of values, where they change anything; slope 0 or NaN means that there are none (nifti1.h; nibabel's NaN).
fn scaling(path: &Path, header: &NiftiHeader) -> Result<Option<[f64; 2]>> {
    let (slope, inter) = (f64::from(header.scl_slope), f64::from(header.scl_inter));
    let identity = slope.total_cmp(&1.0).is_eq() && inter.abs().total_cmp(&0.0).is_eq();
    if slope == 0.0 || slope.is_nan() || identity {
        return Ok(None);
    }
    if !slope.is_finite() || !inter.is_finite() {
        let problem = format!("scl_slope {slope} and scl_inter {inter} are not finite");
        return Err(Error::read(path, problem, "correct the header: slope 1 and inter 0 mean unscaled values"));
    }
    Ok(Some([slope, inter]))
}

/// Position of the first value.
fn voxel_offset(path: &Path, header: &NiftiHeader) -> Result<usize> {
    let offset = header.vox_offset;
    // Some writers leave 0, which cannot be meant in a single file.
    if offset == 0.0 {
        return Ok(HEADER + 4);
    }
    if !((HEADER as f32 + 4.0)..=FARTHEST).contains(&offset) || offset.fract() != 0.0 {
        let problem = format!("vox_offset {offset} is no position behind the header");
        return Err(Error::read(path, problem, "the header is damaged: copy or export the file again"));
    }
    Ok(offset as usize)
}

fn place(path: &Path, header: &NiftiHeader, sizes: &[usize]) -> Result<Placed> {
    // Readers take an unknown unit for mm.
    if !matches!(header.xyzt_units & 7, 0 | 2) {
        let unit = match header.xyzt_units & 7 {
            1 => "metres",
            3 => "micrometres",
            _ => "none of NIfTI's",
        };
        let remedy = "convert its sform and pixdim to mm and set xyzt_units to 2";
        return Err(Error::input(path.display().to_string(), format!("its unit of length is {unit}, not mm"), remedy));
    }
    // Axes that a file does not have need no spacing.
    let rank = usize::from(header.dim[0]);
    let pixdim = std::array::from_fn(|a| match header.pixdim[a] {
        0.0 if a > rank => 1.0,
        spacing => spacing,
    });
    let fields = Fields {
        size: [sizes[0], sizes[1], sizes[2]],
        pixdim,
        sform_code: header.sform_code,
        qform_code: header.qform_code,
        quaternion: [header.quatern_b, header.quatern_c, header.quatern_d],
        offset: [header.quatern_x, header.quatern_y, header.quatern_z],
        rows: [header.srow_x, header.srow_y, header.srow_z],
    };
    fields.place(&path.display().to_string())
}

/// Header extensions: code and content, as far as they are well formed.
fn extensions(head: &[u8], big_endian: bool, warnings: &mut Vec<Warning>) -> Vec<(i32, Vec<u8>)> {
    let mut found = Vec::new();
    if head.get(HEADER).is_none_or(|&flag| flag == 0) {
        return found;
    }
    let mut rest = head.get(HEADER + 4..).unwrap_or_default();
    while let Some((&[size, code], _)) = rest.as_chunks::<4>().0.split_first_chunk::<2>() {
        let [size, code] = [size, code].map(|b| if big_endian { i32::from_be_bytes(b) } else { i32::from_le_bytes(b) });
        let Some(data) = usize::try_from(size).ok().and_then(|n| rest.get(8..n)) else {
            // Padding up to the voxels is legal; anything else is damage that does not touch them.
            if size != 0 {
                let message = format!(
                    "header extension {} claims {size} bytes; it and those behind it are ignored",
                    found.len() + 1
                );
                warnings.push(Warning::new(findings::EXTENSION_DAMAGED, message));
            }
            break;
        };
        found.push((code, data.to_vec()));
        rest = &rest[8 + data.len()..];
    }
    found
}

/// What the vectors of a file mean, or why it is no displacement field.
///
/// ITK writes LPS with intent 1007 and RAS with 1006; NiftyReg writes RAS and puts its field type into `intent_p1`.
fn vector_kind(header: &NiftiHeader, sizes: &[usize]) -> Result<VectorKind, String> {
    if sizes.len() != 5 || sizes[3] != 1 || sizes[4] != 3 {
        return Err(format!(
            "sizes {sizes:?} with intent_code {} are no 5-D (x, y, z, 1, 3) displacement field",
            header.intent_code
        ));
    }
    let niftyreg = text(&header.intent_name) == "NREG_TRANS";
    match (niftyreg, header.intent_code) {
        (true, DISPVECT | VECTOR) if header.intent_p1.to_bits() == 0f32.to_bits() => Ok(VectorKind::RasPosition),
        (true, DISPVECT | VECTOR) if header.intent_p1.to_bits() == 1f32.to_bits() => Ok(VectorKind::Ras),
        (true, _) => Err(format!(
            "its NiftyReg field type (intent_p1) is {}, not 0 (deformation) or 1 (displacement)",
            header.intent_p1
        )),
        (false, VECTOR) => Ok(VectorKind::Lps),
        (false, DISPVECT) => Ok(VectorKind::Ras),
        (false, code) => Err(format!(
            "its intent_code is {code}, neither 1007 (vectors, LPS) nor 1006 (displacements, RAS), so the frame of its vectors is unknown"
        )),
    }
}

/// A header's text up to the first NUL.
fn text(bytes: &[u8]) -> String {
    let end = bytes.iter().position(|&b| b == 0).unwrap_or(bytes.len());
    plain_text(&String::from_utf8_lossy(&bytes[..end]))
}
