//! DICOM objects, and edits of their elements: removed, doubled, of another representation, length, tag or value.
//!
//! Data that begins with `E` are edits of the object of the target, six bytes each; other data are the file itself.

use std::path::Path;

const CT: &str = "1.2.840.10008.5.1.4.1.1.2";
const DOSE: &str = "1.2.840.10008.5.1.4.1.1.481.2";
const STRUCTURES: &str = "1.2.840.10008.5.1.4.1.1.481.3";
const RIGID: &str = "1.2.840.10008.5.1.4.1.1.66.1";
const DEFORMABLE: &str = "1.2.840.10008.5.1.4.1.1.66.3";
const SEGMENTATION: &str = "1.2.840.10008.5.1.4.1.1.66.4";
/// Letters of representations that an element is given.
const LETTERS: [&[u8; 2]; 12] = [b"UN", b"SQ", b"OB", b"OW", b"UI", b"DS", b"IS", b"LO", b"PN", b"US", b"FD", b"??"];
/// Lengths that an element claims.
const CLAIMS: [u32; 8] = [u32::MAX, u32::MAX - 1, 0x7fff_ffff, 0xffff, 1, 0, 3, 1 << 24];
/// Values that an element is given.
const VALUES: [&[u8]; 10] = [
    b"-1",
    b"0\\0\\0",
    b"1e308\\-1e308\\nan",
    b"99999999999999999999",
    b"ISO 2022 IR 87\\ISO 2022 IR 149",
    b"\x1b$B;3\x1b(B\x1b$)C\xfb\xf3",
    b"\xff\xff\xff\xff",
    b"",
    b"1.2.840.10008.1.2.4.90",
    b"65535 ",
];

#[derive(Clone)]
enum Value {
    Bytes(Vec<u8>),
    Items(Vec<Vec<Element>>),
}

#[derive(Clone)]
struct Element {
    tag: [u16; 2],
    vr: [u8; 2],
    value: Value,
    claim: Option<u32>,
}

fn element(tag: [u16; 2], vr: &[u8; 2], value: &[u8]) -> Element {
    let mut value = value.to_vec();
    if value.len() % 2 == 1 {
        value.push(if vr == b"UI" { 0 } else { b' ' });
    }
    Element { tag, vr: *vr, value: Value::Bytes(value), claim: None }
}

fn short(tag: [u16; 2], value: u16) -> Element {
    element(tag, b"US", &value.to_le_bytes())
}

fn sequence(tag: [u16; 2], items: Vec<Vec<Element>>) -> Element {
    Element { tag, vr: *b"SQ", value: Value::Items(items), claim: None }
}

fn written(set: &[Element], out: &mut Vec<u8>) {
    for e in set {
        out.extend(e.tag[0].to_le_bytes());
        out.extend(e.tag[1].to_le_bytes());
        out.extend(e.vr);
        let bytes = match &e.value {
            Value::Bytes(bytes) => bytes.clone(),
            Value::Items(items) => items.iter().flat_map(|item| wrapped(item)).collect(),
        };
        let length = e.claim.unwrap_or(bytes.len() as u32);
        if [b"OB", b"OW", b"OF", b"SQ", b"UN", b"UT", b"??"].contains(&&e.vr) {
            out.extend([0, 0]);
            out.extend(length.to_le_bytes());
        } else {
            out.extend((length as u16).to_le_bytes());
        }
        out.extend(bytes);
    }
}

fn wrapped(item: &[Element]) -> Vec<u8> {
    let mut inner = Vec::new();
    written(item, &mut inner);
    let mut out = vec![0xfe, 0xff, 0x00, 0xe0];
    out.extend((inner.len() as u32).to_le_bytes());
    out.extend(inner);
    out
}

fn file(set: &[Element]) -> Vec<u8> {
    let mut out = vec![0; 128];
    out.extend(b"DICM");
    let meta = [element([2, 0x10], b"UI", b"1.2.840.10008.1.2.1")];
    written(&meta, &mut out);
    written(set, &mut out);
    out
}

/// The element of this number, counted through sequences.
fn at(set: &mut Vec<Element>, number: &mut usize, edit: &mut dyn FnMut(&mut Vec<Element>, usize)) -> bool {
    for n in 0..set.len() {
        if *number == 0 {
            edit(set, n);
            return true;
        }
        *number -= 1;
        if let Value::Items(items) = &mut set[n].value
            && items.iter_mut().any(|item| at(item, number, edit))
        {
            return true;
        }
    }
    false
}

fn count(set: &[Element]) -> usize {
    let inner = |e: &Element| match &e.value {
        Value::Items(items) => items.iter().map(|item| count(item)).sum(),
        Value::Bytes(_) => 0,
    };
    set.iter().map(|e| 1 + inner(e)).sum()
}

