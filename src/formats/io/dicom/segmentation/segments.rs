//! The segments of a segmentation (PS3.3 C.8.20.4): numbers, labels and coded terms.

use super::super::bones::BoneNames;
use super::super::elements::{Item, first, items, text, whole};
use super::super::terms::bone_of;
use crate::error::{Error, Result};
use crate::findings;
use crate::warning::Warning;
use dicom_core::Tag;
use dicom_dictionary_std::tags;
use std::collections::{BTreeMap, BTreeSet};

/// One segment.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(in crate::io) struct Segment {
    /// Segment Number.
    pub(in crate::io) number: u16,
    /// Its name, which no other segment has.
    pub(in crate::io) name: String,
    /// The bone of its coded terms.
    pub(in crate::io) bone: Option<String>,
}

impl Segment {
    /// The bone that it is: by its label, else by its coded terms.
    pub(in crate::io) fn bone(&self, names: &BoneNames) -> Option<String> {
        names.bone(&self.name).or_else(|| self.bone.clone())
    }
}

/// What a header says of its segments, background left out.
///
/// # Errors
/// [`Error::Input`] for a number that is none, or that two segments have, and where there is no segment.
pub(super) fn segments(
    what: &str,
    set: &Item,
    background: Option<i64>,
) -> Result<(BTreeMap<u16, Segment>, Vec<Warning>)> {
    let refuse = |problem: String| {
        Err(Error::refused(
            findings::SEGMENTS_ODD,
            what,
            problem,
            "export the segmentation again, each segment with a number of its own",
        ))
    };
    let mut found: BTreeMap<u16, Segment> = BTreeMap::new();
    let mut labels: BTreeMap<u16, String> = BTreeMap::new();
    for item in items(set, tags::SEGMENT_SEQUENCE) {
        let label = label(item);
        let number = whole(item, tags::SEGMENT_NUMBER);
        if number.is_some() && number == background {
            continue;
        }
        let Some(number) = number.and_then(|n| u16::try_from(n).ok()).filter(|n| *n > 0) else {
            let number = number.map_or("no usable Segment Number".into(), |n| format!("the Segment Number {n}"));
            return refuse(format!("the segment {label:?} has {number}; it must be from 1 to 65535"));
        };
        if let Some(other) = labels.insert(number, label.clone()) {
            return refuse(format!("the segments {other:?} and {label:?} have one Segment Number ({number})"));
        }
        found.insert(number, Segment { number, name: label, bone: coded_bone(item) });
    }
    if found.is_empty() {
        return refuse("it defines no segment".into());
    }
    let mut warnings = Vec::new();
    for s in found.values() {
        let by_label = BoneNames::default().bone(&s.name);
        if let (Some(a), Some(b)) = (&by_label, &s.bone)
            && a != b
        {
            let message = format!(
                "{what}: the segment {:?} is {a} by its label and {b} by its coded term; the label is taken",
                s.name
            );
            warnings.push(Warning::new(findings::SEGMENTS_TERMS, message));
        }
    }
    warnings.extend(one_name_each(what, &mut found));
    Ok((found, warnings))
}

/// Names that repeat give way to the coded bone, or get the number of the segment behind them.
fn one_name_each(what: &str, found: &mut BTreeMap<u16, Segment>) -> Option<Warning> {
    let known = BoneNames::default();
    let count = |found: &BTreeMap<u16, Segment>, name: &str| found.values().filter(|s| s.name == name).count();
    let before = found.clone();
    for s in found.values_mut() {
        if let Some(bone) = &s.bone
            && (known.bone(&s.name).is_none() || count(&before, &s.name) > 1)
            && before.values().all(|other| other.number == s.number || other.name != *bone)
        {
            s.name.clone_from(bone);
        }
    }
    let mut seen: BTreeSet<String> = BTreeSet::new();
    let mut twice = BTreeSet::new();
    for s in found.values_mut() {
        if seen.contains(&s.name) {
            twice.insert(s.name.clone());
            while seen.contains(&s.name) {
                s.name = format!("{} ({})", s.name, s.number);
            }
        }
        seen.insert(s.name.clone());
    }
    (!twice.is_empty()).then(|| {
        let names: Vec<String> = twice.into_iter().collect();
        let message = format!(
            "{what}: names are used twice: {}; the later segments have their number behind the name",
            names.join(", ")
        );
        Warning::new(findings::STRUCTURES_NAMES, message)
    })
}

/// What a segment is called: its label, else what its terms mean.
fn label(item: &Item) -> String {
    let own = text(item, tags::SEGMENT_LABEL);
    let number = || whole(item, tags::SEGMENT_NUMBER).map_or("segment".into(), |n| format!("segment {n}"));
    [own, meaning(item)].into_iter().find(|name| !name.is_empty()).unwrap_or_else(number)
}

/// What the property type of a segment means, with its side; empty where it has none.
fn meaning(item: &Item) -> String {
    let kind = first(item, tags::SEGMENTED_PROPERTY_TYPE_CODE_SEQUENCE);
    let side = kind.and_then(|kind| first(kind, tags::SEGMENTED_PROPERTY_TYPE_MODIFIER_CODE_SEQUENCE));
    let words = [kind, side].into_iter().flatten().map(|code| text(code, tags::CODE_MEANING));
    words.filter(|word| !word.is_empty()).collect::<Vec<_>>().join(" ")
}

/// The bone of a segment's property type, or of its anatomic region, with their modifiers.
fn coded_bone(item: &Item) -> Option<String> {
    let coded = |sequence: Tag, modifiers: Tag| {
        let kind = first(item, sequence)?;
        let scheme = text(kind, tags::CODING_SCHEME_DESIGNATOR);
        let code = Some(text(kind, tags::CODE_VALUE)).filter(|_| scheme == "SCT" || scheme.starts_with("SNOMED"))?;
        // The side stands in the item of what it modifies; some writers put it beside.
        let sides = items(kind, modifiers).iter().chain(items(item, modifiers));
        let mut sides = sides.map(|side| text(side, tags::CODE_VALUE)).chain([String::new()]);
        sides.find_map(|side| bone_of(&code, &side))
    };
    let own = (tags::SEGMENTED_PROPERTY_TYPE_CODE_SEQUENCE, tags::SEGMENTED_PROPERTY_TYPE_MODIFIER_CODE_SEQUENCE);
    let region = (tags::ANATOMIC_REGION_SEQUENCE, tags::ANATOMIC_REGION_MODIFIER_SEQUENCE);
    let by_type = coded(own.0, own.1).or_else(|| {
        // Codes of older terminologies mean the same: "Femur Left", "C1 vertebra".
        let meaning = meaning(item);
        BoneNames::default().bone(meaning.strip_suffix(" vertebra").unwrap_or(&meaning))
    });
    by_type.or_else(|| {
        // A lesion in a bone is no bone.
        let bony = first(item, tags::SEGMENTED_PROPERTY_TYPE_CODE_SEQUENCE)
            .is_none_or(|kind| ["272673000", "3138006"].contains(&text(kind, tags::CODE_VALUE).as_str()));
        bony.then(|| coded(region.0, region.1)).flatten()
    })
}
