//! Names of labels: a JSON file of the user, or the table in a header.

use super::raster::Raster;
use super::text::read_text;
use crate::error::{Error, Result};
use quick_xml::escape::resolve_predefined_entity;
use quick_xml::events::{BytesRef, BytesStart, Event};
use quick_xml::{Reader, XmlVersion};
use serde::Deserialize;
use serde::de::{Deserializer, MapAccess, Visitor};
use serde_json::Value;
use std::collections::BTreeMap;
use std::path::Path;

/// Names of labels.
pub(super) type Names = BTreeMap<u16, String>;

/// Extension codes that hold a label table: TotalSegmentator writes 0, Connectome Workbench 30.
const TABLE_CODES: [i32; 2] = [0, 30];

/// The JSON file's content. Other keys are left for other tools.
#[derive(Deserialize)]
struct NamesFile {
    labels: Pairs,
}

/// Entries of a JSON object in their order, repeated keys included.
struct Pairs(Vec<(String, Value)>);

impl<'de> Deserialize<'de> for Pairs {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Entries;
        impl<'de> Visitor<'de> for Entries {
            type Value = Pairs;
            fn expecting(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
                f.write_str("an object of labels and names")
            }
            fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Pairs, A::Error> {
                let mut pairs = Vec::new();
                while let Some(pair) = map.next_entry()? {
                    pairs.push(pair);
                }
                Ok(Pairs(pairs))
            }
        }
        deserializer.deserialize_map(Entries)
    }
}

/// Reads names of labels: `{"labels": {"1": "skull"}}`, or nnU-Net's `dataset.json`, `{"labels": {"skull": 1}}`.
///
/// # Errors
/// [`Error::Read`] when it is neither; [`Error::Input`] when a label has two names, or a name stands for a region of several
/// labels.
pub(super) fn read_names(path: &Path) -> Result<Names> {
    let text = read_text(path)?;
    let parsed: NamesFile = serde_json::from_str(&text).map_err(|e| {
        let remedy = "write {\"labels\": {\"1\": \"skull\", \"2\": \"mandible\"}}";
        Error::read(path, format!("it is no table of label names ({e})"), remedy)
    })?;
    let mut names = Names::new();
    for (key, value) in &parsed.labels.0 {
        let (label, name) = entry(path, key, value)?;
        let name = name.trim();
        if label == 0 || name.is_empty() {
            continue;
        }
        if let Some(other) = names.insert(label, name.to_owned()).filter(|other| other != name) {
            let problem = format!("label {label} has two names, {other} and {name}");
            return Err(Error::input(path.display().to_string(), problem, "give each label one name"));
        }
    }
    Ok(names)
}

/// A label and its name, whichever of the two is the key.
fn entry<'a>(path: &Path, key: &'a str, value: &'a Value) -> Result<(u16, &'a str)> {
    let number = |v: &Value| v.as_u64().and_then(|n| u16::try_from(n).ok());
    let (label, name) = match value {
        Value::String(name) => (key.trim().parse().ok(), name.as_str()),
        Value::Array(region) if region.len() != 1 => {
            let problem = format!("{key} is a region of several labels of nnU-Net, {value}");
            let remedy = "name each label of its own, {\"labels\": {\"1\": \"skull\"}}, as the label file has them";
            return Err(Error::input(path.display().to_string(), problem, remedy));
        }
        Value::Array(region) => (region.first().and_then(number), key),
        other => (number(other), key),
    };
    match label {
        Some(label) => Ok((label, name)),
        None => {
            let problem = format!("it is no table of label names: {key:?}: {value} has no label from 0 to 65535");
            Err(Error::read(path, problem, "write {\"labels\": {\"1\": \"skull\", \"2\": \"mandible\"}}"))
        }
    }
}

/// The names in a header: those of its own fields, else a label table in its extensions.
pub(super) fn header_names(path: &Path, raster: &Raster<'_>) -> Result<Option<Names>> {
    if !raster.names.is_empty() {
        return Ok(Some(raster.names.clone()));
    }
    for (code, data) in &raster.extensions {
        let text = String::from_utf8_lossy(data);
        if TABLE_CODES.contains(code) && text.contains("<LabelTable") {
            return parse_table(text.trim_matches(|c: char| c == '\0' || c.is_whitespace())).map(Some).map_err(
                |problem| {
                    let problem = format!("the label table in its header is damaged: {problem}");
                    Error::read(path, problem, "give the names as a JSON file with --labels")
                },
            );
        }
    }
    Ok(None)
}

/// Names in a CaretExtension's label table. Label 0 is background, whatever its name.
fn parse_table(xml: &str) -> Result<Names, String> {
    let mut reader = Reader::from_str(xml);
    let mut names = Names::new();
    let mut open: Option<(u16, String)> = None;
    loop {
        let event = reader.read_event().map_err(|e| e.to_string())?;
        match (&event, &mut open) {
            (Event::Start(tag), _) if tag.name().0 == "Label" => open = Some((key(tag)?, String::new())),
            (Event::End(tag), Some((label, name))) if tag.name().0 == "Label" => {
                if *label > 0 && !name.trim().is_empty() {
                    names.insert(*label, name.trim().to_owned());
                }
                open = None;
            }
            (Event::Text(text), Some((_, name))) => name.push_str(text),
            (Event::CData(text), Some((_, name))) => name.push_str(text),
            (Event::GeneralRef(entity), Some((_, name))) => name.push_str(&character(entity)?),
            (Event::Eof, None) => return Ok(names),
            (Event::Eof, Some(_)) => return Err("it ends within a label".into()),
            _ => {}
        }
    }
}

/// The label of a table entry.
fn key(tag: &BytesStart<'_>) -> Result<u16, String> {
    let attribute = tag.try_get_attribute("Key").map_err(|e| e.to_string())?.ok_or("a label has no Key")?;
    let text = attribute.normalized_value(XmlVersion::Implicit1_0).map_err(|e| e.to_string())?;
    text.trim().parse().map_err(|_| format!("label Key {text:?} is no integer from 0 to 65535"))
}

/// The text that an entity such as `&amp;` or `&#228;` stands for.
fn character(entity: &BytesRef<'_>) -> Result<String, String> {
    if let Some(c) = entity.resolve_char_ref().map_err(|e| e.to_string())? {
        return Ok(c.into());
    }
    let name: &str = entity;
    resolve_predefined_entity(name).map(str::to_owned).ok_or_else(|| format!("unknown entity &{name};"))
}
