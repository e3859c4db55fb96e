//! Segmentations: a bit for each voxel of each segment (PS3.3 A.51, C.8.20), a frame for each slice that a segment reaches.

use super::super::elements::{Item, items, text as told};
use super::super::series::Series;
use super::super::terms::term_of;
use super::common::{NewSeries, Origin, frame, instances, put, save};
use super::element::{code, decimals, empty, integer, item, reference, sequence, short, text, texts};
use super::plane::{Frames, orientation, plane_size};
use crate::error::{Error, Result};
use crate::geometry::Grid;
use crate::volume::LabelMap;
use dicom_core::value::PrimitiveValue;
use dicom_core::{DataElement, Tag, VR};
use dicom_dictionary_std::{tags, uids};
use dicom_object::InMemDicomObject;
use dicom_object::mem::InMemElement;
use std::collections::BTreeSet;
use std::path::Path;

/// Positions of slices closer than this are one, mm.
const SAME_MM: f64 = 0.01;
/// Longest Segment Label.
const LONGEST: usize = 64;
/// What a source may say of a segment that stays true of the same segment elsewhere.
const KEPT: [Tag; 7] = [
    tags::SEGMENTED_PROPERTY_CATEGORY_CODE_SEQUENCE,
    tags::SEGMENTED_PROPERTY_TYPE_CODE_SEQUENCE,
    tags::ANATOMIC_REGION_SEQUENCE,
    tags::RECOMMENDED_DISPLAY_CIE_LAB_VALUE,
    tags::SEGMENT_DESCRIPTION,
    tags::TRACKING_ID,
    tags::TRACKING_UID,
];

/// What a new segmentation says of itself.
#[derive(Debug, Clone, Copy)]
pub struct DerivedSegmentation<'a> {
    /// What the object is among those of one [`Origin`], for its UIDs: `labels`.
    pub role: &'a str,
    /// Series Description, at most 64 characters.
    pub description: &'a str,
    /// Series Number.
    pub number: i32,
    /// The series whose frame of reference the labels lie in.
    pub on: &'a Series,
}

/// Writes a label map, LPS mm. `source` is the header of the segmentation that the labels come from, if any: what it says of
/// segments of the same name is kept. Segments are numbered anew, in the order of the labels.
///
/// # Errors
/// [`Error::Write`] when no voxel is labelled, a name is longer than 64 characters, the grid has too many rows or columns,
/// neither the series nor its study has a date, or the file cannot be written.
pub(in super::super) fn write_segmentation(
    path: &Path,
    map: &LabelMap,
    about: &DerivedSegmentation<'_>,
    origin: &Origin,
    source: Option<&Item>,
) -> Result<()> {
    let grid = map.volume.grid();
    let [columns, rows] = plane_size(path, grid)?;
    let (date, time) = origin.dated(path)?;
    // Segments are numbered from 1 without a gap (PS3.3 C.8.20.2).
    let labels: Vec<u16> = map.counts().into_keys().collect();
    let segments =
        (1..).zip(&labels).map(|(n, label)| segment(path, n, *label, map, source)).collect::<Result<Vec<_>>>()?;
    let (places, bits) = bits(map, &labels);
    if places.is_empty() {
        let problem = "no voxel is labelled, and a segmentation has at least one frame";
        return Err(Error::write(path, problem, "give labels that lie on this grid"));
    }
    if bits.len() as u64 >= u64::from(u32::MAX) - 1 {
        let problem = format!("{} frames of {columns} x {rows} bits take more than 4 GB", places.len());
        return Err(Error::write(path, problem, "choose a coarser grid"));
    }
    let uid = origin.uid(&[about.role, "series"]);
    let new = NewSeries {
        uid: &uid,
        class: uids::SEGMENTATION_STORAGE,
        modality: "SEG",
        number: about.number,
        description: about.description,
        frame_of_reference: &about.on.frame_of_reference,
    };
    let mut object = frame(origin, &new, &origin.uid(&[about.role, "object"]));
    put(&mut object, instances(&origin.study_uid(), &[about.on]));
    put(&mut object, of_kind(date, time, [columns, rows], places.len()));
    put(&mut object, dimensions(&origin.uid(&[about.role, "dimensions"])));
    object.put(sequence(tags::SEGMENT_SEQUENCE, segments));
    object.put(sequence(tags::SHARED_FUNCTIONAL_GROUPS_SEQUENCE, vec![shared(grid)]));
    let per_frame = places.iter().map(|place| own(grid, place, about.on)).collect();
    object.put(sequence(tags::PER_FRAME_FUNCTIONAL_GROUPS_SEQUENCE, per_frame));
    object.put(DataElement::new(tags::PIXEL_DATA, VR::OB, PrimitiveValue::U8(bits.into())));
    save(path, object)
}

