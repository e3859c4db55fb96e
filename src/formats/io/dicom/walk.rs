//! The bytes of a data set, checked element by element before dicom-rs parses them.
//!
//! No length is believed that the file does not hold. What dicom-rs does not parse is told in a way that it does: values of
//! unknown representation and undefined length get their length (PS3.5 6.2.2, CP-246), and names of character sets are
//! made unknown to it, so that texts come as their bytes (see [`super::settle`]).

use dicom_core::dictionary::{DataDictionary as _, DataDictionaryEntry as _};
use dicom_core::{Tag, VR};
use dicom_dictionary_std::{StandardDataDictionary, tags};
use std::io::Read;

/// Sequences deeper than this are no data set.
const DEEPEST: usize = 48;
/// A length that is not told.
const UNDEFINED: u32 = u32::MAX;
const ITEM: Tag = Tag(0xFFFE, 0xE000);
const ITEM_END: Tag = Tag(0xFFFE, 0xE00D);
const SEQUENCE_END: Tag = Tag(0xFFFE, 0xE0DD);

/// How elements are encoded (PS3.5 7.1, 7.3).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Coding {
    /// Whether elements name their value representation.
    pub(super) explicit: bool,
    /// Whether the first byte of a number is the greatest.
    pub(super) big: bool,
}

impl Coding {
    /// What most files are.
    pub(super) const EXPLICIT: Self = Self { explicit: true, big: false };
    /// The default of the standard.
    pub(super) const IMPLICIT: Self = Self { explicit: false, big: false };
    /// Retired.
    pub(super) const BIG: Self = Self { explicit: true, big: true };

    /// How a data set is encoded that begins with these bytes; `None` where they are no element.
    pub(super) fn of(head: &[u8]) -> Option<Self> {
        let head: &[u8; 8] = head.get(..8)?.try_into().ok()?;
        let group = |big: bool| Self { explicit: true, big }.short([head[0], head[1]]);
        // Groups are small numbers, and the first is the smallest.
        let big = group(true) < group(false);
        if representation([head[4], head[5]]).is_some() {
            return Some(Self { explicit: true, big });
        }
        (!big).then_some(Self::IMPLICIT)
    }

    fn short(self, bytes: [u8; 2]) -> u16 {
        if self.big { u16::from_be_bytes(bytes) } else { u16::from_le_bytes(bytes) }
    }

    fn long(self, bytes: [u8; 4]) -> u32 {
        if self.big { u32::from_be_bytes(bytes) } else { u32::from_le_bytes(bytes) }
    }

    fn bytes(self, value: u32) -> [u8; 4] {
        if self.big { value.to_be_bytes() } else { value.to_le_bytes() }
    }
}

/// A value representation by its letters.
pub(super) fn representation(letters: [u8; 2]) -> Option<VR> {
    letters.iter().all(u8::is_ascii_uppercase).then(|| VR::from_binary(letters)).flatten()
}

/// The value representation that the standard gives an element.
pub(super) fn known(tag: Tag) -> Option<VR> {
    StandardDataDictionary.by_tag(tag).map(|entry| entry.vr().relaxed()).filter(|vr| *vr != VR::UN)
}

/// Bytes of each value where they are numbers. dicom-rs takes whole ones, and takes what is left for the next element.
fn size(vr: Option<VR>) -> Option<u32> {
    Some(match vr? {
        VR::US | VR::SS | VR::OW => 2,
        VR::UL | VR::SL | VR::FL | VR::AT | VR::OF | VR::OL => 4,
        VR::FD | VR::OD | VR::OV | VR::SV | VR::UV => 8,
        _ => return None,
    })
}

/// A data set, whole or up to an element.
#[derive(Debug, Default)]
pub(super) struct Walked {
    /// Its bytes.
    pub(super) bytes: Vec<u8>,
    /// Whether the file ended.
    pub(super) ended: bool,
    /// Why it cannot be read further, where that is so; the elements before are there.
    pub(super) trouble: Option<String>,
    /// Bytes that were taken and belong to what follows.
    pub(super) over: Vec<u8>,
}

/// Walks over a data set of `length` bytes, up to the first element that is not before `until`.
pub(super) fn walk<R: Read>(from: R, length: u64, coding: Coding, until: Option<Tag>) -> Walked {
    let mut walk = Walk { from, ahead: Vec::new(), left: length, out: Vec::new(), good: 0, until };
    let (ended, trouble) = match walk.set(coding, None, 0) {
        Ok(ended) => (ended, None),
        Err(why) => (false, Some(why)),
    };
    let mut over = walk.out.split_off(walk.good.min(walk.out.len()));
    over.append(&mut walk.ahead);
    Walked { bytes: walk.out, ended, trouble, over }
}

