//! Values of elements, as numbers and texts without padding.

use dicom_core::Tag;
use dicom_object::InMemDicomObject;

/// A data set, or an item of a sequence.
pub(super) type Item = InMemDicomObject;

/// A text without padding; empty where there is none.
pub(super) fn text(item: &Item, tag: Tag) -> String {
    item.get(tag).and_then(|e| e.to_str().ok()).map_or(String::new(), |t| plain(&t).to_owned())
}

/// The values of a text.
pub(super) fn texts(item: &Item, tag: Tag) -> Vec<String> {
    let all = item.get(tag).and_then(|e| e.to_multi_str().ok());
    all.map_or(Vec::new(), |all| all.iter().map(|t| plain(t).to_owned()).collect())
}

fn plain(text: &str) -> &str {
    text.trim_matches(|c: char| c.is_whitespace() || c == '\0')
}

/// Finite numbers; `None` where the element is missing, empty or holds anything else.
pub(super) fn numbers(item: &Item, tag: Tag) -> Option<Vec<f64>> {
    let all = item.get(tag)?.to_multi_float64().ok()?;
    (!all.is_empty() && all.iter().all(|v| v.is_finite())).then_some(all)
}

/// As many finite numbers as asked for.
pub(super) fn some<const N: usize>(item: &Item, tag: Tag) -> Option<[f64; N]> {
    numbers(item, tag)?.try_into().ok()
}

/// One finite number.
pub(super) fn number(item: &Item, tag: Tag) -> Option<f64> {
    numbers(item, tag)?.first().copied()
}

/// One integer; a decimal string where it is one.
pub(super) fn whole(item: &Item, tag: Tag) -> Option<i64> {
    let element = item.get(tag)?;
    let decimal =
        || element.to_float64().ok().filter(|v| v.fract() == 0.0 && v.abs() < 2f64.powi(53)).map(|v| v as i64);
    element.to_int().ok().or_else(decimal)
}

/// The items of a sequence; none where it is missing.
pub(super) fn items(item: &Item, tag: Tag) -> &[Item] {
    item.get(tag).and_then(|e| e.items()).unwrap_or_default()
}

/// The first item of a sequence.
pub(super) fn first(item: &Item, tag: Tag) -> Option<&Item> {
    items(item, tag).first()
}
