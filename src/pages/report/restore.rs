//! A finished run out of its folder, as it was in memory: what pictures and the viewer are made from.

use super::numbers::Report;
use super::outputs::BONE_POSTERIOR;
use crate::error::{Error, Result};
use crate::field::{PullField, PushField};
use crate::io::{read_field, read_image, read_json, read_labels};
use crate::pipeline::{Outcome, PlanningScan};
use crate::sampling::PosePosterior;
use crate::skeleton::{Skeleton, build};
use crate::volume::{Mask, Spans, Volume};
use std::path::{Path, PathBuf};

/// What to do where a file of the run is none.
const REMEDY: &str = "give the --out folder of a finished run of aventail register";

/// The outcome of the run that `report` tells of, from the files in `folder`, with the planning side as it was read for it. What the
/// report does not hold, such as regions of influence, is left out.
///
/// # Errors
/// [`Error::Read`] when a file is missing or cannot be read; [`Error::Input`] when its bones are not those of the
/// report.
pub fn restore(folder: &Path, report: &Report, planning: &PlanningScan) -> Result<Outcome> {
    let file = |stem: &str| file_of(folder, report, stem);
    let mask = |stem: &str| Ok::<Mask, Error>(read_image(file(stem)?)?.value.map(|v| *v != 0.0));
    let map = |stem: &str| Ok::<Volume<f32>, Error>(read_image(file(stem)?)?.value);
    let uncertainty = match report.uncertainty {
        Some(numbers) => Some((Spans::of_volume(&map("uncertainty")?), numbers)),
        None => None,
    };
    let bones_on_fraction = read_labels(file("bones_on_fraction")?, None)?.value;
    Ok(Outcome {
        skeleton: skeleton_of(report, planning)?,
        pose: report.pose.clone(),
        common_shift: report.common_shift,
        couch: report.couch.clone(),
        bone_fits: report.bones.clone(),
        weighed: Default::default(),
        body: mask("body")?,
        push: PushField { displacement: read_field(file("planning_to_fraction")?)?.value, computed: mask("computed")? },
        pull: PullField {
            displacement: read_field(file("fraction_to_planning")?)?.value,
            inside: mask("inside_planning")?,
        },
        planning_on_fraction: map("planning_on_fraction")?,
        bones_on_fraction: bones_on_fraction.into(),
        jacobian: Spans::of_volume(&map("jacobian")?),
        jacobian_report: report.jacobian.clone(),
        rigidity: report.rigidity.clone(),
        contact: report.contact.clone(),
        skin_contact: None,
        volume_changes: report.volume_changes.clone(),
        guides: report.guides.clone(),
        kind: report.fraction_kind.clone(),
        uncertainty,
        posterior: posterior_of(folder, report)?,
        agreement: report.agreement,
        pruning: report.pruning,
        links: report.links,
        inverse: report.inverse,
        consistency: report.consistency,
        landmarks: report.landmarks.clone(),
        warnings: report.warnings.clone(),
        regions: None,
    })
}

/// The file of a run whose name begins so, up to its first dot.
fn file_of(folder: &Path, report: &Report, stem: &str) -> Result<PathBuf> {
    let listed = report.outputs.iter().find(|o| o.name.split('.').next() == Some(stem));
    let listed = listed.ok_or_else(|| {
        Error::read(folder.join("report.json"), format!("it lists no file {stem}: it is no whole registration"), REMEDY)
    })?;
    Ok(folder.join(&listed.name))
}

/// What the fit left open of the bones; nothing where the run did not tell.
fn posterior_of(folder: &Path, report: &Report) -> Result<Option<PosePosterior>> {
    if report.outputs.iter().all(|o| o.name != BONE_POSTERIOR) {
        return Ok(None);
    }
    let path = folder.join(BONE_POSTERIOR);
    let posterior: PosePosterior = read_json(&path, REMEDY)?;
    match posterior.problem() {
        None => Ok(Some(posterior)),
        Some(problem) => Err(Error::read(&path, problem, REMEDY)),
    }
}

/// The bones of the report with where they lie in planning, in the order of the report.
fn skeleton_of(report: &Report, planning: &PlanningScan) -> Result<Skeleton> {
    let built = match &planning.skeleton {
        Some(skeleton) => skeleton.clone(),
        None => build(&planning.bones)?.skeleton,
    };
    let bone = |name: &String| built.bones.iter().find(|b| b.name == *name).cloned();
    let bones: Option<Vec<_>> = report.bones.iter().map(|fit| bone(&fit.name)).collect();
    let bones = bones.ok_or_else(|| Error::input("bone labels", "they are not those of the run", REMEDY))?;
    Ok(Skeleton { bones })
}

/// A volume on a run's grid: of a run of a region, the part that it was cut to.
///
/// # Errors
/// [`Error::Internal`] when no volume can be made of it.
pub fn cut_to<T: Copy + Default + Send + Sync>(volume: Volume<T>, grid: &crate::geometry::Grid) -> Result<Volume<T>> {
    if volume.grid().matches(grid, 1e-3) {
        return Ok(volume);
    }
    let at = |l: usize| volume.grid().voxel_at(&grid.centre(grid.voxel(l))).map_or_else(T::default, |v| *volume.at(v));
    Volume::new(grid.clone(), (0..grid.len()).map(at).collect())
}
