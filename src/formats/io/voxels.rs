//! Stored voxel values of any integer or float type, in either byte order, to the types used inside.

use rayon::prelude::*;

/// Values decoded by one task.
const CHUNK: usize = 1 << 16;

/// Values that are told their type at once: they and what they become stay in the first cache.
const BLOCK: usize = 1 << 10;

/// How one value is stored.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Element {
    U8,
    I8,
    U16,
    I16,
    U32,
    I32,
    U64,
    I64,
    F32,
    F64,
}

impl Element {
    /// Bytes of one value.
    pub(super) fn size(self) -> usize {
        match self {
            Self::U8 | Self::I8 => 1,
            Self::U16 | Self::I16 => 2,
            Self::U32 | Self::I32 | Self::F32 => 4,
            Self::U64 | Self::I64 | Self::F64 => 8,
        }
    }

    /// Name for people, for example `int16`.
    pub(super) fn name(self) -> &'static str {
        match self {
            Self::U8 => "uint8",
            Self::I8 => "int8",
            Self::U16 => "uint16",
            Self::I16 => "int16",
            Self::U32 => "uint32",
            Self::I32 => "int32",
            Self::U64 => "uint64",
            Self::I64 => "int64",
            Self::F32 => "float32",
            Self::F64 => "float64",
        }
    }

    /// Whether values are integers.
    pub(super) fn is_integer(self) -> bool {
        !matches!(self, Self::F32 | Self::F64)
    }
}

/// How the components of a vector are stored.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Layout {
    /// One whole volume per component.
    Planar,
    /// The components of a voxel together.
    Interleaved,
}

/// Stored values: bytes with how to read them. A value is `raw * slope + inter`.
#[derive(Debug, Clone, Copy)]
pub(super) struct Voxels<'a> {
    pub(super) bytes: &'a [u8],
    pub(super) element: Element,
    pub(super) big_endian: bool,
    pub(super) slope: f64,
    pub(super) inter: f64,
}

impl Voxels<'_> {
    /// All values through `convert`, in storage order.
    pub(super) fn decode<T: Copy + Default + Send>(&self, convert: impl Fn(f64) -> T + Sync) -> Vec<T> {
        self.decode_vectors(Layout::Planar, |_, [v]| convert(v))
    }

    /// All vectors of `C` components through `convert(storage position, components)`, decoded in parallel.
    pub(super) fn decode_vectors<T: Copy + Default + Send, const C: usize>(
        &self,
        layout: Layout,
        convert: impl Fn(usize, [f64; C]) -> T + Sync,
    ) -> Vec<T> {
        let voxels = self.bytes.len() / self.element.size() / C;
        let mut out = vec![T::default(); voxels];
        out.par_chunks_mut(CHUNK).enumerate().for_each(|(chunk, out)| {
            let mut values = [[0.0; BLOCK]; C];
            for (block, out) in out.chunks_mut(BLOCK).enumerate() {
                let start = chunk * CHUNK + block * BLOCK;
                for (c, values) in values.iter_mut().enumerate() {
                    let (first, step) = match layout {
                        Layout::Planar => (c * voxels + start, 1),
                        Layout::Interleaved => (C * start + c, C),
                    };
                    self.values(first, step, &mut values[..out.len()]);
                }
                for (i, out) in out.iter_mut().enumerate() {
                    *out = convert(start + i, std::array::from_fn(|c| values[c][i]));
                }
            }
        });
        out
    }

    /// Every `step`-th value from the `first` on. The types are told apart here and nowhere else: once for all uses, for each
    /// further copy of these loops takes a second to compile.
    fn values(&self, first: usize, step: usize, out: &mut [f64]) {
        macro_rules! values_as {
            ($raw:ty) => {{
                let stored = self.bytes.as_chunks::<{ size_of::<$raw>() }>().0[first..].iter().step_by(step);
                if self.big_endian {
                    self.scaled(stored.map(|b| <$raw>::from_be_bytes(*b) as f64), out);
                } else {
                    self.scaled(stored.map(|b| <$raw>::from_le_bytes(*b) as f64), out);
                }
            }};
        }
        match self.element {
            Element::U8 => values_as!(u8),
            Element::I8 => values_as!(i8),
            Element::U16 => values_as!(u16),
            Element::I16 => values_as!(i16),
            Element::U32 => values_as!(u32),
            Element::I32 => values_as!(i32),
            Element::U64 => values_as!(u64),
            Element::I64 => values_as!(i64),
            Element::F32 => values_as!(f32),
            Element::F64 => values_as!(f64),
        }
    }

    fn scaled(&self, raw: impl Iterator<Item = f64>, out: &mut [f64]) {
        for (out, raw) in out.iter_mut().zip(raw) {
            *out = raw * self.slope + self.inter;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn both<const N: usize>(element: Element, le: [u8; N], be: [u8; N], expected: f64) {
        for (big_endian, one) in [(false, le), (true, be)] {
            let bytes = one.repeat(CHUNK + 3);
            let voxels = Voxels { bytes: &bytes, element, big_endian, slope: 2.0, inter: -1.0 };
            let got = voxels.decode(|v| v);
            assert_eq!(got.len(), CHUNK + 3);
            assert!(got.iter().all(|v| v.to_bits() == (expected * 2.0 - 1.0).to_bits()), "{element:?} {big_endian}");
        }
    }

    #[test]
    fn every_type_in_both_orders() {
        both(Element::U8, [200], [200], 200.0);
        both(Element::I8, [200], [200], -56.0);
        both(Element::U16, [1, 250], [250, 1], 64001.0);
        both(Element::I16, [0x18, 0xfc], [0xfc, 0x18], -1000.0);
        both(Element::U32, [0, 0, 0, 0x80], [0x80, 0, 0, 0], 2_147_483_648.0);
        both(Element::I32, (-70_000i32).to_le_bytes(), (-70_000i32).to_be_bytes(), -70_000.0);
        both(Element::U64, (1u64 << 40).to_le_bytes(), (1u64 << 40).to_be_bytes(), (1u64 << 40) as f64);
        both(Element::I64, (-3i64).to_le_bytes(), (-3i64).to_be_bytes(), -3.0);
        both(Element::F32, (0.1f32).to_le_bytes(), (0.1f32).to_be_bytes(), f64::from(0.1f32));
        both(Element::F64, (0.1f64).to_le_bytes(), (0.1f64).to_be_bytes(), 0.1);
    }
}
