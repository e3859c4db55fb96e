//! Whole files, written and read back, and files crafted byte by byte.

#![expect(clippy::float_cmp, reason = "values that are stored exactly must come back exactly")]

mod headers;
mod labels;
mod real;

use super::*;
use crate::error::Error;
use crate::field::FieldFormat;
use crate::geometry::Grid;
use crate::volume::Volume;
use nalgebra::{Matrix3, Point3, Rotation3, Unit, Vector3};
use proptest::prelude::*;
use std::io::Write as _;
use std::path::Path;

/// A NIfTI file put together without the code under test.
#[derive(Clone)]
struct Crafted {
    big: bool,
    dim: [i16; 8],
    datatype: i16,
    bitpix: i16,
    pixdim: [f32; 8],
    offset: f32,
    scaling: [f32; 2],
    units: u8,
    codes: [i16; 2],
    quaternion: [f32; 6],
    rows: [[f32; 4]; 3],
    intent: (i16, f32, &'static str),
    extensions: Vec<u8>,
    voxels: Vec<u8>,
}

impl Default for Crafted {
    fn default() -> Self {
        Self {
            big: false,
            dim: [3, 4, 3, 2, 1, 1, 1, 1],
            datatype: 4,
            bitpix: 16,
            pixdim: [1.0, 1.5, 2.0, 3.0, 1.0, 1.0, 1.0, 1.0],
            offset: 352.0,
            scaling: [0.0, 0.0],
            units: 2,
            codes: [0, 1],
            quaternion: [0.0; 6],
            rows: [[1.5, 0.0, 0.0, 10.0], [0.0, 2.0, 0.0, 20.0], [0.0, 0.0, 3.0, 30.0]],
            intent: (0, 0.0, ""),
            extensions: Vec::new(),
            voxels: (0..24i16).flat_map(|v| (v - 7).to_le_bytes()).collect(),
        }
    }
}

impl Crafted {
    fn bytes(&self) -> Vec<u8> {
        let mut h = vec![0u8; 348];
        let mut put = |at: usize, le: &[u8]| {
            let mut le = le.to_vec();
            if self.big {
                le.reverse();
            }
            h[at..at + le.len()].copy_from_slice(&le);
        };
        put(0, &348i32.to_le_bytes());
        (0..8).for_each(|n| put(40 + 2 * n, &self.dim[n].to_le_bytes()));
        put(56, &self.intent.1.to_le_bytes());
        put(68, &self.intent.0.to_le_bytes());
        put(70, &self.datatype.to_le_bytes());
        put(72, &self.bitpix.to_le_bytes());
        (0..8).for_each(|n| put(76 + 4 * n, &self.pixdim[n].to_le_bytes()));
        put(108, &self.offset.to_le_bytes());
        put(112, &self.scaling[0].to_le_bytes());
        put(116, &self.scaling[1].to_le_bytes());
        put(123, &[self.units]);
        put(252, &self.codes[0].to_le_bytes());
        put(254, &self.codes[1].to_le_bytes());
        (0..6).for_each(|n| put(256 + 4 * n, &self.quaternion[n].to_le_bytes()));
        (0..12).for_each(|n| put(280 + 4 * n, &self.rows[n / 4][n % 4].to_le_bytes()));
        h[328..328 + self.intent.2.len()].copy_from_slice(self.intent.2.as_bytes());
        h[344..348].copy_from_slice(b"n+1\0");
        h.extend([u8::from(!self.extensions.is_empty()), 0, 0, 0]);
        h.extend(&self.extensions);
        h.extend(&self.voxels);
        h
    }
}

/// Puts bytes into a file and hands its path on.
fn with_file<T>(name: &str, bytes: &[u8], f: impl FnOnce(&Path) -> T) -> T {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join(name);
    std::fs::write(&path, bytes).unwrap();
    f(&path)
}

fn image_of(crafted: &Crafted) -> Result<Loaded<Volume<f32>>, Error> {
    with_file("a.nii", &crafted.bytes(), |p| read_image(p))
}

fn gzip(bytes: &[u8]) -> Vec<u8> {
    let mut out = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
    out.write_all(bytes).unwrap();
    out.finish().unwrap()
}

/// A grid of any orientation, either handedness.
fn any_grid() -> impl Strategy<Value = Grid> {
    let axis = prop::array::uniform3(-1.0f64..1.0);
    let flips = (any::<bool>(), prop::sample::select(vec![[0usize, 1, 2], [1, 0, 2], [2, 1, 0], [1, 2, 0]]));
    (axis, 0.0f64..3.1, flips, prop::array::uniform3(0.4f64..5.0), prop::array::uniform3(-600.0f64..600.0)).prop_map(
        |(axis, angle, (flip, order), spacing, origin)| {
            let axis = Unit::new_normalize(Vector3::from(axis) + Vector3::new(0.0, 0.0, 1e-9));
            let turned = Rotation3::from_axis_angle(&axis, angle).into_inner();
            let mut d = Matrix3::from_columns(&order.map(|c| turned.column(c).into_owned()));
            if flip {
                d.column_mut(1).neg_mut();
            }
            Grid::new([5, 4, 3], spacing, origin.into(), d).unwrap()
        },
    )
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(40))]

    #[test]
    fn images_and_fields_round_trip(grid in any_grid(), ext in prop::sample::select(vec!["nii", "nii.gz", "mha", "nrrd"]), level in 0u32..3) {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join(format!("case.01.{ext}"));
        // Float32 headers hold about 1e-7 of 600 mm.
        let tolerance = if ext.starts_with("nii") { 3e-4 } else { 1e-9 };
        let image = Volume::from_fn(grid.clone(), |l| l as f32 * 1.37 - 20.0);
        let options = WriteOptions { gzip_level: level, description: "test\nimage".into() };
        write_image(&path, &image, Stored::Float32, &options).unwrap();
        let back = read_image(&path).unwrap();
        prop_assert_eq!(back.value.data(), image.data());
        prop_assert!(back.value.grid().matches(&grid, tolerance));
        prop_assert!(back.warnings.is_empty(), "{:?}", back.warnings);
        prop_assert_eq!(&back.sha256, &checksum::sha256_file(&path).unwrap());

        write_image(&path, &image, Stored::Int16, &options).unwrap();
        let back = read_image(&path).unwrap();
        prop_assert!(back.value.data().iter().zip(image.data()).all(|(a, b)| (a - b).abs() <= 0.5 && a.fract() == 0.0));

        let field = Volume::from_fn(grid.clone(), |l| [l as f32, -0.5 * l as f32, 1e-3 * l as f32]);
        write_field(&path, &field, FieldFormat::of(&path).unwrap(), &options).unwrap();
        let back = read_field(&path).unwrap();
        prop_assert_eq!(back.value.data(), field.data());
        prop_assert!(back.value.grid().matches(&grid, tolerance));
        prop_assert!(read_image(&path).is_err());
    }

    /// sform and qform must say the same, since tools differ in which they use.
    #[test]
    fn qform_alone_gives_the_same_grid(grid in any_grid()) {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.nii");
        write_image(&path, &Volume::filled(grid.clone(), 1.0f32), Stored::Float32, &WriteOptions::default()).unwrap();
        let header = read_image(&path).unwrap().header;
        prop_assert_eq!((header.sform_code, header.qform_code), (Some(1), Some(1)));
        prop_assert!(header.disagreement_mm.unwrap() < 0.02);
        let mut bytes = std::fs::read(&path).unwrap();
        bytes[254..256].fill(0);
        std::fs::write(&path, &bytes).unwrap();
        let back = read_image(&path).unwrap();
        prop_assert_eq!(back.header.geometry, GeometrySource::Qform);
        prop_assert!(back.value.grid().matches(&grid, 0.02));
    }

}

