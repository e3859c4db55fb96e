//! The format's definition line by line: each field is honoured as Teem and ITK 5.4 read it, or refused.

#![expect(clippy::float_cmp, reason = "values that are exact by construction")]

use crate::error::Error;
use crate::io::{Loaded, read_field, read_image, read_labels};
use crate::volume::Volume;
use std::io::Write as _;

const HEAD: &str = "type: short\ndimension: 3\nsizes: 4 3 2\nendian: little\nencoding: raw\n";
const PLACED: &str = "space: LPS\nspace directions: (2,0,0) (0,3,0) (0,0,4)\nspace origin: (1,2,3)\n";

fn values() -> Vec<u8> {
    (0..24i16).flat_map(i16::to_le_bytes).collect()
}

fn file(head: &str, body: &[u8]) -> Vec<u8> {
    [b"NRRD0004\n", head.as_bytes(), b"\n", body].concat()
}

fn with<T>(bytes: &[u8], f: impl FnOnce(&std::path::Path) -> T) -> T {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.nrrd");
    std::fs::write(&path, bytes).unwrap();
    f(&path)
}

fn image(bytes: &[u8]) -> Result<Loaded<Volume<f32>>, Error> {
    with(bytes, |p| read_image(p))
}

/// Asserts that the values are 0 to 23, and gives spacing and origin.
fn read(bytes: &[u8]) -> ([f64; 3], [f64; 3]) {
    let read = image(bytes).unwrap_or_else(|e| panic!("{e}: {}", String::from_utf8_lossy(bytes)));
    assert_eq!(read.value.data(), (0..24u8).map(f32::from).collect::<Vec<_>>());
    (read.value.grid().spacing(), read.value.grid().origin().into())
}

fn refused(bytes: &[u8], word: &str) {
    let Err(error) = image(bytes) else { panic!("not refused: {}", String::from_utf8_lossy(bytes)) };
    let text = error.to_string();
    assert!(matches!(error.exit_code(), 3 | 4) && text.contains(word) && text.contains("a.nrrd"), "{word}: {text}");
}

fn with_line(line: &str) -> Vec<u8> {
    file(&format!("{HEAD}{PLACED}{line}\n"), &values())
}

#[test]
fn magic_comments_line_ends_case_and_order() {
    let plain = file(&format!("{HEAD}{PLACED}"), &values());
    assert_eq!(read(&plain), ([2.0, 3.0, 4.0], [1.0, 2.0, 3.0]));
    for version in 1..=5 {
        read(&[format!("NRRD000{version}\n").as_bytes(), &plain[9..]].concat());
    }
    for first in ["NRRD0006", "NRRD00.01", "NRRD0004 x"] {
        refused(&[first.as_bytes(), &plain[8..]].concat(), "version");
    }
    read(&[b"\xef\xbb\xbf", &plain[..]].concat());
    let crlf = format!("NRRD0004\r\n{}\r\n", format!("{HEAD}{PLACED}").replace('\n', "\r\n"));
    read(&[crlf.as_bytes(), &values()[..]].concat());
    let capitals = format!("{PLACED}{HEAD}").replace("type: short", "TYPE: Short").replace("raw", "RAW");
    read(&file(&format!("# made by hand: yes\n{capitals}note:=byte skip: 9\n"), &values()));
    read(&file(&format!("{HEAD}{PLACED}").replace("space ", "space"), &values()));
    refused(format!("NRRD0004\n{HEAD}").as_bytes(), "does not end");
    refused(&with_line("no field"), "neither field nor note");
    refused(&with_line("colour: red"), "\"colour\"");
    refused(&with_line("sizes: 4 3 2"), "twice");
    refused(&with_line("Space Origin: (0,0,0)"), "twice");
}

#[test]
fn dimension_sizes_and_number() {
    let plain = format!("{HEAD}{PLACED}");
    refused(&file(&plain.replace("dimension: 3\n", ""), &values()), "dimension");
    refused(&file(&plain.replace("dimension: 3", "dimension: 4"), &values()), "dimension 4");
    refused(&file(&plain.replace("sizes: 4 3 2\n", ""), &values()), "sizes");
    refused(&file(&plain.replace("sizes: 4 3 2", "sizes: 4 -3 2"), &values()), "sizes");
    read(&with_line("number: 24"));
    refused(&with_line("number: 7"), "number 7");
    refused(&file(&plain, &values()[..40]), "holds 40 bytes");
}

#[test]
fn types_block_size_and_byte_order() {
    let plain = format!("{HEAD}{PLACED}");
    for other in ["block", "complex", ""] {
        refused(&file(&plain.replace("type: short", &format!("type: {other}")), &values()), "type");
    }
    refused(&with_line("block size: 4"), "block size");
    refused(&with_line("blocksize: 4"), "block size");
    refused(&file(&plain.replace("endian: little\n", ""), &values()), "byte order");
    refused(&file(&plain.replace("little", "middle"), &values()), "endian");
    let bytes: Vec<u8> = (0..24).collect();
    read(&file(&plain.replace("endian: little\n", "").replace("short", "uchar"), &bytes));
    let big: Vec<u8> = (0..24i16).flat_map(i16::to_be_bytes).collect();
    read(&file(&plain.replace("little", "big"), &big));
}

