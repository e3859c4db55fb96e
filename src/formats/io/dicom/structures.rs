//! Structure sets (PS3.3 C.8.8.5, C.8.8.6, C.8.8.8): closed planar contours with the names of their
//! structures.

use super::super::bytes::{read_bytes, sha256};
use super::super::raster::HeaderNotes;
use super::super::series_path::root_of;
use super::beside::beside;
use super::counts::{images_of, lost};
use super::elements::{Item, items, numbers, text, whole};
use super::find::{Object, frame_of_structures, series};
use super::open;
use super::place::{objects, of_kind};
use super::planes::{Drawing, planes};
use super::series::{Patient, Series, Study};
use crate::error::{Error, Result};
use crate::findings;
use crate::geometry::Grid;
use crate::volume::contour::{Contours, Structure};
use crate::warning::Warning;
use dicom_dictionary_std::tags;
use serde::Serialize;
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

/// Structures that a message names.
const NAMED: usize = 12;

/// What a structure set says of one structure.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize)]
pub struct Roi {
    /// ROI Number.
    pub number: i64,
    /// Name, made unique where the set uses it twice.
    pub name: String,
    /// RT ROI Interpreted Type: `ORGAN`, `PTV`, `EXTERNAL`, ...; empty where it does not say.
    pub interpreted_type: String,
    /// ROI Display Color.
    pub colour: Option<[u8; 3]>,
    /// ROI Generation Algorithm: `AUTOMATIC`, `SEMIAUTOMATIC`, `MANUAL`.
    pub generation_algorithm: String,
    /// Whether it has no closed contour.
    pub empty: bool,
}

/// A structure set.
#[derive(Debug, Clone)]
pub struct StructureSet {
    /// The file.
    pub path: PathBuf,
    /// SHA-256 of its bytes.
    pub sha256: String,
    /// The contours, LPS mm; structures in the order of `rois`, empty ones among them.
    pub contours: Contours,
    /// What it says of each structure.
    pub rois: Vec<Roi>,
    /// Frame of Reference UID of the contours; empty where it does not say.
    pub frame_of_reference: String,
    /// Series Instance UIDs of the images that it was drawn on.
    pub referenced_series: BTreeSet<String>,
    /// SOP Instance UIDs of the images of each of these series.
    pub referenced_images: BTreeMap<String, BTreeSet<String>>,
    /// The patient.
    pub patient: Patient,
    /// The study.
    pub study: Study,
    /// Structure Set Label.
    pub label: String,
    /// SOP Instance UID.
    pub uid: String,
    /// What was left out, and what is missing.
    pub warnings: Vec<Warning>,
}

/// Reads a structure set, or the one in a folder.
///
/// Contours of one plane follow the even-odd rule (as in [`crate::volume::contour`]), which is what
/// both inner contours and CLOSEDPLANAR_XOR mean; keyhole contours come out right by it, too.
///
/// # Errors
/// [`Error::Read`] when it is missing or damaged; [`Error::Input`] when it is no structure set,
/// when a folder holds several, or beside one a file that may be one and cannot be read, and when no
/// structure is left: those of another frame of reference than the others, on other planes, or with a
/// contour that contradicts itself are left out by name.
pub fn read_structure_set(path: impl AsRef<Path>) -> Result<StructureSet> {
    let path = path.as_ref();
    let (object, mut warnings) = the_one(path)?;
    let bytes = read_bytes(&object.path)?;
    let set = open::whole(&object.path, &bytes)?;
    let set: &Item = &set;
    let what = object.path.display().to_string();
    numbers_once(&what, set)?;
    let mut rois = rois(&what, set, &mut warnings);
    let (frame_of_reference, strangers) = frame(&what, set, &mut warnings);
    let (mut drawings, odd) = drawings(&what, set, &rois, &mut warnings);
    let elsewhere = elsewhere(&rois, &mut drawings, &strangers);
    let (contours, tilted) = planes(&what, &drawings)?;
    let is_left =
        |r: &Roi| odd.iter().chain(&tilted).chain(&elsewhere).any(|l| l.starts_with(&format!("{:?} (", r.name)));
    let left =
        |left: &[String]| format!("{what}: structures are left out, with all their contours: {}", some_names(left));
    if !odd.is_empty() {
        warnings.push(Warning::new(findings::STRUCTURES_ODD, left(&odd)));
    }
    if !elsewhere.is_empty() {
        let message = format!("{} ({frame_of_reference} is that of the others)", left(&elsewhere));
        warnings.push(Warning::new(findings::STRUCTURES_FRAME, message));
    }
    if !tilted.is_empty() {
        warnings.push(Warning::new(findings::STRUCTURES_PLANES, left(&tilted)));
    }
    for (roi, structure) in rois.iter_mut().zip(&contours.structures) {
        roi.empty = structure.polygons.is_empty();
    }
    let empty: Vec<&str> = rois.iter().filter(|r| r.empty && !is_left(r)).map(|r| r.name.as_str()).collect();
    if !empty.is_empty() {
        let message = format!("{what}: structures without a closed contour: {}", some_names(&empty));
        warnings.push(Warning::new(findings::STRUCTURES_EMPTY, message));
    }
    if rois.iter().all(|r| r.empty) {
        let problem = "no structure has a closed contour";
        return Err(Error::refused(
            findings::STRUCTURES_EMPTY,
            what,
            problem,
            "export the structure set with its contours",
        ));
    }
    let series = series(set);
    Ok(StructureSet {
        sha256: sha256(&bytes),
        contours,
        rois,
        frame_of_reference,
        referenced_series: images_of(set).keys().cloned().collect(),
        referenced_images: images_of(set),
        patient: series.patient,
        study: series.study,
        label: text(set, tags::STRUCTURE_SET_LABEL),
        uid: text(set, tags::SOP_INSTANCE_UID),
        path: object.path,
        warnings,
    })
}