proptest! {
    /// No bytes may panic or ask for memory that the file does not hold.
    #[test]
    fn damaged_files_give_errors(
        edits in prop::collection::vec((0usize..420, prop_oneof![any::<u8>(), Just(0), Just(255), 48u8..58]), 1..12),
        cut in 0usize..800, zipped in any::<bool>(), kind in 0usize..5,
    ) {
        let mut bytes = whole_file(kind);
        for (at, value) in edits {
            let n = bytes.len();
            bytes[at % n] = value;
        }
        if cut < 400 {
            bytes.truncate(cut);
        }
        if zipped {
            bytes = gzip(&bytes);
        }
        with_file("x", &bytes, |p| {
            // Any outcome but a panic.
            let _ = (read_image(p), read_labels(p, None), read_field(p), inspect::inspect(p));
        });
    }
}

/// A valid file of each kind.
fn whole_file(kind: usize) -> Vec<u8> {
    if kind == 0 {
        let mut extensions = [32i32.to_le_bytes(), 0i32.to_le_bytes()].concat();
        extensions.extend(b"<LabelTable> <a> </a>   ");
        return Crafted { offset: 384.0, extensions, ..Crafted::default() }.bytes();
    }
    if kind == 4 {
        return Crafted { codes: [1, 1], datatype: 2, big: true, voxels: vec![1; 24], ..Crafted::default() }.bytes();
    }
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join(["", "a.nii", "a.mha", "a.nrrd"][kind]);
    let field = Volume::filled(Grid::axis_aligned([3, 2, 2], [1.0; 3], [0.0; 3]).unwrap(), [1.0f32; 3]);
    write_field(&path, &field, FieldFormat::of(&path).unwrap(), &WriteOptions::default()).unwrap();
    std::fs::read(path).unwrap()
}

