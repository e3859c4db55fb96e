//! Small objects for tests.

use dicom_core::value::DataSetSequence;
use dicom_core::{DataElement, PrimitiveValue, Tag, VR};
use dicom_dictionary_std::{tags, uids};
use dicom_object::{FileMetaTableBuilder, InMemDicomObject};
use std::path::{Path, PathBuf};

/// A data set.
pub(super) type Set = InMemDicomObject;
/// Columns, rows and slices of the series made here.
pub(super) const SIZE: [usize; 3] = [5, 4, 6];
/// SOP classes.
pub(super) const CT: &str = "1.2.840.10008.5.1.4.1.1.2";

/// Puts a text, or several with backslashes between them.
pub(super) fn put(set: &mut Set, tag: Tag, vr: VR, text: &str) {
    let all: Vec<&str> = text.split('\\').collect();
    let value =
        if all.len() > 1 { PrimitiveValue::Strs(all.into_iter().map(String::from).collect()) } else { text.into() };
    set.put(DataElement::new(tag, vr, value));
}

pub(super) fn put_u16(set: &mut Set, tag: Tag, value: u16) {
    set.put(DataElement::new(tag, VR::US, PrimitiveValue::from(value)));
}

pub(super) fn put_items(set: &mut Set, tag: Tag, items: Vec<Set>) {
    set.put(DataElement::new(tag, VR::SQ, DataSetSequence::from(items)));
}

/// Numbers with backslashes between them.
pub(super) fn list(values: &[f64]) -> String {
    values
        .iter()
        .map(|v| format!("{v:.6}").trim_end_matches('0').trim_end_matches('.').to_owned())
        .collect::<Vec<_>>()
        .join("\\")
}

/// What every object has.
pub(super) fn base(class: &str, uid: &str, series: &str, modality: &str) -> Set {
    let mut set = Set::new_empty();
    put(&mut set, tags::SPECIFIC_CHARACTER_SET, VR::CS, "ISO_IR 192");
    put(&mut set, tags::SOP_CLASS_UID, VR::UI, class);
    put(&mut set, tags::SOP_INSTANCE_UID, VR::UI, uid);
    put(&mut set, tags::STUDY_DATE, VR::DA, "20260102");
    put(&mut set, tags::SERIES_DATE, VR::DA, "20260103");
    put(&mut set, tags::MODALITY, VR::CS, modality);
    put(&mut set, tags::PATIENT_NAME, VR::PN, "Müller^Jürgen");
    put(&mut set, tags::PATIENT_ID, VR::LO, "7");
    put(&mut set, tags::PATIENT_BIRTH_DATE, VR::DA, "19500607");
    put(&mut set, tags::STUDY_INSTANCE_UID, VR::UI, "1.9");
    put(&mut set, tags::SERIES_INSTANCE_UID, VR::UI, series);
    put(&mut set, tags::SERIES_NUMBER, VR::IS, series.rsplit('.').next().unwrap());
    put(&mut set, tags::FRAME_OF_REFERENCE_UID, VR::UI, "1.8");
    set
}

/// Stored value of a voxel.
pub(super) fn stored(i: usize, j: usize, k: usize) -> u16 {
    (1000 + i + 10 * j + 100 * k) as u16
}

pub(super) fn pixels(set: &mut Set, values: Vec<u16>) {
    put_u16(set, tags::SAMPLES_PER_PIXEL, 1);
    put(set, tags::PHOTOMETRIC_INTERPRETATION, VR::CS, "MONOCHROME2");
    put_u16(set, tags::ROWS, SIZE[1] as u16);
    put_u16(set, tags::COLUMNS, SIZE[0] as u16);
    put_u16(set, tags::BITS_ALLOCATED, 16);
    put_u16(set, tags::BITS_STORED, 16);
    put_u16(set, tags::HIGH_BIT, 15);
    put_u16(set, tags::PIXEL_REPRESENTATION, 0);
    set.put(DataElement::new(tags::PIXEL_DATA, VR::OW, PrimitiveValue::U16(values.into())));
}

