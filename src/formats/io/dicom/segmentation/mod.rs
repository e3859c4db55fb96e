//! Segmentations (PS3.3 A.51, C.8.20) as label maps: bits, fractions of which more than half counts, and maps of numbers.
//!
//! Each frame is a slice of one segment, in any order; slices without a frame are empty. A label is the segment's number.

mod lattice;
mod segments;
mod values;

pub(in crate::io) use segments::Segment;

use super::super::Loaded;
use super::super::bytes::{read_bytes, sha256};
use super::bones::BoneNames;
use super::ct::notes;
use super::elements::{Item, first, items, text, whole};
use super::find::Object;
use super::frames::{Places, Plane, plane, refuse};
use super::open;
use super::place::segmentation;
use super::structures::some_names;
use crate::error::{Error, Result};
use crate::findings;
use crate::geometry::Grid;
use crate::volume::{LabelMap, Volume};
use crate::warning::{Warning, counted};
use dicom_dictionary_std::{tags, uids};
use lattice::{Among, Lattice, Told, lattice};
use segments::segments;
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use values::{Kind, Stored, background};

/// Label maps that name their numbers, and segmentations of one frame for each segment and slice.
const READ: [&str; 2] = [uids::SEGMENTATION_STORAGE, uids::LABEL_MAP_SEGMENTATION_STORAGE];

/// What a header says of the frames.
struct Header {
    kind: Kind,
    segments: BTreeMap<u16, Segment>,
    /// The segment of each frame; `None` where the pixels tell.
    of: Vec<Option<u16>>,
    lattice: Lattice,
    warnings: Vec<Warning>,
}

impl Header {
    fn of(path: &Path, set: &Item, length: u64) -> Result<Self> {
        let class = text(set, tags::SOP_CLASS_UID);
        if !READ.contains(&class.as_str()) {
            let what = if class == uids::SURFACE_SEGMENTATION_STORAGE { "of surfaces" } else { "of a kind" };
            let problem = format!("it is a segmentation {what} that is not read (SOP Class UID {class})");
            let remedy = "export it as a segmentation of voxels, as contours, or as a label map";
            return Err(Error::refused(findings::SEGMENTS_ODD, path.display().to_string(), problem, remedy));
        }
        let what = path.display().to_string();
        let kind = Kind::of(path, set)?;
        let (segments, warnings) = segments(&what, set, background(kind, set))?;
        let own = items(set, tags::PER_FRAME_FUNCTIONAL_GROUPS_SEQUENCE);
        let shared = first(set, tags::SHARED_FUNCTIONAL_GROUPS_SEQUENCE);
        let count = whole(set, tags::NUMBER_OF_FRAMES);
        if count != i64::try_from(own.len()).ok() {
            let count = count.map_or("no".into(), |n| n.to_string());
            return Err(refuse(path, format!("it says {count} frames, and describes {}", own.len())));
        }
        let (mut planes, mut of) = (Vec::with_capacity(own.len()), Vec::with_capacity(own.len()));
        for (n, item) in own.iter().enumerate() {
            let places = Places { set, own: Some(item), shared };
            planes.push(plane(path, places)?);
            of.push(if kind == Kind::Labelmap { None } else { Some(segment(&what, n + 1, places, &segments)?) });
        }
        let told = Told::of(set, own.first(), shared);
        let lattice = lattice(path, &planes, &told, !covers(set, &planes), length)?;
        once(&what, &of, &lattice, &segments)?;
        Ok(Self { kind, segments, of, lattice, warnings })
    }
}

/// The segment that a frame is of.
fn segment(what: &str, frame: usize, places: Places<'_>, segments: &BTreeMap<u16, Segment>) -> Result<u16> {
    let refuse =
        |problem: String| Err(Error::refused(findings::SEGMENTS_ODD, what, problem, "export the segmentation again"));
    let sequence = tags::SEGMENT_IDENTIFICATION_SEQUENCE;
    let group = [places.own, places.shared].into_iter().flatten().find(|g| !items(g, sequence).is_empty());
    let named = group.map_or(&[][..], |g| items(g, sequence));
    let [one] = named else {
        return refuse(format!("frame {frame} names {} segments that it is of, not one", named.len()));
    };
    let values = one.get(tags::REFERENCED_SEGMENT_NUMBER).and_then(|e| e.to_multi_int::<i64>().ok());
    match values.as_deref() {
        Some([number]) => match u16::try_from(*number).ok().filter(|n| segments.contains_key(n)) {
            Some(number) => Ok(number),
            None => refuse(format!("frame {frame} is of segment {number}, which nothing defines")),
        },
        Some(many) if many.len() > 1 => refuse(format!("frame {frame} is of {} segments, not of one", many.len())),
        _ => refuse(format!("frame {frame} has no usable Referenced Segment Number")),
    }
}

