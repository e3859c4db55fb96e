//! Deflate data for numbers that no code shortens by much: they are stored as they are, and only
//! gaps between them are compressed, in which one vector comes again and again.
//!
//! A displacement is noise to a compressor: codes made for it save a fifth of its bytes and take
//! ten times as long as copying it, for the writer and again for every reader. Around the patient a
//! field is constant: nothing, or the shift of the couch. A gap begins and ends at any byte.

use std::ops::Range;

/// Bytes after which a gap's content comes again: float32 vectors one after the other; components
/// apart come again after 4.
const PERIOD: usize = 12;
/// Bytes that are looked at together: gaps of twice as many are always found, of fewer never.
const GRAIN: usize = 64;
/// Greatest length of a stored part of deflate data (RFC 1951, 3.2.4).
const STORED: usize = u16::MAX as usize;
/// Least and greatest length of a match (3.2.5).
const SHORTEST: usize = 3;
const LONGEST: usize = 258;
/// How far back all matches of a gap but its first are copied from: a whole number of periods, and
/// no less than their length, for readers are slow at copying what they have just begun to write.
const FAR: usize = LONGEST.next_multiple_of(PERIOD);
// The first match, if others follow, and the period before it reach back as far.
const _: () = assert!(FAR <= PERIOD + LONGEST + 1 - SHORTEST);

/// Deflate data for `raw` that need nothing before them, ended on a byte border; not the last of
/// their stream.
pub(super) fn pack(raw: &[u8]) -> Vec<u8> {
    let mut out = Bits { bytes: Vec::with_capacity(raw.len() / 2), pending: 0, count: 0 };
    let mut done = 0;
    while let Some(gap) = next_gap(raw, done) {
        store(&raw[done..gap.start], &mut out);
        repeat(gap.len(), &mut out);
        done = gap.end;
    }
    store(&raw[done..], &mut out);
    if out.count > 0 {
        store_part(&[], &mut out);
    }
    out.bytes
}

/// The first gap at or behind byte `from`: each of its bytes is the one [`PERIOD`] before it, which
/// lies in `raw` too.
fn next_gap(raw: &[u8], from: usize) -> Option<Range<usize>> {
    let least = from.max(PERIOD);
    let (now, before) = (raw.get(least..)?, &raw[least - PERIOD..]);
    let ((grains, _), (grains_before, _)) = (now.as_chunks::<GRAIN>(), before.as_chunks::<GRAIN>());
    let mut same = grains.iter().zip(grains_before).map(|(a, b)| a == b);
    let first = same.position(|same| same)?;
    let whole = 1 + same.take_while(|&same| same).count();
    let (start, end) = (first * GRAIN, (first + whole) * GRAIN);
    let ahead = now[..start].iter().rev().zip(before[..start].iter().rev());
    let behind = now[end..].iter().zip(&before[end..]);
    let start = start - ahead.take_while(|(a, b)| a == b).count();
    let end = end + behind.take_while(|(a, b)| a == b).count();
    Some(least + start..least + end)
}

/// Adds a part with fixed codes that goes on with the last [`PERIOD`] bytes for `length` bytes, at
/// least [`SHORTEST`].
fn repeat(length: usize, out: &mut Bits) {
    out.add(0b010, 3);
    let mut rest = length;
    while rest > 0 {
        // What is left must not be too short for a match.
        let now = if rest > LONGEST { LONGEST.min(rest - SHORTEST) } else { rest };
        out.add_match(now, if rest == length { PERIOD } else { FAR });
        rest -= now;
    }
    // The end of the part, symbol 256.
    out.add(0, 7);
}

/// Adds bytes as they are.
fn store(raw: &[u8], out: &mut Bits) {
    raw.chunks(STORED).for_each(|part| store_part(part, out));
}

/// Adds a stored part, which ends on a byte border, of at most [`STORED`] bytes.
fn store_part(part: &[u8], out: &mut Bits) {
    out.add(0b000, 3);
    out.pad();
    let length = part.len() as u16;
    out.bytes.extend_from_slice(&length.to_le_bytes());
    out.bytes.extend_from_slice(&(!length).to_le_bytes());
    out.bytes.extend_from_slice(part);
}

/// Bytes that are filled from their lowest bit on.
struct Bits {
    bytes: Vec<u8>,
    /// Bits that do not fill a byte yet, and their number.
    pending: u32,
    count: u32,
}

impl Bits {
    /// Adds the lowest `count` bits of `value`, at most 16, which has no others.
    fn add(&mut self, value: u32, count: u32) {
        self.pending |= value << self.count;
        self.count += count;
        while self.count >= 8 {
            self.bytes.push(self.pending as u8);
            self.pending >>= 8;
            self.count -= 8;
        }
    }

    /// Adds a Huffman code, whose highest bit comes first.
    fn add_code(&mut self, code: u32, count: u32) {
        self.add(code.reverse_bits() >> (u32::BITS - count), count);
    }

    /// Fills the last byte with zeros.
    fn pad(&mut self) {
        self.add(0, self.count.wrapping_neg() % 8);
    }