/// The structure set that a path means, with what is to be known of the files beside it.
fn the_one(path: &Path) -> Result<(Object, Vec<Warning>)> {
    let found = objects(&root_of(path))?;
    let sets: Vec<&Object> = found.objects.iter().filter(|o| o.series.modality == "RTSTRUCT").collect();
    if let [one] = sets.as_slice() {
        let warnings = beside(path, &found, &sets, &|damaged| of_kind(damaged, "RTSTRUCT"))?;
        return Ok(((*one).clone(), warnings));
    }
    if let (true, Some(damaged)) =
        (sets.is_empty(), found.damaged.iter().find(|damaged| of_kind(damaged, "RTSTRUCT") == Some(true)))
    {
        return Err(open::damaged(&damaged.path, &damaged.why));
    }
    let list: String = sets
        .iter()
        .map(|o| format!("\n    {}: {:?}", o.path.display(), text(&o.header, tags::STRUCTURE_SET_LABEL)))
        .collect();
    let (problem, remedy) = if sets.is_empty() {
        ("it holds no structure set".to_owned(), "give an RTSTRUCT file")
    } else {
        (format!("it holds {} structure sets:{list}", sets.len()), "give the file of the one that is meant")
    };
    Err(Error::refused(findings::STRUCTURES_SEVERAL, path.display().to_string(), problem, remedy))
}

/// Refuses numbers that belong to several structures: whose contours are whose cannot be told.
fn numbers_once(what: &str, set: &Item) -> Result<()> {
    let mut named: BTreeMap<i64, Vec<String>> = BTreeMap::new();
    for item in items(set, tags::STRUCTURE_SET_ROI_SEQUENCE) {
        let Some(number) = whole(item, tags::ROI_NUMBER) else { continue };
        named.entry(number).or_default().push(text(item, tags::ROI_NAME));
    }
    let mut drawn: BTreeMap<i64, usize> = BTreeMap::new();
    let contours = items(set, tags::ROI_CONTOUR_SEQUENCE).iter();
    for item in contours.filter(|item| !items(item, tags::CONTOUR_SEQUENCE).is_empty()) {
        if let Some(number) = whole(item, tags::REFERENCED_ROI_NUMBER) {
            *drawn.entry(number).or_default() += 1;
        }
    }
    let twice = named.iter().find(|(_, names)| names.len() > 1).map(|(number, names)| {
        let names = names.iter().map(|name| format!("{name:?}")).collect::<Vec<_>>().join(" and ");
        format!("the structures {names} have one ROI Number ({number})")
    });
    let twice = twice.or_else(|| {
        let (number, count) = drawn.into_iter().find(|(_, count)| *count > 1)?;
        let name = named.get(&number).and_then(|names| names.first()).map_or("", String::as_str);
        Some(format!(
            "contours stand in {count} places for the ROI Number {number} ({name:?}), as if of several structures"
        ))
    });
    let Some(problem) = twice else { return Ok(()) };
    let remedy = "export the structure set again, each structure with a number of its own";
    Err(Error::refused(findings::STRUCTURES_NUMBERS, what, problem, remedy))
}

