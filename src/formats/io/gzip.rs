//! Gzip: reading any number of members as far as asked, and writing one member with all threads.
//!
//! The writer deflates blocks of fixed size independently, ends each with a sync flush and joins them into one member, as
//! pigz does. Block borders do not depend on the number of threads, so neither do the bytes.

use super::gaps;
use flate2::Crc;
use flate2::bufread::GzDecoder;
use rayon::prelude::*;
use std::borrow::Cow;
use std::io::{self, Read, Write};
use std::ops::Range;
use zlib_rs::{DeflateConfig, DeflateFlush};

/// Bytes that may follow what a header promises, such as padding; more of them mean that the header is wrong, and so that a
/// small file cannot keep the reader at work for hours.
const MOST_BEHIND: u64 = 1 << 20;

/// What is wrong with gzip data, for people.
pub(super) fn problem(error: &io::Error) -> String {
    if error.kind() == io::ErrorKind::FileTooLarge {
        return "the gzip data go on behind the values that the header promises: it is not this file's header".into();
    }
    format!("the gzip data are damaged or cut off ({error})")
}

/// First bytes of a gzip member.
const MAGIC: [u8; 2] = [0x1f, 0x8b];
/// Uncompressed bytes of one block.
const BLOCK: usize = 1 << 20;
/// zlib's greatest room for symbols: half as many tables of codes to make.
const MOST_MEMORY: i32 = 9;
/// Blocks that each thread compresses before they are written, which bounds the memory and what waits at the end.
const EACH: usize = 8;

/// The content of a file in memory, inflated as far as asked when it is gzip.
pub(super) enum GzipContent<'a> {
    /// Not gzip.
    Plain(&'a [u8]),
    /// Gzip: what is inflated so far, and the rest.
    Packed(Vec<u8>, Box<Members<'a>>),
}

impl<'a> GzipContent<'a> {
    /// The content of a file with these raw bytes.
    pub(super) fn new(raw: &'a [u8]) -> Self {
        if raw.starts_with(&MAGIC) {
            Self::Packed(Vec::new(), Box::new(Members { current: Some(GzDecoder::new(raw)) }))
        } else {
            Self::Plain(raw)
        }
    }

    /// The first `len` bytes, or as many as there are.
    ///
    /// # Errors
    /// When the gzip data are damaged or cut off within these bytes.
    pub(super) fn first(&mut self, len: usize) -> io::Result<&[u8]> {
        match self {
            Self::Plain(bytes) => Ok(&bytes[..len.min(bytes.len())]),
            Self::Packed(bytes, members) => {
                inflate(bytes, members, len)?;
                Ok(&bytes[..len.min(bytes.len())])
            }
        }
    }

    /// Reads to the end of the gzip data, whose checksum stands there, and gives the bytes asked for so far.
    ///
    /// # Errors
    /// When the gzip data are damaged or cut off, or go on for long.
    pub(super) fn checked(self) -> io::Result<Cow<'a, [u8]>> {
        match self {
            Self::Plain(bytes) => Ok(Cow::Borrowed(bytes)),
            Self::Packed(bytes, members) => {
                if io::copy(&mut members.take(MOST_BEHIND + 1), &mut io::sink())? > MOST_BEHIND {
                    return Err(io::ErrorKind::FileTooLarge.into());
                }
                Ok(Cow::Owned(bytes))
            }
        }
    }
}

/// Inflates until there are `len` bytes, or as many as there are.
///
/// Room is made for a multiple of the compressed size, and doubles as bytes really arrive, so that a header that promises
/// too much costs nothing. Fresh zeroed memory is not touched before it is filled, which saves a pass over it.
fn inflate(bytes: &mut Vec<u8>, members: &mut Members<'_>, len: usize) -> io::Result<()> {
    let mut filled = bytes.len();
    while filled < len {
        let room = members.remaining().saturating_mul(32).max(2 * filled + 4096).min(len);
        let mut fresh = vec![0; room];
        fresh[..filled].copy_from_slice(bytes);
        *bytes = fresh;
        while filled < room {
            match members.read(&mut bytes[filled..])? {
                0 => {
                    bytes.truncate(filled);
                    return Ok(());
                }
                n => filled += n,
            }
        }
    }
    Ok(())
}

/// Reads gzip members one after the other; bytes that are no member end it, as with gzip itself.
pub(super) struct Members<'a> {
    current: Option<GzDecoder<&'a [u8]>>,
}

