//! Images that a series says it has, against those that are there.

use super::elements::{Item, items, text, whole};
use super::find::Object;
use crate::error::{Error, Result};
use crate::findings;
use crate::warning::Warning;
use dicom_dictionary_std::tags;
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

/// Images that a message names.
const NAMED: usize = 12;

/// Refuses parts of a concatenation (PS3.3 C.7.6.16.2.2.4) without the others, and tells of fewer images than are promised.
///
/// # Errors
/// [`Error::Input`] with what is there of a concatenation.
pub(super) fn fewer(what: &str, objects: &[Object]) -> Result<Vec<Warning>> {
    concatenations(what, objects)?;
    let mut warnings = Vec::new();
    let mut acquisitions: BTreeMap<String, Vec<&Object>> = BTreeMap::new();
    for object in objects {
        acquisitions.entry(text(&object.header, tags::ACQUISITION_NUMBER)).or_default().push(object);
    }
    let promised = |objects: &[&Object], tag| objects.iter().filter_map(|o| whole(&o.header, tag)).max();
    let all: Vec<&Object> = objects.iter().collect();
    let by_series = promised(&all, tags::NUMBER_OF_SERIES_RELATED_INSTANCES).map(|n| (n, &all, String::new()));
    let by_acquisition = acquisitions.iter().filter_map(|(number, own)| {
        let of = if number.is_empty() { String::new() } else { format!(" of acquisition {number}") };
        Some((promised(own, tags::IMAGES_IN_ACQUISITION)?, own, of))
    });
    for (promised, own, of) in by_series.into_iter().chain(by_acquisition) {
        let there = count(own);
        if promised > there {
            let message = format!("{what}: it says that it has {promised} images{of}, and {there} are there");
            warnings.push(Warning::new(findings::DICOM_FEWER, message));
        }
    }
    Ok(warnings)
}

/// The images that an object refers to, by series: those that a structure set was drawn on (PS3.3 C.8.8.5), or a segmentation
/// was made of (C.12.2).
pub(super) fn images_of(set: &Item) -> BTreeMap<String, BTreeSet<String>> {
    let frames = items(set, tags::REFERENCED_FRAME_OF_REFERENCE_SEQUENCE).iter();
    let studies = frames.flat_map(|f| items(f, tags::RT_REFERENCED_STUDY_SEQUENCE));
    let drawn = studies.flat_map(|s| items(s, tags::RT_REFERENCED_SERIES_SEQUENCE));
    let drawn = drawn.map(|s| (s, items(s, tags::CONTOUR_IMAGE_SEQUENCE)));
    let made = items(set, tags::REFERENCED_SERIES_SEQUENCE).iter();
    let made = made.map(|s| (s, items(s, tags::REFERENCED_INSTANCE_SEQUENCE)));
    let mut all: BTreeMap<String, BTreeSet<String>> = BTreeMap::new();
    for (series, images) in drawn.chain(made) {
        let images = images.iter().map(|i| text(i, tags::REFERENCED_SOP_INSTANCE_UID));
        all.entry(text(series, tags::SERIES_INSTANCE_UID)).or_default().extend(images.filter(|uid| !uid.is_empty()));
    }
    all.remove("");
    all
}

/// A word about images of a series that an object refers to and that are not `there`.
pub(super) fn lost(
    path: &Path,
    images: &BTreeMap<String, BTreeSet<String>>,
    series: &str,
    there: &BTreeSet<&str>,
) -> Option<Warning> {
    let wanted = images.get(series)?;
    let gone: Vec<&str> = wanted.iter().map(String::as_str).filter(|uid| !there.contains(uid)).collect();
    (!gone.is_empty()).then(|| {
        let shown = gone.iter().take(NAMED).copied().collect::<Vec<_>>().join(", ");
        let more = if gone.len() > NAMED { format!(" and {} more", gone.len() - NAMED) } else { String::new() };
        let message = format!(
            "{}: of the {} images that it was drawn on or made of {} are not in the series: {shown}{more}",
            path.display(),
            wanted.len(),
            gone.len()
        );
        Warning::new(findings::DICOM_FEWER, message)
    })
}

/// Images of a series that structure sets and segmentations among `others` refer to and that are not among `objects`.
pub(super) fn lost_of(objects: &[&Object], others: &[&Object]) -> Vec<Warning> {
    let Some(first) = objects.first() else { return Vec::new() };
    let there: BTreeSet<&str> = objects.iter().map(|o| o.uid.as_str()).collect();
    let refer = others.iter().filter(|o| ["RTSTRUCT", "SEG"].contains(&o.series.modality.as_str()));
    refer.filter_map(|o| lost(&o.path, &images_of(&o.header), &first.series.uid, &there)).collect()
}

/// Objects, each once, or their frames.
fn count(objects: &[&Object]) -> i64 {
    let mut seen = BTreeSet::new();
    let once = objects.iter().filter(|o| o.uid.is_empty() || seen.insert(&o.uid));
    once.map(|o| whole(&o.header, tags::NUMBER_OF_FRAMES).unwrap_or(1).clamp(1, 1 << 24)).sum()
}

fn concatenations(what: &str, objects: &[Object]) -> Result<()> {
    let mut parts: BTreeMap<String, (i64, BTreeSet<i64>)> = BTreeMap::new();
    for object in objects {
        let uid = text(&object.header, tags::CONCATENATION_UID);
        if uid.is_empty() {
            continue;
        }
        let (total, numbers) = parts.entry(uid).or_default();
        let number = whole(&object.header, tags::IN_CONCATENATION_NUMBER).unwrap_or(1);
        let told = whole(&object.header, tags::IN_CONCATENATION_TOTAL_NUMBER).unwrap_or_default();
        *total = (*total).max(told).max(number);
        numbers.insert(number);
    }
    let Some((uid, (total, numbers))) = parts.iter().find(|(_, (total, numbers))| (numbers.len() as i64) < *total)
    else {
        return Ok(());
    };
    let there = numbers.iter().map(ToString::to_string).collect::<Vec<_>>().join(", ");
    let problem = format!("of the {total} parts of the concatenation {uid} only {there} is there");
    Err(Error::refused(
        findings::DICOM_FEWER,
        what,
        problem,
        "put all parts into one folder, or export the series again",
    ))
}
