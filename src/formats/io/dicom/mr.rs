//! One contrast at a time: MR images that differ in echo, time or kind make no volume together.

use super::acquisitions::listed;
use super::frames::Frame;
use super::kinds::{no_anatomy, refuse_map};
use crate::error::{Error, Result};
use crate::findings;
use std::path::PathBuf;

/// Refuses images of several kinds, echoes or times in one series, with what there is of each; and a series of maps alone.
///
/// # Errors
/// [`Error::Input`] then.
pub(super) fn one_image(what: &str, files: &[PathBuf], frames: &[Frame]) -> Result<()> {
    let frames: Vec<&Frame> = frames.iter().filter(|f| !f.localizer).collect();
    let Some(first) = frames.first() else { return Ok(()) };
    if frames.iter().all(|f| no_anatomy(&f.kind).is_some())
        && let Some(map) = no_anatomy(&first.kind)
    {
        return Err(refuse_map(what, &(map, first.kind.join("\\")), &[]));
    }
    for (n, (name, of_first)) in first.origin.iter().enumerate() {
        let value = |f: &Frame| f.origin.get(n).map_or(String::new(), |o| o.1.clone());
        if frames.iter().all(|f| value(f) == *of_first) {
            continue;
        }
        let values: Vec<String> = frames.iter().map(|f| value(f)).collect();
        let values: Vec<&str> = values.iter().map(String::as_str).collect();
        let list = listed(files, frames.iter().copied(), name, &values);
        let problem = format!("its images differ in {name}, so that they are several volumes:{list}");
        return Err(Error::refused(findings::DICOM_ACQUISITIONS, what, problem, keep(&frames)));
    }
    Ok(())
}

/// What to do about images of several kinds: which of them remain.
fn keep(frames: &[&Frame]) -> String {
    let mut kinds: Vec<String> = frames.iter().map(|f| f.kind.join("\\")).collect();
    kinds.sort_unstable();
    kinds.dedup();
    let split = |kind: &str| kind.split('\\').map(str::to_owned).collect::<Vec<_>>();
    let anatomy: Vec<&String> = kinds.iter().filter(|kind| no_anatomy(&split(kind)).is_none()).collect();
    match anatomy.as_slice() {
        [one] if kinds.len() > 1 => format!("keep the images of image type {one}, and move the others elsewhere"),
        _ => "export each as a series of its own, or move all but one elsewhere".into(),
    }
}
