//! MetaImage (`.mha`) with the values in the same file: LPS mm, as ITK reads and writes it.
//!
//! Written without compression: the header must tell the compressed size before the values are compressed.
//! Source: MetaIO of Kitware, as used by ITK's `MetaImageIO`.

use super::raster::{GeometrySource, HeaderNotes, Raster, VectorKind};
use super::values::Contents;
use super::voxels::{Element, Layout};
use crate::error::{Error, Result};
use crate::geometry::Grid;
use flate2::read::ZlibDecoder;
use nalgebra::{Matrix3, Point3};
use std::borrow::Cow;
use std::collections::HashMap;
use std::fmt::Write as _;
use std::io::Read;
use std::path::Path;
use std::str::FromStr;

/// Longest header that is looked at.
const LONGEST_HEADER: usize = 1 << 16;

/// Whether a file starts as MetaImage headers do.
pub(super) fn is_metaimage(raw: &[u8]) -> bool {
    let text = raw.get(..raw.len().min(32)).unwrap_or_default();
    [&b"ObjectType"[..], b"NDims", b"Comment"].iter().any(|start| text.starts_with(start))
}

/// Parses a MetaImage's header and keeps its values as bytes.
///
/// # Errors
/// [`Error::Read`] when the header is damaged or the values are elsewhere, text, or no numbers.
pub(super) fn parse<'a>(path: &Path, raw: &'a [u8]) -> Result<Raster<'a>> {
    let fields = Fields::parse(path, raw)?;
    let rank: usize = fields.numbers("NDims", 1)?.first().copied().unwrap_or_default();
    let mut sizes: Vec<usize> = fields.numbers("DimSize", rank)?;
    if !(2..=4).contains(&rank) {
        return Err(fields.refuse(format!("NDims is {rank}, not 2, 3 or 4")));
    }
    let channels: usize = fields.optional("ElementNumberOfChannels", 1)?.map_or(1, |n| n[0]);
    let grid = grid(&fields, rank, &sizes)?;
    sizes.resize(rank.max(3), 1);
    let volumes = sizes[3..].iter().product::<usize>();
    let element = element(&fields)?;
    if fields.get("ElementDataFile") != Some("LOCAL") {
        return Err(fields.refuse("its values are in another file (ElementDataFile is not LOCAL)".into()));
    }
    if fields.is_true("BinaryData") == Some(false) {
        return Err(fields.refuse("its values are text (BinaryData = False)".into()));
    }
    let components = channels.checked_mul(volumes).filter(|n| n.checked_mul(grid.len()).is_some());
    let components = components.ok_or_else(|| fields.refuse(format!("sizes {sizes:?} are too large")))?;
    let values = &raw[fields.end..];
    let compressed = fields.is_true("CompressedData") == Some(true);
    let bytes = if compressed {
        // One byte more than needed, so that the checksum behind the last one is reached.
        let most = (grid.len() * components).saturating_mul(element.size()).saturating_add(1) as u64;
        let mut inflated = Vec::new();
        ZlibDecoder::new(values).take(most).read_to_end(&mut inflated).map_err(|e| {
            Error::read(
                path,
                format!("the compressed values are damaged or cut off ({e})"),
                "copy or export the file again",
            )
        })?;
        Cow::Owned(inflated)
    } else {
        Cow::Borrowed(values)
    };
    let notes = HeaderNotes {
        format: "MetaImage".into(),
        sizes: if channels > 1 { [&[channels], &sizes[..]].concat() } else { sizes },
        datatype: element.name().into(),
        big_endian: fields.is_true("BinaryDataByteOrderMSB").or(fields.is_true("ElementByteOrderMSB")) == Some(true),
        compressed,
        scaling: None,
        geometry: GeometrySource::Header,
        sform_code: None,
        qform_code: None,
        disagreement_mm: None,
        intent_code: None,
        intent_name: String::new(),
        description: fields.get("Comment").unwrap_or_default().to_owned(),
        extensions: Vec::new(),
    };
    let vectors = if channels == 3 && volumes == 1 {
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
        warnings: Vec::new(),
    })
}

