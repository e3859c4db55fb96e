//! NRRD (`.nrrd`) with an attached header: LPS mm, raw or gzip, as ITK and Slicer read and write it.
//!
//! Every field of the format is honoured, refused, or without effect on values and geometry (thicknesses, labels, min, max).
//! Source: "Definition of NRRD File Format", teem.sourceforge.net/nrrd/format.html.

mod fields;
mod geometry;
#[cfg(test)]
mod tests;

use super::gzip::{GzipContent, problem};
use super::raster::{GeometrySource, HeaderNotes, Raster, VectorKind};
use super::text::{BYTE_ORDER_MARK, plain_text};
use super::values::Contents;
use super::voxels::{Element, Layout};
use crate::error::{Error, Result};
use fields::Fields;
use geometry::Placed;
use nalgebra::Vector3;
use std::borrow::Cow;
use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::path::Path;

/// Whether a file starts as NRRD headers do, perhaps behind a byte order mark.
pub(super) fn is_nrrd(raw: &[u8]) -> bool {
    raw[mark(raw)..].starts_with(b"NRRD0")
}

/// Bytes of a byte order mark, which some editors put before a header.
fn mark(raw: &[u8]) -> usize {
    if raw.starts_with(BYTE_ORDER_MARK) { BYTE_ORDER_MARK.len() } else { 0 }
}

/// The most bytes of a file that its header accounts for, compression that fails included.
pub(super) fn promised(path: &Path, raw: &[u8]) -> Result<u64> {
    let fields = Fields::parse(path, raw, mark(raw))?;
    let need = sizes(&fields)?.iter().fold(8u64, |n, &s| n.saturating_mul(s as u64));
    let skipped = fields.integer("byteskip")?.unwrap_or(0).max(0) as u64;
    Ok(need.saturating_add(skipped).saturating_add(fields.end as u64))
}

/// Parses an NRRD's header and keeps its values as bytes.
///
/// # Errors
/// [`Error::Read`] when the header is damaged or the values are elsewhere, in another encoding, or no numbers;
/// [`Error::Input`] when its geometry cannot be used or a field contradicts others.
pub(super) fn parse<'a>(path: &Path, raw: &'a [u8]) -> Result<Raster<'a>> {
    let fields = Fields::parse(path, raw, mark(raw))?;
    if let Some(file) = fields.get("datafile") {
        return Err(Error::read(
            path,
            format!("it is a detached header (.nhdr): its values are in {file:?}"),
            "join them to one file: `unu save -f nrrd -i IN.nhdr -o OUT.nrrd`, or read and write it with SimpleITK or Slicer",
        ));
    }
    let stored = sizes(&fields)?;
    basics(&fields, &stored)?;
    let mut warnings = Vec::new();
    let element = element(&fields)?;
    if stored.len() == 4 && fields.notes.keys().any(|k| k.starts_with("Segment0_")) {
        return Err(Error::input(
            path.display().to_string(),
            format!("it is a segmentation of {} layers whose segments overlap", stored.iter().min().unwrap_or(&0)),
            "export it from Slicer as a label map (Export to labelmap), or each segment as a file of its own",
        ));
    }
    let Placed { grid, range_axis, is_lps } = geometry::place(&fields, &stored, &mut warnings)?;
    let values = stored.iter().try_fold(element.size(), |n, &s| n.checked_mul(s));
    let need = values.ok_or_else(|| fields.refuse(format!("sizes {stored:?} are too large")))?;
    let big_endian = big_endian(&fields, element)?;
    let (bytes, offset, compressed) = values_of(&fields, raw, need)?;
    let components = if range_axis.is_some() { need / element.size() / grid.len() } else { 1 };
    let layout = if range_axis == Some(0) { Layout::Interleaved } else { Layout::Planar };
    let vectors = vector_kind(&fields, components, range_axis, is_lps);
    let notes = HeaderNotes {
        format: "NRRD".into(),
        sizes: stored,
        datatype: element.name().into(),
        big_endian,
        compressed,
        scaling: None,
        geometry: GeometrySource::Header,
        sform_code: None,
        qform_code: None,
        disagreement_mm: None,
        intent_code: None,
        intent_name: String::new(),
        description: plain_text(fields.get("content").unwrap_or_default()),
        extensions: Vec::new(),
    };
    let names = segments(&fields)?;
    Ok(Raster {
        grid,
        components,
        layout,
        vectors,
        element,
        bytes,
        offset,
        notes,
        extensions: Vec::new(),
        names,
        warnings,
    })
}

/// Sizes of all axes.
fn sizes(fields: &Fields<'_>) -> Result<Vec<usize>> {
    let words = fields.words("sizes");
    let stored: Option<Vec<usize>> = words.iter().map(|w| w.parse().ok()).collect();
    let stored = stored.filter(|s| (2..=4).contains(&s.len()) && !s.contains(&0));
    let stored = stored.ok_or_else(|| fields.refuse(format!("sizes {words:?} are not 2 to 4 positive numbers")))?;
    match fields.integer("dimension")? {
        Some(n) if n == stored.len() as i64 => Ok(stored),
        Some(n) => Err(fields.field(format!("dimension {n}, but {} sizes", stored.len()), "correct the header")),
        None => Err(fields.refuse("its header has no dimension".into())),
    }
}

