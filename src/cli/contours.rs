//! Contours of the planning CT, as several verbs read them.

use crate::error::{Error, Result};
use crate::io::dicom::{Role, check_frames, is_dicom_path};
use crate::io::{ContourFile, read_contour_file};
use crate::volume::contour::Contours;
use crate::warning::Warning;
use std::path::Path;

/// Reads contours (JSON, DICOM structure set) that lie in the frame of the planning CT, tidied, with what was found.
///
/// # Errors
/// [`Error::Input`] when they lie in another frame; else as [`read_contour_file`].
pub(super) fn of_planning(path: &Path, planning: Option<&Path>) -> Result<(Contours, Vec<Warning>)> {
    if let Some(planning) = planning {
        check_frames(Role::Structures.at(path), Role::Image.at(planning))?;
    }
    let ContourFile { mut contours, frame, mut warnings, .. } = read_contour_file(path)?;
    if let Some(frame) = frame.filter(|frame| frame != "planning" && !is_dicom_path(path)) {
        let problem = format!("its contours lie in the frame {frame:?}, not in planning");
        return Err(Error::input(path.display().to_string(), problem, "give contours of the planning CT"));
    }
    warnings.extend(contours.tidy());
    Ok((contours, warnings))
}