impl Members<'_> {
    /// Compressed bytes not yet read.
    fn remaining(&self) -> usize {
        self.current.as_ref().map_or(0, |d| d.get_ref().len())
    }
}

impl Read for Members<'_> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        while let Some(decoder) = &mut self.current {
            let n = decoder.read(buffer)?;
            if n > 0 || buffer.is_empty() {
                return Ok(n);
            }
            let rest = self.current.take().map_or(&[][..], GzDecoder::into_inner);
            self.current = rest.starts_with(&MAGIC).then(|| GzDecoder::new(rest));
        }
        Ok(0)
    }
}

/// Bytes that a file will hold, made piece by piece: `fill(range, out)` appends the bytes of items in `range`.
pub(super) struct Payload<'a> {
    /// Bytes before the items.
    pub(super) header: Vec<u8>,
    /// Number of items.
    pub(super) items: usize,
    /// Bytes of one item.
    pub(super) item_bytes: usize,
    /// Whether no bytes but those of a constant vector are likely to come again, as in numbers that
    /// were measured or computed.
    pub(super) noisy: bool,
    /// Appends the bytes of a range of items.
    pub(super) fill: &'a (dyn Fn(Range<usize>, &mut Vec<u8>) + Sync),
}

impl Payload<'_> {
    /// The blocks that are compressed before they are written, wave by wave.
    fn waves(&self) -> impl Iterator<Item = Range<usize>> {
        let (blocks, wave) = (self.blocks(), EACH * rayon::current_num_threads());
        (0..blocks).step_by(wave).map(move |first| first..(first + wave).min(blocks))
    }
    fn blocks(&self) -> usize {
        self.items.div_ceil(self.per_block())
    }
    fn per_block(&self) -> usize {
        BLOCK / self.item_bytes
    }
    fn block(&self, n: usize, out: &mut Vec<u8>) {
        out.clear();
        let from = n * self.per_block();
        (self.fill)(from..(from + self.per_block()).min(self.items), out);
    }

    /// Writes header and items as they are.
    pub(super) fn write_plain(&self, out: &mut dyn Write) -> io::Result<()> {
        out.write_all(&self.header)?;
        self.write_items(out)
    }

    fn write_items(&self, out: &mut dyn Write) -> io::Result<()> {
        for wave in self.waves() {
            let blocks: Vec<Vec<u8>> = wave
                .into_par_iter()
                .map(|n| {
                    let mut raw = Vec::with_capacity(BLOCK);
                    self.block(n, &mut raw);
                    raw
                })
                .collect();
            blocks.iter().try_for_each(|b| out.write_all(b))?;
        }
        Ok(())
    }

    /// Writes header and items as one gzip member of this level (0 to 9), in parallel. Of noisy data the lowest level compresses
    /// gaps alone.
    pub(super) fn write_gzip(&self, out: &mut dyn Write, level: u32) -> io::Result<()> {
        out.write_all(&[MAGIC[0], MAGIC[1], 8, 0, 0, 0, 0, 0, 0, 255])?;
        let gaps = self.noisy && level == 1;
        let packer = || if gaps { Packer::Gaps } else { Packer::Zlib(Deflate::new(level)) };
        let head = packer().block(&self.header)?;
        out.write_all(&head.bytes)?;
        let mut crc = head.crc;
        let mut total = self.header.len() as u64;
        for wave in self.waves() {
            let blocks: Vec<io::Result<Deflated>> = wave
                .into_par_iter()
                .map_init(
                    || (packer(), Vec::with_capacity(BLOCK)),
                    |(packer, raw), n| {
                        self.block(n, raw);
                        packer.block(raw)
                    },
                )
                .collect();
            for block in blocks {
                let block = block?;
                out.write_all(&block.bytes)?;
                crc.combine(&block.crc);
            }
        }
        total += (self.items * self.item_bytes) as u64;
        // An empty last block, then checksum and length modulo 2^32.
        out.write_all(&[3, 0])?;
        out.write_all(&crc.sum().to_le_bytes())?;
        out.write_all(&((total & u64::from(u32::MAX)) as u32).to_le_bytes())
    }
}

/// One deflated block, ended on a byte border.
struct Deflated {
    bytes: Vec<u8>,
    crc: Crc,
}

