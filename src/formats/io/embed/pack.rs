//! Whole numbers packed: each by what its neighbours let expect, deflated.

use crate::error::{Error, Result};
use zlib_rs::{DeflateConfig, ReturnCode, Strategy};

/// Marks a number that does not fit a byte.
const WIDE: u8 = 255;

/// Values of a volume of this size, storage order, as a zlib stream. In it each value is told by
/// its difference from what its neighbours in the row before and to the left let expect (the median
/// predictor of LOCO-I, Weinberger et al., IEEE Trans. Image Process. 9 (2000) 1309), 0 beyond the
/// plane; differences 0, -1, 1, -2, ... are a byte 0, 1, 2, 3, ...; for 255 and more the byte is
/// 255 and the number follows, 4 bytes little-endian, behind the bytes of all voxels, in their
/// order.
///
/// # Errors
/// [`Error::Internal`] when the compressor fails.
pub fn pack(values: &[i32], size: [usize; 3]) -> Result<Vec<u8>> {
    let mut bytes = Vec::with_capacity(values.len() + values.len() / 64);
    let mut wide = Vec::new();
    let nothing = vec![0; size[0]];
    for plane in values.chunks(size[0] * size[1]) {
        let mut before = &nothing[..];
        for row in plane.chunks(size[0]) {
            let (mut left, mut corner) = (0, 0);
            for (&value, &above) in row.iter().zip(before) {
                let difference = value.wrapping_sub(expected(left, above, corner));
                let number = ((difference << 1) ^ (difference >> 31)) as u32;
                if number < u32::from(WIDE) {
                    bytes.push(number as u8);
                } else {
                    bytes.push(WIDE);
                    wide.extend(number.to_le_bytes());
                }
                (left, corner) = (value, above);
            }
            before = row;
        }
    }
    bytes.append(&mut wide);
    // Runs of equal bytes are all that is repeated here; to look for more takes five times as long.
    let config = DeflateConfig { level: 6, mem_level: 9, strategy: Strategy::Rle, ..DeflateConfig::default() };
    let mut out = vec![0; zlib_rs::compress_bound(bytes.len())];
    match zlib_rs::compress_slice(&mut out, &bytes, config) {
        (packed, ReturnCode::Ok) => {
            let len = packed.len();
            out.truncate(len);
            Ok(out)
        }
        (_, code) => Err(Error::Internal(format!("a volume for the page was not compressed ({code:?})"))),
    }
}

/// What lies between the neighbours to the left and above, if the plane goes on as there.
#[inline(always)]
fn expected(left: i32, above: i32, corner: i32) -> i32 {
    let (least, most) = (left.min(above), left.max(above));
    if corner >= most {
        least
    } else if corner <= least {
        most
    } else {
        left.wrapping_add(above).wrapping_sub(corner)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::io::Read;

    /// What the page's script does.
    fn unpack(packed: &[u8], size: [usize; 3]) -> Vec<i32> {
        let mut bytes = Vec::new();
        flate2::read::ZlibDecoder::new(packed).read_to_end(&mut bytes).unwrap();
        let [ni, nj, nk] = size;
        let mut wide = ni * nj * nk;
        let mut out = vec![0i32; wide];
        for n in 0..out.len() {
            let (i, j) = (n % ni, n / ni % nj);
            let left = if i > 0 { out[n - 1] } else { 0 };
            let above = if j > 0 { out[n - ni] } else { 0 };
            let corner = if i > 0 && j > 0 { out[n - ni - 1] } else { 0 };
            let mut number = u32::from(bytes[n]);
            if number == 255 {
                number = u32::from_le_bytes(bytes[wide..wide + 4].try_into().unwrap());
                wide += 4;
            }
            let difference = (number >> 1) as i32 ^ -((number & 1) as i32);
            out[n] = expected(left, above, corner).wrapping_add(difference);
        }
        assert_eq!(wide, bytes.len());
        out
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(40))]
        #[test]
        fn what_is_packed_comes_back(values in proptest::collection::vec(prop_oneof![-200..300i32, any::<i32>()], 60)) {
            let size = [5, 4, 3];
            prop_assert_eq!(unpack(&pack(&values, size).unwrap(), size), values);
        }
    }

    #[test]
    fn even_volumes_take_hardly_any_room() {
        let size = [100, 100, 20];
        let values: Vec<i32> = (0..200_000).map(|n| if n % 100 > 50 { 230 } else { 1 }).collect();
        let packed = pack(&values, size).unwrap();
        assert!(packed.len() < 3000, "{}", packed.len());
        assert_eq!(unpack(&packed, size), values);
    }
}
