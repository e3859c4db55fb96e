//! Where DICOM lies: a folder, a file of a series, or `FOLDER#NUMBER` and `FOLDER#UID` for one
//! series of several.

use super::super::series_path::{Place, root_of};
use super::beside::beside;
use super::counts::lost_of;
use super::elements::text;
use super::find::{Catalogue, DEEPEST, Damaged, Group, Object, find, medium};
use super::kinds::{only_maps, refuse_map};
use super::open::{Opened, is_dicom, open};
use super::scan::Scan;
use crate::error::{Error, Result};
use crate::findings;
use crate::warning::Warning;
use dicom_dictionary_std::tags;
use std::path::{Path, PathBuf};

/// Modality of segmentations.
const SEG: &str = "SEG";

/// Whether a path is for this room to read: a folder, a choice in one, or a DICOM file.
pub(in super::super) fn is_place(path: &Path) -> bool {
    let place = Place::of(path);
    place.choice.is_some() || place.root.is_dir() || is_dicom(&place.root)
}

/// Whether a path leads to DICOM as [`super::super::read_image`] and [`super::super::read_bones`]
/// understand it: a folder, a series in one (`FOLDER#NUMBER`), or a DICOM file.
pub fn is_dicom_path(path: &Path) -> bool {
    is_place(path)
}

/// Whether a file is a DICOM structure set.
pub fn is_structure_set(path: &Path) -> bool {
    is_dicom(path) && modality(path) == "RTSTRUCT"
}

/// Whether a DICOM file can be listed and not read as an image: it is no scan, no dose and no segmentation.
pub fn is_listed(path: &Path) -> bool {
    is_dicom(path) && !["", "CT", "MR", "RTDOSE", SEG].contains(&modality(path).as_str())
}

/// Whether labels of a path are those of a segmentation: a file of modality SEG, a folder with one and without a structure set, or
/// `FOLDER#NUMBER`.
pub fn is_segmentation(path: &Path) -> bool {
    let place = Place::of(path);
    if !place.root.is_dir() {
        return is_dicom(&place.root) && modality(&place.root) == SEG;
    }
    let Ok(found) = objects(&place.root) else { return false };
    match &place.choice {
        Some(choice) => named(&found, path, choice).is_ok_and(|group| group.series.modality == SEG),
        None => {
            let any = |modality: &str| found.objects.iter().any(|o| o.series.modality == modality);
            any(SEG) && !any("RTSTRUCT")
        }
    }
}

fn modality(file: &Path) -> String {
    match open(file, tags::ROI_CONTOUR_SEQUENCE) {
        Opened::Object(object, _) => text(&object, tags::MODALITY),
        _ => String::new(),
    }
}

/// The segmentation that a path means, with what is to be known of the files beside it; `None` where there is none.
///
/// # Errors
/// [`Error::Read`] when there is no DICOM; [`Error::Input`] when it is not clear which is meant, and when a file beside it may be
/// one and cannot be read.
pub(super) fn segmentation(path: &Path) -> Result<Option<(Object, Vec<Warning>)>> {
    let mut place = Place::of(path);
    place.root = medium(&place.root);
    let found = objects(&place.root)?;
    let all: Vec<&Object> = match &place.choice {
        Some(choice) => named(&found, path, choice)?.objects,
        None => found.objects.iter().collect(),
    };
    let all: Vec<&Object> = all.into_iter().filter(|o| o.series.modality == SEG).collect();
    match all.as_slice() {
        [] => Ok(None),
        [one] => {
            let warnings = beside(path, &found, &all, &|damaged| of_kind(damaged, SEG))?;
            Ok(Some(((*one).clone(), warnings)))
        }
        _ => Err(several_labels(path, &all)),
    }
}

fn several_labels(path: &Path, all: &[&Object]) -> Error {
    let list: String = all.iter().map(|o| format!("\n    {}: {:?}", o.path.display(), o.series.description)).collect();
    let problem = format!("it holds {} segmentations:{list}", all.len());
    let remedy = "give the file of the one that is meant";
    Error::refused(findings::DICOM_SEVERAL, path.display().to_string(), problem, remedy)
}

/// The folder whose DICOM files belong to what a path means: of a slice its own. `None` where it is
/// one file.
pub(in super::super) fn folder_of(path: &Path) -> Option<PathBuf> {
    let root = root_of(path);
    if root.is_dir() {
        return Some(root);
    }
    let slice = || match open(&root, tags::ROI_CONTOUR_SEQUENCE) {
        Opened::Object(object, _) => Scan::of_class(&text(&object, tags::SOP_CLASS_UID)).is_some(),
        _ => false,
    };
    (is_dicom(&root) && slice()).then(|| parent(&root))
}

fn parent(file: &Path) -> PathBuf {
    match file.parent() {
        Some(parent) if !parent.as_os_str().is_empty() => parent.to_owned(),
        _ => PathBuf::from("."),
    }
}

/// Refuses a folder without DICOM, and what is not there.
///
/// # Errors
/// [`Error::Read`].
pub(in super::super) fn require(path: &Path) -> Result<()> {
    let root = root_of(path);
    if holds_dicom(&root, DEEPEST) { Ok(()) } else { Err(no_objects(&root, &Catalogue::default())) }
}

