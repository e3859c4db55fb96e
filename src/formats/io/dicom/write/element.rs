//! Data elements from values, and numbers as decimal strings.

use dicom_core::header::Length;
use dicom_core::value::{DataSetSequence, PrimitiveValue};
use dicom_core::{DataElement, Tag, VR};
use dicom_dictionary_std::tags;
use dicom_object::InMemDicomObject;
use dicom_object::mem::InMemElement;

/// Longest decimal string (PS3.5 6.2).
const LONGEST: usize = 16;

/// A data set from its elements, in any order; a later element takes the place of an earlier one.
pub fn item(elements: impl IntoIterator<Item = InMemElement>) -> InMemDicomObject {
    InMemDicomObject::from_element_iter(elements)
}

/// A text.
pub fn text(tag: Tag, vr: VR, value: impl Into<String>) -> InMemElement {
    DataElement::new(tag, vr, PrimitiveValue::from(value.into()))
}

/// Several texts of one element.
pub fn texts<'a>(tag: Tag, vr: VR, values: impl IntoIterator<Item = &'a str>) -> InMemElement {
    DataElement::new(tag, vr, PrimitiveValue::Strs(values.into_iter().map(str::to_owned).collect()))
}

/// An element without a value.
pub fn empty(tag: Tag, vr: VR) -> InMemElement {
    DataElement::new(tag, vr, PrimitiveValue::Empty)
}

/// Unsigned 16-bit integers.
pub fn short(tag: Tag, value: u16) -> InMemElement {
    DataElement::new(tag, VR::US, PrimitiveValue::from(value))
}

/// An integer string.
pub fn integer(tag: Tag, value: i64) -> InMemElement {
    text(tag, VR::IS, value.to_string())
}

/// Decimal strings.
pub fn decimals(tag: Tag, values: impl IntoIterator<Item = f64>) -> InMemElement {
    DataElement::new(tag, VR::DS, PrimitiveValue::Strs(values.into_iter().map(decimal).collect()))
}

/// A sequence of items.
pub fn sequence(tag: Tag, items: Vec<InMemDicomObject>) -> InMemElement {
    DataElement::new(tag, VR::SQ, DataSetSequence::new(items, Length::UNDEFINED))
}

/// An item that refers to an object (PS3.3 10.8, SOP Instance Reference).
pub fn reference(class: &str, instance: &str) -> InMemDicomObject {
    item([
        text(tags::REFERENCED_SOP_CLASS_UID, VR::UI, class),
        text(tags::REFERENCED_SOP_INSTANCE_UID, VR::UI, instance),
    ])
}

/// An item that holds a code (PS3.3 8.8).
pub fn code(value: &str, scheme: &str, meaning: &str) -> InMemDicomObject {
    item([
        text(tags::CODE_VALUE, VR::SH, value),
        text(tags::CODING_SCHEME_DESIGNATOR, VR::SH, scheme),
        text(tags::CODE_MEANING, VR::LO, meaning),
    ])
}

/// A finite number in at most 16 characters, as close as they allow: at least 9 digits.
pub fn decimal(value: f64) -> String {
    // No negative zero.
    let value = value + 0.0;
    let plain = format!("{value}");
    if plain.len() <= LONGEST {
        return plain;
    }
    let fixed = (0..LONGEST).map(|digits| format!("{value:.digits$}"));
    let scientific = (0..LONGEST).map(|digits| format!("{value:.digits$e}"));
    let error = |text: &String| text.parse().map_or(f64::INFINITY, |v: f64| (v - value).abs());
    let fitting = fixed.chain(scientific).filter(|t| t.len() <= LONGEST);
    fitting.min_by(|a, b| error(a).total_cmp(&error(b)).then(a.len().cmp(&b.len()))).unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn numbers_fit_and_keep_their_digits() {
        for (value, expected) in [
            (0.0, "0"),
            (-0.0, "0"),
            (2.5, "2.5"),
            (-1024.0, "-1024"),
            (1.0 / 3.0, "0.33333333333333"),
            (-std::f64::consts::FRAC_1_SQRT_2, "-0.7071067811865"),
            (1.234_567_890_123_4e-9, "1.2345678901e-9"),
            (-123_456.789_012_345, "-123456.78901235"),
            (1e300, "1e300"),
        ] {
            let text = decimal(value);
            assert!(text.len() <= 16, "{text}");
            let (got, expected): (f64, f64) = (text.parse().unwrap(), expected.parse().unwrap());
            assert!((got - value).abs() <= (expected - value).abs(), "{value}: {text}");
        }
    }

    proptest! {
        #[test]
        fn any_number_fits(mantissa in -10.0f64..10.0, exponent in -40i32..40) {
            let value = mantissa * 10f64.powi(exponent);
            let text = decimal(value);
            let back: f64 = text.parse().unwrap();
            prop_assert!(text.len() <= 16 && !text.is_empty(), "{}", text);
            prop_assert!((back - value).abs() <= 1e-8 * value.abs(), "{}", text);
        }
    }
}