/// Refuses what the fields that stand for the whole file say of values that are stored otherwise.
fn basics(fields: &Fields<'_>, sizes: &[usize]) -> Result<()> {
    if let Some(number) = fields.integer("number")? {
        let product = sizes.iter().try_fold(1i64, |n, &s| n.checked_mul(i64::try_from(s).ok()?));
        if product != Some(number) {
            return Err(fields.field(format!("number {number} is not the product of {sizes:?}"), "correct the header"));
        }
    }
    if let Some(size) = fields.get("blocksize") {
        return Err(
            fields.field(format!("block size {size}: its values are blocks, no numbers"), "export it as numbers")
        );
    }
    for key in ["oldmin", "oldmax"] {
        if let Some(value) = fields.get(key).filter(|v| !v.eq_ignore_ascii_case("nan")) {
            return Err(fields.field(
                format!("{key} {value}: its values were quantised, they are no HU or Gy as they stand"),
                "restore them with `unu unquantize`, or delete old min and old max if the values are right as stored",
            ));
        }
    }
    let unit = fields.quoted("sampleunits").join(" ");
    let known = ["", "???", "none", "1", "hu", "hounsfield", "hounsfield unit", "hounsfield units", "gy", "gray", "mm"];
    if !known.contains(&unit.to_ascii_lowercase().as_str()) {
        return Err(fields.field(
            format!("its values are in {unit:?}, not HU, Gy or mm"),
            "convert the values, or delete the line if it is wrong",
        ));
    }
    Ok(())
}

/// Whether values are stored with the most significant byte first.
fn big_endian(fields: &Fields<'_>, element: Element) -> Result<bool> {
    match fields.word("endian").as_deref() {
        Some("little") => Ok(false),
        Some("big") => Ok(true),
        None if element.size() == 1 => Ok(false),
        None => Err(fields.field(
            format!("it does not tell the byte order of its {} values", element.name()),
            "add the line `endian: little` (or big) to the header",
        )),
        Some(other) => Err(fields.field(format!("endian {other:?} is neither little nor big"), "correct the header")),
    }
}

/// What the components of a voxel mean, or why it is no displacement field.
fn vector_kind(
    fields: &Fields<'_>,
    components: usize,
    range_axis: Option<usize>,
    is_lps: bool,
) -> Result<VectorKind, String> {
    if components != 3 {
        return Err(format!("it has {components} values per voxel, not 3 as a displacement field has"));
    }
    if !is_lps {
        let space = fields.get("space").unwrap_or("not given");
        return Err(format!("its space is {space}, so the frame of its vectors is unknown"));
    }
    let kinds = fields.word("kinds").unwrap_or_default();
    let kind = range_axis.and_then(|a| kinds.split_whitespace().nth(a)).unwrap_or("???");
    if !matches!(kind, "vector" | "3-vector" | "list" | "none" | "???") {
        return Err(format!("its values are of kind {kind}, not vectors"));
    }
    if let Some(text) = fields.get("measurementframe") {
        let columns = geometry::vectors(text).unwrap_or_default();
        let unit = |(n, v): (usize, &Option<Vector3<f64>>)| {
            v.is_some_and(|v| (0..3).all(|a| (v[a] - f64::from(u8::from(a == n))).abs() < 1e-6))
        };
        if columns.len() != 3 || !columns.iter().enumerate().all(unit) {
            return Err(format!("its measurement frame {text} turns its vectors; only the unit matrix is read"));
        }
    }
    match fields.notes.get("displacement field type").map(String::as_str) {
        None | Some("resampling") => Ok(VectorKind::Lps),
        Some(other) => {
            Err(format!("its displacement field type is {other}, not resampling, so it points the other way"))
        }
    }
}

/// Names of the labels of a segmentation of Slicer (`.seg.nrrd`).
fn segments(fields: &Fields<'_>) -> Result<BTreeMap<u16, String>> {
    let mut names = BTreeMap::new();
    for (key, value) in &fields.notes {
        let Some(segment) = key.strip_suffix("_LabelValue").filter(|k| k.starts_with("Segment")) else { continue };
        let label = value.trim().parse::<u16>().map_err(|_| {
            fields
                .field(format!("{key} {value:?} is no label from 0 to 65535"), "save the segmentation again in Slicer")
        })?;
        if let Some(name) = fields.notes.get(&format!("{segment}_Name")).map(|n| n.trim()).filter(|n| !n.is_empty())
            && label > 0
            && names.insert(label, name.to_owned()).is_some_and(|other| other != *name)
        {
            return Err(fields.field(
                format!("two segments have the label {label}"),
                "export it from Slicer as a label map (Export to labelmap)",
            ));
        }
    }
    Ok(names)
}