fn holds_dicom(path: &Path, deeper: usize) -> bool {
    if !path.is_dir() {
        return is_dicom(path);
    }
    let entries: Vec<PathBuf> = std::fs::read_dir(path).into_iter().flatten().flatten().map(|e| e.path()).collect();
    entries.iter().any(|p| p.is_file() && is_dicom(p))
        || deeper > 0 && entries.iter().any(|p| p.is_dir() && holds_dicom(p, deeper - 1))
}

/// What is read as an image.
pub(super) enum Chosen {
    /// The objects of a CT or MR series, and what is to be known of the files beside them.
    Scan(Vec<Object>, Vec<Warning>),
    /// A dose, or the doses of a series, and the same.
    Dose(Vec<Object>, Vec<Warning>),
    /// A segmentation, which has a grid and is no image.
    Labels(Box<Object>),
}

/// The images that a path means, and the path that means the same ones: of a slice's file it is
/// `FOLDER#UID`.
///
/// # Errors
/// [`Error::Read`] when there is no DICOM; [`Error::Input`] when it is not clear which series is
/// meant, listing them, and when it is none that can be read.
pub(super) fn choose(path: &Path) -> Result<(Chosen, PathBuf)> {
    let mut place = Place::of(path);
    place.root = medium(&place.root);
    if place.root.is_dir() {
        let found = objects(&place.root)?;
        let group = match &place.choice {
            Some(choice) => named(&found, path, choice)?,
            None => only_scan(&found, path)?,
        };
        return Ok((readable(path, group, &found)?, path.into()));
    }
    let found = objects(&place.root)?;
    let groups = found.groups();
    let Some(group) = groups.first() else { return Err(no_objects(path, &found)) };
    if !is_slice(group) {
        return Ok((readable(path, group.clone(), &Catalogue::default())?, place.root));
    }
    let folder = parent(&place.root);
    let all = objects(&folder)?;
    let own = all.groups().into_iter().find(|g| g.series.uid == group.series.uid && is_slice(g));
    let mut same = folder.into_os_string();
    same.push(format!("#{}", group.series.uid));
    Ok((readable(path, own.unwrap_or_else(|| group.clone()), &all)?, same.into()))
}

/// The objects of a folder or file, or a refusal where there is none.
pub(super) fn objects(root: &Path) -> Result<Catalogue> {
    let found = find(&[medium(root)])?;
    if found.objects.is_empty() { Err(no_objects(root, &found)) } else { Ok(found) }
}

fn no_objects(path: &Path, found: &Catalogue) -> Error {
    if let Some(damaged) = found.damaged.first() {
        return super::open::damaged(&damaged.path, &damaged.why);
    }
    if path.is_dir() {
        let problem = "it is a folder without DICOM";
        return Error::read(path, problem, "name one file, or the folder of a DICOM series");
    }
    Error::read(path, "it is no DICOM object", "name a file of a series, or its folder")
}

/// Whether what is left of a damaged file is of a modality, where it says so.
pub(super) fn of_kind(damaged: &Damaged, modality: &str) -> Option<bool> {
    damaged.series.as_ref().map(|s| s.modality.as_str()).filter(|m| !m.is_empty()).map(|m| m == modality)
}

/// That a damaged file is of another modality, where it says so.
fn other_kind(damaged: &Damaged, modality: &str) -> Option<bool> {
    of_kind(damaged, modality).filter(|own| !own)
}

/// What made the slices or frames of a series; `None` where it is of other objects.
fn scan(group: &Group<'_>) -> Option<Scan> {
    Scan::of(group.objects.iter().copied())
}

/// Whether a series is of CT or MR slices or frames.
fn is_slice(group: &Group<'_>) -> bool {
    scan(group).is_some()
}

/// Whether a series is nothing but a localizer.
fn is_localizer(group: &Group<'_>) -> bool {
    group.objects.iter().all(|o| o.image_type().iter().any(|k| k == "LOCALIZER"))
}