/// The header's `Key = Value` lines.
struct Fields<'a> {
    path: &'a Path,
    values: HashMap<String, String>,
    /// Position of the first byte behind the header.
    end: usize,
}

impl<'a> Fields<'a> {
    fn parse(path: &'a Path, raw: &[u8]) -> Result<Self> {
        let mut fields = Self { path, values: HashMap::new(), end: 0 };
        while let Some(length) = raw[fields.end..].iter().take(LONGEST_HEADER).position(|&b| b == b'\n') {
            let line = String::from_utf8_lossy(&raw[fields.end..fields.end + length]);
            fields.end += length + 1;
            let Some((key, value)) = line.split_once('=') else { break };
            let key = key.trim();
            fields.values.insert(key.to_owned(), value.trim().to_owned());
            if key == "ElementDataFile" {
                return Ok(fields);
            }
        }
        Err(fields.refuse("its header has no ElementDataFile line".into()))
    }

    fn refuse(&self, problem: String) -> Error {
        Error::read(self.path, problem, "export it again as one binary .mha file, or as .nii.gz")
    }

    fn get(&self, key: &str) -> Option<&str> {
        self.values.get(key).map(String::as_str)
    }

    fn is_true(&self, key: &str) -> Option<bool> {
        self.get(key).map(|v| v.starts_with(['T', 't', '1']))
    }

    /// `count` numbers of a line, if the line is there.
    fn optional<T: FromStr>(&self, key: &str, count: usize) -> Result<Option<Vec<T>>> {
        let Some(text) = self.get(key) else { return Ok(None) };
        let numbers: Option<Vec<T>> = text.split_whitespace().map(|n| n.parse().ok()).collect();
        match numbers {
            Some(n) if n.len() == count => Ok(Some(n)),
            _ => Err(self.refuse(format!("{key} = {text} is not {count} number(s)"))),
        }
    }

    fn numbers<T: FromStr>(&self, key: &str, count: usize) -> Result<Vec<T>> {
        self.optional(key, count)?.ok_or_else(|| self.refuse(format!("its header has no {key} line")))
    }

    /// The first of several names that is there.
    fn either(&self, keys: [&str; 3], count: usize) -> Result<Option<Vec<f64>>> {
        keys.iter().find(|k| self.get(k).is_some()).map_or(Ok(None), |k| self.optional(k, count))
    }
}

/// The grid of the first three axes; a 2-D image is one slice at z = 0.
fn grid(fields: &Fields<'_>, rank: usize, sizes: &[usize]) -> Result<Grid> {
    let pick = |values: &[f64], a: usize, missing: f64| if a < rank { values[a] } else { missing };
    let spacing =
        fields.either(["ElementSpacing", "ElementSize", "ElementSpacing"], rank)?.unwrap_or_else(|| vec![1.0; rank]);
    let origin = fields.either(["Offset", "Position", "Origin"], rank)?.unwrap_or_else(|| vec![0.0; rank]);
    let matrix = fields.either(["TransformMatrix", "Rotation", "Orientation"], rank * rank)?;
    let unit = |r: usize, c: usize| f64::from(u8::from(r == c));
    // The line lists one axis after the other: columns of the direction.
    let direction = Matrix3::from_fn(|r, c| match &matrix {
        Some(m) if r < rank && c < rank => m[c * rank + r],
        _ => unit(r, c),
    });
    let size = std::array::from_fn(|a| sizes.get(a).copied().unwrap_or(1));
    let spacing = std::array::from_fn(|a| pick(&spacing, a, 1.0));
    let origin = Point3::from(std::array::from_fn::<f64, 3, _>(|a| pick(&origin, a, 0.0)));
    Grid::new(size, spacing, origin, direction).map_err(|e| match e {
        Error::Input { problem, remedy, .. } => Error::input(fields.path.display().to_string(), problem, remedy),
        other => other,
    })
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