/// A frame: the segment's number, the slice of the grid, and the slice's place along the normal, from 1.
struct FramePlace {
    segment: u16,
    slice: usize,
    along: usize,
}

/// Frames by segment and along the normal, and their bits one after another (PS3.5 8.1.1).
fn bits(map: &LabelMap, labels: &[u16]) -> (Vec<FramePlace>, Vec<u8>) {
    let (data, order) = (map.volume.data(), Frames::of(map.volume.grid()));
    let there: Vec<(usize, BTreeSet<u16>)> = order
        .order()
        .map(|k| {
            let mut all = order.values(data, k).to_vec();
            all.dedup();
            (k, all.into_iter().collect())
        })
        .collect();
    let (mut places, mut bytes, mut bit) = (Vec::new(), Vec::new(), 0usize);
    for (segment, label) in (1..).zip(labels) {
        for (along, (slice, _)) in there.iter().enumerate().filter(|(_, (_, there))| there.contains(label)) {
            places.push(FramePlace { segment, slice: *slice, along: along + 1 });
            let values = order.values(data, *slice);
            bytes.resize((bit + values.len()).div_ceil(8), 0u8);
            for (n, _) in values.iter().enumerate().filter(|(_, l)| *l == label) {
                bytes[(bit + n) / 8] |= 1 << ((bit + n) % 8);
            }
            bit += values.len();
        }
    }
    bytes.resize(bytes.len().next_multiple_of(2), 0);
    (places, bytes)
}

/// What the segmentation is (PS3.3 C.7.5.2, C.7.6.3, C.8.20.2).
fn of_kind(date: &str, time: &str, [columns, rows]: [u16; 2], frames: usize) -> Vec<InMemElement> {
    vec![
        texts(tags::IMAGE_TYPE, VR::CS, ["DERIVED", "PRIMARY"]),
        integer(tags::INSTANCE_NUMBER, 1),
        text(tags::CONTENT_DATE, VR::DA, date),
        text(tags::CONTENT_TIME, VR::TM, time),
        text(tags::CONTENT_LABEL, VR::CS, "LABELS"),
        text(tags::CONTENT_DESCRIPTION, VR::LO, "Labels carried by registration; research only"),
        empty(tags::CONTENT_CREATOR_NAME, VR::PN),
        text(tags::DEVICE_SERIAL_NUMBER, VR::LO, "none"),
        integer(tags::NUMBER_OF_FRAMES, frames as i64),
        short(tags::SAMPLES_PER_PIXEL, 1),
        text(tags::PHOTOMETRIC_INTERPRETATION, VR::CS, "MONOCHROME2"),
        short(tags::ROWS, rows),
        short(tags::COLUMNS, columns),
        short(tags::BITS_ALLOCATED, 1),
        short(tags::BITS_STORED, 1),
        short(tags::HIGH_BIT, 0),
        short(tags::PIXEL_REPRESENTATION, 0),
        text(tags::LOSSY_IMAGE_COMPRESSION, VR::CS, "00"),
        text(tags::SEGMENTATION_TYPE, VR::CS, "BINARY"),
        text(tags::SEGMENTS_OVERLAP, VR::CS, "NO"),
    ]
}

/// Frames are told apart by segment and place (PS3.3 C.7.6.17).
fn dimensions(uid: &str) -> [InMemElement; 2] {
    let pointer = |tag: Tag, group: Tag, name: &str| {
        item([
            DataElement::new(tags::DIMENSION_INDEX_POINTER, VR::AT, PrimitiveValue::from(tag)),
            DataElement::new(tags::FUNCTIONAL_GROUP_POINTER, VR::AT, PrimitiveValue::from(group)),
            text(tags::DIMENSION_ORGANIZATION_UID, VR::UI, uid),
            text(tags::DIMENSION_DESCRIPTION_LABEL, VR::LO, name),
        ])
    };
    let segment = pointer(tags::REFERENCED_SEGMENT_NUMBER, tags::SEGMENT_IDENTIFICATION_SEQUENCE, "Segment");
    let place = pointer(tags::IMAGE_POSITION_PATIENT, tags::PLANE_POSITION_SEQUENCE, "Place along the normal");
    [
        sequence(
            tags::DIMENSION_ORGANIZATION_SEQUENCE,
            vec![item([text(tags::DIMENSION_ORGANIZATION_UID, VR::UI, uid)])],
        ),
        sequence(tags::DIMENSION_INDEX_SEQUENCE, vec![segment, place]),
    ]
}

