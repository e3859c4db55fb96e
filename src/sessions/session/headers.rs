//! What arguments, headers and labels tell is refused before anything longer begins.

use super::fraction::FractionSources;
use super::modality::of_scan;
use super::planning::PlanningSources;
use super::source::Source;
use crate::config::{Config, Modality};
use crate::error::{Error, Result};
use crate::geometry::Grid;
use crate::io::dicom::is_dicom_path;
use crate::io::{read_grid, read_label_map, read_scan};
use crate::pipeline::{check_grids, check_size, memory_estimate};
use crate::volume::Volume;

/// Refuses, by the headers alone, scans that are too small, labels of another grid, a region outside the planning CT, and scans
/// that are not of the modality that the settings name;
/// returns the memory that the greediest fraction is expected to need, bytes. Without a fraction the planning scan counts
/// as one.
///
/// # Errors
/// As reading a header, and [`Error::Input`] and [`Error::Usage`] as above.
pub fn judge(side: &PlanningSources, fractions: &[FractionSources], config: &Config) -> Result<u64> {
    planning_modality(side, config.planning.modality)?;
    let planning = grid_of(&side.ct)?;
    check_size("planning CT", &planning)?;
    // Contours are drawn on the planning grid.
    let drawn = side.bones.path().is_some_and(is_dicom_path);
    let labels = if drawn { planning.clone() } else { grid_of(&side.bones)? };
    if let Err(elsewhere) = check_grids(&planning, &labels) {
        // That a file cannot be read or used at all is the first thing to tell.
        side.ct.path().map(read_scan).transpose()?;
        side.bones.path().map(|path| read_label_map(path, None)).transpose()?;
        return Err(elsewhere);
    }
    config.region.check_box(&planning)?;
    modality(fractions, config.fraction.modality)?;
    let mut expected = 0;
    for one in fractions {
        let fraction = grid_of(&one.ct)?;
        check_size("fraction CT", &fraction)?;
        expected = expected.max(memory_estimate(&planning, &fraction, fractions.len() > 1, config));
    }
    Ok(if fractions.is_empty() { memory_estimate(&planning, &planning, false, config) } else { expected })
}

/// What made the planning scan: what a DICOM series says of itself, else what is `told`, else a CT.
///
/// # Errors
/// As [`modality`].
pub(super) fn planning_modality(side: &PlanningSources, told: Modality) -> Result<Modality> {
    of_scan(&side.ct, told, "--planning-modality")
}

/// What made the fractions, which are of one modality: what DICOM series say of themselves, else what is `told`, else a CT.
///
/// # Errors
/// [`Error::Usage`] when a series is of another modality than is told, or than another fraction; else as finding a series.
pub(super) fn modality(fractions: &[FractionSources], told: Modality) -> Result<Modality> {
    let name = |one: &FractionSources| one.ct.path().map_or("an image in memory".into(), |p| p.display().to_string());
    let unsaid = if told == Modality::Auto { Modality::Ct } else { told };
    let mut first: Option<(Modality, &FractionSources)> = None;
    for one in fractions {
        let own = of_scan(&one.ct, told, "--modality")?;
        let (of_first, other) = *first.get_or_insert((own, one));
        if of_first != own {
            let problem = format!("{} and {} are of two modalities, a CT and an MR", name(other), name(one));
            return Err(Error::usage(problem, "register the fractions of each modality in a run of their own"));
        }
    }
    Ok(first.map_or(unsaid, |(own, _)| own))
}

/// The grid of what is given; of a file by its header.
fn grid_of<T>(source: &Source<Volume<T>>) -> Result<Grid> {
    match source {
        Source::File(path) => Ok(read_grid(path)?.0),
        Source::Memory(volume) => Ok(volume.grid().clone()),
    }
}

/// Refuses a run that is expected to need more than is allowed, GB.
///
/// # Errors
/// [`Error::Usage`] then.
pub fn within_memory(expected: u64, most_gb: Option<f64>) -> Result<()> {
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
