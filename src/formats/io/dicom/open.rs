//! Telling DICOM from other files by the first bytes, and parsing a file, whole or before its
//! pixels.
//!
//! Files of PS3.10 have a preamble; older ones begin with the meta information, or with the data
//! set itself. How a data set is encoded is told by its own bytes: meta information may be wrong.

use super::charset::Charset;
use super::elements::{Item, text};
use super::settle::settle;
use super::walk::{Coding, Walked, known, walk};
use crate::error::{Error, Result};
use dicom_core::Tag;
use dicom_dictionary_std::{tags, uids};
use dicom_object::{DefaultDicomObject, FileMetaTableBuilder, OpenFileOptions};
use flate2::read::DeflateDecoder;
use std::fs::{File, Metadata};
use std::io::{BufReader, Cursor, Read};
use std::path::Path;

/// Bytes that tell.
const FIRST: usize = 512;
/// Bytes of the preamble.
const PREAMBLE: usize = 128;
/// Longest first element of a data set without meta information.
const LONGEST_FIRST: usize = 1 << 12;
/// What a deflated data set may come to: so much, and so many times its length.
const INFLATED: [u64; 2] = [1 << 24, 40];
/// Explicit VR Big Endian: retired, and in old archives.
const BIG_ENDIAN: &str = "1.2.840.10008.1.2.2";
/// The first element that is no meta information.
const BEHIND_META: Tag = Tag(3, 0);

/// How a file begins.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Start {
    /// Bytes before the meta information or the data set.
    skip: usize,
    /// Whether it says that it is DICOM.
    marked: bool,
}

fn start(bytes: &[u8]) -> Option<Start> {
    if bytes.get(PREAMBLE..PREAMBLE + 4) == Some(b"DICM") {
        return Some(Start { skip: PREAMBLE + 4, marked: true });
    }
    if bytes.starts_with(b"DICM") && bytes.get(4..).is_some_and(begins) {
        return Some(Start { skip: 4, marked: true });
    }
    if begins(bytes) {
        return Some(Start { skip: 0, marked: false });
    }
    let (empty, rest) = bytes.split_at_checked(PREAMBLE)?;
    (empty.iter().all(|b| *b == 0) && begins(rest)).then_some(Start { skip: PREAMBLE, marked: false })
}

/// Whether meta information or a data set begins with these bytes.
fn begins(bytes: &[u8]) -> bool {
    let (Some(coding), Some(head)) = (Coding::of(bytes), bytes.get(..8)) else { return false };
    let tag_at = |b: &[u8]| {
        let pair = |n: usize| if coding.big { [b[n + 1], b[n]] } else { [b[n], b[n + 1]] };
        Tag(u16::from_le_bytes(pair(0)), u16::from_le_bytes(pair(2)))
    };
    let tag = tag_at(head);
    // Group 0008 begins every data set.
    let first = tag.group() == 2 || tag.group() == 8 && tag.element() <= 0x70;
    if coding.explicit || !first {
        return first;
    }
    let length = u32::from_le_bytes([head[4], head[5], head[6], head[7]]) as usize;
    let next = bytes.get(8 + length.min(FIRST)..).filter(|b| b.len() >= 4);
    let usual = length.is_multiple_of(2) && (tag.element() == 0 || known(tag).is_some());
    usual && length <= LONGEST_FIRST && next.is_none_or(|b| tag_at(b) > tag)
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
    /// An object, and whether the file ends with what was read of it.
    Object(Box<DefaultDicomObject>, bool),
    /// No DICOM.
    Other,
    /// DICOM that cannot be parsed.
    Damaged(Damage),
}

/// What is wrong with a file.
pub(super) struct Damage {
    /// In words.
    pub(super) why: String,
    /// The elements before the damage.
    pub(super) part: Option<Box<DefaultDicomObject>>,
}

impl From<String> for Damage {
    fn from(why: String) -> Self {
        Self { why, part: None }
    }
}