#[test]
fn every_type_scaling_and_byte_order() {
    type Encode = fn(f64) -> Vec<u8>;
    let cases: [(i16, i16, Encode); 10] = [
        (2, 8, |v| vec![v as u8]),
        (256, 8, |v| (v as i8).to_le_bytes().into()),
        (512, 16, |v| (v as u16).to_le_bytes().into()),
        (4, 16, |v| (v as i16).to_le_bytes().into()),
        (768, 32, |v| (v as u32).to_le_bytes().into()),
        (8, 32, |v| (v as i32).to_le_bytes().into()),
        (1280, 64, |v| (v as u64).to_le_bytes().into()),
        (1024, 64, |v| (v as i64).to_le_bytes().into()),
        (16, 32, |v| (v as f32).to_le_bytes().into()),
        (64, 64, |v| v.to_le_bytes().into()),
    ];
    for (datatype, bitpix, encode) in cases {
        for big in [false, true] {
            let voxels = (0..24).flat_map(|v| {
                let mut one = encode(f64::from(v));
                if big {
                    one.reverse();
                }
                one
            });
            let mut c = Crafted { big, datatype, bitpix, voxels: voxels.collect(), ..Crafted::default() };
            for (scaling, slope, inter) in [
                ([0.0, 5.0], 1.0, 0.0),
                ([f32::NAN, 0.0], 1.0, 0.0),
                ([2.0, -10.0], 2.0, -10.0),
                ([-1.0, 0.0], -1.0, 0.0),
            ] {
                c.scaling = scaling;
                let read = image_of(&c).unwrap();
                let expected: Vec<f32> = (0..24).map(|v| v as f32 * slope + inter).collect();
                assert_eq!(read.value.data(), expected, "type {datatype}, big {big}");
                assert_eq!(read.header.big_endian, big);
                // RAS in the file, LPS inside.
                assert_eq!(read.value.grid().origin(), Point3::new(-10.0, -20.0, 30.0));
                assert_eq!(read.value.grid().direction()[(0, 0)], -1.0);
                assert_eq!(read.value.grid().direction()[(2, 2)], 1.0);
            }
        }
    }
}

#[test]
fn sform_is_preferred_and_qform_checked() {
    let both = Crafted { codes: [1, 1], quaternion: [0.0, 0.0, 0.0, 10.0, 20.0, 30.0], ..Crafted::default() };
    let read = image_of(&both).unwrap();
    assert_eq!((read.header.geometry, read.header.disagreement_mm), (GeometrySource::Sform, Some(0.0)));
    assert!(read.warnings.is_empty());

    // The qform turns 90 degrees about z and is shifted: the file's truth is the sform.
    let half = 0.5f32.sqrt();
    let apart = Crafted { codes: [2, 1], quaternion: [0.0, 0.0, half, 10.0, 20.0, 30.5], ..both.clone() };
    let read = image_of(&apart).unwrap();
    assert_eq!(read.value.grid().origin(), Point3::new(-10.0, -20.0, 30.0));
    assert_eq!(read.warnings[0].code, "sform-qform-disagree");

    // Without the sform the qform counts: i runs to anterior (RAS y), which is minus y in LPS.
    let read = image_of(&Crafted { codes: [2, 0], ..apart.clone() }).unwrap();
    assert_eq!(read.header.geometry, GeometrySource::Qform);
    let one = read.value.grid().centre([1, 0, 0]) - read.value.grid().origin();
    assert!((one - Vector3::new(0.0, -1.5, 0.0)).norm() < 1e-6, "{one}");
    // pixdim[0] = -1 turns the third axis.
    let mut left = apart;
    left.codes = [2, 0];
    left.pixdim[0] = -1.0;
    let grid = image_of(&left).unwrap().value.grid().clone();
    assert!((grid.centre([0, 0, 1]) - grid.origin() - Vector3::new(0.0, 0.0, -3.0)).norm() < 1e-6);

    let none = image_of(&Crafted { codes: [0, 0], ..both }).unwrap();
    assert_eq!(none.warnings[0].code, "no-orientation");
    assert_eq!(none.value.grid().spacing(), [1.5, 2.0, 3.0]);
}