struct Walk<R> {
    from: R,
    /// Bytes that were looked at.
    ahead: Vec<u8>,
    /// Bytes of the file behind those taken.
    left: u64,
    out: Vec<u8>,
    /// Where the last whole element of the data set ends.
    good: usize,
    until: Option<Tag>,
}

/// An element's head.
struct Head {
    tag: Tag,
    /// None where it is not told, or unknown.
    vr: Option<VR>,
    length: u32,
    /// Where its representation and its length stand.
    at: [usize; 2],
}

impl<R: Read> Walk<R> {
    /// Takes bytes that the file must have.
    fn take(&mut self, count: u64) -> Result<usize, String> {
        let at = self.out.len();
        if count > self.left {
            return Err(format!("it ends after {at} bytes of its data set, within an element"));
        }
        let ahead = self.ahead.len().min(count as usize);
        self.out.extend(self.ahead.drain(..ahead));
        let rest = count - ahead as u64;
        let got = self.from.by_ref().take(rest).read_to_end(&mut self.out).map_err(|e| e.to_string())?;
        if got as u64 != rest {
            return Err("it became shorter while it was read".into());
        }
        self.left -= count;
        Ok(at)
    }

    /// Looks at the next bytes; fewer where the file ends.
    fn peek(&mut self, count: usize) -> Result<&[u8], String> {
        let more = count.min(self.left as usize).saturating_sub(self.ahead.len());
        self.from.by_ref().take(more as u64).read_to_end(&mut self.ahead).map_err(|e| e.to_string())?;
        Ok(&self.ahead[..count.min(self.ahead.len())])
    }

    fn some<const N: usize>(&mut self) -> Result<[u8; N], String> {
        let at = self.take(N as u64)?;
        self.out[at..].try_into().map_err(|_| "it is cut off".to_owned())
    }

    fn tag(&mut self, coding: Coding) -> Result<Tag, String> {
        let [a, b, c, d] = self.some::<4>()?;
        Ok(Tag(coding.short([a, b]), coding.short([c, d])))
    }

    fn length(&mut self, coding: Coding) -> Result<u32, String> {
        Ok(coding.long(self.some::<4>()?))
    }

    fn head(&mut self, tag: Tag, coding: Coding) -> Result<Head, String> {
        let at = self.out.len();
        if !coding.explicit {
            let length = self.length(coding)?;
            return Ok(Head { tag, vr: known(tag), length, at: [at, at] });
        }
        let vr = representation(self.some::<2>()?);
        let short = !matches!(
            vr,
            None | Some(
                VR::OB
                    | VR::OD
                    | VR::OF
                    | VR::OL
                    | VR::OV
                    | VR::OW
                    | VR::SQ
                    | VR::SV
                    | VR::UC
                    | VR::UN
                    | VR::UR
                    | VR::UT
                    | VR::UV
            )
        );
        let length = if short {
            u32::from(coding.short(self.some::<2>()?))
        } else {
            self.take(2)?;
            self.length(coding)?
        };
        let told = self.out.len();
        Ok(Head { tag, vr, length, at: [at, told - if short { 2 } else { 4 }] })
    }

    /// The elements of a data set or an item, up to `end`. Whether the file has ended.
    fn set(&mut self, coding: Coding, end: Option<usize>, deep: usize) -> Result<bool, String> {
        if deep > DEEPEST {
            return Err(format!("its sequences are more than {DEEPEST} deep"));
        }
        loop {
            let at = self.out.len();
            if deep == 0 {
                self.good = at;
                if self.at_end()? {
                    return Ok(true);
                }
            }
            if end == Some(at) {
                return Ok(false);
            }
            let tag = self.tag(coding)?;
            if tag == ITEM_END {
                self.take(4)?;
                match end {
                    _ if deep == 0 => continue,
                    None => return Ok(false),
                    Some(_) => return Err("an item ends before its length".into()),
                }
            }
            if deep == 0 && self.until.is_some_and(|until| tag >= until) {
                return Ok(false);
            }
            if tag.group() == ITEM.group() {
                return Err(format!("{tag} stands where an element is expected"));
            }
            let head = self.head(tag, coding)?;
            self.value(&head, coding, end, deep)?;
        }
    }

    /// Whether nothing is left, or nothing but padding.
    fn at_end(&mut self) -> Result<bool, String> {
        let padding = self.peek(8)?.iter().all(|b| *b == 0);
        if !padding {
            return Ok(false);
        }
        let at = self.out.len();
        let left = self.left;
        self.take(left)?;
        let end = self.out[at..].iter().all(|b| *b == 0);
        self.out.truncate(at);
        if end { Ok(true) } else { Err(format!("zeros stand where its data set goes on, after {at} bytes")) }
    }

