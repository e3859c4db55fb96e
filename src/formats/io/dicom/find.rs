//! What DICOM objects files and folders hold, by their headers: nothing is read of pixels and
//! contours.

use super::elements::{Item, items, text, texts, whole};
use super::open::{Damage, Opened, open};
use super::series::{Patient, Series, Study};
use crate::error::{Error, Result};
use dicom_core::Tag;
use dicom_core::header::Header as _;
use dicom_dictionary_std::{tags, uids};
use dicom_object::DefaultDicomObject;
use rayon::prelude::*;
use std::collections::BTreeSet;
use std::fmt::{self, Debug, Formatter};
use std::path::{Path, PathBuf};

/// Folders deeper than this are not looked into: a link may lead in a circle.
pub(super) const DEEPEST: usize = 16;
/// SOP classes whose objects are nothing without pixels; those of CT come first.
const PIXELS: [&str; 9] = [
    uids::CT_IMAGE_STORAGE,
    uids::ENHANCED_CT_IMAGE_STORAGE,
    uids::LEGACY_CONVERTED_ENHANCED_CT_IMAGE_STORAGE,
    uids::MR_IMAGE_STORAGE,
    uids::ENHANCED_MR_IMAGE_STORAGE,
    uids::LEGACY_CONVERTED_ENHANCED_MR_IMAGE_STORAGE,
    uids::RT_DOSE_STORAGE,
    uids::SEGMENTATION_STORAGE,
    uids::LABEL_MAP_SEGMENTATION_STORAGE,
];
/// Modalities of objects of which something stands behind the place of contours: they are read up
/// to the pixels, as are objects of several frames.
const LONG: [&str; 4] = ["RTDOSE", "RTPLAN", "REG", "SEG"];

/// One object: what its header says.
#[derive(Clone)]
pub struct Object {
    /// The file.
    pub path: PathBuf,
    /// SOP Class UID: the kind of object.
    pub sop_class: String,
    /// SOP Instance UID.
    pub uid: String,
    /// What it says of its series, without slices.
    pub series: Series,
    /// UIDs of the objects and series that it refers to.
    pub refers_to: BTreeSet<String>,
    /// The data set before its pixels, of structure sets before the contours.
    pub(super) header: Box<DefaultDicomObject>,
}

impl Debug for Object {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        write!(f, "{} {} {}", self.series.modality, self.uid, self.path.display())
    }
}

impl Object {
    pub(super) fn new(path: &Path, header: Box<DefaultDicomObject>) -> Self {
        let mut refers_to = BTreeSet::new();
        for element in header.iter().filter_map(|e| e.items()) {
            element.iter().for_each(|item| references(item, &mut refers_to));
        }
        let uid = text(&header, tags::SOP_INSTANCE_UID);
        let series = series(&header);
        refers_to.remove(&series.uid);
        Self { path: path.into(), sop_class: series.sop_class.clone(), uid, series, refers_to, header }
    }

    /// Image Type (PS3.3 C.7.6.1.1.2), for example `ORIGINAL`, `PRIMARY`, `AXIAL`.
    pub(super) fn image_type(&self) -> Vec<String> {
        texts(&self.header, tags::IMAGE_TYPE)
    }
}

/// The UIDs that an item and the items in it refer to.
fn references(item: &Item, into: &mut BTreeSet<String>) {
    for tag in [tags::REFERENCED_SOP_INSTANCE_UID, tags::SERIES_INSTANCE_UID] {
        into.extend(Some(text(item, tag)).filter(|uid| !uid.is_empty()));
    }
    for deeper in item.iter().filter_map(|e| e.items()) {
        deeper.iter().for_each(|item| references(item, into));
    }
}

/// What a data set says of patient, study and series (PS3.3 C.7.1 to C.7.3), without slices.
pub(super) fn series(set: &Item) -> Series {
    let of = |tag: Tag| text(set, tag);
    let date = [tags::SERIES_DATE, tags::ACQUISITION_DATE, tags::STRUCTURE_SET_DATE, tags::CONTENT_DATE];
    Series {
        patient: Patient {
            name: of(tags::PATIENT_NAME),
            id: of(tags::PATIENT_ID),
            birth_date: of(tags::PATIENT_BIRTH_DATE),
            sex: of(tags::PATIENT_SEX),
        },
        study: Study {
            uid: of(tags::STUDY_INSTANCE_UID),
            date: of(tags::STUDY_DATE),
            time: of(tags::STUDY_TIME),
            id: of(tags::STUDY_ID),
            accession: of(tags::ACCESSION_NUMBER),
            description: of(tags::STUDY_DESCRIPTION),
            physician: of(tags::REFERRING_PHYSICIAN_NAME),
        },
        uid: of(tags::SERIES_INSTANCE_UID),
        number: whole(set, tags::SERIES_NUMBER).and_then(|n| n.try_into().ok()),
        date: date.into_iter().map(of).find(|d| !d.is_empty()).unwrap_or_default(),
        description: of(tags::SERIES_DESCRIPTION),
        modality: of(tags::MODALITY),
        frame_of_reference: frame_of_reference(set),
        sop_class: of(tags::SOP_CLASS_UID),
        patient_position: of(tags::PATIENT_POSITION),
        slices: Vec::new(),
    }
}

