//! NRRD (`.nrrd`) with an attached header: LPS mm, raw or gzip, as ITK and Slicer read and write it.
//!
//! Source: "Definition of NRRD File Format", teem.sourceforge.net/nrrd/format.html.

use super::gzip::Content;
use super::raster::{GeometrySource, HeaderNotes, Raster, VectorKind};
use super::values::Contents;
use super::voxels::{Element, Layout};
use crate::error::{Error, Result};
use crate::geometry::Grid;
use crate::warning::Warning;
use nalgebra::{Matrix3, Matrix4, Vector3};
use std::borrow::Cow;
use std::collections::HashMap;
use std::fmt::Write as _;
use std::path::Path;

/// Whether a file starts as NRRD headers do.
pub(super) fn is_nrrd(raw: &[u8]) -> bool {
    raw.starts_with(b"NRRD00")
}

/// Parses an NRRD's header and keeps its values as bytes.
///
/// # Errors
/// [`Error::Read`] when the header is damaged or the values are elsewhere, in another encoding, or no numbers;
/// [`Error::Input`] when its geometry cannot be used.
pub(super) fn parse<'a>(path: &Path, raw: &'a [u8]) -> Result<Raster<'a>> {
    let fields = Fields::parse(path, raw)?;
    let stored: Option<Vec<usize>> = fields.words("sizes").iter().map(|w| w.parse().ok()).collect();
    let stored = stored.filter(|s| (2..=4).contains(&s.len()) && !s.contains(&0));
    let stored = stored
        .ok_or_else(|| fields.refuse(format!("sizes {:?} are not 2 to 4 positive numbers", fields.words("sizes"))))?;
    let mut warnings = Vec::new();
    let (flip, is_lps) = space(&fields, &mut warnings)?;
    let (grid, range_axis) = grid(&fields, &stored, flip)?;
    let element = element(&fields)?;
    if fields.get("data file").or(fields.get("datafile")).is_some() {
        return Err(fields.refuse("its values are in another file".into()));
    }
    if fields.words("line skip").iter().chain(&fields.words("byte skip")).any(|w| *w != "0") {
        return Err(fields.refuse("it skips lines or bytes before its values".into()));
    }
    let values = stored.iter().try_fold(element.size(), |n, &s| n.checked_mul(s));
    let need = values.ok_or_else(|| fields.refuse(format!("sizes {stored:?} are too large")))?;
    let (bytes, compressed) = inflated(&fields, &raw[fields.end..], need)?;
    let components = if range_axis.is_some() { need / element.size() / grid.len() } else { 1 };
    let layout = if range_axis == Some(0) { Layout::Interleaved } else { Layout::Planar };
    let vectors = if components != 3 {
        Err(format!("it has {components} values per voxel, not 3 as a displacement field has"))
    } else if !is_lps {
        Err(format!(
            "its space is {}, so the frame of its vectors is unknown",
            fields.get("space").unwrap_or("not given")
        ))
    } else {
        Ok(VectorKind::Lps)
    };
    let notes = HeaderNotes {
        format: "NRRD".into(),
        sizes: stored,
        datatype: element.name().into(),
        big_endian: fields.get("endian") == Some("big"),
        compressed,
        scaling: None,
        geometry: GeometrySource::Header,
        sform_code: None,
        qform_code: None,
        disagreement_mm: None,
        intent_code: None,
        intent_name: String::new(),
        description: fields.get("content").unwrap_or_default().to_owned(),
        extensions: Vec::new(),
    };
    Ok(Raster { grid, components, layout, vectors, element, bytes, offset: 0, notes, extensions: Vec::new(), warnings })
}

/// The header's `field: value` lines; field names are of lower case.
struct Fields<'a> {
    path: &'a Path,
    values: HashMap<String, String>,
    /// Position of the first byte behind the header.
    end: usize,
}

impl<'a> Fields<'a> {
    fn parse(path: &'a Path, raw: &[u8]) -> Result<Self> {
        let mut fields = Self { path, values: HashMap::new(), end: 0 };
        while let Some(length) = raw[fields.end..].iter().position(|&b| b == b'\n') {
            let line = String::from_utf8_lossy(&raw[fields.end..fields.end + length]);
            fields.end += length + 1;
            let line = line.trim_end();
            if line.is_empty() {
                return Ok(fields);
            }
            // `key:=value` lines are free annotations.
            if let Some((key, value)) = line.split_once(':')
                && !line.starts_with('#')
                && !value.starts_with('=')
            {
                fields.values.insert(key.trim().to_ascii_lowercase(), value.trim().to_owned());
            }
        }
        Err(fields.refuse("its header does not end".into()))
    }

    fn refuse(&self, problem: String) -> Error {
        Error::read(self.path, problem, "export it again as one .nrrd file with raw or gzip encoding, or as .nii.gz")
    }

    fn get(&self, key: &str) -> Option<&str> {
        self.values.get(key).map(String::as_str)
    }

    fn words(&self, key: &str) -> Vec<&str> {
        self.get(key).unwrap_or_default().split_whitespace().collect()
    }
}