/// Parses what comes before `until`.
pub(super) fn open(path: &Path, until: Tag) -> Opened {
    let file = File::open(path).and_then(|file| file.metadata().map(|about| (file, about.len())));
    match file {
        Ok((file, length)) => parse(BufReader::new(file), length, Some(until)),
        Err(e) => Opened::Damaged(e.to_string().into()),
    }
}

/// Parses a whole file that is known to be DICOM.
///
/// # Errors
/// [`Error::Read`] when it is damaged.
pub(super) fn whole(path: &Path, bytes: &[u8]) -> Result<Box<DefaultDicomObject>> {
    match parse(Cursor::new(bytes), bytes.len() as u64, None) {
        Opened::Object(object, _) => Ok(object),
        Opened::Other => Err(Error::read(path, "it is no DICOM file", "export the objects again")),
        Opened::Damaged(damage) => Err(damaged(path, &damage.why)),
    }
}

/// The refusal of a file that dicom-rs cannot parse.
pub(super) fn damaged(path: &Path, why: &str) -> Error {
    let remedy = "copy or export it again; if it is complete, `dcmconv IN OUT` of DCMTK may repair it";
    Error::read(path, format!("it is damaged, or no DICOM: {why}"), remedy)
}

fn parse<R: Read>(mut reader: R, length: u64, until: Option<Tag>) -> Opened {
    let mut first = Vec::new();
    if let Err(e) = reader.by_ref().take(FIRST as u64).read_to_end(&mut first) {
        return Opened::Damaged(e.to_string().into());
    }
    let Some(Start { skip, marked }) = start(&first) else { return Opened::Other };
    let all = first.get(skip..).unwrap_or_default().chain(reader);
    let read = Meta::read(all, length.saturating_sub(skip as u64));
    let parsed = read.and_then(|(meta, rest, left)| data_set(meta, rest, left, until));
    match parsed {
        Ok((object, _)) if !marked && text(&object, tags::SOP_CLASS_UID).is_empty() => Opened::Other,
        Ok((object, ended)) => Opened::Object(object, ended),
        // What only looks like a data set is of another kind.
        Err(damage) if !marked => match &damage.part {
            Some(part) if !text(part, tags::SOP_CLASS_UID).is_empty() => Opened::Damaged(damage),
            _ => Opened::Other,
        },
        Err(damage) => Opened::Damaged(damage),
    }
}

/// What is used of the meta information.
#[derive(Default)]
struct Meta {
    syntax: String,
    class: String,
    instance: String,
}

impl Meta {
    /// Reads the meta information, what follows it and how long that is. Its own length is not believed.
    fn read<R: Read>(mut all: R, length: u64) -> Result<(Self, impl Read, u64), Damage> {
        let mut head = Vec::new();
        all.by_ref().take(8).read_to_end(&mut head).map_err(|e| e.to_string())?;
        let coding = Coding::of(&head).filter(|coding| !coding.big).unwrap_or(Coding::EXPLICIT);
        let Walked { bytes, over, trouble, .. } =
            walk(head.chain_with(all.by_ref()), length, coding, Some(BEHIND_META));
        if let Some(why) = trouble {
            return Err(why.into());
        }
        let left = length - bytes.len() as u64;
        if bytes.is_empty() {
            return Ok((Self::default(), Cursor::new(over).chain(all), left));
        }
        let syntax = if coding.explicit { uids::EXPLICIT_VR_LITTLE_ENDIAN } else { uids::IMPLICIT_VR_LITTLE_ENDIAN };
        let set = Self { syntax: syntax.into(), ..Self::default() }.object(&bytes)?;
        let own = [tags::TRANSFER_SYNTAX_UID, tags::MEDIA_STORAGE_SOP_CLASS_UID, tags::MEDIA_STORAGE_SOP_INSTANCE_UID];
        let [syntax, class, instance] = own.map(|tag| text(&set, tag));
        Ok((Self { syntax, class, instance }, Cursor::new(over).chain(all), left))
    }

