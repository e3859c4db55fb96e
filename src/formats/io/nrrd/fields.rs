//! The lines of an NRRD header: fields, and `key:=value` notes.

use crate::error::{Error, Result};
use crate::findings;
use std::collections::{BTreeMap, HashMap};
use std::path::Path;

/// Longest header that is looked at; Slicer's segmentations have long ones.
const LONGEST_HEADER: usize = 1 << 24;

/// All fields of the format without their blanks, which are optional. Teem and ITK refuse any other, too.
const FIELDS: [&str; 31] = [
    "axismaxs",
    "axismins",
    "blocksize",
    "byteskip",
    "centers",
    "content",
    "datafile",
    "dimension",
    "encoding",
    "endian",
    "kinds",
    "labels",
    "lineskip",
    "max",
    "measurementframe",
    "min",
    "number",
    "oldmax",
    "oldmin",
    "sampleunits",
    "sizes",
    "space",
    "spacedimension",
    "spacedirections",
    "spaceorigin",
    "spaceunits",
    "spacings",
    "thicknesses",
    "type",
    "units",
    "centerings",
];

/// A parsed header; names of fields are of lower case and without blanks.
pub(super) struct Fields<'a> {
    pub(super) path: &'a Path,
    values: HashMap<String, String>,
    /// `key:=value` lines.
    pub(super) notes: BTreeMap<String, String>,
    /// Position of the first byte behind the header.
    pub(super) end: usize,
}

impl<'a> Fields<'a> {
    /// Parses a header. Bytes before the magic, such as a byte order mark, are told by `start`.
    pub(super) fn parse(path: &'a Path, raw: &[u8], start: usize) -> Result<Self> {
        let mut fields = Self { path, values: HashMap::new(), notes: BTreeMap::new(), end: start };
        let head = &raw[..raw.len().min(LONGEST_HEADER)];
        let mut first = true;
        while fields.end < head.len() {
            let rest = &head[fields.end..];
            let length = rest.iter().position(|&b| b == b'\n');
            let line = String::from_utf8_lossy(&rest[..length.unwrap_or(rest.len())]).trim_end().to_owned();
            fields.end = (fields.end + length.unwrap_or(rest.len()) + 1).min(head.len());
            if first {
                fields.magic(&line)?;
                first = false;
            } else if line.is_empty() {
                return Ok(fields);
            } else if !line.starts_with('#') {
                fields.line(&line)?;
            }
        }
        // A header without values may end with the file.
        if fields.get("datafile").is_some() {
            return Ok(fields);
        }
        Err(fields.refuse("its header does not end".into()))
    }

    fn magic(&self, line: &str) -> Result<()> {
        if matches!(line, "NRRD0001" | "NRRD0002" | "NRRD0003" | "NRRD0004" | "NRRD0005") {
            return Ok(());
        }
        Err(self.refuse(format!("its first line is {line:?}: no version of NRRD from NRRD0001 to NRRD0005")))
    }

    fn line(&mut self, line: &str) -> Result<()> {
        let remedy = "correct the header; free notes are written as key:=value";
        let Some((key, value)) = line.split_once(':') else {
            return Err(self.field(format!("its header has a line that is neither field nor note: {line:?}"), remedy));
        };
        if let Some(value) = value.strip_prefix('=') {
            self.notes.insert(unescaped(key), unescaped(value));
            return Ok(());
        }
        let name: String = key.chars().filter(|c| !c.is_whitespace()).flat_map(char::to_lowercase).collect();
        if !FIELDS.contains(&name.as_str()) {
            return Err(self.field(format!("its header has a field {:?} that NRRD does not know", key.trim()), remedy));
        }
        let name = if name == "centerings" { "centers".into() } else { name };
        if self.values.insert(name, value.trim().to_owned()).is_some() {
            return Err(self.field(format!("its header has the field {:?} twice", key.trim()), "leave one of them"));
        }
        Ok(())
    }

    /// The refusal of a file that is no NRRD that can be read.
    pub(super) fn refuse(&self, problem: String) -> Error {
        Error::read(self.path, problem, "export it again as one .nrrd file with raw or gzip encoding, or as .nii.gz")
    }

    /// The refusal of a field that would change values or geometry.
    pub(super) fn field(&self, problem: String, remedy: &str) -> Error {
        Error::refused(findings::HEADER_FIELD, self.path.display().to_string(), problem, remedy)
    }

    /// A field's text.
    pub(super) fn get(&self, key: &str) -> Option<&str> {
        self.values.get(key).map(String::as_str)
    }

    /// A field's text in lower case, for the words of the format.
    pub(super) fn word(&self, key: &str) -> Option<String> {
        self.get(key).map(str::to_ascii_lowercase)
    }

    /// A field's words.
    pub(super) fn words(&self, key: &str) -> Vec<&str> {
        self.get(key).unwrap_or_default().split_whitespace().collect()
    }

    /// A whole number.
    pub(super) fn integer(&self, key: &str) -> Result<Option<i64>> {
        let number = |text: &str| {
            text.parse().map_err(|_| self.field(format!("{key}: {text} is no integer"), "correct the header"))
        };
        self.get(key).map(number).transpose()
    }

    /// One number per axis, `nan` where it is not known; `None` where none is known.
    pub(super) fn per_axis(&self, key: &str, axes: usize) -> Result<Option<Vec<f64>>> {
        let Some(text) = self.get(key) else { return Ok(None) };
        let numbers: Option<Vec<f64>> = text.split_whitespace().map(|w| w.parse().ok()).collect();
        match numbers {
            Some(n) if n.len() == axes => Ok(n.iter().any(|v| !v.is_nan()).then_some(n)),
            _ => Err(self.field(format!("{key}: {text} are not {axes} numbers"), "correct the header")),
        }
    }

    /// Texts of a field such as `"mm" "mm" "mm"`.
    pub(super) fn quoted(&self, key: &str) -> Vec<String> {
        let text = self.get(key).unwrap_or_default();
        if text.contains('"') {
            text.split('"').skip(1).step_by(2).map(|t| t.trim().to_owned()).collect()
        } else {
            text.split_whitespace().map(str::to_owned).collect()
        }
    }
}

/// A note without the escapes of line ends and backslashes.
fn unescaped(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    let mut chars = text.chars();
    while let Some(c) = chars.next() {
        match c {
            '\\' => match chars.next() {
                Some('n') => out.push('\n'),
                Some(other) => out.push(other),
                None => out.push('\\'),
            },
            _ => out.push(c),
        }
    }
    out
}