/// Frame of Reference UID; of a structure set the one that its contours lie in (PS3.3 C.8.8.5).
fn frame_of_reference(set: &Item) -> String {
    let own = text(set, tags::FRAME_OF_REFERENCE_UID);
    let listed = || {
        let items = items(set, tags::REFERENCED_FRAME_OF_REFERENCE_SEQUENCE).iter();
        items.map(|i| text(i, tags::FRAME_OF_REFERENCE_UID)).find(|uid| !uid.is_empty())
    };
    if text(set, tags::MODALITY) != "RTSTRUCT" {
        return own;
    }
    frame_of_structures(set, None).or_else(listed).unwrap_or(own)
}

/// The frame of reference of a structure set: of several that of the CT that it was drawn on, where it says so, else that of most
/// structures. `drawn` are the numbers of those that count, all where it is not given; `None` where no structure tells.
pub(super) fn frame_of_structures(set: &Item, drawn: Option<&BTreeSet<i64>>) -> Option<String> {
    let rois = items(set, tags::STRUCTURE_SET_ROI_SEQUENCE).iter();
    let counted = |roi: &&Item| {
        drawn.is_none_or(|drawn| whole(roi, tags::ROI_NUMBER).is_some_and(|number| drawn.contains(&number)))
    };
    let mut frames: Vec<(String, usize)> = Vec::new();
    for uid in rois.filter(counted).map(|roi| text(roi, tags::REFERENCED_FRAME_OF_REFERENCE_UID)) {
        match frames.iter_mut().find(|f| f.0 == uid) {
            Some(frame) => frame.1 += 1,
            None if !uid.is_empty() => frames.push((uid, 1)),
            None => {}
        }
    }
    let ct = frames_of_ct(set);
    // Of as many the first.
    let rank = |(n, f): &(usize, &(String, usize))| (ct.contains(&f.0), f.1, usize::MAX - n);
    frames.iter().enumerate().max_by_key(rank).map(|(_, f)| f.0.clone())
}

/// Frames of reference in which a structure set was drawn on CT images.
fn frames_of_ct(set: &Item) -> BTreeSet<String> {
    let is_ct = |frame: &&Item| {
        let studies = items(frame, tags::RT_REFERENCED_STUDY_SEQUENCE).iter();
        let series = studies.flat_map(|s| items(s, tags::RT_REFERENCED_SERIES_SEQUENCE));
        let mut images = series.flat_map(|s| items(s, tags::CONTOUR_IMAGE_SEQUENCE));
        images.any(|image| PIXELS[..3].contains(&text(image, tags::REFERENCED_SOP_CLASS_UID).as_str()))
    };
    let frames = items(set, tags::REFERENCED_FRAME_OF_REFERENCE_SEQUENCE).iter();
    frames.filter(is_ct).map(|frame| text(frame, tags::FRAME_OF_REFERENCE_UID)).collect()
}

/// The objects of files and folders.
#[derive(Debug, Clone, Default)]
pub struct Catalogue {
    /// The objects, by path.
    pub objects: Vec<Object>,
    /// Files that are not DICOM, and directories of media.
    pub others: Vec<PathBuf>,
    /// Files that cannot be read, or are cut off.
    pub damaged: Vec<Damaged>,
}

/// A file that cannot be read whole.
#[derive(Debug, Clone)]
pub struct Damaged {
    /// The file.
    pub path: PathBuf,
    /// What is wrong.
    pub why: String,
    /// What the elements before the damage say of its series.
    pub series: Option<Series>,
}

impl Damaged {
    fn new(path: PathBuf, Damage { why, part }: Damage) -> Self {
        Self { path, why, series: part.map(|part| series(&part)) }
    }
}

/// Looks at files, and at all files in folders and the folders in them. Directories of media
/// (DICOMDIR) count as other files.
///
/// # Errors
/// [`Error::Read`] when a path does not exist or a folder cannot be read.
pub fn find<P: AsRef<Path>>(paths: &[P]) -> Result<Catalogue> {
    let mut files = BTreeSet::new();
    for path in paths {
        let path = path.as_ref();
        if path.is_dir() {
            list(path, DEEPEST, &mut files)?;
        } else if path.exists() {
            files.insert(path.to_owned());
        } else {
            return Err(Error::read(path, "no such file", "check the path"));
        }
    }
    let files: Vec<PathBuf> = files.into_iter().collect();
    let opened: Vec<Opened> = files.par_iter().with_max_len(8).map(|path| header(path)).collect();
    let mut found = Catalogue::default();
    for (path, opened) in files.into_iter().zip(opened) {
        match opened {
            // A directory is no object of a series.
            Opened::Object(object, _) if is_directory(&object) => found.others.push(path),
            Opened::Object(object, ended) => match cut_off(&object, ended) {
                Some(why) => found.damaged.push(Damaged::new(path, Damage { why, part: Some(object) })),
                None => found.objects.push(Object::new(&path, object)),
            },
            Opened::Other => found.others.push(path),
            Opened::Damaged(damage) => found.damaged.push(Damaged::new(path, damage)),
        }
    }
    Ok(found)
}

