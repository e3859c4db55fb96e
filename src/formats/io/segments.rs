//! Bones and organs of a DICOM segmentation, on the voxels of the image that they belong to.

use super::Loaded;
use super::dicom::{BoneNames, Segment, bone_or_name, on_grid, plain, read_segmentation, some_names};
use crate::error::{Error, Result};
use crate::findings;
use crate::geometry::Grid;
use crate::volume::LabelMap;
use crate::warning::Warning;
use std::cell::RefCell;
use std::path::Path;

/// All segments, bones by TotalSegmentator's names where label or coded term tell them.
///
/// # Errors
/// As [`read_segmentation`].
pub(super) fn all_segments(path: &Path) -> Result<Loaded<LabelMap>> {
    read_segmentation(path, &bone_or_name)
}

/// The segments that are bones, on `grid`.
///
/// # Errors
/// As [`read_segmentation`]; [`Error::Input`] when none is a bone, and when the voxels are not those of `grid`.
pub(super) fn bone_segments(path: &Path, names: &BoneNames, grid: &Grid) -> Result<Loaded<LabelMap>> {
    let left: RefCell<Vec<String>> = RefCell::default();
    let keep = |segment: &Segment| {
        let bone = segment.bone(names);
        if bone.is_none() {
            left.borrow_mut().push(segment.name.clone());
        }
        bone
    };
    let mut read = read_segmentation(path, &keep)?;
    let (what, left) = (read.path.display().to_string(), left.into_inner());
    if read.value.names.is_empty() {
        let problem = format!("none of its segments is a bone by label or coded term: {}", some_names(&left));
        let remedy = "label the segments as TotalSegmentator or TG-263 do, or give a TOML file with --labels: [bones], then lines \
            such as \"Unterkiefer\" = \"mandible\"";
        return Err(Error::refused(findings::BONES_UNNAMED, what, problem, remedy));
    }
    if !left.is_empty() {
        let message = format!("{what}: segments that are no bone are left out: {}", some_names(&left));
        read.warnings.push(Warning::new(findings::SEGMENTS_LEFT_OUT, message));
    }
    let joined = read.value.one_number_a_name();
    if !joined.is_empty() {
        let message = format!("{what}: several segments are one bone: {}", some_names(&joined));
        read.warnings.push(Warning::new(findings::LABELS_JOINED, message));
    }
    let counts = read.value.counts();
    let gone: Vec<&String> = read.value.names.iter().filter(|n| !counts.contains_key(n.0)).map(|n| n.1).collect();
    if !gone.is_empty() && !counts.is_empty() {
        let message = format!("{what}: bones without a voxel: {}", some_names(&gone));
        read.warnings.push(Warning::new(findings::BONES_OUTSIDE, message));
    }
    read.value = on_grid(&read.path, &read.value, grid)?;
    Ok(read)
}

/// The segments of these names, on `grid`, by the names that are asked for.
///
/// # Errors
/// As [`read_segmentation`]; [`Error::Input`] when no segment has one of the names, and when the voxels are not those of `grid`.
pub(super) fn organ_segments(path: &Path, wanted: &[String], grid: &Grid) -> Result<Loaded<LabelMap>> {
    let others: RefCell<Vec<String>> = RefCell::default();
    let keep = |segment: &Segment| {
        let name = wanted.iter().find(|w| plain(w) == plain(&segment.name)).cloned();
        if name.is_none() {
            others.borrow_mut().push(segment.name.clone());
        }
        name
    };
    let mut read = read_segmentation(path, &keep)?;
    if read.value.names.is_empty() {
        let problem = format!(
            "none of its segments is an organ that the settings name ({}): {}",
            some_names(wanted),
            some_names(&others.into_inner())
        );
        let remedy = "name organs as the segmentation does, in --volume-change, chainmail.organs or chainmail.slip.organs; or \
            leave --organs out";
        return Err(Error::input(read.path.display().to_string(), problem, remedy));
    }
    read.value = on_grid(&read.path, &read.value, grid)?;
    Ok(read)
}
