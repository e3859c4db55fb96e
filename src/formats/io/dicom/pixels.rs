//! Stored pixels of an object as numbers.

use super::elements::{Item, text, whole};
use super::frames::refuse;
use super::open::told;
use crate::error::{Error, Result};
use crate::findings;
use dicom_dictionary_std::{tags, uids};
use dicom_object::DefaultDicomObject;
use dicom_pixeldata::PixelDecoder as _;
use std::path::Path;

/// Transfer syntaxes whose pixels cannot be decoded here, and what unpacks them. Others are named
/// by their UID.
const PACKED: [(&str, &str, &str); 4] = [
    (uids::JPEGLS_LOSSLESS, "JPEG-LS", "dcmdjpls IN OUT"),
    (uids::JPEGLS_NEAR_LOSSLESS, "JPEG-LS, near lossless", "dcmdjpls IN OUT"),
    (uids::HTJ2K_LOSSLESS, "High-Throughput JPEG 2000, lossless", "Dataset.decompress() of pydicom with pylibjpeg"),
    (uids::HTJ2K, "High-Throughput JPEG 2000", "Dataset.decompress() of pydicom with pylibjpeg"),
];
/// JPEG syntaxes, whose decoder fills what the data does not tell with zeros.
const JPEG: [&str; 6] = [
    uids::JPEG_BASELINE8_BIT,
    uids::JPEG_EXTENDED12_BIT,
    uids::JPEG_LOSSLESS,
    uids::JPEG_LOSSLESS_SV1,
    uids::JPEG2000_LOSSLESS,
    uids::JPEG2000,
];

/// Bytes of pixels that a file may hold: so many, and so many times its length, where they are compressed.
const MOST: [u64; 2] = [1 << 23, 200];

/// Refuses a promise of more pixels than `length` bytes of a file can hold, before memory is taken for them.
///
/// # Errors
/// [`Error::Read`].
pub(super) fn believable(path: &Path, promised: u64, length: u64) -> Result<()> {
    if promised <= MOST[0] + MOST[1].saturating_mul(length) {
        return Ok(());
    }
    let problem = format!("{promised} bytes of pixels are promised, and the file has {length} bytes");
    Err(Error::read(path, problem, "copy or export the object again"))
}

/// Decoded pixels of all frames.
pub(super) struct Pixels {
    bytes: Vec<u8>,
    /// Bytes of a value.
    width: usize,
    /// Values of a frame.
    frame: usize,
    /// Bits that a value has, and how far to shift them.
    stored: u32,
    shift: u32,
    signed: bool,
}

impl Pixels {
    /// Decodes the pixels of an object.
    ///
    /// # Errors
    /// [`Error::Input`] for compression that is not read, and for pixels that are no grey values of
    /// 8, 16 or 32 bits; [`Error::Read`] when pixels are missing or damaged.
    pub(super) fn of(path: &Path, object: &DefaultDicomObject) -> Result<Self> {
        let set: &Item = object;
        let get = |tag| whole(set, tag).and_then(|n| usize::try_from(n).ok());
        let bits = |tag| get(tag).and_then(|n| u32::try_from(n).ok());
        let (Some(rows), Some(columns), Some(allocated), Some(stored)) =
            (get(tags::ROWS), get(tags::COLUMNS), bits(tags::BITS_ALLOCATED), bits(tags::BITS_STORED))
        else {
            return Err(refuse(path, "it has no usable Rows, Columns, Bits Allocated and Bits Stored"));
        };
        let high = bits(tags::HIGH_BIT).unwrap_or(stored.saturating_sub(1));
        let samples = get(tags::SAMPLES_PER_PIXEL).unwrap_or(1);
        let grey = text(set, tags::PHOTOMETRIC_INTERPRETATION).starts_with("MONOCHROME");
        if !matches!(allocated, 8 | 16 | 32)
            || stored == 0
            || stored > allocated
            || high + 1 < stored
            || high >= allocated
        {
            let problem = format!("Bits Allocated {allocated}, Bits Stored {stored}, High Bit {high} make no numbers");
            return Err(refuse(path, problem));
        }
        if samples != 1 || !grey {
            return Err(refuse(path, format!("its pixels are no grey values ({samples} samples)")));
        }
        let signed = match bits(tags::PIXEL_REPRESENTATION) {
            Some(0) => false,
            Some(1) => true,
            _ => return Err(refuse(path, "its Pixel Representation is neither 0 nor 1")),
        };
        let count = get(tags::NUMBER_OF_FRAMES).unwrap_or(1);
        let fragments = |parts: &[Vec<u8>]| parts.iter().map(|part| part.len() as u64).sum::<u64>();
        let length = object.get(tags::PIXEL_DATA).map_or(0, |e| match e.value().fragments() {
            Some(parts) => fragments(parts),
            None => e.value().primitive().map_or(0, |v| v.calculate_byte_len() as u64),
        });
        let promised =
            [rows, columns, count, allocated as usize / 8].iter().fold(1u64, |n, f| n.saturating_mul(*f as u64));
        believable(path, promised, length)?;
        let (width, frame) = (allocated as usize / 8, rows * columns);
        let bytes = decode(path, object, count, [frame, width])?;
        if frame.checked_mul(count).and_then(|n| n.checked_mul(width)).is_none_or(|need| bytes.len() < need) {
            let problem = format!(
                "{columns} x {rows} x {count} values of {allocated} bits are promised, and {} bytes are there",
                bytes.len()
            );
            return Err(Error::read(path, problem, "copy or export the object again"));
        }
        Ok(Self { bytes, width, frame, stored, shift: high + 1 - stored, signed })
    }