    fn value(&mut self, head: &Head, coding: Coding, end: Option<usize>, deep: usize) -> Result<(), String> {
        let &Head { tag, vr, length, at: [letters, told] } = head;
        let at = self.out.len();
        if length == UNDEFINED {
            let pixels = tag == tags::PIXEL_DATA;
            if coding.explicit && vr == Some(VR::UN) && !pixels {
                if self.inner(Coding::EXPLICIT)? {
                    self.patch(letters, b"SQ");
                    return self.items(Coding::EXPLICIT, None, deep);
                }
                self.items(Coding::IMPLICIT, None, deep)?;
                return self.define(told, at, coding);
            }
            if pixels || coding.explicit && vr != Some(VR::SQ) {
                self.fragments(coding, pixels)?;
                return if pixels { Ok(()) } else { self.define(told, at, coding) };
            }
            return self.items(coding, None, deep);
        }
        let stop = at + length as usize;
        let room = end.map_or(u64::MAX, |end| end.saturating_sub(at) as u64).min(self.left);
        if u64::from(length) > room {
            return Err(format!("the element {tag} says {length} bytes, and there are {room}"));
        }
        match vr {
            Some(VR::SQ) => self.items(coding, Some(stop), deep),
            Some(VR::UN) if coding.explicit && known(tag) == Some(VR::SQ) => {
                if self.inner(Coding::EXPLICIT)? {
                    self.patch(letters, b"SQ");
                    return self.items(Coding::EXPLICIT, Some(stop), deep);
                }
                self.items(Coding::IMPLICIT, Some(stop), deep)
            }
            _ => {
                if let Some(size) = size(vr).filter(|size| !length.is_multiple_of(*size)) {
                    // Pixels of 8 bits may be told as words, and be odd in number.
                    if vr != Some(VR::OW) || coding != Coding::EXPLICIT {
                        return Err(format!("the element {tag} says {length} bytes, and its values have {size} each"));
                    }
                    self.patch(letters, b"OB");
                }
                self.take(length.into())?;
                if tag == tags::SPECIFIC_CHARACTER_SET {
                    self.out[at..].make_ascii_lowercase();
                }
                Ok(())
            }
        }
    }

    /// Whether the first element of the first item that follows is encoded so.
    fn inner(&mut self, coding: Coding) -> Result<bool, String> {
        let head = self.peek(16)?;
        Ok(head.get(8..16).and_then(Coding::of) == Some(coding))
    }

    fn patch(&mut self, at: usize, bytes: &[u8]) {
        if let Some(place) = self.out.get_mut(at..at + bytes.len()) {
            place.copy_from_slice(bytes);
        }
    }

    /// Gives a value its length.
    fn define(&mut self, told: usize, at: usize, coding: Coding) -> Result<(), String> {
        let length = u32::try_from(self.out.len() - at).map_err(|_| "a value is longer than 4 GB".to_owned())?;
        self.patch(told, &coding.bytes(length));
        Ok(())
    }

    /// The items of a sequence.
    fn items(&mut self, coding: Coding, end: Option<usize>, deep: usize) -> Result<(), String> {
        loop {
            if end == Some(self.out.len()) {
                return Ok(());
            }
            let tag = self.tag(coding)?;
            let length = self.length(coding)?;
            let at = self.out.len();
            match tag {
                SEQUENCE_END if end.is_none_or(|end| end == at) => return Ok(()),
                ITEM if length == UNDEFINED => {
                    self.set(coding, None, deep + 1)?;
                }
                ITEM => {
                    let room = end.map_or(u64::MAX, |end| end.saturating_sub(at) as u64).min(self.left);
                    if u64::from(length) > room {
                        return Err(format!("an item says {length} bytes, and there are {room}"));
                    }
                    self.set(coding, Some(at + length as usize), deep + 1)?;
                }
                _ => return Err(format!("{tag} stands where an item is expected")),
            }
        }
    }

    /// The fragments of encapsulated pixels, or of what else is encoded so (PS3.5 A.4).
    fn fragments(&mut self, coding: Coding, pixels: bool) -> Result<(), String> {
        loop {
            // Some writers leave the end of the sequence out.
            if pixels && self.left == 0 {
                return Ok(());
            }
            let tag = self.tag(coding)?;
            let length = self.length(coding)?;
            match tag {
                SEQUENCE_END => return Ok(()),
                ITEM if u64::from(length) <= self.left => {
                    self.take(length.into())?;
                }
                ITEM => return Err(format!("a fragment says {length} bytes, and there are {}", self.left)),
                _ => return Err(format!("{tag} stands where a fragment is expected")),
            }
        }
    }
}
