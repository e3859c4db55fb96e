//! Deflate data for numbers that no code shortens by much: they are stored as they are, and only the gaps of zeros between them are
//! compressed.
//!
//! A displacement is noise to a compressor: codes made for it save a fifth of its bytes and take ten times as long as copying it, for
//! the writer and again for every reader. Gaps are put together from ready pieces that zlib has made of zeros.

use super::gzip::Deflate;
use std::io;

/// Bytes that are zero together or stored together.
const GRAIN: usize = 64;
/// Gaps of fewer grains are stored: their pieces would be as long.
const LEAST: usize = 2;
/// Digits of a gap's length, and their base, as the pieces have them: the greatest stands for 4 MB, more than a block.
const DIGITS: usize = 4;
const BASE: usize = 16;
/// Greatest length of a stored part of deflate data (RFC 1951, 3.2.4).
const STORED: usize = u16::MAX as usize;

/// Compressed gaps: for each digit, of 1 to 15 times its unit.
pub(super) struct Gaps([Vec<Vec<u8>>; DIGITS]);

impl Gaps {
    /// Has zlib make the pieces for blocks of at most `block` bytes.
    pub(super) fn new(block: usize) -> io::Result<Self> {
        let zeros = vec![0; block];
        let mut deflate = Deflate::new(6);
        let mut gaps = Self(Default::default());
        for (digit, pieces) in gaps.0.iter_mut().enumerate() {
            let unit = GRAIN * BASE.pow(digit as u32);
            for n in (1..BASE).take_while(|n| n * unit <= block) {
                pieces.push(deflate.block(&zeros[..n * unit])?);
            }
        }
        Ok(gaps)
    }

    /// Deflate data for `raw`, ended on a byte border; not the last of its stream.
    pub(super) fn pack(&self, raw: &[u8]) -> Vec<u8> {
        let mut out = Vec::with_capacity(raw.len() / 2);
        let (grains, _) = raw.as_chunks::<GRAIN>();
        let empty = |grain: &[u8; GRAIN]| grain.iter().fold(0, |any, byte| any | byte) == 0;
        let (mut stored, mut at) = (0, 0);
        while at < grains.len() {
            let gap = grains[at..].iter().take_while(|grain| empty(grain)).count();
            if gap >= LEAST {
                store(&raw[stored * GRAIN..at * GRAIN], &mut out);
                self.skip(gap, &mut out);
                stored = at + gap;
            }
            at += gap.max(1);
        }
        store(&raw[stored * GRAIN..], &mut out);
        out
    }

    /// Adds the pieces of a gap of this many grains.
    fn skip(&self, grains: usize, out: &mut Vec<u8>) {
        for (digit, pieces) in self.0.iter().enumerate() {
            if let Some(before) = (grains / BASE.pow(digit as u32) % BASE).checked_sub(1) {
                out.extend_from_slice(&pieces[before]);
            }
        }
    }
}

/// Adds bytes as they are.
fn store(raw: &[u8], out: &mut Vec<u8>) {
    for part in raw.chunks(STORED) {
        let length = part.len() as u16;
        out.push(0);
        out.extend_from_slice(&length.to_le_bytes());
        out.extend_from_slice(&(!length).to_le_bytes());
        out.extend_from_slice(part);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::io::Read;

    fn inflated(packed: &[u8]) -> Vec<u8> {
        let mut back = Vec::new();
        let whole = [packed, &[3, 0]].concat();
        flate2::read::DeflateDecoder::new(&whole[..]).read_to_end(&mut back).unwrap();
        back
    }

    proptest! {
        #[test]
        fn any_gaps_come_back(parts in prop::collection::vec((0usize..90_000, 0usize..300), 0..9), odd in 0usize..70) {
            let mut raw = vec![7; odd];
            for (gap, noise) in parts {
                raw.extend(vec![0; gap]);
                raw.extend((0..noise).map(|n| (n * 37 % 251) as u8));
            }
            let gaps = Gaps::new(raw.len()).unwrap();
            prop_assert_eq!(inflated(&gaps.pack(&raw)), raw);
        }
    }

    #[test]
    fn gaps_take_hardly_any_room_and_noise_its_own() {
        let gaps = Gaps::new(1 << 20).unwrap();
        assert!(gaps.pack(&[]).is_empty());
        let empty = vec![0; 1 << 20];
        let packed = gaps.pack(&empty);
        assert!(packed.len() < 2000 && inflated(&packed) == empty, "{}", packed.len());
        let noise: Vec<u8> = (0..200_000u32).map(|n| (n.wrapping_mul(2_654_435_761) >> 24) as u8 | 1).collect();
        assert_eq!(gaps.pack(&noise).len(), noise.len() + 4 * 5);
    }
}
