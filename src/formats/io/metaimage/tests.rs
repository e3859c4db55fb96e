//! MetaIO's documentation tag by tag: each is honoured as ITK 5.4 reads it, or refused.

use crate::error::Error;
use crate::io::{Loaded, read_field, read_image};
use crate::volume::Volume;
use std::io::Write as _;

const GEOMETRY: &str = "TransformMatrix = 0 1 0 -1 0 0 0 0 1\nOffset = -10 -20 30\nElementSpacing = 2 2.5 3\n";

fn values() -> Vec<u8> {
    (0..24i16).flat_map(|v| (v - 5).to_le_bytes()).collect()
}

/// A file whose header has these lines besides those that it must have.
fn file(lines: &str, body: &[u8]) -> Vec<u8> {
    let head = format!(
        "ObjectType = Image\nNDims = 3\nDimSize = 4 3 2\n{lines}ElementType = MET_SHORT\nElementDataFile = LOCAL\n"
    );
    [head.as_bytes(), body].concat()
}

fn with<T>(bytes: &[u8], f: impl FnOnce(&std::path::Path) -> T) -> T {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.mha");
    std::fs::write(&path, bytes).unwrap();
    f(&path)
}

fn image(bytes: &[u8]) -> Result<Loaded<Volume<f32>>, Error> {
    with(bytes, |p| read_image(p))
}

/// Asserts that the values are -5 to 18 and gives the rest.
fn read(bytes: &[u8]) -> Loaded<Volume<f32>> {
    let read = image(bytes).unwrap_or_else(|e| panic!("{e}: {}", String::from_utf8_lossy(bytes)));
    assert_eq!(read.value.data(), (0..24u8).map(|v| f32::from(v) - 5.0).collect::<Vec<_>>());
    read
}

fn refused(bytes: &[u8], word: &str) {
    let Err(error) = image(bytes) else { panic!("not refused: {}", String::from_utf8_lossy(bytes)) };
    let text = error.to_string();
    assert!(matches!(error.exit_code(), 3 | 4) && text.contains(word) && text.contains("a.mha"), "{word}: {text}");
}

#[test]
fn names_of_the_geometry() {
    let plain = read(&file(GEOMETRY, &values()));
    let grid = plain.value.grid();
    assert_eq!((grid.spacing(), <[f64; 3]>::from(grid.origin())), ([2.0, 2.5, 3.0], [-10.0, -20.0, 30.0]));
    assert!((grid.direction()[(1, 0)] - 1.0).abs() < 1e-12 && plain.warnings.is_empty());
    for (from, to) in [
        ("Offset", "Position"),
        ("Offset", "Origin"),
        ("TransformMatrix", "Rotation"),
        ("TransformMatrix", "Orientation"),
        ("ElementSpacing", "ElementSize"),
    ] {
        let other = read(&file(&GEOMETRY.replace(from, to), &values()));
        assert!(other.value.grid().matches(grid, 1e-9), "{to}");
    }
    // The same thing twice must be the same.
    read(&file(&format!("{GEOMETRY}Position = -10 -20 30\n"), &values()));
    refused(&file(&format!("{GEOMETRY}Position = 0 0 0\n"), &values()), "Offset and Position");
    refused(&file(&format!("{GEOMETRY}Rotation = 1 0 0 0 1 0 0 0 1\n"), &values()), "TransformMatrix and Rotation");
    refused(&file(&format!("{GEOMETRY}ElementSpacing = 1 1 1\n"), &values()), "ElementSpacing twice");
    refused(&file("elementspacing = 2 2 2\n", &values()), "write ElementSpacing");
    refused(&file("ElementSpacing = -2 2 2\n", &values()), "positive");
    refused(&file("ElementSpacing = 2 2\n", &values()), "3 number(s)");
    // What a voxel covers is not how far it is to the next; nothing is turned about a centre.
    let wide = read(&file(&format!("{GEOMETRY}ElementSize = 2 2 1\nCenterOfRotation = 9 9 9\n"), &values()));
    assert!(wide.value.grid().matches(grid, 1e-9));
    assert_eq!(read(&file("", &values())).warnings[0].code, "no-spacing");
}

#[test]
fn anatomical_orientation_and_units() {
    let unit = "ElementSpacing = 1 1 1\n";
    for code in ["RAI", "LPS", "???"] {
        assert!(read(&file(&format!("{unit}AnatomicalOrientation = {code}\n"), &values())).warnings.is_empty());
    }
    refused(&file(&format!("{unit}AnatomicalOrientation = LPI\n"), &values()), "AnatomicalOrientation = LPI");
    let odd = read(&file(&format!("{GEOMETRY}AnatomicalOrientation = RAI\n"), &values()));
    assert_eq!(odd.warnings[0].code, "orientation-contradicts");
    // Its first axis runs to posterior, its second to right.
    assert!(read(&file(&format!("{GEOMETRY}AnatomicalOrientation = PRS\n"), &values())).warnings.is_empty());
    read(&file(&format!("{unit}DistanceUnits = mm\n"), &values()));
    for units in ["cm", "um"] {
        refused(&file(&format!("{unit}DistanceUnits = {units}\n"), &values()), units);
    }
}

