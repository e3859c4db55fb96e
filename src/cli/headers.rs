//! What arguments, headers and labels tell is refused before anything longer begins.

use crate::chainmail::organ_label;
use crate::config::Config;
use crate::error::{Error, Result};
use crate::geometry::Grid;
use crate::io::dicom::is_dicom_path;
use crate::io::{read_grid, read_image, read_label_map};
use crate::pipeline::{check_grids, check_size, memory_estimate};
use crate::skeleton;
use crate::volume::LabelMap;
use std::path::Path;

/// Refuses, by the headers alone, scans that are too small, labels of another grid, and a region outside the planning CT;
/// returns the memory that the greediest fraction is expected to need, bytes. Without a fraction the planning scan counts
/// as one.
///
/// # Errors
/// As reading a header, and [`Error::Input`] and [`Error::Usage`] as above.
pub(super) fn judge(planning: &Path, bones: &Path, fractions: &[&Path], config: &Config) -> Result<u64> {
    let grid = |path: &Path| read_grid(path).map(|read| read.0);
    let file = planning;
    let planning = grid(file)?;
    check_size("planning CT", &planning)?;
    // Contours are drawn on the planning grid.
    let labels = if is_dicom_path(bones) { planning.clone() } else { grid(bones)? };
    if let Err(elsewhere) = check_grids(&planning, &labels) {
        // That a file cannot be read or used at all is the first thing to tell.
        read_image(file)?;
        read_label_map(bones, None)?;
        return Err(elsewhere);
    }
    config.region.check_box(&planning)?;
    let mut expected = 0;
    for path in fractions {
        let fraction: Grid = grid(path)?;
        check_size("fraction CT", &fraction)?;
        expected = expected.max(memory_estimate(&planning, &fraction, config));
    }
    Ok(if fractions.is_empty() { memory_estimate(&planning, &planning, config) } else { expected })
}

/// Refuses a run that is expected to need more than is allowed, GB.
pub(super) fn within_memory(expected: u64, most_gb: Option<f64>) -> Result<()> {
    match most_gb {
        Some(most) if expected as f64 > most * 1e9 => Err(Error::usage(
            format!(
                "the run is expected to need {:.1} GB of memory, more than --max-memory {most}",
                expected as f64 / 1e9
            ),
            "allow more, name a region with --roi, or resample the scans to larger voxels",
        )),
        _ => Ok(()),
    }
}

/// Refuses settings that name a region or organs which the labels do not have.
pub(super) fn judge_names(labels: &LabelMap, config: &Config) -> Result<()> {
    config.region.voxels(labels)?;
    let (organs, changes) = (config.chainmail.organs.keys(), &config.chainmail.volume_change);
    if config.chainmail.organs.is_empty() && changes.is_empty() {
        return Ok(());
    }
    let built = skeleton::build(labels)?.skeleton;
    let is_bone = |label: u16| built.bones.iter().any(|b| b.label == label);
    let named = organs.map(|organ| ("chainmail.organs", organ));
    let changed = changes.iter().map(|c| ("chainmail.volume_change", &c.organ));
    named.chain(changed).try_for_each(|(setting, organ)| organ_label(setting, organ, labels, is_bone).map(drop))
}