/// What each structure is observed as, by its number: the first that is told.
fn kinds(what: &str, set: &Item, warnings: &mut Vec<Warning>) -> BTreeMap<i64, String> {
    let mut kinds: BTreeMap<i64, String> = BTreeMap::new();
    let mut differ = BTreeSet::new();
    for o in items(set, tags::RTROI_OBSERVATIONS_SEQUENCE) {
        let Some(number) = whole(o, tags::REFERENCED_ROI_NUMBER) else { continue };
        let kind = text(o, tags::RTROI_INTERPRETED_TYPE);
        let own = kinds.entry(number).or_default();
        if own.is_empty() {
            *own = kind;
        } else if !kind.is_empty() && *own != kind {
            differ.insert(format!("number {number} ({own}, {kind})"));
        }
    }
    if !differ.is_empty() {
        let differ: Vec<String> = differ.into_iter().collect();
        let message = format!("{what}: structures are of several types, the first is taken: {}", some_names(&differ));
        warnings.push(Warning::new(findings::STRUCTURES_NUMBERS, message));
    }
    kinds
}

/// Numbers, names and kinds; names that repeat get the number of the structure behind them.
fn rois(what: &str, set: &Item, warnings: &mut Vec<Warning>) -> Vec<Roi> {
    let kinds = kinds(what, set, warnings);
    let mut seen: BTreeSet<String> = BTreeSet::new();
    let mut twice = Vec::new();
    let mut rois = Vec::new();
    for (n, item) in items(set, tags::STRUCTURE_SET_ROI_SEQUENCE).iter().enumerate() {
        let number = whole(item, tags::ROI_NUMBER).unwrap_or(-1 - n as i64);
        let given = text(item, tags::ROI_NAME);
        let mut name = if given.is_empty() { format!("ROI {number}") } else { given };
        if seen.contains(&name) {
            twice.push(name.clone());
            while seen.contains(&name) {
                name = format!("{name} ({number})");
            }
        }
        seen.insert(name.clone());
        rois.push(Roi {
            number,
            name,
            interpreted_type: kinds.get(&number).cloned().unwrap_or_default(),
            generation_algorithm: text(item, tags::ROI_GENERATION_ALGORITHM),
            ..Roi::default()
        });
    }
    if !twice.is_empty() {
        twice.dedup();
        let message = format!(
            "{what}: names are used twice: {}; the later structures have their number behind the name",
            some_names(&twice)
        );
        warnings.push(Warning::new(findings::STRUCTURES_NAMES, message));
    }
    let colours = items(set, tags::ROI_CONTOUR_SEQUENCE).iter().filter_map(|c| {
        let colour: [f64; 3] = numbers(c, tags::ROI_DISPLAY_COLOR)?.try_into().ok()?;
        Some((whole(c, tags::REFERENCED_ROI_NUMBER)?, colour.map(|v| v.clamp(0.0, 255.0) as u8)))
    });
    let colours: BTreeMap<i64, [u8; 3]> = colours.collect();
    rois.iter_mut().for_each(|r| r.colour = colours.get(&r.number).copied());
    rois
}

/// The frame of reference of the structures, and that of those in another one, by their numbers.
fn frame(what: &str, set: &Item, warnings: &mut Vec<Warning>) -> (String, BTreeMap<i64, String>) {
    let drawn: BTreeSet<i64> = items(set, tags::ROI_CONTOUR_SEQUENCE)
        .iter()
        .filter(|c| !items(c, tags::CONTOUR_SEQUENCE).is_empty())
        .filter_map(|c| whole(c, tags::REFERENCED_ROI_NUMBER))
        .collect();
    let one = frame_of_structures(set, Some(&drawn)).unwrap_or_else(|| {
        let all = items(set, tags::REFERENCED_FRAME_OF_REFERENCE_SEQUENCE).iter();
        let all: BTreeSet<String> = all.map(|f| text(f, tags::FRAME_OF_REFERENCE_UID)).collect();
        let listed = if all.len() == 1 { all.into_iter().next() } else { None };
        listed.unwrap_or_else(|| text(set, tags::FRAME_OF_REFERENCE_UID))
    });
    if one.is_empty() {
        let message =
            format!("{what}: it names no frame of reference: whether it belongs to an image cannot be checked");
        warnings.push(Warning::new(findings::DICOM_FRAME, message));
    }
    let own = items(set, tags::STRUCTURE_SET_ROI_SEQUENCE).iter();
    let own = own.filter_map(|r| Some((whole(r, tags::ROI_NUMBER)?, text(r, tags::REFERENCED_FRAME_OF_REFERENCE_UID))));
    let strangers = own.filter(|(n, f)| drawn.contains(n) && !f.is_empty() && *f != one).collect();
    (one, strangers)
}

/// Takes the contours of structures away that lie in another frame of reference; returns them by name.
fn elsewhere(rois: &[Roi], drawings: &mut [Drawing], strangers: &BTreeMap<i64, String>) -> Vec<String> {
    let all = rois.iter().zip(drawings);
    let all = all.filter_map(|(roi, drawing)| Some((drawing, strangers.get(&roi.number)?)));
    all.map(|(drawing, frame)| {
        drawing.contours.clear();
        format!("{:?} (in the frame of reference {frame})", drawing.name)
    })
    .collect()
}

