//! From where to where a row holds anything.

use std::ops::Range;

/// Values that are looked at together.
const BLOCK: usize = 32;

/// From the first to the last value of a row of which `any` says that it is something.
#[inline(always)]
pub fn extent<T>(row: &[T], any: impl Fn(&[T]) -> bool) -> Range<usize> {
    // Whole blocks of nothing are passed over at once.
    let before = (row.chunks(BLOCK).take_while(|chunk| !any(chunk)).count() * BLOCK).min(row.len());
    let something = |value: &T| any(std::slice::from_ref(value));
    let Some(first) = row[before..].iter().position(something) else { return 0..0 };
    let behind = row.rchunks(BLOCK).take_while(|chunk| !any(chunk)).count() * BLOCK;
    let last = row[..row.len() - behind].iter().rposition(something).unwrap_or(0);
    before + first..last + 1
}

/// What two ranges span, of which any may be empty.
#[inline(always)]
pub fn union(a: &Range<usize>, b: &Range<usize>) -> Range<usize> {
    match (a.is_empty(), b.is_empty()) {
        (true, _) => b.clone(),
        (_, true) => a.clone(),
        _ => a.start.min(b.start)..a.end.max(b.end),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn the_extent_is_from_the_first_to_the_last(row in prop::collection::vec(prop::bool::weighted(0.02), 0..200)) {
            let found = extent(&row, |part| part.contains(&true));
            let ends = row.iter().position(|set| *set).zip(row.iter().rposition(|set| *set));
            prop_assert_eq!(found, ends.map_or(0..0, |(first, last)| first..last + 1));
        }
    }
}