    /// Adds a match in the fixed codes (3.2.5 and 3.2.6), `distance` at least 4.
    fn add_match(&mut self, length: usize, distance: usize) {
        // Four symbols for each number of extra bits; eight lengths and the greatest have none.
        let over = (length - SHORTEST) as u32;
        let extra = over.max(4).ilog2() - 2;
        let (symbol, extra) = if length == LONGEST { (285, 0) } else { (257 + 4 * extra + (over >> extra), extra) };
        match symbol {
            ..280 => self.add_code(symbol - 256, 7),
            _ => self.add_code(0b1100_0000 + (symbol - 280), 8),
        }
        self.add(over & ((1 << extra) - 1), extra);
        // Two symbols for each number of extra bits.
        let over = (distance - 1) as u32;
        let extra = over.ilog2() - 1;
        self.add_code(2 * extra + (over >> extra), 5);
        self.add(over & ((1 << extra) - 1), extra);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::io::Read;

    /// What an ordinary reader makes of a block that nothing comes before.
    fn inflated(packed: &[u8]) -> Vec<u8> {
        let mut back = Vec::new();
        let whole = [packed, &[3, 0]].concat();
        flate2::read::DeflateDecoder::new(&whole[..]).read_to_end(&mut back).unwrap();
        back
    }

    fn noise(length: usize) -> Vec<u8> {
        (0..length as u32).map(|n| (n.wrapping_mul(2_654_435_761) >> 24) as u8).collect()
    }

    /// `length` bytes of a constant field: components apart, interleaved, or of another period.
    fn constant(period: usize, length: usize) -> Vec<u8> {
        let vector: Vec<u8> = [2.832_519_5_f32, 9.316_406, -2.863_281_2].iter().flat_map(|x| x.to_le_bytes()).collect();
        vector[..period].iter().copied().cycle().take(length).collect()
    }

    proptest! {
        #[test]
        fn any_gaps_come_back(
            parts in prop::collection::vec(
                (0usize..8, prop_oneof![0usize..40, 60usize..700, 0usize..90_000], 0usize..300),
                0..9,
            ),
            odd in 0usize..70,
        ) {
            let mut raw = noise(odd);
            for (kind, gap, between) in parts {
                match kind {
                    0 | 1 => raw.extend(vec![0; gap]),
                    2 | 3 => raw.extend(constant(4, gap)),
                    4 | 5 => raw.extend(constant(12, gap)),
                    6 => raw.extend(constant(5, gap)),
                    _ => raw.extend(noise(gap)),
                }
                raw.extend(noise(between));
            }
            let packed = pack(&raw);
            prop_assert!(packed.len() <= raw.len() + 5 * (raw.len() / STORED + 20), "{} of {}", packed.len(), raw.len());
            prop_assert!(inflated(&packed) == raw);
        }
    }

    #[test]
    fn gaps_of_every_length_come_back() {
        for length in 0..1200 {
            for period in [4, 12] {
                let raw = [&noise(5)[..], &constant(period, length), &noise(9)].concat();
                let packed = pack(&raw);
                assert!(inflated(&packed) == raw, "{length} {period}");
                assert!(length < 2 * GRAIN + PERIOD || packed.len() < 70, "{length} {period}: {}", packed.len());
            }
        }
    }

    /// The bits of the standard, written out by hand: a stored part of 12 bytes, then fixed codes.
    /// 258 bytes from 12 back are symbol 285 and distance symbol 6 with 3 in 2 bits; from 264 back,
    /// distance symbol 16 with 7 in 7; 100 more are symbol 279 with 1 in 4. Extra bits come lowest
    /// first.
    #[test]
    fn the_bits_are_those_of_the_standard() {
        let bits = [
            "0 10", // not the last, fixed codes
            "11000101 00110 11",
            "11000101 10000 1110000",
            "0010111 1000 10000 1110000",
            "0000000",
        ];
        let bits: Vec<u8> = bits.concat().bytes().filter(|b| *b != b' ').map(|b| b - b'0').collect();
        let expected: Vec<u8> =
            bits.chunks(8).map(|byte| byte.iter().rev().fold(0, |all, bit| 2 * all + bit)).collect();
        let raw = constant(12, 12 + 258 + 258 + 100);
        let packed = pack(&raw);
        assert_eq!(packed[..5], [0, 12, 0, !12, 255]);
        assert_eq!(packed[5..17], raw[..12]);
        let (codes, end) = packed[17..].split_at(packed.len() - 17 - 4);
        assert_eq!(end, [0, 0, 255, 255]);
        assert_eq!(codes[..expected.len()], expected);
        assert!(codes.len() <= expected.len() + 1);
    }

    #[test]
    fn gaps_take_hardly_any_room_and_noise_its_own() {
        assert!(pack(&[]).is_empty());
        let length = 1 << 20;
        for empty in [vec![0; length], constant(4, length), constant(12, length)] {
            let packed = pack(&empty);
            assert!(packed.len() < length / 100 && inflated(&packed) == empty, "{}", packed.len());
        }
        let noise = noise(200_000);
        assert_eq!(pack(&noise).len(), noise.len() + 4 * 5);
    }
}