/// Asserts that a file is refused with a text that holds `word` and the file's name.
fn refused(crafted: &Crafted, word: &str) {
    let text = image_of(crafted).map(|_| ()).unwrap_err().to_string();
    assert!(text.contains(word) && text.contains("a.nii"), "{word}: {text}");
}

#[test]
fn unsuitable_images_are_refused() {
    let c = Crafted::default();
    let mut sheared = c.clone();
    sheared.rows[0][1] = 0.4;
    refused(&sheared, "sform");
    let mut flat = c.clone();
    flat.rows[2] = [0.0; 4];
    refused(&flat, "sform");
    refused(&Crafted { dim: [4, 4, 3, 1, 2, 1, 1, 1], ..c.clone() }, "2 values per voxel");
    refused(&Crafted { dim: [3, 4, -3, 2, 1, 1, 1, 1], ..c.clone() }, "dim");
    refused(&Crafted { dim: [3, 4, 0, 2, 1, 1, 1, 1], ..c.clone() }, "dim");
    refused(&Crafted { dim: [7, 32767, 32767, 32767, 32767, 32767, 32767, 32767], ..c.clone() }, "too large");
    refused(&Crafted { dim: [3, 32767, 32767, 32767, 1, 1, 1, 1], ..c.clone() }, "cut off");
    refused(&Crafted { dim: [3, 4, 3, 3, 1, 1, 1, 1], ..c.clone() }, "file holds 48 bytes");
    for (datatype, name) in [(128, "Rgb24"), (32, "Complex64"), (1536, "Float128"), (1, "unknown"), (0, "unknown")] {
        refused(&Crafted { datatype, ..c.clone() }, name);
    }
    refused(&Crafted { units: 1, ..c.clone() }, "metres");
    for offset in [f32::NAN, -1.0, 10.0, 400.5, 1e30] {
        refused(&Crafted { offset, ..c.clone() }, "vox_offset");
    }
    refused(&Crafted { scaling: [f32::INFINITY, 0.0], ..c.clone() }, "scl_slope");
    let trailing = Crafted { dim: [5, 4, 3, 2, 1, 1, 1, 1], ..c.clone() };
    assert_eq!(image_of(&trailing).unwrap().value.grid().size(), [4, 3, 2]);

    let mut values: Vec<f32> = vec![0.0; 24];
    values[5] = f32::NAN;
    values[9] = f32::INFINITY;
    let voxels = values.iter().flat_map(|v| v.to_le_bytes()).collect();
    refused(&Crafted { datatype: 16, voxels, ..c }, "2 of 24 voxels are NaN or infinite, the first at voxel [1, 1, 0]");
}

#[test]
fn other_files_are_refused() {
    let good = Crafted::default().bytes();
    let mut pair = good.clone();
    pair[344..348].copy_from_slice(b"ni1\0");
    let mut second = good.clone();
    second[..4].copy_from_slice(&540i32.to_be_bytes());
    let zipped = gzip(&good);
    let cases: [(&[u8], &str); 7] = [
        (b"", "empty"),
        (b"DICM and more", "NIfTI"),
        (&[7; 1000], "magic"),
        (&pair, ".hdr/.img"),
        (&second, "NIfTI-2"),
        (&zipped[..zipped.len() - 3], "cut off"),
        (&zipped[..zipped.len() / 2], "cut off"),
    ];
    for (bytes, word) in cases {
        let err = with_file("b.nii.gz", bytes, |p| read_image(p).map(|_| ())).unwrap_err();
        assert_eq!(err.exit_code(), 3);
        assert!(err.to_string().contains(word) && err.to_string().contains("b.nii.gz"), "{word}: {err}");
    }
}

#[test]
fn gzip_in_several_members() {
    let bytes = Crafted::default().bytes();
    let members = [&bytes[..100], &bytes[100..360], &bytes[360..]].map(gzip).concat();
    let read = with_file("m.nii.gz", &members, |p| read_image(p)).unwrap();
    assert_eq!(read.value.data()[..3], [-7.0, -6.0, -5.0]);
    assert!(read.header.compressed);
}

