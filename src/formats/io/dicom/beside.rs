//! Files beside the objects that are read: what cannot be read may be a part of the same series.

use super::find::{Catalogue, Damaged, Object};
use crate::error::{Error, Result};
use crate::findings;
use crate::warning::Warning;
use std::collections::BTreeSet;
use std::fs::File;
use std::io::Read as _;
use std::path::Path;

/// Files that a message names.
const NAMED: usize = 6;
/// Bytes by which text is told.
const FIRST: u64 = 1 << 10;

/// Refuses objects beside which a file of the same series cannot be read, or may be one: `same` tells it of a damaged file
/// by what is left of it, where that says anything. Others are told.
///
/// # Errors
/// [`Error::Input`] naming the files.
pub(super) fn beside(
    path: &Path,
    found: &Catalogue,
    objects: &[&Object],
    same: &dyn Fn(&Damaged) -> Option<bool>,
) -> Result<Vec<Warning>> {
    let folders: BTreeSet<Option<&Path>> = objects.iter().map(|o| o.path.parent()).collect();
    let near = |file: &Path| folders.contains(&file.parent());
    let names: BTreeSet<String> = objects.iter().map(|o| pattern(&o.path)).collect();
    let (mut lost, mut odd) = (Vec::new(), Vec::new());
    for damaged in &found.damaged {
        let told = format!("{}: {}", damaged.path.display(), damaged.why);
        let may = || near(&damaged.path) && !is_hidden(&damaged.path);
        match same(damaged) {
            Some(true) => lost.push(told),
            None if may() => lost.push(told),
            _ => odd.push(told),
        }
    }
    let alike = |file: &Path| {
        let extension = extension(file);
        extension == "dcm"
            || names.contains(&pattern(file))
            || extension.is_empty() && names.iter().all(|n| !n.contains('.'))
    };
    for file in found.others.iter().filter(|file| near(file) && !is_hidden(file)) {
        let Some(why) = strange(file) else { continue };
        let told = format!("{}: {why}", file.display());
        if alike(file) {
            lost.push(told)
        } else if why == EMPTY {
            odd.push(told)
        }
    }
    if !lost.is_empty() {
        let problem = format!("some files beside it cannot be read and may belong to it: {}", list(&lost));
        let remedy = "copy or export the series again; move files that do not belong to it elsewhere";
        return Err(Error::refused(findings::DICOM_DAMAGED, path.display().to_string(), problem, remedy));
    }
    let message = || format!("{}: files of other series or kinds cannot be read: {}", path.display(), list(&odd));
    Ok(if odd.is_empty() { Vec::new() } else { vec![Warning::new(findings::DICOM_DAMAGED, message())] })
}

const EMPTY: &str = "it is empty (0 bytes)";

/// Why a file that is no DICOM may have been some; `None` where it is text, or of a kind of its own.
fn strange(file: &Path) -> Option<&'static str> {
    let mut first = Vec::new();
    if File::open(file).and_then(|f| f.take(FIRST).read_to_end(&mut first)).is_err() {
        return Some("it cannot be opened");
    }
    if first.is_empty() {
        return Some(EMPTY);
    }
    let text = match std::str::from_utf8(&first) {
        Ok(text) => !text.contains('\0'),
        // A character may be cut off.
        Err(e) => e.error_len().is_none() && !first.contains(&0),
    };
    (!text || extension(file) == "dcm").then_some("it is no DICOM")
}

/// Files of the system, which lie beside others by themselves.
fn is_hidden(file: &Path) -> bool {
    let name = file.file_name().map(|n| n.to_string_lossy().to_lowercase()).unwrap_or_default();
    name.starts_with('.') || matches!(name.as_str(), "thumbs.db" | "desktop.ini" | "dicomdir")
}

fn extension(file: &Path) -> String {
    let end = file.extension().map(|e| e.to_string_lossy().to_lowercase()).unwrap_or_default();
    // UIDs as names end with a number.
    if end.bytes().all(|b| b.is_ascii_digit()) { String::new() } else { end }
}

/// A name without its digits.
fn pattern(file: &Path) -> String {
    let name = file.file_name().map(|n| n.to_string_lossy().to_lowercase()).unwrap_or_default();
    name.chars().filter(|c| !c.is_ascii_digit()).collect()
}

fn list(all: &[String]) -> String {
    let shown: String = all.iter().take(NAMED).map(|one| format!("\n    {one}")).collect();
    if all.len() > NAMED { format!("{shown}\n    and {} more", all.len() - NAMED) } else { shown }
}
