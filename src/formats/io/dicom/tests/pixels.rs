//! Stored values: signs, bits, padding, transfer syntaxes.

use super::make::*;
use crate::io::read_image;
use dicom_core::value::PixelFragmentSequence;
use dicom_core::{DataElement, PrimitiveValue, VR};
use dicom_dictionary_std::{tags, uids};

/// Explicit VR Big Endian, which is retired and still about.
const BIG_ENDIAN: &str = "1.2.840.10008.1.2.2";

/// The first voxels of a series of which every slice has these values.
fn first(values: &[u16], change: impl Fn(&mut Set)) -> (Vec<f32>, Vec<String>) {
    let dir = series(|_, set| {
        let mut all = values.to_vec();
        all.resize(SIZE[0] * SIZE[1], 500);
        pixels(set, all);
        put(set, tags::RESCALE_SLOPE, VR::DS, "1");
        change(set);
    });
    let read = read_image(dir.path()).unwrap();
    let codes = read.warnings.iter().map(|w| w.code.clone()).collect();
    (read.value.data()[..values.len()].to_vec(), codes)
}

#[test]
fn signs_and_bits_are_told_apart() {
    let signed = |set: &mut Set| {
        put_u16(set, tags::PIXEL_REPRESENTATION, 1);
        put(set, tags::RESCALE_INTERCEPT, VR::DS, "0");
    };
    assert_eq!(first(&[(-1000i16) as u16, 40], signed).0, [-1000.0, 40.0]);
    assert_eq!(first(&[64536, 40], |_| ()).0, [63512.0, -984.0]);
    let twelve = |set: &mut Set| {
        put_u16(set, tags::BITS_STORED, 12);
        put_u16(set, tags::HIGH_BIT, 11);
    };
    // What stands in the unused bits, such as an overlay, is no part of the value.
    assert_eq!(first(&[0x1400, 0x0400], twelve).0, [0.0, 0.0]);
    // Values that fill the upper bits of a word.
    let upper = |set: &mut Set| {
        put_u16(set, tags::BITS_STORED, 12);
        put_u16(set, tags::HIGH_BIT, 15);
    };
    assert_eq!(first(&[0x4000, 0x7d05], upper).0, [0.0, 976.0]);
    let both = |set: &mut Set| {
        signed(set);
        twelve(set);
    };
    assert_eq!(first(&[0x0fff, 0x0800, 0x07ff], both).0, [-1.0, -2048.0, 2047.0]);
}

#[test]
fn padding_stays_where_it_could_be_a_measurement_and_is_air_elsewhere() {
    let pad = |value: u16| move |set: &mut Set| put_u16(set, tags::PIXEL_PADDING_VALUE, value);
    assert_eq!(first(&[0, 1000], pad(0)), (vec![-1024.0, -24.0], vec![]));
    let (values, codes) = first(&[63536, 1000], pad(63536));
    assert_eq!((values, codes), (vec![-1024.0, -24.0], vec!["dicom-padding".to_owned()]));
    // A range, whichever of its ends comes first.
    for [value, limit] in [[63000, 63536], [63536, 63000]] {
        let range = |set: &mut Set| {
            put_u16(set, tags::PIXEL_PADDING_VALUE, value);
            put_u16(set, tags::PIXEL_PADDING_RANGE_LIMIT, limit);
        };
        assert_eq!(first(&[63000, 63300, 63536, 1000], range).0, [-1024.0, -1024.0, -1024.0, -24.0]);
    }
    // -2000 as an unsigned number, in an image of signed ones.
    let signed = |set: &mut Set| {
        put_u16(set, tags::PIXEL_REPRESENTATION, 1);
        put_u16(set, tags::PIXEL_PADDING_VALUE, 63536);
    };
    assert_eq!(first(&[63536, 1000], signed), (vec![-3024.0, -24.0], vec![]));
}