#[test]
fn fields_of_other_tools() {
    let values: Vec<f32> = (0..6).map(|v| v as f32 + 1.0).collect();
    let c = Crafted {
        dim: [5, 2, 1, 1, 1, 3, 1, 1],
        datatype: 16,
        intent: (1007, 0.0, ""),
        voxels: values.iter().flat_map(|v| v.to_le_bytes()).collect(),
        ..Crafted::default()
    };
    let read = |c: &Crafted| with_file("a.nii", &c.bytes(), |p| read_field(p).map(|f| f.value.into_data()));
    assert_eq!(read(&c).unwrap(), [[1.0, 3.0, 5.0], [2.0, 4.0, 6.0]]);
    assert_eq!(read(&Crafted { intent: (1006, 0.0, ""), ..c.clone() }).unwrap()[1], [-2.0, -4.0, 6.0]);
    assert_eq!(read(&Crafted { intent: (1007, 1.0, "NREG_TRANS"), ..c.clone() }).unwrap()[1], [-2.0, -4.0, 6.0]);
    // Absolute RAS positions: voxel 1 lies at RAS (11.5, 20, 30).
    let positions = read(&Crafted { intent: (1007, 0.0, "NREG_TRANS"), ..c.clone() }).unwrap();
    assert_eq!(positions[1], [-2.0 + 11.5, -4.0 + 20.0, 6.0 - 30.0]);

    let refused = [
        Crafted { intent: (0, 0.0, ""), ..c.clone() },
        Crafted { dim: [4, 2, 1, 1, 3, 1, 1, 1], ..c.clone() },
        Crafted { dim: [5, 1, 1, 1, 2, 3, 1, 1], ..c.clone() },
        Crafted { intent: (1007, 2.0, "NREG_TRANS"), ..c },
        Crafted::default(),
    ];
    for c in refused {
        let err = read(&c).unwrap_err();
        assert!(matches!(err, Error::Input { .. }) && err.to_string().contains("1007"), "{err}");
    }
}

#[test]
fn directions_are_told_in_the_header() {
    let dir = tempfile::tempdir().unwrap();
    let grid = Grid::axis_aligned([2, 2, 2], [1.0; 3], [0.0; 3]).unwrap();
    let displacement = Volume::filled(grid.clone(), [1.0f32, 2.0, 3.0]);
    let mask = Volume::filled(grid, true);
    let told = |name: &str| read_field(dir.path().join(name)).unwrap().header.description;
    let push = crate::field::PushField { displacement: displacement.clone(), computed: mask.clone() };
    let pull = crate::field::PullField { displacement, inside: mask };
    for ext in ["nii.gz", "mha", "nrrd"] {
        let (a, b) = (format!("push.{ext}"), format!("pull.{ext}"));
        write_push(dir.path().join(&a), &push, FieldFormat::of(a.as_ref()).unwrap(), 2).unwrap();
        write_pull(dir.path().join(&b), &pull, FieldFormat::of(b.as_ref()).unwrap(), 2).unwrap();
        assert!(told(&a).starts_with("aventail planning_to_fraction") && told(&a).ends_with("LPS mm"), "{}", told(&a));
        assert!(told(&b).starts_with("aventail fraction_to_planning") && told(&b).ends_with("LPS mm"), "{}", told(&b));
    }
}

#[test]
fn values_that_do_not_fit_and_places_that_do_not_exist() {
    let dir = tempfile::tempdir().unwrap();
    let grid = Grid::axis_aligned([2, 1, 1], [1.0; 3], [0.0; 3]).unwrap();
    let image = Volume::new(grid, vec![0.0f32, 40_000.0]).unwrap();
    let path = dir.path().join("a.nii.gz");
    let err = write_image(&path, &image, Stored::Int16, &WriteOptions::default()).unwrap_err();
    assert!(err.to_string().contains("40000 at voxel [1, 0, 0]"), "{err}");
    assert!(!path.exists());
    let missing = dir.path().join("none/a.nii.gz");
    assert_eq!(write_image(&missing, &image, Stored::Float32, &WriteOptions::default()).unwrap_err().exit_code(), 5);
    let odd = dir.path().join("a.tiff");
    assert_eq!(write_image(&odd, &image, Stored::Float32, &WriteOptions::default()).unwrap_err().exit_code(), 2);
}
