//! Structures one by one, which may lie over each other: of a structure set, a segmentation or a label map.

use super::dicom::{self, outlines_from_structures, read_structure_set, some_names, structure_notes};
use super::labels::read_structures;
use super::segments::all_segments;
use super::{Loaded, read_grid};
use crate::error::{Error, Result};
use crate::findings;
use crate::volume::Outline;
use crate::warning::Warning;
use std::path::Path;

/// Reads the structures of a file: a label map (names in the header, or in the JSON file `names`), a DICOM segmentation, or a
/// structure set, drawn on the grid of the scan `on`. Those without a voxel are named and left out.
///
/// # Errors
/// As [`read_structures`] and [`read_structure_set`]; [`Error::Usage`] when a structure set has no scan in a file.
pub fn read_outlines(path: &Path, names: Option<&Path>, on: Option<&Path>) -> Result<Loaded<Vec<Outline>>> {
    if !dicom::is_place(path) || dicom::is_segmentation(path) {
        let read = if dicom::is_place(path) { all_segments(path)? } else { read_structures(path, names)? };
        let Loaded { value, path, sha256, header, warnings } = read;
        return Ok(Loaded { value: Outline::all(&value), path, sha256, header, warnings });
    }
    let Some(on) = on else {
        let problem =
            format!("{}: a structure set is drawn on the grid of its scan, which is in memory", path.display());
        return Err(Error::usage(problem, "give the scan as a DICOM folder, or a label map"));
    };
    let grid = read_grid(on)?.0;
    let mut set = read_structure_set(path)?;
    let tidied = set.contours.tidy();
    let (value, empty) = outlines_from_structures(&set, &grid)?;
    let mut warnings = [std::mem::take(&mut set.warnings), tidied].concat();
    if !empty.is_empty() {
        let message = format!(
            "{}: structures without a voxel in the image are not used as guides: {}",
            path.display(),
            some_names(&empty)
        );
        warnings.push(Warning::new(findings::GUIDE_LEFT_OUT, message));
    }
    let header = structure_notes(&grid, &set.label);
    Ok(Loaded { value, path: set.path, sha256: set.sha256, header, warnings })
}