fn element(fields: &Fields<'_>) -> Result<Element> {
    Ok(match fields.word("type").unwrap_or_default().as_str() {
        "uchar" | "unsigned char" | "uint8" | "uint8_t" => Element::U8,
        "signed char" | "int8" | "int8_t" => Element::I8,
        "ushort" | "unsigned short" | "unsigned short int" | "uint16" | "uint16_t" => Element::U16,
        "short" | "short int" | "signed short" | "signed short int" | "int16" | "int16_t" => Element::I16,
        "uint" | "unsigned int" | "uint32" | "uint32_t" => Element::U32,
        "int" | "signed int" | "int32" | "int32_t" => Element::I32,
        "ulonglong" | "unsigned long long" | "unsigned long long int" | "uint64" | "uint64_t" => Element::U64,
        "longlong"
        | "long long"
        | "long long int"
        | "signed long long"
        | "signed long long int"
        | "int64"
        | "int64_t" => Element::I64,
        "float" => Element::F32,
        "double" => Element::F64,
        other => return Err(fields.refuse(format!("type {other:?} is no integer or float type"))),
    })
}

/// The bytes that hold the values, where these begin in them, and whether they were compressed.
fn values_of<'a>(fields: &Fields<'_>, raw: &'a [u8], need: usize) -> Result<(Cow<'a, [u8]>, usize, bool)> {
    let cut = |skip: &str| fields.field(format!("{skip} reaches beyond the file's end"), "copy or export it again");
    let mut values = raw.get(fields.end..).unwrap_or_default();
    let lines = fields.integer("lineskip")?.unwrap_or(0);
    if lines < 0 {
        return Err(fields.field(format!("line skip {lines} is negative"), "correct the header"));
    }
    for _ in 0..lines {
        let length = values.iter().position(|b| *b == b'\n').ok_or_else(|| cut("line skip"))?;
        values = &values[length + 1..];
    }
    let skip = fields.integer("byteskip")?.unwrap_or(0);
    let encoding = fields.word("encoding");
    match (encoding.as_deref(), usize::try_from(skip)) {
        (Some("raw"), Ok(skip)) => {
            let values = values.get(skip..).ok_or_else(|| cut("byte skip"))?;
            Ok((Cow::Borrowed(values), 0, false))
        }
        // The values are the last of the file.
        (Some("raw"), Err(_)) if skip == -1 => {
            Ok((Cow::Borrowed(&values[values.len().saturating_sub(need)..]), 0, false))
        }
        // These are bytes of what was compressed.
        (Some("gzip" | "gz"), Ok(skip)) => {
            let damaged = |e: std::io::Error| Error::read(fields.path, problem(&e), "copy or export the file again");
            let mut content = GzipContent::new(values);
            content.first(need.saturating_add(skip)).map_err(damaged)?;
            Ok((content.checked().map_err(damaged)?, skip, true))
        }
        (Some("raw" | "gzip" | "gz"), Err(_)) => Err(fields.field(
            format!("byte skip {skip} has no meaning here"),
            "give the number of bytes before the values; -1 only with raw encoding",
        )),
        (other, _) => {
            Err(fields.refuse(format!("its encoding is {}, neither raw nor gzip", other.unwrap_or("not given"))))
        }
    }
}

/// Everything before the values.
pub(super) fn header(contents: &Contents<'_>, compressed: bool) -> Vec<u8> {
    let grid = contents.grid;
    let kind = match contents.values.element() {
        Element::U8 => "uint8",
        Element::I8 => "int8",
        Element::U16 => "uint16",
        Element::I16 => "int16",
        Element::U32 => "uint32",
        Element::I32 => "int32",
        Element::U64 => "uint64",
        Element::I64 => "int64",
        Element::F32 => "float",
        Element::F64 => "double",
    };
    let vectors = contents.values.components() > 1;
    let [nx, ny, nz] = grid.size();
    let parentheses = |v: [f64; 3]| format!("({},{},{})", v[0], v[1], v[2]);
    let axis = |a: usize| parentheses(grid.step().column(a).into_owned().into());
    let mut text = String::from("NRRD0004\n");
    let mut line = |key: &str, value: &str| {
        writeln!(text, "{key}: {value}").expect("writing to a String cannot fail");
    };
    line("type", kind);
    line("dimension", if vectors { "4" } else { "3" });
    line("space", "left-posterior-superior");
    line("sizes", &format!("{}{nx} {ny} {nz}", if vectors { "3 " } else { "" }));
    line("space directions", &format!("{}{} {} {}", if vectors { "none " } else { "" }, axis(0), axis(1), axis(2)));
    line("kinds", if vectors { "vector domain domain domain" } else { "domain domain domain" });
    line("endian", "little");
    line("encoding", if compressed { "gzip" } else { "raw" });
    line("space origin", &parentheses(grid.origin().coords.into()));
    let content = contents.description.replace(['\n', '\r'], " ");
    if !content.is_empty() {
        line("content", &content);
    }
    if vectors {
        // Slicer's note that the field resamples images, as every displacement field transform of ITK does.
        text.push_str("displacement field type:=resampling\n");
    }
    text.push('\n');
    text.into_bytes()
}
