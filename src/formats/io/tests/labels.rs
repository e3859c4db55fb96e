//! Label maps with their names, and what inspection tells.

use super::{Crafted, with_file};
use crate::field::FieldFormat;
use crate::geometry::Grid;
use crate::io::*;
use crate::volume::{LabelMap, Volume};

fn two_labels() -> LabelMap {
    let grid = Grid::axis_aligned([4, 1, 1], [2.0, 2.0, 5.0], [0.0; 3]).unwrap();
    let names = [(7, "skull".to_owned()), (300, "a & \"b\" <ä>".to_owned()), (9, "absent".to_owned())];
    LabelMap { volume: Volume::new(grid, vec![0, 7, 300, 7]).unwrap(), names: names.into() }
}

#[test]
fn label_names_travel_in_the_header() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("labels.nii.gz");
    let mut map = two_labels();
    write_labels(&path, &map, &WriteOptions::default()).unwrap();
    let back = read_labels(&path, None).unwrap();
    assert_eq!(back.value, map);
    assert_eq!(back.header.datatype, "uint16");

    let json = dir.path().join("names.json");
    std::fs::write(&json, r#"{"labels": {"7": "mandible", "300": "hyoid", "12": "sternum"}, "note": 1}"#).unwrap();
    let back = read_labels(&path, Some(&json)).unwrap().value;
    assert_eq!((back.names[&7].as_str(), back.names[&300].as_str()), ("mandible", "hyoid"));

    map.volume.data_mut()[2] = 8;
    map.names.insert(8, "one".into());
    write_labels(&path, &map, &WriteOptions::default()).unwrap();
    assert_eq!(read_labels(&path, None).unwrap().header.datatype, "uint8");
}

