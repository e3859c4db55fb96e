//! `aventail skeleton`: build, check and show the joint tree of a label map.

use super::args::JsonArgs;
use super::inputs::needed;
use super::terminal::{command_line, progress};
use crate::config::{InputRole, Modality};
use crate::error::{Error, Result};
use crate::io::dicom::{Role, check_frames, is_dicom_path, is_segmentation, missing_images};
use crate::io::skeleton::{load_override, write_skeleton};
use crate::io::{Loaded, check_files, check_place, read_bones, read_grid, read_labels};
use crate::pipeline::check_grids;
use crate::plausibility::{CheckOptions, levels_by_landmarks, sides_and_levels};
use crate::runtime::Runtime;
use crate::session::{BonesBy, PlanningSources, Source};
use crate::skeleton::{Skeleton, build, tree};
use crate::volume::LabelMap;
use crate::warning::Warning;
use clap::Args;
use serde::Serialize;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};

/// Options of `skeleton`.
#[derive(Debug, Args)]
pub struct SkeletonArgs {
    /// Bone labels, for example TotalSegmentator's multi-label file; with --planning also a DICOM structure set, or `auto` as
    /// in `register`
    #[arg(long, value_name = "FILE|auto")]
    pub bones: PathBuf,
    /// Planning CT: gives the grid for a structure set; `auto` labels its bones
    #[arg(long, value_name = "FILE")]
    pub planning: Option<PathBuf>,
    /// Names of the labels (JSON), {"labels": {"1": "skull", ...}}
    #[arg(long, value_name = "FILE")]
    pub labels: Option<PathBuf>,
    /// Changes to the skeleton (TOML), to be applied and checked
    #[arg(long, value_name = "FILE")]
    pub skeleton: Option<PathBuf>,
    /// Write the skeleton as TOML, to edit and give to `register --skeleton`
    #[arg(long, value_name = "FILE")]
    pub out: Option<PathBuf>,
    /// How the result is told.
    #[command(flatten)]
    pub told: JsonArgs,
}

/// What the verb shows, besides what it writes.
#[derive(Debug, Clone, Serialize)]
struct SkeletonShown {
    /// The skeleton, with overrides laid over.
    #[serde(flatten)]
    skeleton: Skeleton,
    /// Voxels of each bone, in the order of the skeleton's bones.
    voxels: Vec<usize>,
    /// Labels that are not bones.
    ignored: Vec<String>,
    /// Findings that the user should know of.
    warnings: Vec<Warning>,
}

/// Builds the skeleton of a label map, checks it, writes it where asked, and describes it.
///
/// # Errors
/// When the labels cannot be read, when none is a bone, when the override does not fit, or when the result cannot be
/// written.
pub(super) fn run(args: &SkeletonArgs) -> Result<String> {
    let planning = Source::File(args.planning.clone().unwrap_or_default());
    let mut side = PlanningSources::new(planning, Source::File(args.bones.clone()));
    side.names = args.labels.clone().map(Source::File);
    if side.wants_bones() {
        needed(&args.planning, InputRole::Planning, &[])?;
        // Without a folder of results labels are kept beside the result, else here.
        let beside = args.out.as_deref().unwrap_or(Path::new("skeleton"));
        let by = BonesBy { beside, command: &command_line(), quiet: args.told.json };
        side.make_bones(&[], Modality::Auto, by, &Runtime::new(0, progress(args.told.json))?)?;
    }
    let file = side.bones.path().map_or(args.bones.clone(), Path::to_owned);
    let file = &file;
    let files = [Some(file), args.labels.as_ref(), args.skeleton.as_ref(), args.planning.as_ref()];
    let files: Vec<&Path> = files.into_iter().flatten().map(PathBuf::as_path).collect();
    check_files(&files, args.out.as_slice())?;
    args.out.as_deref().map_or(Ok(()), check_place)?;
    let labels = read(file, args)?;
    let mut shown = show(&labels.value, args.skeleton.as_deref(), args.out.as_deref())?;
    shown.warnings.splice(0..0, labels.warnings.into_iter().chain(side.made().iter().cloned()));
    // Nothing is registered yet: what would be refused then is told here.
    shown.warnings.extend(CheckOptions { refuse: false }.told(sides_and_levels(&labels.value))?);
    shown.warnings.extend(levels_by_landmarks(&labels.value));
    if args.told.json { shown.json() } else { Ok(shown.text()) }
}

