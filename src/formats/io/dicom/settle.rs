//! What a parsed data set means beyond what dicom-rs reads: values of known elements whose representation is told as
//! unknown (PS3.5 6.2.2), and texts, which come as their bytes.

use super::charset::Charset;
use super::elements::Item;
use super::walk::known;
use dicom_core::header::Header as _;
use dicom_core::{DataElement, PrimitiveValue, Tag, VR};
use dicom_dictionary_std::tags;

/// Parses a data set in Implicit VR Little Endian.
pub(super) type Parse<'a> = &'a dyn Fn(&[u8]) -> Option<Item>;

/// Settles a data set, and the items in it.
pub(super) fn settle(set: &mut Item, above: Charset, parse: Parse<'_>) {
    let own = set.get(tags::SPECIFIC_CHARACTER_SET).and_then(|e| e.to_multi_str().ok().map(|v| Charset::of(&v)));
    let charset = own.unwrap_or(above);
    let unknown: Vec<Tag> =
        set.iter().filter(|e| e.vr() == VR::UN && known(e.tag()).is_some()).map(|e| e.tag()).collect();
    for tag in unknown {
        let Some(bytes) = set.get(tag).and_then(|e| e.to_bytes().ok().map(|b| b.into_owned())) else { continue };
        if let Some(mut parsed) = parse(&alone(tag, &bytes))
            && let Some(element) = parsed.take(tag)
        {
            set.put(element);
        }
    }
    let odd: Vec<(Tag, VR)> =
        set.iter().filter(|e| is_odd(e.vr(), e.value().primitive())).map(|e| (e.tag(), e.vr())).collect();
    for (tag, vr) in odd {
        let Some(text) = set.get(tag).and_then(|e| e.value().primitive()).map(|v| decoded(v, vr, charset)) else {
            continue;
        };
        set.put(DataElement::new(tag, vr, text));
    }
    let sequences: Vec<Tag> = set.iter().filter(|e| e.items().is_some()).map(|e| e.tag()).collect();
    for tag in sequences {
        set.update_value(tag, |value| {
            for item in value.items_mut().into_iter().flatten() {
                settle(item, charset, parse);
            }
        });
    }
}

/// An element in Implicit VR Little Endian.
fn alone(tag: Tag, value: &[u8]) -> Vec<u8> {
    let mut bytes = Vec::with_capacity(8 + value.len());
    bytes.extend(tag.group().to_le_bytes());
    bytes.extend(tag.element().to_le_bytes());
    bytes.extend((value.len() as u32).to_le_bytes());
    bytes.extend(value);
    bytes
}

/// Whether a value is a text that the character set decides about (PS3.5 6.1.2.3).
fn is_odd(vr: VR, value: Option<&PrimitiveValue>) -> bool {
    let odd = |text: &String| text.bytes().any(|b| b >= 0x80 || b == 0x1b);
    matches!(vr, VR::SH | VR::LO | VR::ST | VR::LT | VR::UC | VR::UT | VR::PN)
        && match value {
            Some(PrimitiveValue::Strs(all)) => all.iter().any(odd),
            Some(PrimitiveValue::Str(one)) => odd(one),
            _ => false,
        }
}

fn decoded(value: &PrimitiveValue, vr: VR, charset: Charset) -> PrimitiveValue {
    // A character is a byte, and what was taken for a separator may be a part of a pair.
    let bytes: Vec<u8> = value.to_multi_str().join("\\").chars().map(|c| c as u8).collect();
    let text = charset.text(&bytes, vr == VR::PN);
    if matches!(vr, VR::ST | VR::LT | VR::UT) {
        return PrimitiveValue::Str(text);
    }
    PrimitiveValue::Strs(text.split('\\').map(str::to_owned).collect())
}