/// Whether an object is the directory of a medium (DICOMDIR, PS3.3 F.3).
fn is_directory(object: &DefaultDicomObject) -> bool {
    object.get(tags::DIRECTORY_RECORD_SEQUENCE).is_some()
        || object.meta().media_storage_sop_class_uid().trim_end_matches('\0') == uids::MEDIA_STORAGE_DIRECTORY_STORAGE
}

/// Why an object is not whole, though every element of it is.
fn cut_off(object: &DefaultDicomObject, ended: bool) -> Option<String> {
    let last = || object.iter().map(|e| e.tag()).max().map_or("nothing".into(), |tag| tag.to_string());
    if ended && PIXELS.contains(&text(object, tags::SOP_CLASS_UID).as_str()) {
        return Some(format!("it ends before its pixels, after the element {}", last()));
    }
    let nameless = text(object, tags::SERIES_INSTANCE_UID).is_empty();
    let short = object.iter().all(|e| e.tag() < tags::SERIES_INSTANCE_UID);
    (nameless && short).then(|| format!("it ends before it names its series, after the element {}", last()))
}

/// The folder that a path means where it is the directory of a medium; else the path.
pub(super) fn medium(path: &Path) -> PathBuf {
    let directory = || match open(path, tags::SPECIFIC_CHARACTER_SET) {
        Opened::Object(object, _) => is_directory(&object),
        _ => false,
    };
    match path.parent() {
        Some(parent) if path.is_file() && directory() => {
            if parent.as_os_str().is_empty() {
                PathBuf::from(".")
            } else {
                parent.to_owned()
            }
        }
        _ => path.to_owned(),
    }
}

/// What comes before the pixels, of structure sets before the contours.
fn header(path: &Path) -> Opened {
    let short = open(path, tags::ROI_CONTOUR_SEQUENCE);
    let long =
        |set: &Item| LONG.contains(&text(set, tags::MODALITY).as_str()) || set.get(tags::NUMBER_OF_FRAMES).is_some();
    if matches!(&short, Opened::Object(set, _) if long(set)) { open(path, tags::PIXEL_DATA) } else { short }
}

fn list(folder: &Path, deeper: usize, into: &mut BTreeSet<PathBuf>) -> Result<()> {
    let unreadable = |e: std::io::Error| Error::read(folder, e.to_string(), "make the folder readable for you");
    for entry in std::fs::read_dir(folder).map_err(unreadable)? {
        let path = entry.map_err(unreadable)?.path();
        if path.is_dir() {
            if deeper > 0 {
                list(&path, deeper - 1, into)?;
            }
        } else if path.is_file() {
            into.insert(path);
        }
    }
    Ok(())
}

/// Objects of one series.
#[derive(Debug, Clone)]
pub struct Group<'a> {
    /// What the first of them says of it.
    pub series: &'a Series,
    /// Its objects, by path.
    pub objects: Vec<&'a Object>,
}

impl Catalogue {
    /// The objects by series, ordered by patient, study date, modality and series number.
    pub fn groups(&self) -> Vec<Group<'_>> {
        let mut groups: Vec<Group<'_>> = Vec::new();
        for object in &self.objects {
            let own =
                |g: &&mut Group<'_>| g.series.uid == object.series.uid && g.series.modality == object.series.modality;
            match groups.iter_mut().find(own) {
                Some(group) => group.objects.push(object),
                None => groups.push(Group { series: &object.series, objects: vec![object] }),
            }
        }
        let key = |g: &Group<'_>| {
            let s = g.series;
            let study = (s.patient.id.clone(), s.study.date.clone(), s.study.uid.clone());
            (study, s.modality.clone(), s.number, s.uid.clone())
        };
        groups.sort_by_cached_key(key);
        groups
    }
}

impl Group<'_> {
    /// The series in words: number, modality, date, description, objects.
    pub fn words(&self) -> String {
        let s = self.series;
        let number = s.number.map_or("without number".into(), |n| format!("{n}"));
        let images = match (self.objects.len(), s.modality.as_str()) {
            (1, "CT" | "MR" | "PT") => "1 slice".into(),
            (n, "CT" | "MR" | "PT") => format!("{n} slices"),
            (1, _) => "1 object".into(),
            (n, _) => format!("{n} objects"),
        };
        let date = day(&s.date);
        let description = if s.description.is_empty() { "no description" } else { &s.description };
        format!("series {number}: {} of {date}, {description}, {images}", s.modality)
    }
}

/// A date as `YYYY-MM-DD`, or what stands in its place.
pub(in super::super) fn day(date: &str) -> String {
    match (date.get(..4), date.get(4..6), date.get(6..8)) {
        (Some(year), Some(month), Some(day)) if date.len() == 8 => format!("{year}-{month}-{day}"),
        _ if date.is_empty() => "unknown date".into(),
        _ => date.into(),
    }
}