/// What makes blocks.
enum Packer {
    Gaps,
    Zlib(Deflate),
}

impl Packer {
    fn block(&mut self, raw: &[u8]) -> io::Result<Deflated> {
        let mut crc = Crc::new();
        crc.update(raw);
        let bytes = match self {
            Self::Gaps => gaps::pack(raw),
            Self::Zlib(zlib) => zlib.block(raw)?,
        };
        Ok(Deflated { bytes, crc })
    }
}

/// A compressor that starts anew for each block.
struct Deflate {
    zlib: zlib_rs::Deflate,
    /// Room for a block.
    room: Vec<u8>,
}

impl Deflate {
    /// Of this level (0 to 9).
    fn new(level: u32) -> Self {
        let config = DeflateConfig {
            level: level.min(9) as i32,
            window_bits: -15,
            mem_level: MOST_MEMORY,
            ..DeflateConfig::default()
        };
        Self { zlib: zlib_rs::Deflate::new_with_config(config), room: vec![0; BLOCK] }
    }

    /// Deflate data for `raw`, ended on a byte border; not the last of its stream.
    fn block(&mut self, raw: &[u8]) -> io::Result<Vec<u8>> {
        self.zlib.reset();
        let mut bytes = Vec::new();
        loop {
            let (done, before) = (self.zlib.total_in() as usize, self.zlib.total_out());
            let status = self.zlib.compress(&raw[done..], &mut self.room, DeflateFlush::SyncFlush);
            status.map_err(|e| io::Error::other(e.as_str()))?;
            let made = (self.zlib.total_out() - before) as usize;
            bytes.extend_from_slice(&self.room[..made]);
            // The flush is complete only when the compressor leaves room unused.
            if made < self.room.len() {
                return Ok(bytes);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn payload_bytes(seed: u32, len: usize) -> Vec<u8> {
        let mut x = seed;
        (0..len)
            .map(|i| {
                if i % 7 == 0 {
                    x = x.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                    (x >> 24) as u8
                } else {
                    5
                }
            })
            .collect()
    }

    fn compress(header: &[u8], data: &[u8], level: u32, noisy: bool, threads: usize) -> Vec<u8> {
        let fill = |range: Range<usize>, out: &mut Vec<u8>| out.extend_from_slice(&data[range]);
        let payload = Payload { header: header.to_vec(), items: data.len(), item_bytes: 1, noisy, fill: &fill };
        let mut out = Vec::new();
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| payload.write_gzip(&mut out, level)).unwrap();
        out
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(24))]
        #[test]
        fn one_member_that_ordinary_readers_inflate(seed in any::<u32>(), len in 0usize..3_000_000, level in 0u32..10, noisy in any::<bool>()) {
            let data = payload_bytes(seed, len);
            let file = compress(b"head", &data, level, noisy, 2);
            let mut back = Vec::new();
            // GzDecoder reads a single member only.
            flate2::read::GzDecoder::new(&file[..]).read_to_end(&mut back).unwrap();
            prop_assert_eq!(&back[..4], b"head");
            prop_assert!(back[4..] == data[..]);
            prop_assert!(file == compress(b"head", &data, level, noisy, 1));
        }
    }

    #[test]
    fn reads_many_members_and_ignores_padding() {
        let mut file = compress(b"", b"abc", 1, true, 1);
        file.extend(compress(b"", b"defgh", 6, false, 1));
        file.extend([0; 20]);
        let mut content = GzipContent::new(&file);
        assert_eq!(content.first(4).unwrap(), b"abcd");
        assert_eq!(content.first(7).unwrap(), b"abcdefg");
        assert_eq!(content.first(100).unwrap(), b"abcdefgh");
        assert_eq!(&*content.checked().unwrap(), b"abcdefgh");
    }

    #[test]
    fn damage_is_found_even_after_the_wanted_bytes() {
        let good = compress(b"", &payload_bytes(1, 5000), 1, false, 1);
        for cut in [good.len() - 1, good.len() - 8, good.len() / 2, 12, 5] {
            let mut content = GzipContent::new(&good[..cut]);
            assert!(content.first(5000).is_err() || content.checked().is_err(), "cut at {cut}");
        }
        let mut bad = good.clone();
        let at = bad.len() - 6;
        bad[at] ^= 1;
        let mut content = GzipContent::new(&bad);
        assert!(content.first(5000).is_err() || content.checked().is_err());
    }
}