/// Whether frames lie on as many slices as the images have that it was made of.
fn covers(set: &Item, planes: &[Plane]) -> bool {
    let series = items(set, tags::REFERENCED_SERIES_SEQUENCE);
    let [series] = series else { return false };
    let images = items(series, tags::REFERENCED_INSTANCE_SEQUENCE).len();
    let mut places: Vec<[i64; 3]> =
        planes.iter().map(|p| [p.position.x, p.position.y, p.position.z].map(|c| (100.0 * c).round() as i64)).collect();
    places.sort_unstable();
    places.dedup();
    images > 1 && places.len() >= images
}

/// Refuses two frames of one segment at one place.
fn once(what: &str, of: &[Option<u16>], lattice: &Lattice, segments: &BTreeMap<u16, Segment>) -> Result<()> {
    let mut seen: BTreeMap<(Option<u16>, usize), usize> = BTreeMap::new();
    for (n, (segment, slice)) in of.iter().zip(&lattice.slices).enumerate() {
        if let Some(other) = seen.insert((*segment, *slice), n) {
            let name = segment.and_then(|s| segments.get(&s)).map_or(String::new(), |s| format!(" of {:?}", s.name));
            let problem = format!("frames {} and {}{name} lie at one place", other + 1, n + 1);
            let remedy = "export each phase or observer as a segmentation of its own";
            return Err(Error::refused(findings::DICOM_DUPLICATES, what, problem, remedy));
        }
    }
    Ok(())
}

/// Reads a segmentation, the one in a folder, or `FOLDER#NUMBER`: those of its segments that `keep` names differently or at
/// all. Labels are the segments' numbers; the grid is that of the frames, with an empty slice at both ends unless frames lie on
/// every slice of the series.
///
/// # Errors
/// [`Error::Read`] when it is missing or damaged. [`Error::Input`] when it is none or several, when its segments are not told
/// apart or overlap, when its frames do not lie on one grid, and when it is compressed in a way that is not read.
pub(in crate::io) fn read_segmentation(
    path: &Path,
    keep: &dyn Fn(&Segment) -> Option<String>,
) -> Result<Loaded<LabelMap>> {
    let (object, mut warnings) = the_one(path)?;
    let bytes = read_bytes(&object.path)?;
    let set = open::whole(&object.path, &bytes)?;
    let header = Header::of(&object.path, &set, bytes.len() as u64)?;
    warnings.extend(header.warnings.iter().cloned());
    let names: BTreeMap<u16, String> = header.segments.values().filter_map(|s| Some((s.number, keep(s)?))).collect();
    let stored = Stored::of(&object.path, &set, header.kind, header.of.len())?;
    let what = object.path.display().to_string();
    let labels = labels(&what, &header, &stored, &names)?;
    let grid = header.lattice.grid;
    let mut notes = notes("DICOM Segmentation", &set, &grid, None, &object.series.description);
    notes.datatype = header.kind.name().to_lowercase();
    let value = LabelMap { volume: Volume::new(grid, labels)?, names };
    Ok(Loaded { value, path: object.path, sha256: sha256(&bytes), header: notes, warnings })
}

