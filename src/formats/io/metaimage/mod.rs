//! MetaImage (`.mha`) with the values in the same file: LPS mm, as ITK reads and writes it.
//!
//! Written without compression: the header must tell the compressed size before the values are compressed.
//! Every tag of the format is honoured, refused, or without effect on values and geometry (Name, ID, Color, Modality,
//! ElementMin and -Max, CenterOfRotation, which turns nothing). Source: MetaIO of Kitware, as used by ITK's `MetaImageIO`.

mod fields;
#[cfg(test)]
mod tests;

use super::raster::{GeometrySource, HeaderNotes, Raster, VectorKind};
use super::text::plain_text;
use super::values::Contents;
use super::voxels::{Element, Layout};
use crate::error::{Error, Result};
use crate::findings;
use crate::geometry::Grid;
use crate::warning::Warning;
use fields::{Fields, TAGS, mark};
use flate2::read::ZlibDecoder;
use nalgebra::{Matrix3, Point3};
use std::borrow::Cow;
use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::io::Read;
use std::path::Path;

/// Bytes within which the first line's tag ends.
const LONGEST_TAG: usize = 48;

/// Whether a file starts as MetaImage headers do: with a line of a tag, perhaps behind a byte order mark.
pub(super) fn is_metaimage(raw: &[u8]) -> bool {
    let text = &raw[mark(raw)..];
    let key = text.iter().take(LONGEST_TAG).position(|b| *b == b'=').map(|n| text[..n].trim_ascii());
    key.is_some_and(|key| TAGS.iter().any(|tag| tag.as_bytes() == key))
}

/// The most bytes of a file that its header accounts for, compression that fails included.
pub(super) fn promised(path: &Path, raw: &[u8]) -> Result<u64> {
    let fields = Fields::parse(path, raw)?;
    let (sizes, channels) = fields.sizes()?;
    let need = sizes.iter().fold(8u64.saturating_mul(channels as u64), |n, &s| n.saturating_mul(s as u64));
    let skipped = fields.one::<i64>("HeaderSize")?.unwrap_or(0).max(fields.end as i64) as u64;
    Ok(need.saturating_add(skipped))
}

/// Parses a MetaImage's header and keeps its values as bytes.
///
/// # Errors
/// [`Error::Read`] when the header is damaged or the values are elsewhere, text, or no numbers; [`Error::Input`] when a
/// field says what cannot be honoured, or contradicts another.
pub(super) fn parse<'a>(path: &Path, raw: &'a [u8]) -> Result<Raster<'a>> {
    let fields = Fields::parse(path, raw)?;
    fields.elsewhere()?;
    let (mut sizes, channels) = fields.sizes()?;
    let rank = sizes.len();
    let mut warnings = Vec::new();
    let grid = grid(&fields, &sizes, &mut warnings)?;
    sizes.resize(rank.max(3), 1);
    let volumes = sizes[3..].iter().try_fold(1usize, |n, &s| n.checked_mul(s));
    let element = element(&fields)?;
    unsupported(&fields, element)?;
    let components = volumes.and_then(|v| channels.checked_mul(v));
    let need = components.and_then(|c| c.checked_mul(grid.len())).and_then(|n| n.checked_mul(element.size()));
    let (Some(components), Some(need)) = (components, need) else {
        return Err(fields.refuse(format!("sizes {sizes:?} are too large")));
    };
    let compressed = fields.flag("CompressedData")? == Some(true);
    let bytes = values_of(&fields, raw, need, compressed)?;
    let notes = HeaderNotes {
        format: "MetaImage".into(),
        sizes: if channels > 1 { [&[channels], &sizes[..]].concat() } else { sizes },
        datatype: element.name().into(),
        big_endian: fields.same(&["BinaryDataByteOrderMSB", "ElementByteOrderMSB"], |k| fields.flag(k))? == Some(true),
        compressed,
        scaling: None,
        geometry: GeometrySource::Header,
        sform_code: None,
        qform_code: None,
        disagreement_mm: None,
        intent_code: None,
        intent_name: String::new(),
        description: plain_text(fields.get("Comment").unwrap_or_default()),
        extensions: Vec::new(),
    };
    let vectors = if channels == 3 && volumes == Some(1) {
        Ok(VectorKind::Lps)
    } else {
        Err(format!("it has {components} values per voxel, not 3 as a displacement field has"))
    };
    Ok(Raster {
        grid,
        components,
        layout: Layout::Interleaved,
        vectors,
        element,
        bytes,
        offset: 0,
        notes,
        extensions: Vec::new(),
        names: BTreeMap::new(),
        warnings,
    })
}