/// The file that data stand for.
fn edited(set: &[Element], data: &[u8]) -> Vec<u8> {
    let Some(edits) = data.strip_prefix(b"E") else { return data.to_vec() };
    let mut set = set.to_vec();
    let mut cut = None;
    for edit in edits.chunks_exact(6).take(8) {
        let [op, place, x, y, z, w] = *edit else { continue };
        let mut number = usize::from(place) % count(&set).max(1);
        at(&mut set, &mut number, &mut |set, n| match op % 8 {
            0 => drop(set.remove(n)),
            1 => set.insert(n, set[n].clone()),
            2 => set[n].vr = *LETTERS[usize::from(x) % LETTERS.len()],
            3 => set[n].claim = Some(CLAIMS[usize::from(x) % CLAIMS.len()]),
            4 => set[n].value = Value::Bytes(VALUES[usize::from(x) % VALUES.len()].to_vec()),
            5 => set[n].tag = [u16::from_le_bytes([x, y]), u16::from_le_bytes([z, w])],
            6 => set[n].value = Value::Bytes(vec![x, y, z, w]),
            _ => cut = Some(usize::from(x) << 3 | usize::from(y)),
        });
    }
    let mut bytes = file(&set);
    bytes.truncate(cut.unwrap_or(usize::MAX));
    bytes
}

fn base(class: &str, modality: &str, uid: &str) -> Vec<Element> {
    vec![
        element([8, 5], b"CS", b"ISO_IR 100"),
        element([8, 0x16], b"UI", class.as_bytes()),
        element([8, 0x18], b"UI", uid.as_bytes()),
        element([8, 0x60], b"CS", modality.as_bytes()),
        element([0x10, 0x10], b"PN", b"Name^Given"),
        element([0x10, 0x20], b"LO", b"1"),
        element([0x20, 0x0d], b"UI", b"1.9"),
        element([0x20, 0x0e], b"UI", b"1.7"),
        element([0x20, 0x52], b"UI", b"1.8"),
    ]
}

fn pixels(set: &mut Vec<Element>, bytes: &[u8]) {
    set.extend([
        short([0x28, 2], 1),
        element([0x28, 4], b"CS", b"MONOCHROME2"),
        short([0x28, 0x10], 2),
        short([0x28, 0x11], 3),
        element([0x28, 0x30], b"DS", b"2\\1.5"),
        short([0x28, 0x100], 16),
        short([0x28, 0x101], 16),
        short([0x28, 0x102], 15),
        short([0x28, 0x103], 0),
        element([0x28, 0x1052], b"DS", b"-1024"),
        element([0x28, 0x1053], b"DS", b"1"),
    ]);
    set.push(element([0x7fe0, 0x10], b"OW", bytes));
}

fn slice(k: usize) -> Vec<Element> {
    let mut set = base(CT, "CT", &format!("1.5.{k}"));
    set.push(element([0x20, 0x32], b"DS", format!("0\\0\\{}", 3 * k).as_bytes()));
    set.push(element([0x20, 0x37], b"DS", b"1\\0\\0\\0\\1\\0"));
    pixels(&mut set, &[7; 12]);
    set
}

fn dose_set() -> Vec<Element> {
    let mut set = base(DOSE, "RTDOSE", "1.5.60");
    set.push(element([0x20, 0x32], b"DS", b"0\\0\\0"));
    set.push(element([0x20, 0x37], b"DS", b"1\\0\\0\\0\\1\\0"));
    pixels(&mut set, &[9; 24]);
    set.splice(set.len() - 1..set.len() - 1, {
        let beam = vec![element([0x300c, 6], b"IS", b"1")];
        let group = vec![sequence([0x300c, 4], vec![beam])];
        [
            element([0x28, 8], b"IS", b"2"),
            element([0x3004, 2], b"CS", b"GY"),
            element([0x3004, 4], b"CS", b"PHYSICAL"),
            element([0x3004, 0x0a], b"CS", b"PLAN"),
            element([0x3004, 0x0c], b"DS", b"0\\3"),
            element([0x3004, 0x0e], b"DS", b"0.01"),
            sequence(
                [0x300c, 2],
                vec![vec![element([8, 0x1155], b"UI", b"1.6"), sequence([0x300c, 0x20], vec![group])]],
            ),
        ]
    });
    set
}

