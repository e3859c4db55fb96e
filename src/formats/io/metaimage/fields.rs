//! The lines of a MetaImage header.

use crate::error::{Error, Result};
use crate::findings;
use crate::io::text::BYTE_ORDER_MARK;
use std::collections::HashMap;
use std::path::Path;
use std::str::FromStr;

/// Longest header that is looked at.
const LONGEST_HEADER: usize = 1 << 16;

/// Tags of the format. Unknown ones are other tools' notes, as MetaIO and ITK write them.
pub(super) const TAGS: [&str; 38] = [
    "AnatomicalOrientation",
    "BinaryData",
    "BinaryDataByteOrderMSB",
    "CenterOfRotation",
    "Color",
    "Comment",
    "CompressedData",
    "CompressedDataSize",
    "CompressionLevel",
    "DimSize",
    "DistanceUnits",
    "ElementByteOrderMSB",
    "ElementDataFile",
    "ElementMax",
    "ElementMin",
    "ElementNBits",
    "ElementNumberOfChannels",
    "ElementSize",
    "ElementSpacing",
    "ElementToIntensityFunctionOffset",
    "ElementToIntensityFunctionSlope",
    "ElementType",
    "HeaderSize",
    "HeaderSizePerSlice",
    "ID",
    "Modality",
    "NDims",
    "Name",
    "ObjectSubType",
    "ObjectType",
    "Offset",
    "Orientation",
    "Origin",
    "ParentID",
    "Position",
    "Rotation",
    "TransformMatrix",
    "TransformType",
];

/// Bytes of a byte order mark, which some editors put before a header.
pub(super) fn mark(raw: &[u8]) -> usize {
    if raw.starts_with(BYTE_ORDER_MARK) { BYTE_ORDER_MARK.len() } else { 0 }
}

/// The header's `Key = Value` lines.
pub(super) struct Fields<'a> {
    pub(super) path: &'a Path,
    values: HashMap<String, String>,
    /// Position of the first byte behind the header.
    pub(super) end: usize,
}

impl<'a> Fields<'a> {
    pub(super) fn parse(path: &'a Path, raw: &[u8]) -> Result<Self> {
        let mut fields = Self { path, values: HashMap::new(), end: mark(raw) };
        loop {
            let rest = raw.get(fields.end..).unwrap_or_default();
            // The last line of a header without values may end with the file.
            let end = rest.iter().take(LONGEST_HEADER).position(|&b| b == b'\n');
            let length = end.unwrap_or(rest.len().min(LONGEST_HEADER));
            let line = String::from_utf8_lossy(&rest[..length]);
            fields.end = (fields.end + length + 1).min(raw.len());
            let Some((key, value)) = line.split_once('=') else { break };
            let (key, value) = (key.trim(), value.trim());
            let similar = TAGS.iter().find(|tag| tag.eq_ignore_ascii_case(key));
            if let Some(tag) = similar.filter(|tag| **tag != key) {
                return Err(fields
                    .field(format!("its header has {key:?}, which MetaIO does not know"), &format!("write {tag}")));
            }
            let before = fields.values.insert(key.to_owned(), value.to_owned());
            if similar.is_some() && before.is_some_and(|b| b != value) {
                return Err(fields.field(format!("its header has {key} twice, with different values"), "leave one"));
            }
            if key == "ElementDataFile" {
                return Ok(fields);
            }
        }
        Err(fields.refuse("its header has no ElementDataFile line".into()))
    }

    pub(super) fn refuse(&self, problem: String) -> Error {
        Error::read(self.path, problem, "export it again as one binary .mha file, or as .nii.gz")
    }

    /// The refusal of a field that would change values or geometry.
    pub(super) fn field(&self, problem: String, remedy: &str) -> Error {
        Error::refused(findings::HEADER_FIELD, self.path.display().to_string(), problem, remedy)
    }

    /// Refuses a header whose values are in other files, telling where.
    pub(super) fn elsewhere(&self) -> Result<()> {
        let file = self.get("ElementDataFile").unwrap_or_default();
        let what = match file {
            "LOCAL" => return Ok(()),
            "LIST" => "a list of files (LIST)".into(),
            pattern if pattern.contains('%') => format!("a series of files, {pattern:?}"),
            file => format!("another file, {file:?}"),
        };
        let remedy =
            "join them to one file: in SimpleITK `WriteImage(ReadImage(\"IN.mhd\"), \"OUT.mha\")`, or give .nii.gz";
        Err(Error::read(self.path, format!("it is a header alone (.mhd): its values are in {what}"), remedy))
    }

    pub(super) fn get(&self, key: &str) -> Option<&str> {
        self.values.get(key).map(String::as_str)
    }

    /// Yes or no.
    pub(super) fn flag(&self, key: &str) -> Result<Option<bool>> {
        match self.get(key) {
            None => Ok(None),
            Some(text) if text.starts_with(['T', 't', '1', 'Y', 'y']) => Ok(Some(true)),
            Some(text) if text.starts_with(['F', 'f', '0', 'N', 'n']) => Ok(Some(false)),
            Some(text) => Err(self.field(format!("{key} = {text} is neither True nor False"), "correct the header")),
        }
    }

    /// `count` numbers of a line, if the line is there.
    pub(super) fn optional<T: FromStr>(&self, key: &str, count: usize) -> Result<Option<Vec<T>>> {
        let Some(text) = self.get(key) else { return Ok(None) };
        let numbers: Option<Vec<T>> = text.split_whitespace().map(|n| n.parse().ok()).collect();
        match numbers {
            Some(n) if n.len() == count => Ok(Some(n)),
            _ => Err(self.refuse(format!("{key} = {text} is not {count} number(s)"))),
        }
    }

    pub(super) fn numbers<T: FromStr>(&self, key: &str, count: usize) -> Result<Vec<T>> {
        self.optional(key, count)?.ok_or_else(|| self.refuse(format!("its header has no {key} line")))
    }

    /// The number of a line, if the line is there.
    pub(super) fn one<T: FromStr>(&self, key: &str) -> Result<Option<T>> {
        Ok(self.optional(key, 1)?.and_then(|mut n| n.pop()))
    }

    /// The value of one of several names for one thing; refused where two of them differ.
    pub(super) fn same<T: PartialEq>(
        &self,
        keys: &[&str],
        value: impl Fn(&str) -> Result<Option<T>>,
    ) -> Result<Option<T>> {
        let mut found: Option<(&str, T)> = None;
        for key in keys {
            match (value(key)?, &found) {
                (Some(v), None) => found = Some((key, v)),
                (Some(v), Some((other, w))) if v != *w => {
                    return Err(self.field(format!("{other} and {key} name the same and differ"), "leave one of them"));
                }
                _ => {}
            }
        }
        Ok(found.map(|f| f.1))
    }

    /// Sizes of the axes, and values per voxel.
    pub(super) fn sizes(&self) -> Result<(Vec<usize>, usize)> {
        let rank: usize = self.one("NDims")?.ok_or_else(|| self.refuse("its header has no NDims line".into()))?;
        if !(2..=4).contains(&rank) {
            return Err(self.refuse(format!("NDims is {rank}, not 2, 3 or 4")));
        }
        let channels = self.one("ElementNumberOfChannels")?.unwrap_or(1);
        if channels == 0 {
            return Err(self.refuse("ElementNumberOfChannels is 0".into()));
        }
        Ok((self.numbers("DimSize", rank)?, channels))
    }
}
