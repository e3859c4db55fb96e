//! DICOM as it comes from a planning system: listed, warped, and as dose and structures.

#![expect(clippy::unwrap_used, reason = "a test that cannot read what it wrote fails")]

use crate::support::{aventail, folder};
use aventail::field::FieldFormat;
use aventail::geometry::Grid;
use aventail::io::{WriteOptions, read_image, write_field};
use aventail::volume::Volume;
use std::fs;
use std::path::{Path, PathBuf};

/// Columns, rows and slices; 2 mm x 2 mm x 3 mm.
const SIZE: [usize; 3] = [16, 14, 10];

/// An element in explicit little endian.
fn element(tag: (u16, u16), vr: &[u8; 2], mut value: Vec<u8>) -> Vec<u8> {
    if value.len() % 2 == 1 {
        value.push(if vr == b"UI" { 0 } else { b' ' });
    }
    let mut bytes = [tag.0.to_le_bytes(), tag.1.to_le_bytes(), *vr].concat();
    if matches!(vr, b"OB" | b"OW" | b"SQ" | b"UN") {
        bytes.extend([0, 0]);
        bytes.extend((value.len() as u32).to_le_bytes());
    } else {
        bytes.extend((value.len() as u16).to_le_bytes());
    }
    bytes.extend(value);
    bytes
}

fn text(tag: (u16, u16), vr: &[u8; 2], value: impl Into<String>) -> Vec<u8> {
    element(tag, vr, value.into().into_bytes())
}

fn number(tag: (u16, u16), value: u16) -> Vec<u8> {
    element(tag, b"US", value.to_le_bytes().to_vec())
}

fn sequence(tag: (u16, u16), items: Vec<Vec<Vec<u8>>>) -> Vec<u8> {
    let item = |elements: Vec<Vec<u8>>| {
        let content = elements.concat();
        [&[0xfe, 0xff, 0x00, 0xe0][..], &(content.len() as u32).to_le_bytes(), &content].concat()
    };
    element(tag, b"SQ", items.into_iter().flat_map(item).collect())
}

/// Writes an object; its elements are given in the order of their tags.
fn object(path: &Path, class: &str, uid: &str, series: (&str, &str), elements: Vec<Vec<u8>>) {
    let syntax = text((2, 0x10), b"UI", "1.2.840.10008.1.2.1");
    let meta = [element((2, 1), b"OB", vec![0, 1]), text((2, 2), b"UI", class), text((2, 3), b"UI", uid), syntax];
    let meta = [&meta.concat()[..], &text((2, 0x12), b"UI", "1.2.3")].concat();
    let length = element((2, 0), b"UL", (meta.len() as u32).to_le_bytes().to_vec());
    let own = [
        text((8, 0x16), b"UI", class),
        text((8, 0x18), b"UI", uid),
        text((8, 0x20), b"DA", "20260102"),
        text((8, 0x60), b"CS", series.1),
        text((0x10, 0x10), b"PN", "Doe^Jane"),
        text((0x10, 0x20), b"LO", "4711"),
        text((0x20, 0x0d), b"UI", "1.2.9"),
        text((0x20, 0x0e), b"UI", series.0),
    ];
    let all = [&vec![0; 128][..], b"DICM", &length, &meta, &own.concat(), &elements.concat()].concat();
    fs::write(path, all).unwrap();
}

fn stored(i: usize, j: usize, k: usize) -> u16 {
    (1000 + 3 * i + 5 * j + 7 * k) as u16
}

fn plane(frames: usize) -> Vec<Vec<u8>> {
    let mut all = vec![number((0x28, 2), 1), text((0x28, 4), b"CS", "MONOCHROME2")];
    if frames > 1 {
        all.push(text((0x28, 8), b"IS", frames.to_string()));
    }
    all.extend([number((0x28, 0x10), SIZE[1] as u16), number((0x28, 0x11), SIZE[0] as u16)]);
    all.push(text((0x28, 0x30), b"DS", "2\\2"));
    all.extend([number((0x28, 0x100), 16), number((0x28, 0x101), 16), number((0x28, 0x102), 15)]);
    all.push(number((0x28, 0x103), 0));
    all
}