/// What a segment is (PS3.3 C.8.20.4).
fn segment(path: &Path, number: u16, label: u16, map: &LabelMap, source: Option<&Item>) -> Result<InMemDicomObject> {
    let name = map.names.get(&label).cloned().unwrap_or_else(|| format!("label {label}"));
    if name.chars().count() > LONGEST || name.contains('\\') || name.chars().any(char::is_control) {
        let problem = format!("the name {name:?} cannot be a Segment Label: at most 64 characters, no backslash");
        return Err(Error::write(path, problem, "give the label a shorter name, with --labels"));
    }
    let mut segment = item([
        short(tags::SEGMENT_NUMBER, number),
        text(tags::SEGMENT_LABEL, VR::LO, name.as_str()),
        text(tags::SEGMENT_ALGORITHM_TYPE, VR::CS, "AUTOMATIC"),
        text(tags::SEGMENT_ALGORITHM_NAME, VR::LO, "aventail"),
        sequence(
            tags::SEGMENTED_PROPERTY_CATEGORY_CODE_SEQUENCE,
            vec![code("123037004", "SCT", "Anatomical Structure")],
        ),
    ]);
    let kind = match term_of(&name) {
        Some(((value, meaning), side)) => {
            let mut kind = code(value, "SCT", meaning);
            if let Some((value, meaning)) = side {
                let side = vec![code(value, "SCT", meaning)];
                kind.put(sequence(tags::SEGMENTED_PROPERTY_TYPE_MODIFIER_CODE_SEQUENCE, side));
            }
            kind
        }
        None => code("91723000", "SCT", "Anatomical structure"),
    };
    segment.put(sequence(tags::SEGMENTED_PROPERTY_TYPE_CODE_SEQUENCE, vec![kind]));
    let same = |s: &&Item| told(s, tags::SEGMENT_LABEL) == name;
    let known = source.and_then(|set| items(set, tags::SEGMENT_SEQUENCE).iter().find(same));
    for element in known.into_iter().flat_map(|s| KEPT.iter().filter_map(|tag| s.get(*tag))) {
        segment.put(element.clone());
    }
    Ok(segment)
}

/// What all frames have in common.
fn shared(grid: &Grid) -> InMemDicomObject {
    let [across, down, thick] = grid.spacing();
    item([
        sequence(
            tags::PIXEL_MEASURES_SEQUENCE,
            vec![item([
                // Between rows first, then between columns (PS3.3 10.7.1.3).
                decimals(tags::PIXEL_SPACING, [down, across]),
                decimals(tags::SLICE_THICKNESS, [thick]),
                decimals(tags::SPACING_BETWEEN_SLICES, [thick]),
            ])],
        ),
        sequence(
            tags::PLANE_ORIENTATION_SEQUENCE,
            vec![item([decimals(tags::IMAGE_ORIENTATION_PATIENT, orientation(grid))])],
        ),
    ])
}

/// What a frame has of its own.
fn own(grid: &Grid, place: &FramePlace, on: &Series) -> InMemDicomObject {
    let position = grid.centre([0, 0, place.slice]);
    let index = PrimitiveValue::U32([place.segment.into(), place.along as u32].into_iter().collect());
    let mut groups = item([
        sequence(
            tags::FRAME_CONTENT_SEQUENCE,
            vec![item([DataElement::new(tags::DIMENSION_INDEX_VALUES, VR::UL, index)])],
        ),
        sequence(
            tags::PLANE_POSITION_SEQUENCE,
            vec![item([decimals(tags::IMAGE_POSITION_PATIENT, position.coords.iter().copied())])],
        ),
        sequence(
            tags::SEGMENT_IDENTIFICATION_SEQUENCE,
            vec![item([short(tags::REFERENCED_SEGMENT_NUMBER, place.segment)])],
        ),
    ]);
    let along = |p: &nalgebra::Point3<f64>| grid.direction().column(2).dot(&p.coords);
    let slice = on.slices.iter().find(|s| (along(&s.position) - along(&position)).abs() <= SAME_MM);
    if let Some(slice) = slice {
        let mut image = reference(&on.sop_class, &slice.uid);
        if let Some(frame) = slice.frame {
            image.put(integer(tags::REFERENCED_FRAME_NUMBER, frame.into()));
        }
        let purpose = code("121322", "DCM", "Source image for image processing operation");
        image.put(sequence(tags::PURPOSE_OF_REFERENCE_CODE_SEQUENCE, vec![purpose]));
        let derivation = item([
            sequence(tags::SOURCE_IMAGE_SEQUENCE, vec![image]),
            sequence(tags::DERIVATION_CODE_SEQUENCE, vec![code("113076", "DCM", "Segmentation")]),
        ]);
        groups.put(sequence(tags::DERIVATION_IMAGE_SEQUENCE, vec![derivation]));
    }
    groups
}

#[cfg(test)]
mod tests;