/// The bytes of the values, which begin where `HeaderSize` says, else behind the header.
fn values_of<'a>(fields: &Fields<'_>, raw: &'a [u8], need: usize, compressed: bool) -> Result<Cow<'a, [u8]>> {
    let values = match fields.one::<i64>("HeaderSize")?.unwrap_or(0) {
        0 => &raw[fields.end..],
        -1 if !compressed => &raw[raw.len().saturating_sub(need).max(fields.end)..],
        // From the beginning of the file, as MetaIO counts.
        n => match usize::try_from(n).ok().filter(|n| *n >= fields.end).and_then(|n| raw.get(n..)) {
            Some(values) => values,
            None => {
                let problem = format!("HeaderSize = {n} is no position of values behind the header");
                return Err(fields.field(problem, "write the file again without HeaderSize"));
            }
        },
    };
    if !compressed {
        return Ok(Cow::Borrowed(values));
    }
    let values = match fields.one::<usize>("CompressedDataSize")? {
        None | Some(0) => values,
        Some(n) => values.get(..n).ok_or_else(|| {
            fields.refuse(format!("CompressedDataSize is {n}, but the file holds {} bytes of it", values.len()))
        })?,
    };
    // One byte more than needed, so that the checksum behind the last one is reached.
    let most = need.saturating_add(1) as u64;
    let mut inflated = Vec::new();
    ZlibDecoder::new(values).take(most).read_to_end(&mut inflated).map_err(|e| {
        let problem = format!("the compressed values are damaged or cut off ({e})");
        Error::read(fields.path, problem, "copy or export the file again")
    })?;
    Ok(Cow::Owned(inflated))
}

/// Refuses fields that change values and are not honoured.
fn unsupported(fields: &Fields<'_>, element: Element) -> Result<()> {
    let plain = "write the file again with values as they are, for example with SimpleITK";
    if let Some(kind) = fields.get("ObjectType").filter(|k| *k != "Image") {
        return Err(fields.refuse(format!("it holds an object of type {kind}, not an image")));
    }
    for (key, neutral) in [("ElementToIntensityFunctionSlope", 1.0), ("ElementToIntensityFunctionOffset", 0.0)] {
        if let Some(value) = fields.one::<f64>(key)?.filter(|v| v.total_cmp(&neutral).is_ne()) {
            return Err(fields.field(format!("{key} = {value}: readers differ in whether they scale values"), plain));
        }
    }
    if let Some(bytes) = fields.one::<i64>("HeaderSizePerSlice")?.filter(|n| *n != 0) {
        return Err(fields.field(format!("HeaderSizePerSlice = {bytes}: bytes lie between its slices"), plain));
    }
    if let Some(bits) = fields.one::<usize>("ElementNBits")?.filter(|n| *n != 0 && *n != 8 * element.size()) {
        return Err(fields.field(format!("ElementNBits = {bits} is not the size of {}", element.name()), plain));
    }
    let units = fields.get("DistanceUnits").unwrap_or("mm");
    if !matches!(units, "mm" | "?" | "") {
        return Err(fields.field(format!("DistanceUnits = {units}, not mm"), "convert its geometry to mm"));
    }
    if fields.flag("BinaryData")? == Some(false) {
        return Err(fields.refuse("its values are text (BinaryData = False)".into()));
    }
    Ok(())
}

/// The grid of the first three axes; a 2-D image is one slice at z = 0.
fn grid(fields: &Fields<'_>, sizes: &[usize], warnings: &mut Vec<Warning>) -> Result<Grid> {
    let rank = sizes.len();
    let pick = |values: &[f64], a: usize, missing: f64| if a < rank { values[a] } else { missing };
    // ElementSize is what a voxel covers, not how far it is to the next.
    let spacing = match fields.optional("ElementSpacing", rank)? {
        Some(spacing) => spacing,
        None => fields.optional("ElementSize", rank)?.unwrap_or_else(|| {
            let message = "the header has no ElementSpacing; voxels are taken to be 1 mm apart, as ITK does";
            warnings.push(Warning::new(findings::NO_SPACING, message));
            vec![1.0; rank]
        }),
    };
    let origin = fields.same(&["Offset", "Position", "Origin"], |k| fields.optional::<f64>(k, rank))?;
    let origin = origin.unwrap_or_else(|| vec![0.0; rank]);
    let matrix = fields.same(&["TransformMatrix", "Rotation", "Orientation"], |k| fields.optional(k, rank * rank))?;
    let unit = |r: usize, c: usize| f64::from(u8::from(r == c));
    // The line lists one axis after the other: columns of the direction.
    let direction = Matrix3::from_fn(|r, c| match &matrix {
        Some(m) if r < rank && c < rank => m[c * rank + r],
        _ => unit(r, c),
    });
    anatomy(fields, &direction, matrix.is_some(), warnings)?;
    let size = std::array::from_fn(|a| sizes.get(a).copied().unwrap_or(1));
    let spacing = std::array::from_fn(|a| pick(&spacing, a, 1.0));
    let origin = Point3::from(std::array::from_fn::<f64, 3, _>(|a| pick(&origin, a, 0.0)));
    Grid::new(size, spacing, origin, direction).map_err(|e| match e {
        Error::Input { problem, remedy, .. } => Error::input(fields.path.display().to_string(), problem, remedy),
        other => other,
    })
}