#[test]
fn unsuitable_labels_are_refused() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("labels.nii");
    let json = dir.path().join("names.json");
    let check = |map: &LabelMap, names: Option<&str>, word: &str| {
        write_labels(&path, map, &WriteOptions::default()).unwrap();
        if let Some(text) = names {
            std::fs::write(&json, text).unwrap();
        }
        let err = read_labels(&path, names.map(|_| json.as_path())).unwrap_err().to_string();
        assert!(err.contains(word), "{word}: {err}");
    };
    let map = two_labels();
    let bare = LabelMap { names: Default::default(), ..map.clone() };
    check(&bare, None, "--labels");
    check(&bare, Some(r#"{"labels": {"7": "skull"}}"#), "labels without a name: 300");
    check(&bare, Some(r#"{"labels": {"7": "skull", "300": "skull"}}"#), "labels 7 and 300 have the same name");
    check(&bare, Some(r#"{"labels": {"background": 0, "skull": 7}}"#), "labels without a name: 300");
    check(&bare, Some(r#"{"labels": {"head": [7, 300], "skull": 7}}"#), "head is a region of several labels");
    check(&bare, Some(r#"{"labels": {"7": "skull", "7": "hyoid"}}"#), "label 7 has two names");
    check(&bare, Some(r#"{"labels": {"skull": 7, "hyoid": 7}}"#), "label 7 has two names");
    check(&bare, Some(r#"{"labels": {"skull": 70000}}"#), "names.json");
    check(&bare, Some(r#"{"labels": {"skull": "7"}}"#), "names.json");
    check(&bare, Some(r#"{"labels": ["skull"]}"#), "names.json");
    check(&bare, Some("[1]"), "names.json");
    let empty = LabelMap { volume: map.volume.map(|_| 0), names: map.names.clone() };
    check(&empty, None, "no voxel is labelled");

    for bad in [1.5f32, -1.0, 65_536.0, f32::NAN] {
        let image = Volume::new(map.volume.grid().clone(), vec![0.0, 1.0, bad, 2.0]).unwrap();
        write_image(&path, &image, Stored::Float32, &WriteOptions::default()).unwrap();
        let err = read_labels(&path, Some(&json)).unwrap_err();
        assert!(err.exit_code() == 3 || err.to_string().contains("voxel [2, 0, 0]"), "{err}");
    }
    std::fs::write(&json, r#"{"labels": {"1": "skull", "65535": "hyoid"}}"#).unwrap();
    let image = Volume::new(map.volume.grid().clone(), vec![-0.0, 1.0, 65_535.0, 1.0]).unwrap();
    write_image(&path, &image, Stored::Float32, &WriteOptions::default()).unwrap();
    assert_eq!(read_labels(&path, Some(&json)).unwrap().value.volume.data(), [0, 1, 65_535, 1]);
}

#[test]
fn label_tables_of_other_writers() {
    let xml = r#"<?xml version="1.0"?> <CaretExtension><VolumeInformation Index="0"><LabelTable>
        <Label Key="0" Red="1"><![CDATA[???]]></Label>
        <Label Red="1" Key="1"><![CDATA[bone < ]]>&amp; &#x43;1</Label></LabelTable></VolumeInformation></CaretExtension>"#;
    let table = |xml: &str, big: bool| {
        let size = (8 + xml.len() + 1).next_multiple_of(16);
        let bytes = |v: i32| if big { v.to_be_bytes() } else { v.to_le_bytes() };
        let mut extensions = [bytes(16), bytes(6), [b'x'; 4], [b' '; 4], bytes(size as i32), bytes(0)].concat();
        extensions.extend(xml.bytes());
        extensions.resize(16 + size, 0);
        let offset = 352.0 + extensions.len() as f32;
        let voxels = (0..24).map(|v| v % 2).collect();
        Crafted { big, datatype: 2, offset, extensions, voxels, ..Crafted::default() }.bytes()
    };
    for big in [false, true] {
        let read = with_file("l.nii", &table(xml, big), |p| read_labels(p, None)).unwrap();
        assert_eq!(read.value.names, [(1, "bone < & C1".to_owned())].into());
        assert_eq!(read.header.extensions.len(), 2);
    }
    for damaged in [
        xml.replace("Key=\"1\"", "Key=\"one\""),
        xml.replace("&amp;", "&what;"),
        xml.replace("</Label></LabelTable>", ""),
    ] {
        let err = with_file("l.nii", &table(&damaged, false), |p| read_labels(p, None)).unwrap_err();
        assert!(err.to_string().contains("label table"), "{err}");
    }
}

#[test]
fn inspection_tells_orientation_labels_and_grids() {
    let dir = tempfile::tempdir().unwrap();
    let labels = dir.path().join("labels.nii.gz");
    write_labels(&labels, &two_labels(), &WriteOptions::default()).unwrap();
    let field = dir.path().join("field.nrrd");
    let vectors = Volume::filled(two_labels().volume.grid().clone(), [3.0f32, 0.0, -4.0]);
    write_field(&field, &vectors, FieldFormat::of(&field).unwrap(), &WriteOptions::default()).unwrap();
    let ras = dir.path().join("ras.nii");
    std::fs::write(&ras, Crafted::default().bytes()).unwrap();

    let files: Vec<_> = [&labels, &field, &ras].iter().map(|p| inspect::inspect(p).unwrap()).collect();
    assert_eq!(files.iter().map(|f| f.orientation.code.as_str()).collect::<Vec<_>>(), ["LPS", "LPS", "RAS"]);
    assert!(files.iter().all(|f| f.orientation.right_handed && f.orientation.oblique_deg == 0.0));
    let inspect::Content::Labels { labels, absent: 1 } = &files[0].content else { panic!("{:?}", files[0].content) };
    assert_eq!((labels[0].voxels, labels[0].volume_ml, labels[0].name.as_deref()), (2, 0.04, Some("skull")));
    let inspect::Content::Field { length, components, .. } = &files[1].content else {
        panic!("{:?}", files[1].content)
    };
    assert_eq!((length.greatest, components[2].mean), (5.0, -4.0));
    let grids = inspect::compare_grids(&files);
    assert!(grids[0].contains("lies on the grid") && grids[1].contains("NOT on the grid"), "{grids:?}");
    assert!(files[1].to_string().contains("its format does not record the direction"), "{}", files[1]);
    let description = crate::io::direction("planning", "fraction", FieldFormat::of(&field).unwrap());
    let options = WriteOptions { description, ..WriteOptions::default() };
    write_field(&field, &vectors, FieldFormat::of(&field).unwrap(), &options).unwrap();
    let told = inspect::inspect(&field).unwrap().to_string();
    assert!(told.contains("displacement field, planning to fraction by its description"), "{told}");
    assert!(!told.contains("does not record"), "{told}");
    let text = files[0].to_string();
    assert!(text.contains("skull") && text.contains("axes run to left, posterior, superior"), "{text}");
    assert!(serde_json::to_string(&files[0]).unwrap().contains("\"kind\":\"labels\""));
}

#[test]
fn names_as_nnunet_writes_them_and_one_name_of_two_labels() {
    let dir = tempfile::tempdir().unwrap();
    let (path, json) = (dir.path().join("labels.nii"), dir.path().join("dataset.json"));
    let bare = LabelMap { names: Default::default(), ..two_labels() };
    write_labels(&path, &bare, &WriteOptions::default()).unwrap();
    let text = r#"{"channel_names": {"0": "CT"}, "labels": {"background": 0, "skull": 7, "hyoid": [300]}, "file_ending": ".nii.gz"}"#;
    std::fs::write(&json, format!("\u{feff}{text}")).unwrap();
    let read = read_labels(&path, Some(&json)).unwrap();
    assert_eq!(read.value.names, [(7, "skull".to_owned()), (300, "hyoid".to_owned())].into());
    assert!(read.warnings.is_empty());

    // One name is one structure, whatever its labels, but never one bone; a map that is only carried keeps them.
    std::fs::write(&json, r#"{"labels": {"7": "cord", "300": "cord"}}"#).unwrap();
    let read = read_structures(&path, Some(&json)).unwrap();
    assert_eq!((read.value.volume.data(), read.warnings[0].code.as_str()), (&[0, 7, 7, 7][..], "labels-joined"));
    let carried = read_label_map(&path, Some(&json)).unwrap();
    assert_eq!(carried.value.volume.data(), [0, 7, 300, 7]);
}

#[test]
fn scaled_labels_are_integers_up_to_the_scale_s_rounding() {
    let voxels: Vec<u8> = (0..24i16).flat_map(|v| (10 * (v % 3)).to_le_bytes()).collect();
    let scaled = Crafted { scaling: [0.1, 0.0], voxels, ..Crafted::default() };
    let read = |c: &Crafted| with_file("l.nii", &c.bytes(), |p| read_label_map(p, None));
    assert_eq!(read(&scaled).unwrap().value.volume.data()[..4], [0, 1, 2, 0]);
    assert!(read(&Crafted { scaling: [0.13, 0.0], ..scaled.clone() }).is_err());
    assert_eq!(read(&Crafted { scaling: [1.0, 0.0], ..scaled }).unwrap().value.volume.data()[..2], [0, 10]);
}