/// Slice `k` of a series with 3 mm between slices, 2 mm between rows and 1.5 mm between columns;
/// slope 2, intercept -1024.
pub(super) fn slice(k: usize) -> Set {
    let mut set = base(CT, &format!("1.5.{k}"), "1.7.2", "CT");
    put(&mut set, tags::IMAGE_TYPE, VR::CS, "ORIGINAL\\PRIMARY\\AXIAL");
    // Neither number nor name tells the order.
    put(&mut set, tags::INSTANCE_NUMBER, VR::IS, &((k * 5) % 7).to_string());
    put(&mut set, tags::IMAGE_POSITION_PATIENT, VR::DS, &list(&[-10.0, -20.0, 30.0 + 3.0 * k as f64]));
    put(&mut set, tags::IMAGE_ORIENTATION_PATIENT, VR::DS, "1\\0\\0\\0\\1\\0");
    put(&mut set, tags::PIXEL_SPACING, VR::DS, "2\\1.5");
    put(&mut set, tags::SLICE_THICKNESS, VR::DS, "3");
    put(&mut set, tags::RESCALE_SLOPE, VR::DS, "2");
    put(&mut set, tags::RESCALE_INTERCEPT, VR::DS, "-1024");
    put(&mut set, tags::RESCALE_TYPE, VR::LO, "HU");
    let all = (0..SIZE[1]).flat_map(|j| (0..SIZE[0]).map(move |i| stored(i, j, k)));
    pixels(&mut set, all.collect());
    set
}

/// HU of a voxel of [`slice`].
pub(super) fn hu(i: usize, j: usize, k: usize) -> f32 {
    2.0 * f32::from(stored(i, j, k)) - 1024.0
}

/// Writes an object in explicit little endian.
pub(super) fn write(folder: &Path, name: &str, set: &Set) -> PathBuf {
    write_as(folder, name, set, uids::EXPLICIT_VR_LITTLE_ENDIAN)
}

pub(super) fn write_as(folder: &Path, name: &str, set: &Set, syntax: &str) -> PathBuf {
    let path = folder.join(name);
    let object = set.clone().with_meta(FileMetaTableBuilder::new().transfer_syntax(syntax)).unwrap();
    object.write_to_file(&path).unwrap();
    path
}

/// A series of six slices, each changed by `change`, in a new folder.
pub(super) fn series(change: impl Fn(usize, &mut Set)) -> tempfile::TempDir {
    let dir = tempfile::tempdir().unwrap();
    for k in 0..SIZE[2] {
        let mut set = slice(k);
        change(k, &mut set);
        write(dir.path(), &format!("IM{}", (k * 7 + 3) % 11), &set);
    }
    dir
}

/// A dose of three planes, 4 mm apart.
pub(super) fn dose(uid: &str, offsets: &[f64], values: impl Fn(usize) -> u16) -> Set {
    let mut set = base("1.2.840.10008.5.1.4.1.1.481.2", uid, "1.7.4", "RTDOSE");
    put(&mut set, tags::IMAGE_POSITION_PATIENT, VR::DS, "-10\\-20\\30");
    put(&mut set, tags::IMAGE_ORIENTATION_PATIENT, VR::DS, "1\\0\\0\\0\\1\\0");
    put(&mut set, tags::PIXEL_SPACING, VR::DS, "2\\1.5");
    put(&mut set, tags::NUMBER_OF_FRAMES, VR::IS, &offsets.len().to_string());
    put(&mut set, tags::GRID_FRAME_OFFSET_VECTOR, VR::DS, &list(offsets));
    put(&mut set, tags::DOSE_UNITS, VR::CS, "GY");
    put(&mut set, tags::DOSE_TYPE, VR::CS, "PHYSICAL");
    put(&mut set, tags::DOSE_SUMMATION_TYPE, VR::CS, "PLAN");
    put(&mut set, tags::DOSE_GRID_SCALING, VR::DS, "0.01");
    pixels(&mut set, (0..SIZE[0] * SIZE[1] * offsets.len()).map(values).collect());
    let mut plan = Set::new_empty();
    put(&mut plan, tags::REFERENCED_SOP_INSTANCE_UID, VR::UI, "1.6.1");
    put_items(&mut set, tags::REFERENCED_RT_PLAN_SEQUENCE, vec![plan]);
    set
}