/// A folder with a CT, its structures and its dose, made once.
fn case() -> &'static Path {
    static MADE: std::sync::LazyLock<PathBuf> = std::sync::LazyLock::new(|| {
        let dir = folder().join("dicom");
        fs::create_dir_all(&dir).unwrap();
        let words = |values: Vec<u16>| values.into_iter().flat_map(u16::to_le_bytes).collect::<Vec<u8>>();
        let place = |z: usize| {
            [
                text((0x20, 0x32), b"DS", format!("10\\20\\{}", 30 + 3 * z)),
                text((0x20, 0x37), b"DS", "1\\0\\0\\0\\1\\0"),
                text((0x20, 0x52), b"UI", "1.2.8"),
            ]
        };
        for k in 0..SIZE[2] {
            let mut all = place(k).to_vec();
            all.extend(plane(1));
            all.extend([text((0x28, 0x1052), b"DS", "-1024"), text((0x28, 0x1053), b"DS", "1")]);
            let values = (0..SIZE[1]).flat_map(|j| (0..SIZE[0]).map(move |i| stored(i, j, k)));
            all.push(element((0x7fe0, 0x10), b"OW", words(values.collect())));
            let path = dir.join(format!("CT{}", SIZE[2] - k));
            object(&path, "1.2.840.10008.5.1.4.1.1.2", &format!("1.2.5.{k}"), ("1.2.7.1", "CT"), all);
        }
        let offsets = (0..SIZE[2]).map(|k| (3 * k).to_string()).collect::<Vec<_>>().join("\\");
        let mut all = place(0).to_vec();
        all.extend(plane(SIZE[2]));
        all.extend([
            text((0x3004, 2), b"CS", "GY"),
            text((0x3004, 4), b"CS", "PHYSICAL"),
            text((0x3004, 0xa), b"CS", "PLAN"),
            text((0x3004, 0xc), b"DS", offsets),
            text((0x3004, 0xe), b"DS", "0.001"),
            element((0x7fe0, 0x10), b"OW", words(vec![20000; SIZE.iter().product()])),
        ]);
        object(&dir.join("RD"), "1.2.840.10008.5.1.4.1.1.481.2", "1.2.5.80", ("1.2.7.2", "RTDOSE"), all);
        let contour = |z: usize| {
            let z = 30 + 3 * z;
            vec![
                text((0x3006, 0x42), b"CS", "CLOSED_PLANAR"),
                text((0x3006, 0x46), b"IS", "4"),
                text((0x3006, 0x50), b"DS", format!("20\\30\\{z}\\30\\30\\{z}\\30\\40\\{z}\\20\\40\\{z}")),
            ]
        };
        let frame = text((0x3006, 0x24), b"UI", "1.2.8");
        let roi = vec![text((0x3006, 0x22), b"IS", "1"), frame, text((0x3006, 0x26), b"LO", "Cord")];
        let drawn = vec![sequence((0x3006, 0x40), (2..6).map(contour).collect()), text((0x3006, 0x84), b"IS", "1")];
        let all = vec![sequence((0x3006, 0x20), vec![roi]), sequence((0x3006, 0x39), vec![drawn])];
        object(&dir.join("RS"), "1.2.840.10008.5.1.4.1.1.481.3", "1.2.5.90", ("1.2.7.3", "RTSTRUCT"), all);
        dir
    });
    &MADE
}

