//! Labels are made: tasks of TotalSegmentator, joined to one map.

use super::Ask;
use super::place::LabelsPlace;
use super::record::{Failed, LabelsRecord};
use super::segmentator::{Segmentator, arguments};
use crate::error::{Error, Result};
use crate::geometry::Grid;
use crate::io::merge::Merging;
use crate::io::{
    Loaded, Planned, RunFolder, Stored, WriteOptions, check_place, is_lock, open_folder, read_image, read_label_map,
    write_image, write_json, write_labels,
};
use crate::progress::Progress;
use crate::skeleton::anatomy::Kind;
use crate::volume::{LabelMap, Volume};
use std::path::{Path, PathBuf};

/// The task that finds the whole skeleton but for what hangs on the skull.
const WHOLE: &str = "total";
/// Further tasks, the bone that each finds, and the bones of which one must be in view. They come first: what `total` calls
/// skull holds the mandible.
const FURTHER: [(&str, &str, &[&str]); 2] = [
    ("craniofacial_structures", "mandible", &["skull"]),
    ("headneck_bones_vessels", "hyoid", &["skull", "vertebrae_C2", "vertebrae_C3", "vertebrae_C4", "vertebrae_C5"]),
];
/// The tasks for MR: one has all vertebrae as one class, so that another tells their levels.
const WHOLE_OF_MR: &str = "total_mr";
const SPINE_OF_MR: &str = "vertebrae_mr";
/// Classes of the first that are bones of the skeleton.
const IN_TOTAL_MR: [&str; 10] = [
    "humerus_left",
    "humerus_right",
    "scapula_left",
    "scapula_right",
    "clavicula_left",
    "clavicula_right",
    "femur_left",
    "femur_right",
    "hip_left",
    "hip_right",
];
/// Bones of the skeleton that no open task finds with their side.
const LICENSED: [&str; 4] = ["ulna_left", "ulna_right", "radius_left", "radius_right"];

/// A folder that this process holds, and that is gone when the work is done, or has failed.
struct Work {
    folder: PathBuf,
    _held: RunFolder,
}

impl Work {
    /// Takes hold of the folder, rid of what a killed run left there.
    ///
    /// # Errors
    /// [`Error::Write`] when another process works there, or the folder cannot be written to.
    fn open(folder: PathBuf, command: &str) -> Result<Self> {
        let planned = Planned { reports: Vec::new(), names: Vec::new() };
        let held = RunFolder::open(&folder, &planned, &[], command)?;
        let refuse = |e: std::io::Error| Error::write(&folder, e.to_string(), "remove it by hand");
        for entry in std::fs::read_dir(&folder).map_err(refuse)? {
            let path = entry.map_err(refuse)?.path();
            if path.is_dir() {
                std::fs::remove_dir_all(&path).map_err(refuse)?;
            } else if !is_lock(&path) {
                std::fs::remove_file(&path).map_err(refuse)?;
            }
        }
        Ok(Self { folder, _held: held })
    }
}

impl Drop for Work {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.folder);
    }
}

/// Has the labels made, joins them and keeps them with their record.
///
/// # Errors
/// As [`AutoBones::of`](super::AutoBones::of).
pub(super) fn make(ask: Ask<'_>, place: &LabelsPlace, progress: &dyn Progress) -> Result<LabelsRecord> {
    let program = Segmentator::find(ask.quiet)?;
    let folder = if place.folder.as_os_str().is_empty() { Path::new(".") } else { &place.folder };
    open_folder(folder)?;
    check_place(&place.labels)?;
    let name = place.labels.file_name().unwrap_or_default().to_string_lossy().replace(".nii.gz", "");
    let work = Work::open(folder.join(format!("{name}_work")), ask.command)?;
    progress.note(&program.told(ask.is_mr));
    let image = read_image(ask.planning)?;
    let scan = scan_file(ask.planning, &image, &work.folder)?;
    let mut tasks = Tasks { program: &program, scan: &scan, work: &work.folder, place, progress, commands: Vec::new() };
    let mut merging = Merging::new(true);
    let labelled = if ask.is_mr { of_mr } else { of_ct };
    let failed = labelled(&mut tasks, image.value.grid(), &mut merging)?;
    let commands = tasks.commands;
    let (map, merged) = merging.finish()?;
    let description = "bones by TotalSegmentator".into();
    write_labels(&place.labels, &map, &WriteOptions { description, ..WriteOptions::default() })?;
    let bones = merged.structures.into_iter().map(|s| s.name).collect();
    let record = LabelsRecord::new(place, ask.is_mr, &program, commands, bones, failed)?;
    write_json(&place.record, &record)?;
    progress.note(&format!("bones: {}", place.labels.display()));
    Ok(record)
}