fn list(groups: &[Group<'_>]) -> String {
    groups.iter().map(|g| format!("\n    {}; UID {}", g.words(), g.series.uid)).collect()
}

/// The one CT series of a folder; in one without a CT the one MR series, maps left aside.
fn only_scan<'a>(found: &'a Catalogue, path: &Path) -> Result<Group<'a>> {
    let groups = found.groups();
    let of = |made_by: Scan| groups.iter().filter(move |g| scan(g) == Some(made_by) && !is_localizer(g)).cloned();
    let (maps, mr): (Vec<Group<'_>>, Vec<Group<'_>>) = of(Scan::Mr).partition(|g| only_maps(&g.objects).is_some());
    let ct: Vec<Group<'_>> = of(Scan::Ct).collect();
    let (mut all, name) = if ct.is_empty() { (mr, "MR") } else { (ct, "CT") };
    match all.len() {
        1 => Ok(all.remove(0)),
        0 => {
            let dose: Vec<&Group<'_>> = groups.iter().filter(|g| g.series.modality == "RTDOSE").collect();
            if let [one] = dose.as_slice() {
                return Ok((*one).clone());
            }
            let labels: Vec<&Group<'_>> = groups.iter().filter(|g| g.series.modality == SEG).collect();
            if let ([one], true) = (labels.as_slice(), dose.is_empty()) {
                return Ok((*one).clone());
            }
            if let Some((map, kind)) = maps.first().and_then(|g| only_maps(&g.objects)) {
                return Err(refuse_map(&path.display().to_string(), &(map, kind), &[]));
            }
            let problem = format!("it holds no CT series:{}", list(&groups));
            Err(Error::refused(
                findings::DICOM_NO_CT,
                path.display().to_string(),
                problem,
                "give the folder of a CT series",
            ))
        }
        n => {
            let alone = |g: &&Group<'_>| all.iter().filter(|o| o.series.number == g.series.number).count() == 1;
            let number = all.iter().filter(alone).find_map(|g| g.series.number);
            let example = number.map_or_else(|| all[0].series.uid.clone(), |n| n.to_string());
            let remedy = format!("choose one by its number or its UID: {}#{example}", path.display());
            let problem = format!("it holds {n} {name} series:{}", list(&all));
            Err(Error::refused(findings::DICOM_SEVERAL, path.display().to_string(), problem, remedy))
        }
    }
}

/// The series of this number or UID.
fn named<'a>(found: &'a Catalogue, path: &Path, choice: &str) -> Result<Group<'a>> {
    let groups = found.groups();
    let chosen =
        |g: &&Group<'_>| g.series.uid == choice || g.series.number.is_some_and(|n| choice.parse::<i32>() == Ok(n));
    let mut matching: Vec<Group<'_>> = groups.iter().filter(chosen).cloned().collect();
    // Planning systems number structures and doses as the CT that they belong to.
    for made_by in [Scan::Ct, Scan::Mr] {
        if matching.len() > 1 && matching.iter().filter(|g| scan(g) == Some(made_by)).count() == 1 {
            matching.retain(|g| scan(g) == Some(made_by));
        }
    }
    match matching.len() {
        1 => Ok(matching.remove(0)),
        0 => {
            let problem = format!("it holds no series of number or UID {choice}; there are:{}", list(&groups));
            Err(Error::refused(findings::DICOM_SEVERAL, path.display().to_string(), problem, "choose one of these"))
        }
        n => {
            let problem = format!("{n} series have the number {choice}:{}", list(&matching));
            let remedy = "choose by UID: FOLDER#UID";
            Err(Error::refused(findings::DICOM_SEVERAL, path.display().to_string(), problem, remedy))
        }
    }
}

/// A series as something that is read, or a refusal by its modality.
fn readable(path: &Path, group: Group<'_>, found: &Catalogue) -> Result<Chosen> {
    let owned = |objects: Vec<&Object>| objects.into_iter().cloned().collect::<Vec<_>>();
    if let Some(made_by) = scan(&group) {
        if let (Scan::Mr, Some(map)) = (made_by, only_maps(&group.objects)) {
            let others: Vec<Group<'_>> = found.groups().into_iter().filter(|g| scan(g) == Some(Scan::Mr)).collect();
            return Err(refuse_map(&path.display().to_string(), &map, &others));
        }
        let same = |damaged: &Damaged| {
            let told = damaged.series.as_ref().filter(|s| !s.uid.is_empty());
            told.map(|s| s.uid == group.series.uid).or(other_kind(damaged, made_by.name()))
        };
        let mut warnings = beside(path, found, &group.objects, &same)?;
        let all: Vec<&Object> = found.objects.iter().collect();
        warnings.extend(lost_of(&group.objects, &all));
        return Ok(Chosen::Scan(owned(group.objects), warnings));
    }
    let (what, remedy) = match group.series.modality.as_str() {
        "RTDOSE" => {
            let warnings = beside(path, found, &group.objects, &|damaged| of_kind(damaged, "RTDOSE"))?;
            return Ok(Chosen::Dose(owned(group.objects), warnings));
        }
        SEG => {
            if let [one] = group.objects.as_slice() {
                return Ok(Chosen::Labels(Box::new((*one).clone())));
            }
            return Err(several_labels(path, &group.objects));
        }
        "RTSTRUCT" => ("a structure set, no image", "give it where structures, contours or bones are asked for"),
        "MR" => {
            ("of modality MR, but no MR image (a screenshot, a spectrum or raw data)", "give the series of the slices")
        }
        "PT" => ("a PET series: its values are no HU", "give the CT that was taken with it"),
        "RTIMAGE" => ("a projection (RT Image), no volume", "give a CT series"),
        "RTPLAN" => ("a plan, which has no image", "give the CT series, or the RTDOSE of the plan"),
        "REG" => ("a registration, no image", "give the CT series"),
        "CT" => ("of modality CT, but no CT image (a screenshot or a report)", "give the series of the slices"),
        _ => ("no CT series", "give a CT series"),
    };
    let problem = format!("it is {what} (modality {:?})", group.series.modality);
    Err(Error::refused(findings::DICOM_NO_CT, path.display().to_string(), problem, remedy))
}