/// Factors that turn the file's axes into LPS, and whether they are LPS already.
fn space(fields: &Fields<'_>, warnings: &mut Vec<Warning>) -> Result<([f64; 3], bool)> {
    match fields.get("space").map(str::to_ascii_lowercase).as_deref() {
        Some("left-posterior-superior" | "lps") => Ok(([1.0; 3], true)),
        Some("right-anterior-superior" | "ras") => Ok(([-1.0, -1.0, 1.0], false)),
        Some("left-anterior-superior" | "las") => Ok(([1.0, -1.0, 1.0], false)),
        None => {
            let message = "the header names no space; its axes are taken as left, posterior, superior";
            warnings.push(Warning::new("no-orientation", message));
            Ok(([1.0; 3], true))
        }
        Some(other) => Err(fields.refuse(format!("space {other:?} is no 3-D patient space"))),
    }
}

/// `(x,y,z)` of a header line.
fn vector(text: &str) -> Option<Vector3<f64>> {
    let numbers: Option<Vec<f64>> =
        text.trim().strip_prefix('(')?.strip_suffix(')')?.split(',').map(|n| n.trim().parse().ok()).collect();
    let numbers: [f64; 3] = numbers?.try_into().ok()?;
    Some(numbers.into())
}

/// The grid, LPS, and which stored axis holds the components.
fn grid(fields: &Fields<'_>, sizes: &[usize], flip: [f64; 3]) -> Result<(Grid, Option<usize>)> {
    // A space after a comma within parentheses is legal.
    let line = fields.get("space directions").unwrap_or_default().replace(", ", ",");
    let words: Vec<&str> = line.split_whitespace().collect();
    let axes: Vec<Option<Vector3<f64>>> = match words.len() {
        0 => return without_directions(fields, sizes),
        n if n == sizes.len() => words.iter().map(|w| vector(w)).collect(),
        n => return Err(fields.refuse(format!("{n} space directions for {} axes", sizes.len()))),
    };
    let none: Vec<usize> = (0..axes.len()).filter(|&a| axes[a].is_none()).collect();
    let kept: Vec<(usize, Vector3<f64>)> = axes.iter().zip(sizes).filter_map(|(v, &n)| v.map(|v| (n, v))).collect();
    let [(nx, x), (ny, y), (nz, z)] = kept[..] else {
        return Err(fields.refuse(format!("{} of its axes have a space direction, not 3", kept.len())));
    };
    let origin = match fields.get("space origin") {
        Some(text) => vector(text).ok_or_else(|| fields.refuse(format!("space origin {text} is not (x,y,z)")))?,
        None => Vector3::zeros(),
    };
    if !matches!(none[..], [] | [0] | [3]) {
        return Err(fields.refuse("its components are neither the first nor the last axis".into()));
    }
    let mut affine = Matrix4::identity();
    let lps = Matrix3::from_diagonal(&Vector3::from(flip));
    for (column, v) in [x, y, z, origin].into_iter().enumerate() {
        affine.fixed_view_mut::<3, 1>(0, column).copy_from(&(lps * v));
    }
    let grid = Grid::from_affine([nx, ny, nz], &affine).map_err(|e| match e {
        Error::Input { problem, remedy, .. } => Error::input(fields.path.display().to_string(), problem, remedy),
        other => other,
    })?;
    Ok((grid, none.first().copied()))
}

/// The grid of a header with plain spacings.
fn without_directions(fields: &Fields<'_>, sizes: &[usize]) -> Result<(Grid, Option<usize>)> {
    let spacings: Option<Vec<f64>> = fields.words("spacings").iter().map(|w| w.parse().ok()).collect();
    match (spacings.as_deref(), sizes) {
        (Some(&[x, y, z]), &[nx, ny, nz]) => Ok((Grid::axis_aligned([nx, ny, nz], [x, y, z], [0.0; 3])?, None)),
        _ => Err(fields.refuse("its header has neither space directions nor three spacings".into())),
    }
}

fn element(fields: &Fields<'_>) -> Result<Element> {
    Ok(match fields.get("type").unwrap_or_default() {
        "uchar" | "unsigned char" | "uint8" | "uint8_t" => Element::U8,
        "signed char" | "int8" | "int8_t" => Element::I8,
        "ushort" | "unsigned short" | "unsigned short int" | "uint16" | "uint16_t" => Element::U16,
        "short" | "short int" | "signed short" | "signed short int" | "int16" | "int16_t" => Element::I16,
        "uint" | "unsigned int" | "uint32" | "uint32_t" => Element::U32,
        "int" | "signed int" | "int32" | "int32_t" => Element::I32,
        "ulonglong" | "unsigned long long" | "unsigned long long int" | "uint64" | "uint64_t" => Element::U64,
        "longlong" | "long long" | "long long int" | "signed long long" | "int64" | "int64_t" => Element::I64,
        "float" => Element::F32,
        "double" => Element::F64,
        other => return Err(fields.refuse(format!("type {other:?} is no integer or float type"))),
    })
}

/// The values' bytes, and whether they were compressed.
fn inflated<'a>(fields: &Fields<'_>, values: &'a [u8], need: usize) -> Result<(Cow<'a, [u8]>, bool)> {
    match fields.get("encoding") {
        Some("raw") => Ok((Cow::Borrowed(values), false)),
        Some("gzip" | "gz") => {
            let damaged = |e: std::io::Error| {
                let problem = format!("the gzip data are damaged or cut off ({e})");
                Error::read(fields.path, problem, "copy or export the file again")
            };
            let mut content = Content::new(values);
            content.first(need).map_err(damaged)?;
            Ok((content.checked().map_err(damaged)?, true))
        }
        other => Err(fields.refuse(format!("its encoding is {}, neither raw nor gzip", other.unwrap_or("not given")))),
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