/// The bones of a CT, each to keep what others overlap that come later; returns further tasks that failed.
fn of_ct(tasks: &mut Tasks<'_>, grid: &Grid, merging: &mut Merging) -> Result<Vec<Failed>> {
    let place = tasks.place;
    let names: Vec<String> = Kind::names().into_iter().filter(|n| is_in_total(n)).collect();
    let mut whole = tasks.run(WHOLE, &names, grid)?.ok_or_else(|| place.failed("it found no bone in the CT"))?;
    let (mut failed, mut found) = (Vec::new(), Vec::new());
    let labelled = whole.counts();
    let seen: Vec<String> = labelled.keys().filter_map(|l| whole.names.get(l).cloned()).collect();
    for (task, bone, near) in FURTHER {
        if !seen.iter().any(|b| near.contains(&b.as_str())) {
            continue;
        }
        match tasks.run(task, &[], grid) {
            Ok(Some(mut map)) => {
                map.names.retain(|_, n| n == bone);
                let counts = map.counts();
                found.extend(map.names.keys().any(|l| counts.contains_key(l)).then_some(bone));
                merging.add(&place.labels, map, true)?;
            }
            Ok(None) => {}
            Err(error) => {
                tasks.progress.note(&format!("task {task} failed; {bone} has no label"));
                failed.push(Failed { task: task.into(), bone: bone.into(), problem: error.to_string() });
            }
        }
    }
    whole.names.retain(|_, n| !found.contains(&n.as_str()));
    merging.add(&place.labels, whole, true)?;
    Ok(failed)
}

/// The bones of an MR: sacrum and vertebrae by their levels, which keep what others overlap, and what else is found.
fn of_mr(tasks: &mut Tasks<'_>, grid: &Grid, merging: &mut Merging) -> Result<Vec<Failed>> {
    let place = tasks.place;
    let rest = tasks.run(WHOLE_OF_MR, &IN_TOTAL_MR.map(str::to_owned), grid)?;
    let mut failed = Vec::new();
    let spine = tasks.run(SPINE_OF_MR, &[], grid).unwrap_or_else(|error| {
        tasks.progress.note(&format!("task {SPINE_OF_MR} failed; the spine has no label"));
        failed.push(Failed { task: SPINE_OF_MR.into(), bone: "spine".into(), problem: error.to_string() });
        None
    });
    if spine.is_none() && rest.is_none() {
        return Err(place.failed("it found no bone in the MR"));
    }
    for map in [spine, rest].into_iter().flatten() {
        merging.add(&place.labels, map, true)?;
    }
    Ok(failed)
}

/// Whether the task `total` has a class of this name.
fn is_in_total(bone: &str) -> bool {
    !LICENSED.contains(&bone) && FURTHER.iter().all(|(_, own, _)| *own != bone)
}

/// The scan as TotalSegmentator reads it: NIfTI as it is, all else as NIfTI of what is read here.
fn scan_file(planning: &Path, image: &Loaded<Volume<f32>>, work: &Path) -> Result<PathBuf> {
    let name = planning.file_name().unwrap_or_default().to_string_lossy();
    if planning.is_file() && (name.ends_with(".nii") || name.ends_with(".nii.gz")) {
        return Ok(planning.to_owned());
    }
    let file = work.join("planning.nii.gz");
    let description = "planning, grey values".into();
    write_image(&file, &image.value, Stored::Int16, &WriteOptions { description, ..WriteOptions::default() })?;
    Ok(file)
}

/// Tasks that are run one after the other.
struct Tasks<'a> {
    program: &'a Segmentator,
    scan: &'a Path,
    work: &'a Path,
    place: &'a LabelsPlace,
    progress: &'a dyn Progress,
    commands: Vec<String>,
}

impl Tasks<'_> {
    /// Runs a task, for these classes alone where some are named; `None` when it labels nothing.
    fn run(&mut self, task: &str, classes: &[String], grid: &Grid) -> Result<Option<LabelMap>> {
        let out = self.work.join(format!("{task}.nii.gz"));
        let arguments = arguments(self.scan, &out, task, classes);
        let command = self.program.command_line(&arguments);
        self.progress.note(&format!("runs {command}"));
        let failed = |problem: &str| self.place.failed(&format!("`{command}` {problem}"));
        self.program.run(&arguments, self.progress).map_err(|problem| failed(&problem))?;
        if !out.is_file() {
            return Err(failed("ended well and wrote no label map"));
        }
        let map = read_label_map(&out, None).map_err(|e| failed(&format!("wrote what cannot be used: {e}")))?.value;
        let tolerance = 0.1 * grid.spacing().into_iter().fold(f64::MAX, f64::min);
        if !grid.matches(map.volume.grid(), tolerance) {
            return Err(failed("wrote labels on another grid than the scan's"));
        }
        let counts = map.counts();
        if let Some(nameless) = counts.keys().find(|l| !map.names.contains_key(l)) {
            return Err(failed(&format!("wrote label {nameless} without a name")));
        }
        self.commands.push(command);
        Ok(Some(map).filter(|_| !counts.is_empty()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn total_is_asked_for_all_bones_that_it_knows() {
        let names: Vec<String> = Kind::names().into_iter().filter(|n| is_in_total(n)).collect();
        assert_eq!(names.len(), 62);
        let of_mr = IN_TOTAL_MR.iter().filter(|n| Kind::of(n).is_none());
        assert_eq!(of_mr.count(), 0);
        assert!(names.iter().any(|n| n == "vertebrae_S1") && names.iter().all(|n| n != "mandible" && n != "ulna_left"));
    }
}