#[test]
fn where_the_values_begin() {
    let pad = |body: &[u8]| [b"PAD!", body].concat();
    read(&file("HeaderSize = 0\n", &values()));
    read(&file("HeaderSize = -1\n", &pad(&values())));
    let head = file("HeaderSize = 200\n", &[]).len();
    read(&file("HeaderSize = 200\n", &[vec![b'x'; 200 - head], values()].concat()));
    refused(&file("HeaderSize = 4\n", &pad(&values())), "HeaderSize = 4");
    refused(&file("HeaderSize = 9999\n", &values()), "HeaderSize = 9999");
    refused(&file("HeaderSize = -2\n", &values()), "HeaderSize = -2");
    refused(&file("HeaderSizePerSlice = 2\n", &values()), "HeaderSizePerSlice");
    let elsewhere = |to: &str| String::from_utf8(file("", &[])).unwrap().replace("LOCAL", to);
    for (to, word) in [("a.raw", "another file, \"a.raw\""), ("LIST\na.raw", "LIST"), ("a%03d.raw 1 2 1", "series")] {
        refused(elsewhere(to).as_bytes(), word);
    }
    refused(elsewhere("a.raw").trim_end().as_bytes(), "(.mhd)");
    refused(&file("", &values()[..40]), "holds 40 bytes");
}

#[test]
fn compression_and_its_size() {
    let packed = {
        let mut out = flate2::write::ZlibEncoder::new(Vec::new(), flate2::Compression::fast());
        out.write_all(&values()).unwrap();
        out.finish().unwrap()
    };
    let lines = |size: usize| format!("CompressedData = True\nCompressedDataSize = {size}\n");
    read(&file("CompressedData = True\n", &packed));
    read(&file(&lines(0), &packed));
    read(&file(&lines(packed.len()), &[&packed[..], b"rest"].concat()));
    refused(&file(&lines(packed.len() + 1), &packed), "CompressedDataSize");
    refused(&file(&lines(packed.len() - 9), &packed), "cut off");
    refused(&file("CompressedData = True\nHeaderSize = -1\n", &packed), "HeaderSize");
    refused(&file("CompressedData = perhaps\n", &packed), "perhaps");
    // A header that promises little is all that is inflated.
    let mut bomb = flate2::write::ZlibEncoder::new(Vec::new(), flate2::Compression::fast());
    bomb.write_all(&values()).unwrap();
    (0..64).for_each(|_| bomb.write_all(&[0; 1 << 16]).unwrap());
    read(&file("CompressedData = True\n", &bomb.finish().unwrap()));
}

#[test]
fn types_and_byte_order() {
    let big: Vec<u8> = (0..24i16).flat_map(|v| (v - 5).to_be_bytes()).collect();
    for key in ["BinaryDataByteOrderMSB", "ElementByteOrderMSB"] {
        read(&file(&format!("{key} = True\n"), &big));
        read(&file(&format!("{key} = False\n"), &values()));
        refused(&file(&format!("{key} = middle\n"), &values()), "middle");
    }
    refused(
        &file("BinaryDataByteOrderMSB = True\nElementByteOrderMSB = False\n", &values()),
        "and ElementByteOrderMSB",
    );
    refused(&file("BinaryData = False\n", &values()), "text");
    read(&file("ElementNBits = 16\n", &values()));
    refused(&file("ElementNBits = 12\n", &values()), "ElementNBits");
    refused(&file("ElementNumberOfChannels = 0\n", &values()), "ElementNumberOfChannels");
    refused(&file("ElementNumberOfChannels = two\n", &values()), "two");
    refused(&file("ElementToIntensityFunctionSlope = 2\n", &values()), "Slope = 2");
    refused(&file("ElementToIntensityFunctionOffset = -1000\n", &values()), "Offset = -1000");
    read(&file("ElementToIntensityFunctionSlope = 1\nElementToIntensityFunctionOffset = 0\n", &values()));
}

#[test]
fn tags_without_effect_and_other_starts() {
    read(&file(
        "Comment = a\nID = 1\nParentID = -1\nName = n\nColor = 1 0 0 1\nModality = MET_MOD_CT\nElementMin = 0\nElementMax = 9\n0008|0008 = ORIGINAL\n",
        &values(),
    ));
    let scene = String::from_utf8(file("", &[])).unwrap().replace("= Image", "= Scene");
    refused(scene.as_bytes(), "type Scene");
    let moved = String::from_utf8(file("", &[])).unwrap().replace("ObjectType = Image\n", "");
    read(&[b"\xef\xbb\xbfBinaryData = True\r\n", moved.replace('\n', "\r\n").as_bytes(), &values()[..]].concat());
    let vectors = String::from_utf8(file("ElementNumberOfChannels = 3\n", &[])).unwrap().replace("4 3 2", "1 1 1");
    let body: Vec<u8> = [1i16, 2, 3].iter().flat_map(|v| v.to_le_bytes()).collect();
    let field = with(&[vectors.as_bytes(), &body].concat(), |p| read_field(p)).unwrap();
    assert_eq!(field.value.data(), [[1.0, 2.0, 3.0]]);
}