    /// Parses a data set with this meta information.
    fn object(&self, bytes: &[u8]) -> Result<Box<DefaultDicomObject>, Damage> {
        let table = FileMetaTableBuilder::new()
            .transfer_syntax(self.syntax.as_str())
            .media_storage_sop_class_uid(self.class.as_str())
            .media_storage_sop_instance_uid(self.instance.as_str());
        let mut meta = b"DICM".to_vec();
        table.build().and_then(|table| table.write(&mut meta)).map_err(|e| told(&e))?;
        let object = OpenFileOptions::new().from_reader(meta.as_slice().chain(bytes));
        Ok(Box::new(object.map_err(|e| told(&e))?))
    }
}

/// Parses the data set that follows the meta information.
fn data_set<R: Read>(
    mut meta: Meta,
    mut rest: R,
    left: u64,
    until: Option<Tag>,
) -> Result<(Box<DefaultDicomObject>, bool), Damage> {
    let mut head = Vec::new();
    rest.by_ref().take(8).read_to_end(&mut head).map_err(|e| e.to_string())?;
    if head.is_empty() {
        return Err("it has no data set".to_owned().into());
    }
    let (found, plain) = (Coding::of(&head), begins(&head));
    let rest = head.chain_with(rest);
    let said = match meta.syntax.as_str() {
        uids::IMPLICIT_VR_LITTLE_ENDIAN => Coding::IMPLICIT,
        BIG_ENDIAN => Coding::BIG,
        _ => Coding::EXPLICIT,
    };
    let deflated = meta.syntax == uids::DEFLATED_EXPLICIT_VR_LITTLE_ENDIAN && !plain;
    let walked = if deflated {
        meta.syntax = uids::EXPLICIT_VR_LITTLE_ENDIAN.into();
        let bytes = inflated(rest, left)?;
        let length = bytes.len() as u64;
        walk(Cursor::new(bytes), length, Coding::EXPLICIT, until)
    } else {
        let coding = found.unwrap_or(said);
        if coding != said || meta.syntax.is_empty() || meta.syntax == uids::DEFLATED_EXPLICIT_VR_LITTLE_ENDIAN {
            meta.syntax = native(coding).into();
        }
        walk(rest, left, coding, until)
    };
    let part = meta.object(&walked.bytes).map(|mut object| {
        let parse = |bytes: &[u8]| {
            let implicit = Meta { syntax: uids::IMPLICIT_VR_LITTLE_ENDIAN.into(), ..Meta::default() };
            // Values of unknown representation were not walked yet.
            let walked = walk(Cursor::new(bytes), bytes.len() as u64, Coding::IMPLICIT, None);
            let whole = walked.trouble.is_none().then_some(walked.bytes)?;
            implicit.object(&whole).ok().map(|object| object.into_inner())
        };
        let set: &mut Item = &mut object;
        settle(set, Charset::default(), &parse);
        object
    });
    match walked.trouble {
        Some(why) => Err(Damage { why, part: part.ok() }),
        None => Ok((part?, walked.ended)),
    }
}

fn native(coding: Coding) -> &'static str {
    match coding {
        Coding { explicit: false, .. } => uids::IMPLICIT_VR_LITTLE_ENDIAN,
        Coding { big: true, .. } => BIG_ENDIAN,
        _ => uids::EXPLICIT_VR_LITTLE_ENDIAN,
    }
}

/// A deflated data set (PS3.5 A.5).
fn inflated(from: impl Read, length: u64) -> Result<Vec<u8>, Damage> {
    let [least, times] = INFLATED;
    let most = least + times * length;
    let mut bytes = Vec::new();
    DeflateDecoder::new(from)
        .take(most + 1)
        .read_to_end(&mut bytes)
        .map_err(|e| format!("it cannot be inflated: {e}"))?;
    if bytes.len() as u64 > most {
        return Err(format!("it inflates to more than {most} bytes; `dcmconv +te IN OUT` unpacks it").into());
    }
    Ok(bytes)
}

/// Bytes that were read, and what follows them.
trait Before {
    fn chain_with<R: Read>(self, rest: R) -> impl Read;
}

impl Before for Vec<u8> {
    fn chain_with<R: Read>(self, rest: R) -> impl Read {
        Cursor::new(self).chain(rest)
    }
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