#[test]
fn encodings_and_skips() {
    let gzip = |bytes: &[u8]| {
        let mut out = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
        out.write_all(bytes).unwrap();
        out.finish().unwrap()
    };
    let plain = format!("{HEAD}{PLACED}");
    let zipped = plain.replace("raw", "gzip");
    let before =
        |head: &str, line: &str, pad: &[u8], body: &[u8]| file(&format!("{head}{line}\n"), &[pad, body].concat());
    read(&file(&zipped, &gzip(&values())));
    for key in ["byteskip", "byte skip", "Byte Skip"] {
        read(&before(&plain, &format!("{key}: 6"), b"sixpad", &values()));
    }
    read(&before(&plain, "byte skip: -1", b"any number", &values()));
    for key in ["lineskip", "line skip"] {
        read(&before(&plain, &format!("{key}: 2"), b"one\ntwo two\n", &values()));
    }
    read(&before(&plain, "line skip: 1\nbyte skip: 3", b"one\nabc", &values()));
    // Lines are skipped in the file, bytes in what was compressed.
    read(&before(&zipped, "line skip: 1", b"one\n", &gzip(&values())));
    read(&before(&zipped, "byte skip: 6", b"", &gzip(&[b"sixpad", &values()[..]].concat())));
    refused(&before(&zipped, "byte skip: -1", b"", &gzip(&values())), "byte skip -1");
    refused(&before(&plain, "byte skip: -2", b"", &values()), "byte skip -2");
    refused(&before(&plain, "byte skip: 9999", b"", &values()), "byte skip");
    refused(&before(&plain, "byte skip: six", b"", &values()), "six");
    refused(&before(&plain, "line skip: 9999", b"", &values()), "line skip");
    refused(&before(&plain, "line skip: -1", b"", &values()), "line skip");
    for other in ["txt", "hex", "bzip2"] {
        refused(&file(&plain.replace("raw", other), &values()), other);
    }
    for key in ["data file", "datafile"] {
        let detached = format!("NRRD0004\n{plain}{key}: a.raw\n");
        refused(detached.as_bytes(), "detached header (.nhdr): its values are in \"a.raw\"");
        refused(&[detached.as_bytes(), b"\n"].concat(), "unu save");
    }
}

#[test]
fn space_and_its_directions() {
    let plain = format!("{HEAD}{PLACED}");
    let lines = |lines: &str| file(&format!("{HEAD}{lines}\n"), &values());
    let dirs = "space directions: (2,0,0) ( 0, 3, 0 ) (0,0,4)";
    let ras = image(&file(&plain.replace("LPS", "right-anterior-superior"), &values())).unwrap();
    assert_eq!(<[f64; 3]>::from(ras.value.grid().origin()), [-1.0, -2.0, 3.0]);
    assert_eq!(ras.value.grid().direction()[(0, 0)].to_bits(), (-1.0f64).to_bits());
    let unknown = image(&lines(&format!("space dimension: 3\n{dirs}\nspace origin: (1,2,3)"))).unwrap();
    assert_eq!(unknown.warnings[0].code, "no-orientation");
    let nowhere = image(&lines(&format!("space: LPS\n{dirs}"))).unwrap();
    assert_eq!(nowhere.warnings[0].code, "no-orientation");
    refused(&lines(&format!("space dimension: 2\n{dirs}")), "space dimension");
    refused(&file(&plain.replace("LPS", "scanner-xyz"), &values()), "scanner-xyz");
    refused(&file(&plain.replace("(0,3,0)", "(0,three,0)"), &values()), "three");
    refused(&file(&plain.replace("(0,3,0)", "none"), &values()), "2 of its axes");
    refused(&file(&plain.replace("(0,3,0) ", ""), &values()), "2 space directions for 3");
    refused(&file(&plain.replace("(1,2,3)", "(1,2)"), &values()), "space origin");
    // Where directions are, plain spacings and borders contradict them.
    for line in ["spacings: 2 3 4", "axis mins: 0 0 0", "axismaxs: 8 9 8"] {
        refused(&with_line(line), "beside space directions");
    }
    read(&with_line("spacings: nan nan nan"));
}