#[test]
fn every_uncompressed_syntax_gives_the_same_values() {
    let expected = read_image(series(|_, _| ()).path()).unwrap().value;
    for syntax in [uids::IMPLICIT_VR_LITTLE_ENDIAN, BIG_ENDIAN, uids::DEFLATED_EXPLICIT_VR_LITTLE_ENDIAN] {
        let dir = tempfile::tempdir().unwrap();
        (0..SIZE[2]).for_each(|k| drop(write_as(dir.path(), &k.to_string(), &slice(k), syntax)));
        assert_eq!(read_image(dir.path()).unwrap().value, expected, "{syntax}");
    }
}

#[test]
fn compression_that_is_not_read_is_named_with_its_tool() {
    for (syntax, words) in [
        (uids::JPEGLS_LOSSLESS, ["JPEG-LS", "1.2.840.10008.1.2.4.80", "dcmdjpls"]),
        (uids::HTJ2K_LOSSLESS, ["High-Throughput", "1.2.840.10008.1.2.4.201", "pydicom"]),
    ] {
        let dir = tempfile::tempdir().unwrap();
        for k in 0..SIZE[2] {
            let mut set = slice(k);
            let fragments = PixelFragmentSequence::new_fragments(vec![vec![1u8; 20]]);
            set.put(DataElement::new(tags::PIXEL_DATA, VR::OB, fragments));
            write_as(dir.path(), &k.to_string(), &set, syntax);
        }
        let error = read_image(dir.path()).unwrap_err();
        let text = error.to_string();
        assert_eq!(error.code(), "dicom-compression", "{text}");
        words.iter().for_each(|word| assert!(text.contains(word), "{word}: {text}"));
    }
}

#[test]
fn run_length_encoding_is_read() {
    // Two planes of bytes, the high ones first; a run of n is 257 - n, as PS3.5 annex G says.
    let plane = |value: u8| vec![(257 - SIZE[0] * SIZE[1]) as u8, value];
    let mut encoded: Vec<u8> = [2u32, 64, 66].iter().flat_map(|v| v.to_le_bytes()).collect();
    encoded.resize(64, 0);
    encoded.extend([plane(4), plane(7)].concat());
    let dir = tempfile::tempdir().unwrap();
    for k in 0..SIZE[2] {
        let mut set = slice(k);
        let fragments = PixelFragmentSequence::new_fragments(vec![encoded.clone()]);
        set.put(DataElement::new(tags::PIXEL_DATA, VR::OB, fragments));
        write_as(dir.path(), &k.to_string(), &set, uids::RLE_LOSSLESS);
    }
    let value = 2.0 * f32::from(4u16 * 256 + 7) - 1024.0;
    assert!(read_image(dir.path()).unwrap().value.data().iter().all(|v| *v == value));
    // Segments that are not there, begin beyond the end, or hold too little.
    let short = [&encoded[..64], &[0, 4, 0, 7]].concat();
    let one = [&[1u8, 0, 0, 0], &encoded[4..]].concat();
    let beyond = [&encoded[..4], &[200u8, 0, 0, 0], &encoded[8..]].concat();
    for damaged in [encoded[..3].to_vec(), encoded[..64].to_vec(), vec![255; 70], short, one, beyond] {
        let mut set = slice(2);
        set.put(DataElement::new(tags::PIXEL_DATA, VR::OB, PixelFragmentSequence::new_fragments(vec![damaged])));
        write_as(dir.path(), "2", &set, uids::RLE_LOSSLESS);
        let error = read_image(dir.path()).unwrap_err();
        assert!(error.exit_code() == 3 && error.to_string().contains("run lengths"), "{error}");
    }
}

#[test]
fn pixels_that_are_cut_off_or_coloured_are_refused() {
    let dir = series(|_, set| {
        set.put(DataElement::new(tags::PIXEL_DATA, VR::OW, PrimitiveValue::U16(vec![1u16; 7].into())));
    });
    let error = read_image(dir.path()).unwrap_err();
    assert!(error.exit_code() == 3 && error.to_string().contains("14 bytes are there"), "{error}");
    let dir = series(|_, set| {
        put(set, tags::PHOTOMETRIC_INTERPRETATION, VR::CS, "RGB");
        put_u16(set, tags::SAMPLES_PER_PIXEL, 3);
    });
    assert_eq!(read_image(dir.path()).unwrap_err().code(), "dicom-incomplete");
}
