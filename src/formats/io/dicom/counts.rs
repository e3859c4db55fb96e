//! Images that a series says it has, against those that are there.

use super::elements::{text, whole};
use super::find::Object;
use crate::error::{Error, Result};
use crate::findings;
use crate::warning::Warning;
use dicom_dictionary_std::tags;
use std::collections::{BTreeMap, BTreeSet};

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
