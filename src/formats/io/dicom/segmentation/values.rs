//! Stored pixels of a segmentation: bits, fractions or numbers of segments.

use super::super::elements::{Item, text, whole};
use super::super::frames::refuse;
use super::super::pixels::Pixels;
use crate::error::{Error, Result};
use crate::findings;
use dicom_dictionary_std::tags;
use dicom_object::DefaultDicomObject;
use std::path::Path;

/// What the pixels of a frame say.
pub(super) enum Stored {
    /// A bit for each pixel, of all frames without a gap between them, the least significant first (PS3.5 8.1.1).
    Bits { bytes: Vec<u8>, frame: usize },
    /// Values, of which those above so much are in the segment.
    Above(Pixels, f64),
    /// Numbers of segments, and that of the background.
    Numbers(Pixels, i64),
}

/// How segments are stored (Segmentation Type).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Kind {
    /// One bit.
    Binary,
    /// A fraction of Maximum Fractional Value.
    Fractional,
    /// A number of a segment.
    Labelmap,
}

impl Kind {
    /// Of a header.
    ///
    /// # Errors
    /// [`Error::Input`] for others.
    pub(super) fn of(path: &Path, set: &Item) -> Result<Self> {
        match text(set, tags::SEGMENTATION_TYPE).as_str() {
            "BINARY" => Ok(Self::Binary),
            "FRACTIONAL" => Ok(Self::Fractional),
            "LABELMAP" => Ok(Self::Labelmap),
            other => {
                Err(refuse(path, format!("its Segmentation Type is {other:?}, not BINARY, FRACTIONAL or LABELMAP")))
            }
        }
    }

    /// Its name in DICOM.
    pub(super) fn name(self) -> &'static str {
        match self {
            Self::Binary => "BINARY",
            Self::Fractional => "FRACTIONAL",
            Self::Labelmap => "LABELMAP",
        }
    }
}

/// The number that stands for no segment in a map of numbers.
pub(super) fn background(kind: Kind, set: &Item) -> Option<i64> {
    (kind == Kind::Labelmap).then(|| whole(set, tags::PIXEL_PADDING_VALUE).unwrap_or(0))
}

impl Stored {
    /// Decodes the pixels of an object.
    ///
    /// # Errors
    /// [`Error::Input`] for compression that is not read, and where there are not as many pixels as promised; as
    /// [`Pixels::of`] for values.
    pub(super) fn of(path: &Path, object: &DefaultDicomObject, kind: Kind, frames: usize) -> Result<Self> {
        if whole(object, tags::BITS_ALLOCATED) == Some(1) {
            return if kind == Kind::Labelmap {
                Err(refuse(path, "it is of Segmentation Type LABELMAP, and its pixels have one bit"))
            } else {
                Self::bits(path, object, frames)
            };
        }
        let pixels = Pixels::of(path, object)?;
        match kind {
            Kind::Binary => Ok(Self::Above(pixels, 0.0)),
            Kind::Fractional => {
                let Some(most) = whole(object, tags::MAXIMUM_FRACTIONAL_VALUE).filter(|m| *m > 0) else {
                    return Err(refuse(path, "it has no usable Maximum Fractional Value"));
                };
                Ok(Self::Above(pixels, 0.5 * most as f64))
            }
            Kind::Labelmap => Ok(Self::Numbers(pixels, background(kind, object).unwrap_or(0))),
        }
    }

    fn bits(path: &Path, object: &DefaultDicomObject, frames: usize) -> Result<Self> {
        let get = |tag| whole(object, tag).and_then(|n| usize::try_from(n).ok());
        let (Some(rows), Some(columns)) = (get(tags::ROWS), get(tags::COLUMNS)) else {
            return Err(refuse(path, "it has no usable Rows and Columns"));
        };
        let Some(pixels) = object.get(tags::PIXEL_DATA) else {
            return Err(Error::read(path, "it has no Pixel Data", "export the object again"));
        };
        let Some(value) = pixels.value().primitive() else {
            let syntax = object.meta().transfer_syntax().trim_end_matches('\0').to_owned();
            let problem = format!("its bits are compressed (transfer syntax {syntax}), which is not read");
            let remedy = "unpack it first, for example with `Dataset.decompress()` of pydicom";
            return Err(Error::refused(findings::DICOM_COMPRESSION, path.display().to_string(), problem, remedy));
        };
        let bytes = value.to_bytes().into_owned();
        let frame = rows.checked_mul(columns);
        let need = frame.and_then(|n| n.checked_mul(frames)).map(|n| n.div_ceil(8));
        // An empty byte fills the value up to an even length.
        let whole = |need: usize| {
            bytes.len() == need || bytes.len() == need + need % 2 && bytes.last().is_some_and(|last| *last == 0)
        };
        match (frame, need) {
            (Some(frame), Some(need)) if whole(need) => Ok(Self::Bits { bytes, frame }),
            _ => {
                let problem = format!(
                    "{columns} x {rows} x {frames} bits without a gap are promised, and {} bytes are there",
                    bytes.len()
                );
                Err(Error::read(path, problem, "copy or export the object again"))
            }
        }
    }

    /// Gives the pixels of a frame that are in a segment to `put`: their places, and of numbers the segment.
    pub(super) fn each(&self, frame: usize, mut put: impl FnMut(usize, Option<i64>)) {
        match self {
            Self::Bits { bytes, frame: pixels } => {
                let first = frame * pixels;
                let set = |bit: usize| bytes.get(bit / 8).is_some_and(|b| b >> (bit % 8) & 1 == 1);
                (0..*pixels).filter(|n| set(first + n)).for_each(|n| put(n, None));
            }
            Self::Above(pixels, limit) => pixels.each(frame, |n, v| {
                if v as f64 > *limit {
                    put(n, None);
                }
            }),
            Self::Numbers(pixels, background) => pixels.each(frame, |n, v| {
                if v != *background {
                    put(n, Some(v));
                }
            }),
        }
    }
}