/// The label of each voxel.
fn labels(what: &str, header: &Header, stored: &Stored, names: &BTreeMap<u16, String>) -> Result<Vec<u16>> {
    let grid = &header.lattice.grid;
    let slice = grid.strides()[2];
    let mut labels = vec![0u16; grid.len()];
    let mut overlaps: BTreeMap<(u16, u16), usize> = BTreeMap::new();
    let mut undefined = BTreeSet::new();
    for (n, (of, at)) in header.of.iter().zip(&header.lattice.slices).enumerate() {
        if of.is_some_and(|own| !names.contains_key(&own)) {
            continue;
        }
        let Some(out) = labels.get_mut(at * slice..(at + 1) * slice) else { continue };
        stored.each(n, |place, number| {
            let own = match (of, number) {
                (Some(own), _) => *own,
                (None, number) => {
                    let own = number.and_then(|n| u16::try_from(n).ok()).filter(|n| header.segments.contains_key(n));
                    let Some(own) = own else {
                        undefined.insert(number.unwrap_or_default());
                        return;
                    };
                    if !names.contains_key(&own) {
                        return;
                    }
                    own
                }
            };
            match out.get_mut(place) {
                Some(label) if *label == 0 => *label = own,
                Some(label) if *label != own => {
                    *overlaps.entry((own.min(*label), own.max(*label))).or_default() += 1;
                }
                _ => {}
            }
        });
    }
    if let Some(number) = undefined.first() {
        let problem =
            format!("voxels are of segment {number}, which nothing defines ({} such numbers)", undefined.len());
        return Err(Error::refused(findings::SEGMENTS_ODD, what, problem, "export the segmentation again"));
    }
    if overlaps.is_empty() {
        return Ok(labels);
    }
    let name = |n: &u16| names.get(n).map_or("", String::as_str);
    let all: Vec<String> = overlaps
        .iter()
        .map(|((a, b), count)| format!("{} and {} ({})", name(a), name(b), counted(*count, "voxel", "voxels")))
        .collect();
    let problem = format!("segments overlap, and a label map has one label for each voxel: {}", some_names(&all));
    let remedy = "export segments that overlap as segmentations of their own, or as contours";
    Err(Error::refused(findings::SEGMENTS_OVERLAP, what, problem, remedy))
}

/// The segmentation that a path means.
fn the_one(path: &Path) -> Result<(Object, Vec<Warning>)> {
    segmentation(path)?.ok_or_else(|| {
        let what = path.display().to_string();
        Error::refused(findings::SEGMENTS_ODD, what, "it holds no segmentation", "give a file of modality SEG")
    })
}

/// The grid of a segmentation's frames, by its header.
///
/// # Errors
/// As [`read_segmentation`], but for the pixels.
pub(super) fn read_grid(path: &Path) -> Result<(Grid, Vec<Warning>)> {
    let (object, mut warnings) = the_one(path)?;
    let header = described(&object)?;
    warnings.extend(header.warnings);
    Ok((header.lattice.grid, warnings))
}

/// What a segmentation is, in words, and its grid, by its header.
pub(super) fn describe(object: &Object) -> Result<(String, Grid)> {
    let header = described(object)?;
    let names: Vec<&str> = header.segments.values().map(|s| s.name.as_str()).collect();
    Ok((format!("{} segments ({})", names.len(), some_names(&names)), header.lattice.grid))
}

fn described(object: &Object) -> Result<Header> {
    let length = std::fs::metadata(&object.path).map_or(0, |about| about.len());
    Header::of(&object.path, &object.header, length)
}

/// The name of a segment that is no bone by anything, as it is; of others the bone.
pub(in crate::io) fn bone_or_name(segment: &Segment) -> Option<String> {
    Some(segment.bone(&BoneNames::default()).unwrap_or_else(|| segment.name.clone()))
}

/// Labels on the voxels of `grid`, which are also theirs.
///
/// # Errors
/// [`Error::Input`] when the voxels are not the same, and when a labelled one lies outside.
pub(in crate::io) fn on_grid(path: &Path, map: &LabelMap, grid: &Grid) -> Result<LabelMap> {
    let own = map.volume.grid();
    let refuse = |problem: String| {
        let remedy =
            "give the segmentation of this image, or resample it onto its grid with nearest-neighbour interpolation";
        Err(Error::refused(findings::LABELS_ELSEWHERE, path.display().to_string(), problem, remedy))
    };
    let Some(among) = Among::of(own, grid) else {
        return refuse(format!(
            "its voxels ({:.3?} mm, first at {:.2?}) are not those of the image ({:.3?} mm, first at {:.2?})",
            own.spacing(),
            own.origin().coords.as_slice(),
            grid.spacing(),
            grid.origin().coords.as_slice()
        ));
    };
    let mut labels = vec![0u16; grid.len()];
    let mut outside = 0usize;
    for (n, label) in map.volume.data().iter().enumerate().filter(|(_, label)| **label > 0) {
        match among.voxel(own.voxel(n), grid.size()) {
            Some(voxel) => labels[grid.linear(voxel)] = *label,
            None => outside += 1,
        }
    }
    if outside > 0 {
        return refuse(format!("{outside} of its labelled voxels lie outside the image"));
    }
    Ok(LabelMap { volume: Volume::new(grid.clone(), labels)?, names: map.names.clone() })
}