/// Reads the labels; a structure set is drawn on the planning CT's grid.
fn read(bones: &Path, args: &SkeletonArgs) -> Result<Loaded<LabelMap>> {
    let Some(planning) = &args.planning else {
        if is_dicom_path(bones) {
            // Where the image ends decides about the joints of bones that it cuts.
            let why = if is_segmentation(bones) {
                "a segmentation does not say where the image ends"
            } else {
                "a structure set is drawn on a grid, and none is given"
            };
            let problem = format!("{}: {why}", bones.display());
            return Err(Error::usage(problem, "name the planning CT with --planning"));
        }
        return read_labels(bones, args.labels.as_deref());
    };
    let grid = read_grid(planning)?.0;
    if is_dicom_path(bones) {
        check_frames(Role::Structures.at(bones), Role::Image.at(planning))?;
    }
    let mut labels = read_bones(bones, args.labels.as_deref(), &grid)?;
    if is_dicom_path(bones) && is_dicom_path(planning) {
        labels.warnings.extend(missing_images(bones, planning)?);
    }
    check_grids(&grid, labels.value.volume.grid())?;
    Ok(labels)
}

/// Builds the skeleton of a label map, lays a `skeleton.toml` over it where given, and writes the result to `out`
/// where given.
fn show(labels: &LabelMap, overrides: Option<&Path>, out: Option<&Path>) -> Result<SkeletonShown> {
    let built = build(labels)?;
    let counted: Vec<(String, usize)> =
        built.skeleton.bones.iter().map(|b| b.name.clone()).zip(built.voxels.iter().copied()).collect();
    let skeleton = match overrides {
        Some(path) => load_override(path, built.skeleton)?,
        None => built.skeleton,
    };
    if let Some(path) = out {
        write_skeleton(path, &skeleton)?;
    }
    let count = |name: &str| counted.iter().find(|(n, _)| n == name).map_or(0, |(_, c)| *c);
    let voxels = skeleton.bones.iter().map(|b| count(&b.name)).collect();
    Ok(SkeletonShown { skeleton, voxels, ignored: built.ignored, warnings: built.warnings })
}

impl SkeletonShown {
    /// The tree, the ignored labels and the warnings as text.
    fn text(&self) -> String {
        let mut out = tree(&self.skeleton, &self.voxels);
        if !self.ignored.is_empty() {
            writeln!(out, "\nnot bones of the skeleton, ignored ({}): {}", self.ignored.len(), self.ignored.join(", "))
                .expect("writing to a String cannot fail");
        }
        for w in &self.warnings {
            writeln!(out, "\nwarning ({}): {}", w.code, w.message).expect("writing to a String cannot fail");
        }
        out
    }

    /// The same as a JSON document.
    fn json(&self) -> Result<String> {
        serde_json::to_string_pretty(self).map_err(|e| Error::Internal(format!("skeleton as JSON: {e}")))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Grid;
    use crate::volume::Volume;

    #[test]
    fn shows_writes_and_reads_back() {
        let grid = Grid::axis_aligned([12, 12, 40], [1.0; 3], [0.0; 3]).unwrap();
        let volume = Volume::from_fn(grid.clone(), |l| (grid.voxel(l)[2] / 10) as u16);
        let names = ["vertebrae_C2", "skull", "brain"].iter().zip(1u16..).map(|(n, l)| (l, (*n).to_owned()));
        let labels = LabelMap { volume, names: names.collect() };
        let dir = tempfile::tempdir().unwrap();
        let (first, second) = (dir.path().join("a.toml"), dir.path().join("b.toml"));
        let shown = show(&labels, None, Some(&first)).unwrap();
        assert_eq!((shown.ignored.as_slice(), shown.voxels.as_slice()), (&["brain".to_owned()][..], &[1440, 1440][..]));
        assert!(shown.text().contains("skull-C2") && shown.text().contains("ignored (1): brain"), "{}", shown.text());
        // The root turned round: the counts follow their bones.
        std::fs::write(&first, "bones.skull.parent = \"none\"\nbones.vertebrae_C2.parent = \"skull\"\n").unwrap();
        let turned = show(&labels, Some(&first), Some(&second)).unwrap();
        assert_eq!(turned.skeleton.bones[0].name, "skull");
        let json: serde_json::Value = serde_json::from_str(&turned.json().unwrap()).unwrap();
        assert_eq!(json["bones"][1]["name"], "vertebrae_C2");
        assert_eq!(show(&labels, Some(&second), None).unwrap().skeleton.bones[1].parent, Some(0));
    }
}