#[test]
fn spacings_mins_maxs_and_centers() {
    let lines = |lines: &str| file(&format!("{HEAD}{lines}\n"), &values());
    let spacing = [2.0, 3.0, 4.0];
    assert_eq!(read(&lines("spacings: 2 3 4")), (spacing, [0.0; 3]));
    // Positions as ITK gives them: borders of cells, unless centers are at nodes.
    for (more, origin) in [
        ("axis mins: 10 20 30", [11.0, 21.5, 32.0]),
        ("axismins: 10 20 30\naxismaxs: 18 29 38\ncenters: cell cell cell", [11.0, 21.5, 32.0]),
        ("axis mins: 10 20 30\ncenterings: node node node", [10.0, 20.0, 30.0]),
        ("axis mins: nan nan nan", [0.0; 3]),
    ] {
        assert_eq!(read(&lines(&format!("spacings: 2 3 4\n{more}"))), (spacing, origin), "{more}");
    }
    for (more, word) in [
        ("spacings: 2 3 4\naxis mins: 10 20 30\naxis maxs: 17 29 38", "axis maxs 17"),
        ("spacings: 2 3 4\naxis maxs: 18 29 38", "axis maxs"),
        ("spacings: 2 3 4\naxis mins: 10 20", "axismins"),
        ("spacings: 2 3 4\ncenters: cell edge cell", "edge"),
        ("spacings: 2 3 4\nspace: LPS", "space directions"),
        ("spacings: 2 3 4\nspace dimension: 3\nspace origin: (1,2,3)", "space origin"),
        ("spacings: -2 3 4", "positive"),
        ("spacings: 0 3 4", "positive"),
        ("spacings: nan 3 4", "positive"),
        ("axis mins: 10 20 30\naxis maxs: 18 29 38", "spacings"),
        ("space: LPS", "spacings"),
    ] {
        refused(&lines(more), word);
    }
}

#[test]
fn units_kinds_and_values_that_are_not_as_stored() {
    for line in [
        "space units: \"mm\" \"mm\" \"mm\"",
        "units: \"mm\" \"\" \"\"",
        "thicknesses: nan nan 3",
        "labels: \"x\" \"y\" \"z\"",
        "kinds: domain space ???",
        "content: a CT",
        "min: 0",
        "max: 23",
        "old min: nan",
        "sample units: \"HU\"",
        "measurement frame: (0,1,0) (1,0,0) (0,0,1)",
    ] {
        read(&with_line(line));
    }
    for (line, word) in [
        ("space units: \"cm\" \"cm\" \"cm\"", "\"cm\""),
        ("units: um um um", "\"um\""),
        ("kinds: domain domain time", "time"),
        ("kinds: domain domain", "2 kinds"),
        ("old min: -1000", "quantised"),
        ("oldmax: 3000", "quantised"),
        ("sample units: \"cGy\"", "cGy"),
    ] {
        refused(&with_line(line), word);
    }
}

#[test]
fn vectors_and_their_frame() {
    let head = "type: float\ndimension: 4\nsizes: 3 2 1 1\nendian: little\nencoding: raw\nspace: LPS\nkinds: vector domain domain domain\n\
        space directions: none (2,0,0) (0,2,0) (0,0,2)\nspace origin: (0,0,0)\n";
    let body: Vec<u8> = (0..6u8).flat_map(|v| f32::from(v).to_le_bytes()).collect();
    let field = |head: &str| with(&file(head, &body), |p| read_field(p));
    assert_eq!(field(head).unwrap().value.data(), [[0.0, 1.0, 2.0], [3.0, 4.0, 5.0]]);
    assert!(field(&format!("{head}measurement frame: (1,0,0) (0,1,0) (0,0,1)\n")).is_ok());
    assert!(field(&format!("{head}displacement field type:=resampling\n")).is_ok());
    for (head, word) in [
        (format!("{head}measurement frame: (0,1,0) (1,0,0) (0,0,1)\n"), "measurement frame"),
        (format!("{head}displacement field type:=modeling\n"), "modeling"),
        (head.replace("kinds: vector", "kinds: RGB-color"), "rgb-color"),
        (head.replace("kinds: vector", "kinds: point"), "point"),
        (head.replace("space: LPS", "space: RAS"), "RAS"),
    ] {
        let error = field(&head).unwrap_err().to_string();
        assert!(error.contains(word), "{word}: {error}");
    }
}

#[test]
fn names_of_slicers_segments() {
    let head = format!("{HEAD}{PLACED}").replace("short", "uchar");
    let body: Vec<u8> = (0..24).map(|v| v % 3).collect();
    let notes = "Segment0_Name:=skull\nSegment0_LabelValue:=1\nSegment0_Layer:=0\nSegment1_LabelValue:=2\nSegment1_Name:=left \\\\ hip\n";
    let labels = |notes: &str| with(&file(&format!("{head}{notes}"), &body), |p| read_labels(p, None));
    let read = labels(notes).unwrap();
    assert_eq!(read.value.names, [(1, "skull".to_owned()), (2, "left \\ hip".to_owned())].into());
    for (notes, word) in [
        (notes.replace("LabelValue:=2", "LabelValue:=1"), "two segments"),
        (notes.replace("LabelValue:=2", "LabelValue:=two"), "two"),
    ] {
        assert!(labels(&notes).unwrap_err().to_string().contains(word));
    }
    let layers = "type: uchar\ndimension: 4\nsizes: 2 4 3 1\nencoding: raw\nspace: LPS\nspace origin: (0,0,0)\n\
        space directions: none (2,0,0) (0,2,0) (0,0,2)\nSegment0_Name:=skull\nSegment0_LabelValue:=1\n";
    let error = with(&file(layers, &body), |p| read_labels(p, None)).unwrap_err().to_string();
    assert!(error.contains("segments overlap"), "{error}");
}
