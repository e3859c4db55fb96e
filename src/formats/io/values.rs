//! Values on their way into a file: each kind with its stored type and little-endian bytes.

use super::voxels::{Element, Layout};
use crate::field::FieldFormat;
use crate::geometry::Grid;
use crate::volume::Spans;
use std::ops::Range;

/// What an image file will hold.
pub(super) struct Contents<'a> {
    pub(super) grid: &'a Grid,
    pub(super) values: Values<'a>,
    /// What the values mean, where the format can tell.
    pub(super) meaning: Meaning,
    /// Free text for the header, where the format has room for it.
    pub(super) description: &'a str,
    /// Table of label names for the NIfTI header extension.
    pub(super) extension: Option<String>,
}

/// What values mean: NIfTI's intent.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Meaning {
    /// Numbers such as HU, Gy, or a mask.
    Scalar,
    /// Labels.
    Labels,
    /// Displacements or positions, already in the layout's frame.
    Field(FieldFormat),
}

/// Values to store, in storage order of the grid.
pub(super) enum Values<'a> {
    /// As float32.
    Float(&'a [f32]),
    /// As float32.
    Spans(&'a Spans<f32>),
    /// As uint8; the caller has checked the range.
    ByteSpans(&'a Spans<u16>),
    /// As uint16.
    WordSpans(&'a Spans<u16>),
    /// Rounded to int16; the caller has checked the range.
    Rounded(&'a [f32]),
    /// 1 and 0 as uint8.
    Mask(&'a [bool]),
    /// As uint8; the caller has checked the range.
    Bytes(&'a [u16]),
    /// As uint16.
    Words(&'a [u16]),
    /// Three float32.
    Vectors(&'a [[f32; 3]]),
}

impl Values<'_> {
    /// Stored type.
    pub(super) fn element(&self) -> Element {
        match self {
            Self::Float(_) | Self::Spans(_) | Self::Vectors(_) => Element::F32,
            Self::Rounded(_) => Element::I16,
            Self::Mask(_) | Self::Bytes(_) | Self::ByteSpans(_) => Element::U8,
            Self::Words(_) | Self::WordSpans(_) => Element::U16,
        }
    }

    /// Values per voxel.
    pub(super) fn components(&self) -> usize {
        if matches!(self, Self::Vectors(_)) { 3 } else { 1 }
    }

    /// Number of stored values.
    pub(super) fn len(&self) -> usize {
        match self {
            Self::Float(v) | Self::Rounded(v) => v.len(),
            Self::Spans(v) => v.grid().len(),
            Self::ByteSpans(v) | Self::WordSpans(v) => v.grid().len(),
            Self::Mask(v) => v.len(),
            Self::Bytes(v) | Self::Words(v) => v.len(),
            Self::Vectors(v) => 3 * v.len(),
        }
    }

    /// Appends the bytes of stored values `range`, vectors laid out as told.
    pub(super) fn fill(&self, layout: Layout, range: Range<usize>, out: &mut Vec<u8>) {
        match self {
            Self::Float(v) => append(out, &v[range], |x| x.to_le_bytes()),
            Self::Spans(v) => append(out, &copied(v, range), |x| x.to_le_bytes()),
            Self::ByteSpans(v) => append(out, &copied(v, range), |x| [*x as u8]),
            Self::WordSpans(v) => append(out, &copied(v, range), |x| x.to_le_bytes()),
            Self::Rounded(v) => append(out, &v[range], |x| (x.round_ties_even() as i16).to_le_bytes()),
            Self::Mask(v) => append(out, &v[range], |x| [u8::from(*x)]),
            Self::Bytes(v) => append(out, &v[range], |x| [*x as u8]),
            Self::Words(v) => append(out, &v[range], |x| x.to_le_bytes()),
            Self::Vectors(v) => match layout {
                Layout::Interleaved => append(out, &v.as_flattened()[range], |x| x.to_le_bytes()),
                Layout::Planar => {
                    for component in 0..3 {
                        let start = component * v.len();
                        let from = range.start.clamp(start, start + v.len()) - start;
                        let to = range.end.clamp(start, start + v.len()) - start;
                        append(out, &v[from..to], |x| x[component].to_le_bytes());
                    }
                }
            },
        }
    }
}

/// The values of the voxels `range` in storage.
fn copied<T: Copy + Default + Send + Sync>(spans: &Spans<T>, range: Range<usize>) -> Vec<T> {
    let mut values = vec![T::default(); range.len()];
    spans.copy_to(range.start, &mut values);
    values
}

/// Appends the bytes of values, each made by `bytes`.
fn append<T, const N: usize>(out: &mut Vec<u8>, values: &[T], bytes: impl Fn(&T) -> [u8; N]) {
    let start = out.len();
    out.resize(start + N * values.len(), 0);
    out[start..].as_chunks_mut().0.iter_mut().zip(values).for_each(|(to, value)| *to = bytes(value));
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn planar_vectors_are_the_same_in_any_pieces() {
        let v: Vec<[f32; 3]> = (0..10).map(|i| [i as f32, 100.0 + i as f32, 200.0 + i as f32]).collect();
        let values = Values::Vectors(&v);
        let mut whole = Vec::new();
        values.fill(Layout::Planar, 0..30, &mut whole);
        let expected: Vec<u8> =
            (0..3).flat_map(|c| (0..10).flat_map(move |i| (c as f32 * 100.0 + i as f32).to_le_bytes())).collect();
        assert_eq!(whole, expected);
        for cut in 0..=30 {
            let mut parts = Vec::new();
            values.fill(Layout::Planar, 0..cut, &mut parts);
            values.fill(Layout::Planar, cut..30, &mut parts);
            assert_eq!(parts, whole, "cut at {cut}");
        }
    }
}