fn structure_set() -> Vec<Element> {
    let mut set = base(STRUCTURES, "RTSTRUCT", "1.5.90");
    let contour = |z: u8| {
        vec![
            element([0x3006, 0x42], b"CS", b"CLOSED_PLANAR"),
            element([0x3006, 0x46], b"IS", b"4"),
            element([0x3006, 0x50], b"DS", format!("0\\0\\{z}\\9\\0\\{z}\\9\\9\\{z}\\0\\9\\{z}").as_bytes()),
        ]
    };
    let roi = |number: &[u8], name: &[u8]| {
        let number = element([0x3006, 0x22], b"IS", number);
        vec![number, element([0x3006, 0x24], b"UI", b"1.8"), element([0x3006, 0x26], b"LO", name)]
    };
    let drawn = |number: &[u8]| {
        let contours = sequence([0x3006, 0x40], vec![contour(0), contour(3)]);
        vec![element([0x3006, 0x2a], b"IS", b"1\\2\\3"), contours, element([0x3006, 0x84], b"IS", number)]
    };
    set.extend([
        sequence([0x3006, 0x10], vec![vec![element([0x20, 0x52], b"UI", b"1.8")]]),
        sequence([0x3006, 0x20], vec![roi(b"1", b"mandible"), roi(b"2", b"a\xe4")]),
        sequence([0x3006, 0x39], vec![drawn(b"1"), drawn(b"2")]),
        sequence(
            [0x3006, 0x80],
            vec![vec![element([0x3006, 0x84], b"IS", b"1"), element([0x3006, 0xa4], b"CS", b"ORGAN")]],
        ),
    ]);
    set
}

fn matrix(shift: &str) -> Vec<Element> {
    let numbers = format!("1\\0\\0\\{shift}\\0\\1\\0\\0\\0\\0\\1\\0\\0\\0\\0\\1");
    vec![element([0x3006, 0xc6], b"DS", numbers.as_bytes()), element([0x70, 0x30c], b"CS", b"RIGID")]
}

fn rigid_set() -> Vec<Element> {
    let mut set = base(RIGID, "REG", "1.5.91");
    let one = |frame: &[u8], shift: &str| {
        let matrices = vec![sequence([0x70, 0x30a], vec![matrix(shift)])];
        vec![element([0x20, 0x52], b"UI", frame), sequence([0x70, 0x309], vec![matrices])]
    };
    set.push(sequence([0x70, 0x308], vec![one(b"1.8", "0"), one(b"1.88", "5")]));
    set
}

fn deformable_set() -> Vec<Element> {
    let mut set = base(DEFORMABLE, "REG", "1.5.92");
    let size: Vec<u8> = [2u32; 3].iter().flat_map(|n| n.to_le_bytes()).collect();
    let step: Vec<u8> = [3f64; 3].iter().flat_map(|n| n.to_le_bytes()).collect();
    let vectors: Vec<u8> = [0.5f32; 24].iter().flat_map(|n| n.to_le_bytes()).collect();
    let grid = vec![
        element([0x20, 0x32], b"DS", b"0\\0\\0"),
        element([0x20, 0x37], b"DS", b"1\\0\\0\\0\\1\\0"),
        element([0x64, 7], b"UL", &size),
        element([0x64, 8], b"FD", &step),
        element([0x64, 9], b"OF", &vectors),
    ];
    let one = vec![
        element([0x64, 3], b"UI", b"1.88"),
        sequence([0x64, 5], vec![grid]),
        sequence([0x64, 0x0f], vec![matrix("0")]),
        sequence([0x64, 0x10], vec![matrix("1")]),
    ];
    set.push(sequence([0x64, 2], vec![one]));
    set
}

/// Two segments on three slices: bits, or fractions where `bits` is 8.
fn segmentation_set(bits: u16) -> Vec<Element> {
    let mut set = base(SEGMENTATION, "SEG", "1.5.93");
    let code = |value: &[u8]| {
        vec![
            element([8, 0x100], b"SH", value),
            element([8, 0x102], b"SH", b"SCT"),
            element([8, 0x104], b"LO", b"Femur"),
        ]
    };
    let segment = |number: u16, label: &[u8]| {
        let mut kind = code(b"71341001");
        kind.push(sequence([0x62, 0x11], vec![code(b"7771000")]));
        let number = short([0x62, 4], number);
        vec![number, element([0x62, 5], b"LO", label), sequence([0x62, 0x0f], vec![kind])]
    };
    let frame = |number: u16, z: u8| {
        let place = element([0x20, 0x32], b"DS", format!("0\\0\\{z}").as_bytes());
        let of = short([0x62, 0x0b], number);
        vec![sequence([0x20, 0x9113], vec![vec![place]]), sequence([0x62, 0x0a], vec![vec![of]])]
    };
    let measures = vec![element([0x18, 0x50], b"DS", b"3"), element([0x28, 0x30], b"DS", b"2\\1.5")];
    let turned = vec![element([0x20, 0x37], b"DS", b"1\\0\\0\\0\\1\\0")];
    let shared = vec![sequence([0x20, 0x9116], vec![turned]), sequence([0x28, 0x9110], vec![measures])];
    set.extend([
        short([0x28, 2], 1),
        element([0x28, 4], b"CS", b"MONOCHROME2"),
        element([0x28, 8], b"IS", b"3"),
        short([0x28, 0x10], 2),
        short([0x28, 0x11], 3),
        short([0x28, 0x100], bits),
        short([0x28, 0x101], bits),
        short([0x28, 0x102], bits - 1),
        short([0x28, 0x103], 0),
        element([0x62, 1], b"CS", if bits == 1 { b"BINARY".as_slice() } else { b"FRACTIONAL" }),
        sequence([0x62, 2], vec![segment(1, b"mandible"), segment(2, b"thigh")]),
        short([0x62, 0x0e], 200),
        sequence([0x5200, 0x9229], vec![shared]),
        sequence([0x5200, 0x9230], vec![frame(1, 0), frame(2, 6), frame(1, 9)]),
        element([0x7fe0, 0x10], b"OB", if bits == 1 { &[0x0f, 0x30, 0x03] } else { &[150; 18] }),
    ]);
    set
}