/// A folder with an MR of the same places, in a frame of reference of its own, made once.
fn mr() -> &'static Path {
    static MADE: std::sync::LazyLock<PathBuf> = std::sync::LazyLock::new(|| {
        let dir = folder().join("dicom_mr");
        fs::create_dir_all(&dir).unwrap();
        for k in 0..SIZE[2] {
            let mut all = vec![
                text((0x20, 0x32), b"DS", format!("10\\20\\{}", 30 + 3 * k)),
                text((0x20, 0x37), b"DS", "1\\0\\0\\0\\1\\0"),
                text((0x20, 0x52), b"UI", "1.2.88"),
            ];
            all.extend(plane(1));
            let values = (0..SIZE[1]).flat_map(|j| (0..SIZE[0]).flat_map(move |i| stored(i, j, k).to_le_bytes()));
            all.push(element((0x7fe0, 0x10), b"OW", values.collect()));
            let uid = format!("1.2.6.{k}");
            object(&dir.join(format!("MR{k}")), "1.2.840.10008.5.1.4.1.1.4", &uid, ("1.2.7.9", "MR"), all);
        }
        dir
    });
    &MADE
}

fn said(words: &[&str]) -> String {
    let run = aventail().args(words).assert().success();
    String::from_utf8(run.get_output().stdout.clone()).unwrap()
}

#[test]
fn a_folder_is_listed_and_names_are_hidden() {
    let dir = case().to_str().unwrap();
    let shown = said(&["inspect", dir]);
    for word in ["Doe^Jane", "10 slices, 16 x 14 x 10, 2 x 2 x 3 mm", "1 structure,", "PLAN PHYSICAL GY"] {
        assert!(shown.contains(word), "{word}: {shown}");
    }
    assert!(said(&["inspect", case().join("RD").to_str().unwrap()]).contains("dose in Gy, "));
    for hidden in [said(&["inspect", dir, "--anonymous"]), said(&["inspect", dir, "--anonymous", "--json"])] {
        assert!(!hidden.contains("Doe") && !hidden.contains("4711") && hidden.contains("RTDOSE"), "{hidden}");
    }
    let json: serde_json::Value = serde_json::from_str(&said(&["inspect", dir, "--json"])).unwrap();
    let frames: Vec<&str> =
        json["dicom"][0]["entries"].as_array().unwrap().iter().map(|e| e["frame"].as_str().unwrap()).collect();
    assert_eq!(frames, ["A", "A", "A"]);
}

#[test]
fn ct_and_contours_are_warped_and_a_dose_is_summed_over_structures() {
    let (dir, at) = (case(), |name: &str| folder().join(name));
    let grid = Grid::axis_aligned(SIZE, [2.0, 2.0, 3.0], [10.0, 20.0, 30.0]).unwrap();
    // What lies at x is taken from x + 2 mm to the left.
    let pull = at("dicom_pull.mha");
    let shift = Volume::filled(grid, [2.0f32, 0.0, 0.0]);
    write_field(&pull, &shift, FieldFormat::MetaImage, &WriteOptions::default()).unwrap();
    let warp = |input: &Path, out: &Path, more: &[&str]| {
        let common = ["warp", "--quiet", "--from", "planning", "--to", "fraction"];
        let mut run = aventail();
        run.args(common).args(more).arg("--input").arg(input).arg("--out").arg(out);
        run.arg("--field").arg(format!("fraction:planning={}", pull.display())).assert().success();
    };
    let out = at("dicom_warped.nii.gz");
    warp(dir, &out, &["--kind", "image"]);
    let warped = read_image(&out).unwrap().value;
    let value = warped.data()[warped.grid().linear([4, 5, 6])];
    assert!((value - (f32::from(stored(5, 5, 6)) - 1024.0)).abs() < 1e-3, "{value}");
    let out = at("dicom_warped.json");
    warp(&dir.join("RS"), &out, &[]);
    let moved: serde_json::Value = serde_json::from_slice(&fs::read(&out).unwrap()).unwrap();
    let xs = moved["structures"][0]["contours"][0].as_array().unwrap().iter().map(|p| p[0].as_f64().unwrap());
    let (low, high) = xs.fold((f64::MAX, f64::MIN), |(l, h), x| (l.min(x), h.max(x)));
    assert!((low - 18.0).abs() < 0.2 && (high - 28.0).abs() < 0.2, "{low} {high}");
    let out = at("dicom_dvh");
    let mut run = aventail();
    run.args(["dose", "dvh", "--dose"]).arg(dir).arg("--structures").arg(dir).arg("--out").arg(&out).assert().success();
    let rows: serde_json::Value = serde_json::from_slice(&fs::read(out.join("dvh.json")).unwrap()).unwrap();
    let cord = &rows[0]["structures"][0];
    assert_eq!(cord["name"], "Cord");
    assert!((cord["mean"].as_f64().unwrap() - 20.0).abs() < 0.01, "{cord}");
}