/// Holds `AnatomicalOrientation` against the axes. ITK writes the sides that axes come from, the format's description names
/// those they run to; either is right.
fn anatomy(fields: &Fields<'_>, direction: &Matrix3<f64>, has_matrix: bool, warnings: &mut Vec<Warning>) -> Result<()> {
    let Some(code) = fields.get("AnatomicalOrientation").filter(|c| !c.contains('?') && !c.is_empty()) else {
        return Ok(());
    };
    let [to, from] = [["RL", "AP", "IS"], ["LR", "PA", "SI"]].map(|ends| {
        let letter = |column: usize| {
            let axis = direction.column(column);
            let main = axis.iamax();
            ends[main].chars().nth(usize::from(axis[main] > 0.0)).unwrap_or('?')
        };
        (0..3).map(letter).collect::<String>()
    });
    if code == to || code == from {
        return Ok(());
    }
    let problem = format!("AnatomicalOrientation = {code}, but its axes run to {to}");
    if has_matrix {
        warnings.push(Warning::new(
            findings::ORIENTATION_CONTRADICTS,
            format!("{problem}; its matrix is used, as ITK does"),
        ));
        return Ok(());
    }
    Err(fields.field(problem, "write the orientation as TransformMatrix, for example by exporting it again"))
}

fn element(fields: &Fields<'_>) -> Result<Element> {
    Ok(match fields.get("ElementType").unwrap_or_default() {
        "MET_UCHAR" => Element::U8,
        "MET_CHAR" => Element::I8,
        "MET_USHORT" => Element::U16,
        "MET_SHORT" => Element::I16,
        "MET_UINT" | "MET_ULONG" => Element::U32,
        "MET_INT" | "MET_LONG" => Element::I32,
        "MET_ULONG_LONG" => Element::U64,
        "MET_LONG_LONG" => Element::I64,
        "MET_FLOAT" => Element::F32,
        "MET_DOUBLE" => Element::F64,
        other => return Err(fields.refuse(format!("ElementType {other:?} is no integer or float type"))),
    })
}

/// Everything before the values.
pub(super) fn header(contents: &Contents<'_>) -> Vec<u8> {
    let grid = contents.grid;
    let kind = match contents.values.element() {
        Element::U8 => "MET_UCHAR",
        Element::I8 => "MET_CHAR",
        Element::U16 => "MET_USHORT",
        Element::I16 => "MET_SHORT",
        Element::U32 => "MET_UINT",
        Element::I32 => "MET_INT",
        Element::U64 => "MET_ULONG_LONG",
        Element::I64 => "MET_LONG_LONG",
        Element::F32 => "MET_FLOAT",
        Element::F64 => "MET_DOUBLE",
    };
    let join = |numbers: &[f64]| numbers.iter().map(f64::to_string).collect::<Vec<_>>().join(" ");
    let size = grid.size().map(|n| n.to_string()).join(" ");
    let mut text = String::from("ObjectType = Image\nNDims = 3\n");
    let comment = contents.description.replace(['\n', '\r'], " ");
    let mut line = |key: &str, value: &str| {
        writeln!(text, "{key} = {value}").expect("writing to a String cannot fail");
    };
    if !comment.is_empty() {
        line("Comment", &comment);
    }
    line("BinaryData", "True");
    line("BinaryDataByteOrderMSB", "False");
    line("CompressedData", "False");
    line("TransformMatrix", &join(grid.direction().as_slice()));
    line("Offset", &join(grid.origin().coords.as_slice()));
    line("CenterOfRotation", "0 0 0");
    line("ElementSpacing", &join(&grid.spacing()));
    line("DimSize", &size);
    if contents.values.components() > 1 {
        line("ElementNumberOfChannels", &contents.values.components().to_string());
    }
    line("ElementType", kind);
    line("ElementDataFile", "LOCAL");
    text.into_bytes()
}