fn seeds(set: &[Element]) -> Vec<Vec<u8>> {
    let byte = |n: u8, k: u8| k.wrapping_mul(37).wrapping_add(n.wrapping_mul(11));
    let edits = |n: u8| -> Vec<u8> { b"E".iter().copied().chain((0..12).map(|k| byte(n, k))).collect() };
    let mut all = vec![file(set)];
    all.extend((0..12).map(edits));
    all
}

/// A folder of this kind with nothing in it.
fn alone(name: &str) -> std::path::PathBuf {
    let folder = super::folder().join(name);
    std::fs::create_dir_all(&folder).expect("a folder for the fuzzer's files");
    folder
}

fn put(folder: &Path, name: &str, bytes: &[u8]) -> std::path::PathBuf {
    let path = folder.join(name);
    std::fs::write(&path, bytes).expect("the fuzzer's file can be written");
    path
}

use aventail::io::dicom::registration::{kind_of, read_deformable, read_rigid};
use aventail::io::dicom::{read_doses, read_structure_set, summary};
use aventail::io::{read_bones, read_contours, read_field, read_grid, read_image, read_label_map, read_labels};

/// A CT series of three slices, one of them changed.
pub fn ct(data: &[u8]) {
    let folder = alone("ct");
    put(&folder, "1.dcm", &file(&slice(1)));
    put(&folder, "3.dcm", &file(&slice(3)));
    let path = put(&folder, "2.dcm", &edited(&slice(2), data));
    let _ = (summary(&folder, false).map(|s| s.to_string()), read_grid(&folder));
    let _ = (read_image(&folder), read_image(path));
}

/// A structure set.
pub fn rtstruct(data: &[u8]) {
    let path = put(&alone("rtstruct"), "a.dcm", &edited(&structure_set(), data));
    let _ = (read_structure_set(&path), read_contours(&path), summary(&path, true));
}

/// A dose, and another beside it.
pub fn rtdose(data: &[u8]) {
    let folder = alone("rtdose");
    put(&folder, "1.dcm", &file(&dose_set()));
    let path = put(&folder, "2.dcm", &edited(&dose_set(), data));
    let _ = (read_doses(&[&path]), read_doses(&[&folder]), read_image(&path), summary(&path, true));
}

/// Registrations.
pub fn reg(data: &[u8]) {
    let folder = alone("reg");
    for set in [rigid_set(), deformable_set()] {
        let path = put(&folder, "a.dcm", &edited(&set, data));
        let _ = (kind_of(&path), read_rigid(&path), read_deformable(&path), read_field(&path));
    }
}

/// A segmentation, as labels and as bones.
pub fn seg(data: &[u8]) {
    let folder = alone("seg");
    for bits in [1, 8] {
        let path = put(&folder, "a.dcm", &edited(&segmentation_set(bits), data));
        let grid = read_grid(&path);
        let _ = (read_label_map(&path, None), read_labels(&folder, None), summary(&path, true));
        let _ = grid.map(|(grid, _)| read_bones(&path, None, &grid));
    }
}

pub(super) fn ct_seeds() -> Vec<Vec<u8>> {
    seeds(&slice(2))
}

pub(super) fn rtstruct_seeds() -> Vec<Vec<u8>> {
    seeds(&structure_set())
}

pub(super) fn rtdose_seeds() -> Vec<Vec<u8>> {
    seeds(&dose_set())
}

pub(super) fn reg_seeds() -> Vec<Vec<u8>> {
    [seeds(&rigid_set()), seeds(&deformable_set())].concat()
}

pub(super) fn seg_seeds() -> Vec<Vec<u8>> {
    [seeds(&segmentation_set(1)), seeds(&segmentation_set(8))].concat()
}
