//! `aventail labels merge`: one named label map of masks, label maps and structure sets.

mod inputs;

use super::args::JsonArgs;
use crate::error::{Error, Result};
use crate::io::merge::{Merged, Merging};
use crate::io::{WriteOptions, check_files, check_place, json, read_grid, write_labels};
use crate::warning::{Warning, counted};
use clap::{Args, Subcommand};
use inputs::LabelSources;
use serde::Serialize;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};

const HELP: &str = "\
A mask is one structure, named by its file: vertebrae_C1.nii.gz is vertebrae_C1. A label map gives
all its named structures. A folder gives all its images, in alphabetical order. NAME=FILE names a
mask, or takes only the structure NAME from a label map. A DICOM structure set gives its bones, on
the grid of --grid. Common spellings of bones (Unterkiefer, VB_C1, Femur_L) are translated to the
skeleton's names, unless NAME= gives the name.

Where structures overlap, the one listed first keeps the voxels. Bones have fixed numbers from 1 to
68, the same in every map; other structures are numbered from 101 in alphabetical order.

Examples:
  # TotalSegmentator's folder of masks
  aventail labels merge segmentations --only-bones --out bones.nii.gz
  # its further tasks first: the skull of its task `total` includes the mandible
  aventail labels merge mandible=craniofacial.nii.gz hyoid=headneck.nii.gz total.nii.gz \\
                --only-bones --out bones.nii.gz
  aventail labels merge C1.nii.gz skull=head_bone.mha --out bones.nii.gz
  aventail labels merge RS.dcm hyoid.nii.gz --grid planning_ct --out bones.nii.gz";

/// What `labels` can do.
#[derive(Debug, Subcommand)]
pub enum LabelsVerb {
    /// Merge masks, label maps and structure sets into one label map with names, on one grid
    #[command(after_help = HELP)]
    Merge(MergeArgs),
}

/// Options of `labels merge`.
#[derive(Debug, Args)]
pub struct MergeArgs {
    /// Masks, label maps with names, folders of them, DICOM structure sets
    #[arg(required = true, value_name = "[NAME=]FILE")]
    pub files: Vec<PathBuf>,
    /// The label map to write (.nii or .nii.gz: the only format that holds the names)
    #[arg(long, value_name = "FILE")]
    pub out: PathBuf,
    /// Leave out labels that are not bones of the skeleton
    #[arg(long)]
    pub only_bones: bool,
    /// Planning CT: gives the grid for structure sets; all other files must have the same grid
    #[arg(long, value_name = "IMAGE")]
    pub grid: Option<PathBuf>,
    /// Names of the labels (JSON), {"labels": {"1": "skull", ...}}, of label maps without names; or a
    /// TOML file that translates names of a structure set that are not recognised, in a table
    /// `bones` with lines such as "Unterkiefer" = "mandible"
    #[arg(long, value_name = "FILE")]
    pub labels: Option<PathBuf>,
    /// How the result is told.
    #[command(flatten)]
    pub told: JsonArgs,
}

/// Runs a verb of `labels`.
///
/// # Errors
/// Of every kind but failed registration; see [`Error`].
pub(super) fn run(verb: &LabelsVerb) -> Result<String> {
    match verb {
        LabelsVerb::Merge(args) => merge(args),
    }
}

/// What is told of a merged label map.
#[derive(Serialize)]
struct LabelsTold<'a> {
    out: String,
    #[serde(flatten)]
    merged: &'a Merged,
    /// Masks without a voxel.
    empty: &'a [String],
    /// Files of folders that are no images.
    passed_over: &'a [String],
    warnings: &'a [Warning],
}

fn merge(args: &MergeArgs) -> Result<String> {
    require_names(&args.out)?;
    let sources = LabelSources::of(&args.files)?;
    let more = [&args.grid, &args.labels].into_iter().flatten().map(PathBuf::as_path);
    let files: Vec<&Path> = sources.all.iter().map(|s| s.path.as_path()).chain(more).collect();
    check_files(&files, std::slice::from_ref(&args.out))?;
    check_place(&args.out)?;
    let mut warnings = Vec::new();
    let grid = args.grid.as_deref().map(read_grid).transpose()?;
    let mut merging = Merging::new(args.only_bones);
    if let (Some(path), Some((grid, found))) = (&args.grid, grid) {
        warnings.extend(found);
        merging.on(path, grid);
    }
    let mut empty = Vec::new();
    for source in &sources.all {
        match source.read(args.grid.as_deref(), args.labels.as_deref(), &mut warnings)? {
            None => empty.push(source.name()?),
            Some(map) => merging.add(&source.path, map, source.given.is_none())?,
        }
    }
    let (map, merged) = merging.finish()?;
    warnings.extend(merged.warnings());
    warnings.dedup();
    let description = "label map, names in the header".into();
    write_labels(&args.out, &map, &WriteOptions { description, ..WriteOptions::default() })?;
    let told = LabelsTold {
        out: args.out.display().to_string(),
        merged: &merged,
        empty: &empty,
        passed_over: &sources.passed_over,
        warnings: &warnings,
    };
    if args.told.json { json(&told) } else { Ok(told.text()) }
}

/// Refuses results in formats that would lose the names.
fn require_names(out: &Path) -> Result<()> {
    let name = out.file_name().unwrap_or_default().to_string_lossy().to_lowercase();
    if name.ends_with(".nii") || name.ends_with(".nii.gz") {
        return Ok(());
    }
    let problem = format!("--out {}: only NIfTI carries the names of labels", out.display());
    Err(Error::usage(problem, "name a file that ends in .nii.gz or .nii"))
}

impl LabelsTold<'_> {
    fn text(&self) -> String {
        let mut text = String::new();
        let mut line = |l: String| writeln!(text, "{l}").expect("writing to a String cannot fail");
        let wide = self.merged.structures.iter().map(|s| s.name.len()).max().unwrap_or(0);
        for s in &self.merged.structures {
            line(format!("{:>5}  {:<wide$}  {:>10.1} ml  {}", s.label, s.name, s.volume_ml, s.from));
        }
        let renamed: Vec<String> = self.merged.renamed.iter().map(|r| format!("{} is {}", r.from, r.to)).collect();
        for (what, names) in [
            ("named as the skeleton does", &renamed),
            ("no bones, left out", &self.merged.left_out),
            ("empty masks", &self.empty.to_vec()),
            ("no images, passed over", &self.passed_over.to_vec()),
        ] {
            if !names.is_empty() {
                line(format!("{what} ({}): {}", names.len(), names.join(", ")));
            }
        }
        for w in self.warnings {
            line(format!("warning ({}): {}", w.code, w.message));
        }
        line(format!("{} in {}", counted(self.merged.structures.len(), "structure", "structures"), self.out));
        text
    }
}