/// The closed contours of each structure, and structures of which a contour contradicts itself, by name.
fn drawings(what: &str, set: &Item, rois: &[Roi], warnings: &mut Vec<Warning>) -> (Vec<Drawing>, Vec<String>) {
    let mut all: Vec<Drawing> =
        rois.iter().map(|r| Drawing { name: r.name.clone(), colour: r.colour, contours: Vec::new() }).collect();
    let mut left: BTreeMap<String, BTreeMap<String, usize>> = BTreeMap::new();
    let mut odd: BTreeMap<usize, String> = BTreeMap::new();
    for item in items(set, tags::ROI_CONTOUR_SEQUENCE) {
        let number = whole(item, tags::REFERENCED_ROI_NUMBER);
        let Some(at) = rois.iter().position(|r| Some(r.number) == number) else {
            let name = format!("number {}", number.unwrap_or_default());
            *left.entry(name).or_default().entry("of no structure".into()).or_default() += 1;
            continue;
        };
        for contour in items(item, tags::CONTOUR_SEQUENCE) {
            let kind = text(contour, tags::CONTOUR_GEOMETRIC_TYPE);
            let given = numbers(contour, tags::CONTOUR_DATA);
            let unread = given.is_none() && !text(contour, tags::CONTOUR_DATA).is_empty();
            let flat: Vec<f64> = given.unwrap_or_default();
            let (points, rest) = flat.as_chunks::<3>();
            let stated = whole(contour, tags::NUMBER_OF_CONTOUR_POINTS);
            if unread || !rest.is_empty() || stated.is_some_and(|n| usize::try_from(n) != Ok(points.len())) {
                let stated = stated.unwrap_or_default();
                odd.entry(at).or_insert_with(|| format!("a contour of {stated} points and {} numbers", flat.len()));
                continue;
            }
            let closed = matches!(kind.as_str(), "CLOSED_PLANAR" | "CLOSEDPLANAR_XOR" | "CLOSED_PLANAR_XOR");
            if closed && points.len() > 2 {
                all[at].contours.push(points.to_vec());
            } else {
                let why = if closed { format!("of {} points", points.len()) } else { kind };
                *left.entry(rois[at].name.clone()).or_default().entry(why).or_default() += 1;
            }
        }
    }
    if !left.is_empty() {
        let one = |(name, kinds): (&String, &BTreeMap<String, usize>)| {
            let kinds = kinds.iter().map(|(kind, n)| format!("{n} {kind}")).collect::<Vec<_>>().join(", ");
            format!("{name} ({kinds})")
        };
        let named: Vec<String> = left.iter().map(one).collect();
        let message = format!("{what}: contours that enclose nothing are left out: {}", some_names(&named));
        warnings.push(Warning::new(findings::STRUCTURES_LEFT_OUT, message));
    }
    let odd = odd.into_iter().map(|(at, why)| {
        all[at].contours.clear();
        format!("{:?} ({why})", all[at].name)
    });
    let odd = odd.collect();
    (all, odd)
}

/// The first of many names.
pub(in super::super) fn some_names<S: AsRef<str>>(names: &[S]) -> String {
    let shown = names.iter().take(NAMED).map(AsRef::as_ref).collect::<Vec<_>>().join(", ");
    if names.len() > NAMED { format!("{shown} and {} more", names.len() - NAMED) } else { shown }
}

impl StructureSet {
    /// A word about images that the set was drawn on and that are not in `series`, which was read from `place`; nothing where the
    /// set lies there as well, for reading the series tells it then.
    pub fn missing_images(&self, series: &Series, place: &Path) -> Option<Warning> {
        let root = root_of(place);
        let folder = if root.is_dir() { Some(root.as_path()) } else { root.parent() };
        if folder.is_some_and(|folder| self.path.starts_with(folder)) {
            return None;
        }
        let there: BTreeSet<&str> = series.slices.iter().map(|s| s.uid.as_str()).collect();
        lost(&self.path, &self.referenced_images, &series.uid, &there)
    }

    /// Structures with contours, with what the set says of them.
    pub fn drawn(&self) -> impl Iterator<Item = (&Roi, &Structure)> {
        self.rois.iter().zip(&self.contours.structures).filter(|(roi, _)| !roi.empty)
    }
}

/// What a label map drawn from a structure set says of its file.
pub(in super::super) fn structure_notes(grid: &Grid, label: &str) -> HeaderNotes {
    HeaderNotes::plain("DICOM RT Structure Set", grid, "contours", label)
}

/// Structures that a header names.
pub(super) fn count(set: &Item) -> usize {
    items(set, tags::STRUCTURE_SET_ROI_SEQUENCE).len()
}