#[test]
fn a_series_says_itself_whether_it_is_a_ct_or_an_mr() {
    let (ct, mr) = (case().to_str().unwrap(), mr().to_str().unwrap());
    let shown = said(&["inspect", mr]);
    assert!(shown.contains("MR") && shown.contains("10 slices, 16 x 14 x 10, 2 x 2 x 3 mm"), "{shown}");
    let bones = case().join("RS");
    let refused = |planning: &str, fractions: &[&str], modality: &[&str], code: i32| {
        let out = folder().join("dicom_modality");
        let mut run = aventail();
        run.args(["register", "--quiet", "--planning", planning]).arg("--bones").arg(&bones).arg("--out").arg(&out);
        fractions.iter().for_each(|fraction| {
            run.args(["--fraction", fraction]);
        });
        let run = run.args(modality).assert().code(code);
        assert!(!out.join("report.json").exists());
        String::from_utf8(run.get_output().stderr.clone()).unwrap()
    };
    let error = refused(ct, &[mr], &["--modality", "ct"], 2);
    assert!(error.contains("it is an MR series, and the settings say a CT"), "{error}");
    let error = refused(ct, &[ct], &["--modality", "mr"], 2);
    assert!(error.contains("it is a CT series, and the settings say an MR"), "{error}");
    let error = refused(ct, &[ct, mr], &[], 2);
    assert!(error.contains("are of two modalities"), "{error}");
    let error = refused(mr, &[mr], &["--planning-modality", "ct"], 2);
    assert!(error.contains("the settings say a CT (--planning-modality)"), "{error}");
    // As planning it is read; contours of another frame do not lie on it.
    let error = refused(mr, &[mr], &[], 4);
    assert!(!error.contains("[dicom-no-ct]") && error.contains("frame"), "{error}");
    // Grey values of an MR go through a field as they are, and into no CT series.
    let pull = folder().join("dicom_mr_pull.mha");
    let grid = Grid::axis_aligned(SIZE, [2.0, 2.0, 3.0], [10.0, 20.0, 30.0]).unwrap();
    write_field(&pull, &Volume::filled(grid, [2.0f32, 0.0, 0.0]), FieldFormat::MetaImage, &WriteOptions::default())
        .unwrap();
    let warp = |out: &Path| {
        let mut run = aventail();
        run.args(["warp", "--quiet", "--from", "fraction", "--to", "planning", "--kind", "image", "--input", mr]);
        run.arg("--out").arg(out).arg("--field").arg(format!("planning:fraction={}", pull.display()));
        run
    };
    let out = folder().join("dicom_mr_warped.nii.gz");
    warp(&out).assert().success();
    let warped = read_image(&out).unwrap().value;
    let value = warped.data()[warped.grid().linear([4, 5, 6])];
    assert!((value - f32::from(stored(5, 5, 6))).abs() < 1e-3, "{value}");
    let series = folder().join("dicom_mr_series");
    let run = warp(&series).args(["--dicom-like", ct]).assert().code(4);
    let error = String::from_utf8(run.get_output().stderr.clone()).unwrap();
    assert!(error.contains("[dicom-no-ct]") && error.contains("written as a CT series"), "{error}");
}
