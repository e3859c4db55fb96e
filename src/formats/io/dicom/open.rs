//! Telling DICOM from other files by the first bytes, and parsing a file, whole or before its
//! pixels.
//!
//! Files of PS3.10 have a preamble; older ones begin with the meta information, or with the data
//! set itself.

use crate::error::{Error, Result};
use dicom_core::Tag;
use dicom_dictionary_std::{tags, uids};
use dicom_object::{DefaultDicomObject, FileMetaTableBuilder, OpenFileOptions};
use std::fs::{File, Metadata};
use std::io::{BufReader, Cursor, Read};
use std::path::Path;

/// Bytes that tell.
const FIRST: usize = 132;
/// Longest first element of a data set without meta information.
const LONGEST_FIRST: u32 = 1 << 12;

/// How a file begins.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Start {
    /// With the preamble, or with its mark.
    Marked,
    /// With the meta information.
    Meta,
    /// With the data set, of this transfer syntax.
    Bare(&'static str),
}

fn start(bytes: &[u8]) -> Option<Start> {
    if bytes.get(128..132) == Some(b"DICM") || bytes.starts_with(b"DICM\x02\0") {
        return Some(Start::Marked);
    }
    let head = bytes.get(..8)?;
    if head[..2] == [2, 0] && head[3] == 0 && &head[4..6] == b"UL" {
        return Some(Start::Meta);
    }
    // Group 0008 begins every data set: its length, or one of the first elements.
    if head[..2] != [8, 0] || head[3] != 0 || head[2] > 0x18 {
        return None;
    }
    if head[4..6].iter().all(u8::is_ascii_uppercase) {
        return Some(Start::Bare(uids::EXPLICIT_VR_LITTLE_ENDIAN));
    }
    let length = u32::from_le_bytes([head[4], head[5], head[6], head[7]]);
    (length <= LONGEST_FIRST).then_some(Start::Bare(uids::IMPLICIT_VR_LITTLE_ENDIAN))
}

/// Whether a file is DICOM by its first bytes.
pub(in super::super) fn is_dicom(path: &Path) -> bool {
    let mut first = Vec::new();
    // A pipe can be opened once only.
    let file = std::fs::metadata(path).ok().filter(Metadata::is_file).and_then(|_| File::open(path).ok());
    file.is_some_and(|f| f.take(FIRST as u64).read_to_end(&mut first).is_ok()) && start(&first).is_some()
}

/// What a file is.
pub(super) enum Opened {
    /// An object.
    Object(Box<DefaultDicomObject>),
    /// No DICOM.
    Other,
    /// DICOM that cannot be parsed, and why.
    Damaged(String),
}

/// Parses what comes before `until`.
pub(super) fn open(path: &Path, until: Tag) -> Opened {
    match File::open(path) {
        Ok(file) => parse(BufReader::new(file), Some(until)),
        Err(e) => Opened::Damaged(e.to_string()),
    }
}

/// Parses a whole file that is known to be DICOM.
///
/// # Errors
/// [`Error::Read`] when it is damaged.
pub(super) fn whole(path: &Path, bytes: &[u8]) -> Result<Box<DefaultDicomObject>> {
    match parse(Cursor::new(bytes), None) {
        Opened::Object(object) => Ok(object),
        Opened::Other => Err(Error::read(path, "it is no DICOM file", "export the objects again")),
        Opened::Damaged(why) => Err(damaged(path, &why)),
    }
}

/// The refusal of a file that dicom-rs cannot parse.
pub(super) fn damaged(path: &Path, why: &str) -> Error {
    Error::read(path, format!("it is damaged, or no DICOM: {why}"), "copy or export it again")
}

fn parse<R: Read>(mut reader: R, until: Option<Tag>) -> Opened {
    let mut first = Vec::new();
    if let Err(e) = reader.by_ref().take(FIRST as u64).read_to_end(&mut first) {
        return Opened::Damaged(e.to_string());
    }
    let Some(start) = start(&first) else { return Opened::Other };
    let mark = match start {
        Start::Marked => Vec::new(),
        Start::Meta => b"DICM".to_vec(),
        Start::Bare(syntax) => match meta(syntax) {
            Some(meta) => meta,
            None => return Opened::Other,
        },
    };
    let all = mark.as_slice().chain(first.as_slice()).chain(reader);
    let options = until.map_or_else(OpenFileOptions::new, |tag| OpenFileOptions::new().read_until(tag));
    match (options.from_reader(all), start) {
        (Ok(object), Start::Bare(_)) if object.get(tags::SOP_CLASS_UID).is_none() => Opened::Other,
        (Ok(object), _) => Opened::Object(Box::new(object)),
        // What only looks like a data set is of another kind.
        (Err(_), Start::Bare(_)) => Opened::Other,
        (Err(e), _) => Opened::Damaged(told(&e)),
    }
}

/// Meta information for a data set that has none.
fn meta(syntax: &str) -> Option<Vec<u8>> {
    let table = FileMetaTableBuilder::new().transfer_syntax(syntax).media_storage_sop_class_uid("");
    let mut bytes = b"DICM".to_vec();
    table.media_storage_sop_instance_uid("").build().ok()?.write(&mut bytes).ok()?;
    Some(bytes)
}

/// An error with its causes, on one line.
pub(super) fn told(error: &dyn std::error::Error) -> String {
    let mut text = error.to_string();
    let mut cause = error.source();
    while let Some(next) = cause {
        text = format!("{text}: {next}");
        cause = next.source();
    }
    text
}
