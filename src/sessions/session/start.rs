//! The start of a fit: a motion of all bones that is known from elsewhere, planning to fraction.

use crate::error::{Error, Result};
use crate::findings;
use crate::geometry::Rigid;
use crate::io::dicom::{Role, frame_of};
use crate::io::{split_choice, transform};
use std::path::{Path, PathBuf};

/// The file, and the name of its entry: `FILE`, `FILE#NAME`.
pub fn split(path: &Path) -> (PathBuf, Option<&str>) {
    let parts = if path.exists() { None } else { split_choice(path) };
    parts.map_or((path.to_owned(), None), |(file, entry)| (file, Some(entry)))
}

/// Reads the start of a fit. A registration in DICOM is turned where its frames of reference say that it takes the fraction to
/// planning; everything else takes planning to the fraction.
///
/// # Errors
/// [`Error::Input`] when a registration joins other frames of reference than those of the scans; else as
/// [`transform::read_rigid`].
pub(super) fn read(path: &Path, planning: Option<&Path>, fraction: Option<&Path>) -> Result<Rigid> {
    let (file, entry) = split(path);
    if !transform::is_transform(&file) {
        let problem = "it is no rigid transform by its extension, and no Spatial Registration";
        let remedy = "give a Spatial Registration (DICOM), an ITK .tfm, a 4x4 as .txt#lps or .txt#ras, or .json#NAME";
        return Err(Error::input(file.display().to_string(), problem, remedy));
    }
    let (rigid, uids) = transform::read_rigid_between(&file, entry, None)?;
    let Some(uids) = uids else { return Ok(rigid) };
    let frame = |scan: Option<&Path>| scan.map_or(Ok(None), |scan| frame_of(Role::Image.at(scan)));
    let frames = [frame(planning)?, frame(fraction)?];
    Ok(if turned(&file, &uids, &frames)? { rigid.inverse() } else { rigid })
}

/// Whether a registration takes the fraction to planning.
fn turned(file: &Path, [a, b]: &[String; 2], frames: &[Option<String>; 2]) -> Result<bool> {
    let fits = |own: &Option<String>, uid: &String| own.as_ref().is_none_or(|own| own == uid);
    let [planning, fraction] = frames;
    if fits(planning, a) && fits(fraction, b) {
        return Ok(false);
    }
    if fits(planning, b) && fits(fraction, a) {
        return Ok(true);
    }
    let name = |own: &Option<String>| own.clone().unwrap_or_else(|| "no known one".into());
    let problem = format!(
        "it joins the frames of reference {a} and {b}, but planning lies in {} and the fraction in {}",
        name(planning),
        name(fraction)
    );
    let remedy = "give the registration that belongs to these scans";
    Err(Error::refused(findings::DICOM_FRAME, file.display().to_string(), problem, remedy))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_name_of_an_entry_is_split_off() {
        let told = |path: &str, file: &str, entry: Option<&str>| {
            assert_eq!(split(Path::new(path)), (PathBuf::from(file), entry), "{path}");
        };
        told("a#b/start.txt#lps", "a#b/start.txt", Some("lps"));
        told("moves.json#a/b", "moves.json", Some("a/b"));
        told("start.tfm", "start.tfm", None);
    }

    /// A folder whose name is no text: `#lps` was taken for a part of the file's name.
    #[cfg(unix)]
    #[test]
    fn an_entry_is_split_off_in_a_folder_that_is_no_text() {
        use std::ffi::OsStr;
        use std::os::unix::ffi::OsStrExt;
        let folder = Path::new(OsStr::from_bytes(b"caf\xe9"));
        assert_eq!(split(&folder.join("start.txt#lps")), (folder.join("start.txt"), Some("lps")));
        assert_eq!(split(&folder.join("start.txt")), (folder.join("start.txt"), None));
    }

    #[test]
    fn a_registration_is_turned_by_its_frames_of_reference() {
        let uids = ["1.2.3".to_owned(), "1.2.4".to_owned()];
        let judged = |planning: Option<&str>, fraction: Option<&str>| {
            turned(Path::new("r.dcm"), &uids, &[planning, fraction].map(|f| f.map(str::to_owned)))
        };
        for (planning, fraction, expected) in [
            (Some("1.2.3"), Some("1.2.4"), false),
            (Some("1.2.4"), Some("1.2.3"), true),
            (Some("1.2.4"), None, true),
            (None, Some("1.2.3"), true),
            (None, None, false),
        ] {
            assert_eq!(judged(planning, fraction).unwrap(), expected, "{planning:?} {fraction:?}");
        }
        for (planning, fraction) in
            [(Some("1.2.3"), Some("1.2.9")), (Some("1.2.9"), None), (Some("1.2.3"), Some("1.2.3"))]
        {
            assert!(judged(planning, fraction).is_err(), "{planning:?} {fraction:?}");
        }
    }
}