    /// Gives the stored values of a frame to `put`, in order; nothing where there is no such frame.
    pub(super) fn each(&self, frame: usize, mut put: impl FnMut(usize, i64)) {
        let one = self.frame * self.width;
        let Some(bytes) = self.bytes.get(frame * one..(frame + 1) * one) else { return };
        let unused = 64 - self.stored;
        let value = |raw: u64| {
            let high = (raw >> self.shift) << unused;
            if self.signed { (high as i64) >> unused } else { (high >> unused) as i64 }
        };
        match self.width {
            1 => bytes.iter().enumerate().for_each(|(n, b)| put(n, value(u64::from(*b)))),
            2 => bytes.as_chunks().0.iter().enumerate().for_each(|(n, b)| {
                put(n, value(u64::from(u16::from_ne_bytes(*b))));
            }),
            _ => bytes.as_chunks().0.iter().enumerate().for_each(|(n, b)| {
                put(n, value(u64::from(u32::from_ne_bytes(*b))));
            }),
        }
    }
}

/// Refuses a frame of run lengths (PS3.5 G) whose segments, one for each byte of a value, are not there or do not hold all values,
/// which the decoder takes for granted.
fn whole_runs(path: &Path, syntax: &str, part: &[u8], [values, width]: [usize; 2]) -> Result<()> {
    if syntax != uids::RLE_LOSSLESS {
        return Ok(());
    }
    let word = |n: usize| Some(u32::from_le_bytes(*part.get(4 * n..)?.first_chunk::<4>()?) as usize);
    let segments = word(0).filter(|n| (1..=15).contains(n)).unwrap_or(0);
    let lengths = (1..=segments).map(|n| {
        let end = if n == segments { part.len() } else { word(n + 1)? };
        part.get(word(n)?..end).map(run_lengths)
    });
    let held: Option<Vec<usize>> = lengths.collect();
    if held.is_some_and(|held| held.len() >= width && held.iter().take(width).all(|own| *own >= values)) {
        return Ok(());
    }
    let problem = "its pixels cannot be decoded: a frame of run lengths (RLE) does not hold what is promised";
    Err(Error::read(path, problem, "copy or export it again"))
}

/// Bytes that a segment of run lengths comes to (PS3.5 G.3.2); those before an end within a run.
fn run_lengths(segment: &[u8]) -> usize {
    let (mut at, mut bytes) = (0, 0);
    while let Some(head) = segment.get(at) {
        let run = usize::from(*head);
        let (step, own) = match run {
            0..128 => (run + 2, run + 1),
            128 => (1, 0),
            _ => (2, 257 - run),
        };
        if at + step > segment.len() {
            break;
        }
        (at, bytes) = (at + step, bytes + own);
    }
    bytes
}

/// The pixels' bytes, in this machine's order; `frame` are values of a frame, and bytes of one.
fn decode(path: &Path, object: &DefaultDicomObject, count: usize, frame: [usize; 2]) -> Result<Vec<u8>> {
    let syntax = object.meta().transfer_syntax().trim_end_matches('\0').trim();
    let refused = |what: &str, tool: &str| {
        let problem = format!("its pixels are compressed as {what}, which is not read");
        let remedy = format!("unpack all slices first, for example with `{tool}`");
        Error::refused(findings::DICOM_COMPRESSION, path.display().to_string(), problem, remedy)
    };
    if let Some((_, what, tool)) = PACKED.iter().find(|p| p.0 == syntax) {
        return Err(refused(&format!("{what} (transfer syntax {syntax})"), tool));
    }
    let Some(pixels) = object.get(tags::PIXEL_DATA) else {
        return Err(Error::read(path, "it has no Pixel Data", "export the object again"));
    };
    let jpeg = JPEG.contains(&syntax);
    if let Some(parts) = pixels.value().fragments()
        && parts.len() < count
    {
        let problem = format!("it says {count} frames, and holds {} fragments of pixels", parts.len());
        return Err(Error::read(path, problem, "copy or export the object again"));
    }
    let failed = |e: &dyn std::error::Error| match e.to_string() {
        e if e.contains("ransfer syntax") => refused(&format!("transfer syntax {syntax}"), "gdcmconv --raw IN OUT"),
        _ => Error::read(path, format!("its pixels cannot be decoded: {}", told(e)), "copy or export it again"),
    };
    let bytes = match pixels.value().fragments() {
        // One by one: all at once are judged by the first, which may be empty and small.
        Some(parts) if count > 1 && parts.len() == count => {
            let mut bytes = Vec::new();
            for (n, part) in parts.iter().enumerate() {
                whole_runs(path, syntax, part, frame)?;
                let decoded = object.decode_pixel_data_frame(n as u32).map_err(|e| failed(&e))?;
                bytes.extend_from_slice(decoded.data());
            }
            bytes
        }
        parts => {
            parts.into_iter().flatten().try_for_each(|part| whole_runs(path, syntax, part, frame))?;
            object.decode_pixel_data().map_err(|e| failed(&e))?.into_data()
        }
    };
    let half = bytes.len() / 2;
    if jpeg && count == 1 && bytes.get(half..).is_some_and(|rest| rest.iter().all(|b| *b == 0)) {
        // Values of 8 bits where 16 are promised fill half of the room.
        return Err(refused(
            &format!("JPEG of fewer bits than it promises (transfer syntax {syntax})"),
            "dcmdjpeg IN OUT",
        ));
    }
    Ok(bytes)
}