/// One structure: name, and contours with their types.
pub(super) struct Roi<'a> {
    pub(super) name: &'a str,
    pub(super) contours: Vec<(&'a str, Vec<[f64; 3]>)>,
}

/// A structure set on frame `1.8`.
pub(super) fn structure_set(rois: &[Roi<'_>]) -> Set {
    let mut set = base("1.2.840.10008.5.1.4.1.1.481.3", "1.5.90", "1.7.3", "RTSTRUCT");
    set.remove_element(tags::FRAME_OF_REFERENCE_UID);
    put(&mut set, tags::STRUCTURE_SET_LABEL, VR::SH, "bones");
    let mut referenced = Set::new_empty();
    put(&mut referenced, tags::SERIES_INSTANCE_UID, VR::UI, "1.7.2");
    let mut study = Set::new_empty();
    put_items(&mut study, tags::RT_REFERENCED_SERIES_SEQUENCE, vec![referenced]);
    let mut frame = Set::new_empty();
    put(&mut frame, tags::FRAME_OF_REFERENCE_UID, VR::UI, "1.8");
    put_items(&mut frame, tags::RT_REFERENCED_STUDY_SEQUENCE, vec![study]);
    put_items(&mut set, tags::REFERENCED_FRAME_OF_REFERENCE_SEQUENCE, vec![frame]);
    let (mut list_of, mut drawn, mut seen) = (Vec::new(), Vec::new(), Vec::new());
    for (n, roi) in rois.iter().enumerate() {
        let number = (n + 1).to_string();
        let mut item = Set::new_empty();
        put(&mut item, tags::ROI_NUMBER, VR::IS, &number);
        put(&mut item, tags::REFERENCED_FRAME_OF_REFERENCE_UID, VR::UI, "1.8");
        put(&mut item, tags::ROI_NAME, VR::LO, roi.name);
        put(&mut item, tags::ROI_GENERATION_ALGORITHM, VR::CS, "MANUAL");
        list_of.push(item);
        let mut observed = Set::new_empty();
        put(&mut observed, tags::REFERENCED_ROI_NUMBER, VR::IS, &number);
        put(&mut observed, tags::RTROI_INTERPRETED_TYPE, VR::CS, "ORGAN");
        seen.push(observed);
        let mut item = Set::new_empty();
        put(&mut item, tags::REFERENCED_ROI_NUMBER, VR::IS, &number);
        put(&mut item, tags::ROI_DISPLAY_COLOR, VR::IS, "1\\2\\3");
        let contours = roi.contours.iter().map(|(kind, points)| {
            let mut contour = Set::new_empty();
            put(&mut contour, tags::CONTOUR_GEOMETRIC_TYPE, VR::CS, kind);
            put(&mut contour, tags::NUMBER_OF_CONTOUR_POINTS, VR::IS, &points.len().to_string());
            put(&mut contour, tags::CONTOUR_DATA, VR::DS, &list(&points.concat()));
            contour
        });
        let contours: Vec<Set> = contours.collect();
        if !contours.is_empty() {
            put_items(&mut item, tags::CONTOUR_SEQUENCE, contours);
        }
        drawn.push(item);
    }
    put_items(&mut set, tags::STRUCTURE_SET_ROI_SEQUENCE, list_of);
    put_items(&mut set, tags::ROI_CONTOUR_SEQUENCE, drawn);
    put_items(&mut set, tags::RTROI_OBSERVATIONS_SEQUENCE, seen);
    set
}

/// A square of half width `half` around x = -7, y = -17, in the plane at `z`.
pub(super) fn square(half: f64, z: f64) -> Vec<[f64; 3]> {
    [[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]].map(|[x, y]| [-7.0 + half * x, -17.0 + half * y, z]).to_vec()
}
