//! Fields of NIfTI headers as nifti1.h describes them, files of other kinds, and files longer than their headers say.

use super::{Crafted, gzip, image_of, refused, with_file};
use crate::io::points::read_points;
use crate::io::*;

#[test]
fn pixdim_against_sform() {
    let c = Crafted::default();
    let with = |n: usize, value: f32| {
        let mut c = c.clone();
        c.pixdim[n] = value;
        c
    };
    for (n, value) in [(1, 1.6), (2, 1.0), (3, 3.3), (3, 0.0), (1, f32::NAN)] {
        let error = image_of(&with(n, value)).unwrap_err();
        assert_eq!(error.code(), "pixdim-sform-disagree", "{error}");
    }
    // The rounding of a header is no contradiction.
    assert!(image_of(&with(2, 2.000_001)).unwrap().warnings.is_empty());
    let long = Crafted { dim: [3, 4, 3, 200, 1, 1, 1, 1], voxels: vec![0; 4800], ..with(3, 2.99) };
    assert_eq!(image_of(&long).unwrap().warnings[0].code, "pixdim-sform-disagree");
    // Spacings are positive whatever the geometry comes from.
    for codes in [[0, 1], [1, 0], [0, 0]] {
        for n in 1..4 {
            let error = image_of(&Crafted { codes, ..with(n, -1.5) }).unwrap_err();
            assert!(error.code() == "header-field" && error.to_string().contains(&format!("pixdim[{n}]")), "{error}");
        }
    }
    refused(&Crafted { codes: [1, 0], ..with(2, 0.0) }, "qform");
    refused(&Crafted { codes: [0, 0], ..with(2, 0.0) }, "pixdim");
    // Axes that are not there need no spacing, and pixdim[0] is a sign, whatever its size.
    let flat = Crafted { dim: [2, 4, 3, 1, 1, 1, 1, 1], codes: [0, 0], ..with(3, 0.0) };
    assert_eq!(image_of(&flat).unwrap().value.grid().spacing(), [1.5, 2.0, 1.0]);
    assert!(image_of(&with(0, 0.0)).is_ok());
}

#[test]
fn units_offsets_and_what_has_no_effect() {
    let c = Crafted::default();
    for units in [0, 2, 2 | 8, 2 | 64] {
        assert!(image_of(&Crafted { units, ..c.clone() }).is_ok(), "{units}");
    }
    for (units, word) in [(1, "metres"), (3, "micrometres"), (3 | 8, "micrometres"), (5, "none of NIfTI's")] {
        refused(&Crafted { units, ..c.clone() }, word);
    }
    // The type tells the size; no reader looks at bitpix.
    assert!(image_of(&Crafted { bitpix: 32, ..c.clone() }).is_ok());
    // Zero cannot be meant in a single file; far behind the header lies no value.
    assert_eq!(image_of(&Crafted { offset: 0.0, ..c.clone() }).unwrap().value.data()[0].to_bits(), (-7f32).to_bits());
    refused(&Crafted { offset: 1e8, ..c.clone() }, "vox_offset");
    // dim_info, cal_max, slice codes, toffset, text.
    let mut bytes = c.bytes();
    bytes[39] = 57;
    for at in [124, 128, 132, 136] {
        bytes[at..at + 4].copy_from_slice(&9f32.to_le_bytes());
    }
    bytes[148..152].copy_from_slice(b"a\x1b[2");
    bytes[228..232].copy_from_slice(b"aux.");
    let read = with_file("a.nii", &bytes, |p| read_image(p)).unwrap();
    assert_eq!(read.value.data(), image_of(&c).unwrap().value.data());
    assert_eq!(read.header.description, "a [2");
}

#[test]
fn files_of_other_kinds_are_named() {
    let mut analyze = Crafted::default().bytes();
    analyze[344..348].fill(0);
    let mut dicom = vec![0; 128];
    dicom.extend(b"DICM");
    let cases: [(&[u8], &str); 8] = [
        (&analyze, "ANALYZE 7.5"),
        (&dicom, "damaged, or no DICOM"),
        (b"\x89HDF\r\n\x1a\nrest", "composite transforms"),
        (b"PK\x03\x04", "zip"),
        (b"\x93NUMPY\x01", "NumPy"),
        (b"<VTKFile type=\"ImageData\">", "VTK"),
        (b"BZh9", "bzip2"),
        (b"II*\0", "TIFF"),
    ];
    for (bytes, word) in cases {
        let error = with_file("a.h5", bytes, |p| read_image(p).map(|_| ())).unwrap_err();
        assert!(error.exit_code() == 3 && error.to_string().contains(word), "{word}: {error}");
    }
    let points = |name: &str, bytes: &[u8]| with_file(name, bytes, |p| read_points(p, "planning", None).map(|_| ()));
    assert!(points("a.csv", b"PK\x03\x04 sheet").unwrap_err().to_string().contains("zip"));
    assert!(points("a.csv", b"\xff\xfex\0,\0").unwrap_err().to_string().contains("UTF"));
    let marks = |bytes: &[u8]| with_file("a.csv", bytes, |p| read_landmarks(p).map(|_| ()));
    assert!(marks(b"\xff\xfen\0").unwrap_err().to_string().contains("UTF-16"));
}

#[test]
fn byte_order_marks_before_any_text() {
    let mark = |text: &str| [b"\xef\xbb\xbf", text.as_bytes()].concat();
    let points = |name: &str, text: &str| {
        with_file(name, &mark(text), |p| read_points(p, "planning", Some(points::Space::Lps)).map(|f| f.points.len()))
    };
    for (name, text) in [
        ("a.csv", "x,y,z\n1,2,3\n"),
        ("a.mrk.json", r#"{"markups": [{"controlPoints": [{"position": [1, 2, 3]}]}]}"#),
        ("a.fcsv", "# CoordinateSystem = LPS\nn,1,2,3\n"),
        ("a.txt", "point\n1\n1 2 3\n"),
        ("a.obj", "v 1 2 3\n"),
    ] {
        assert_eq!(points(name, text).unwrap_or_else(|e| panic!("{name}: {e}")), 1, "{name}");
    }
    let head = "name,planning_x,planning_y,planning_z,fraction_x,fraction_y,fraction_z\n";
    let read = with_file("m.csv", &mark(&format!("{head}a,1,2,3,4,5,6\n")), |p| read_landmarks(p)).unwrap();
    assert_eq!(read[0].name, "a");
    let contours =
        r#"{"aventail_contours": 1, "structures": [{"name": "a", "contours": [[[0,0,0],[1,0,0],[1,1,0]]]}]}"#;
    assert!(with_file("c.json", &mark(contours), |p| read_contours(p)).is_ok());
}

#[test]
fn what_follows_the_promised_values_is_not_kept() {
    let c = Crafted::default();
    let padded = [c.bytes(), vec![0; 1000]].concat();
    assert!(with_file("a.nii.gz", &gzip(&padded), |p| read_image(p)).is_ok());
    let bomb = gzip(&[c.bytes(), vec![0; 3 << 20]].concat());
    let error = with_file("a.nii.gz", &bomb, |p| read_image(p)).unwrap_err().to_string();
    assert!(error.contains("go on behind"), "{error}");

    // A file of 100 MB without a byte on the disk, whose header promises 48 bytes.
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("long.nii");
    std::fs::write(&path, c.bytes()).unwrap();
    std::fs::OpenOptions::new().write(true).open(&path).unwrap().set_len(100 << 20).unwrap();
    let error = read_image(&path).unwrap_err().to_string();
    assert!(error.contains("far longer than its header promises"), "{error}");
}
