//! The fields, images and masks of a run as files.

use super::OutputFile;
use crate::config::Config;
use crate::error::Result;
use crate::io::{self, Planned, Stored, WriteOptions};
use crate::pipeline::Outcome;
use rayon::prelude::*;
use std::path::Path;

/// What the fit leaves open of the bones.
pub const BONE_POSTERIOR: &str = "bone_posterior.json";

/// What a run with these settings may write, besides pictures: what its folder must have room for.
pub fn planned(config: &Config) -> Planned {
    let format = config.output.field_format.extension();
    let fields = ["planning_to_fraction", "fraction_to_planning"].map(|name| format!("{name}.{format}"));
    let masks = ["planning_on_fraction", "bones_on_fraction", "jacobian", "body", "computed", "inside_planning"];
    let more = ["skin_contact", "uncertainty", "regions"];
    let images = masks.iter().chain(&more).map(|name| format!("{name}.nii.gz"));
    let others = ["settings.toml", "landmarks.csv", "bone_transforms.json", BONE_POSTERIOR].map(String::from);
    Planned {
        reports: ["report.json", "report.html"].map(String::from).into(),
        names: fields.into_iter().chain(images).chain(others).collect(),
    }
}

/// Writes fields, images and masks side by side; returns what was written.
pub(super) fn write_outputs(out: &Path, outcome: &Outcome, config: &Config) -> Result<Vec<OutputFile>> {
    let level = config.output.gzip_level;
    let options = |description: &str| WriteOptions { gzip_level: level, description: description.into() };
    let format = config.output.field_format;
    let mut files = Files::of(out);
    files.add(
        &format!("planning_to_fraction.{}", format.extension()),
        "push field on the planning grid, LPS mm: planning x goes to x + u(x)",
        move |path| io::write_push(path, &outcome.push, format, level),
    );
    files.add(
        &format!("fraction_to_planning.{}", format.extension()),
        "pull field on the fraction grid, LPS mm: fraction y shows planning at y + v(y)",
        move |path| io::write_pull(path, &outcome.pull, format, level),
    );
    files.add("planning_on_fraction.nii.gz", "planning CT on the fraction grid, int16 HU", move |path| {
        let options = options("planning CT on the fraction grid");
        io::write_image(path, &outcome.planning_on_fraction, Stored::Int16, &options)
    });
    files.add(
        "bones_on_fraction.nii.gz",
        "bone labels on the fraction grid, names in the header extension",
        move |path| {
            io::write_label_spans(path, &outcome.bones_on_fraction, &options("bone labels on the fraction grid"))
        },
    );
    files.add(
        "jacobian.nii.gz",
        "V_deformed / V_initial on the planning grid; -1 folded, 1 outside tissue",
        move |path| {
            let options = options("Jacobian of planning to fraction");
            io::write_map(path, &outcome.jacobian, &options)
        },
    );
    for (name, mask, what) in [
        ("body.nii.gz", &outcome.body, "patient in the planning CT, cavities filled"),
        (
            "computed.nii.gz",
            &outcome.push.computed,
            "planning voxels whose motion was computed; elsewhere the field is a smooth extension",
        ),
        (
            "inside_planning.nii.gz",
            &outcome.pull.inside,
            "fraction voxels whose pre-image lies inside the planning scan",
        ),
    ] {
        files.add(name, what, move |path| io::write_mask(path, mask, &options(what)));
    }
    if let Some(skin) = &outcome.skin_contact {
        let what = "fraction voxels where skin passes through skin";
        files.add("skin_contact.nii.gz", what, move |path| io::write_mask(path, skin, &options(what)));
    }
    if let Some((map, _)) = &outcome.uncertainty {
        let what = "estimated error on the planning grid, mm: on posed CTs two thirds of errors lay below it; -1 outside the patient or unknown";
        files.add("uncertainty.nii.gz", what, move |path| {
            io::write_map(path, map, &options("estimated error, mm: on posed CTs two thirds of errors lay below"))
        });
    }
    if let Some(posterior) = &outcome.posterior {
        let what = "remaining uncertainty of the bones' poses, for aventail samples";
        files.add(BONE_POSTERIOR, what, move |path| io::write_json(path, posterior));
    }
    if let Some(regions) = &outcome.regions {
        let what = "regions of influence on the planning grid: label of the bone that each voxel follows";
        files
            .add("regions.nii.gz", what, move |path| io::write_labels(path, regions, &options("regions of influence")));
    }
    files.add("settings.toml", "the settings of this run, for --config", |path| {
        let text = config.toml()?;
        io::write_file(path, |w| w.write_all(text.as_bytes()))
    });
    files.write()
}

/// Writes a file.
type Writing<'a> = Box<dyn Fn(&Path) -> Result<()> + Sync + 'a>;

/// Files of a folder, still to be written.
pub struct Files<'a> {
    folder: &'a Path,
    /// Name, what it holds, and how it is written.
    files: Vec<((String, String), Writing<'a>)>,
}

impl<'a> Files<'a> {
    /// None yet, of this folder.
    pub fn of(folder: &'a Path) -> Self {
        Self { folder, files: Vec::new() }
    }

    /// One more: its name, what it holds, and how it is written.
    pub fn add(&mut self, name: &str, what: &str, write: impl Fn(&Path) -> Result<()> + Sync + 'a) {
        self.files.push(((name.into(), what.into()), Box::new(write)));
    }

    /// Writes them side by side, so that one thread can compress while another waits for the disk; of several failures the first
    /// file's is told.
    ///
    /// # Errors
    /// What writing reports; [`Error::Read`](crate::error::Error::Read) when a file cannot be read back for its checksum.
    pub fn write(self) -> Result<Vec<OutputFile>> {
        let one = |((name, what), write): &((String, String), Writing<'a>)| {
            write(&self.folder.join(name))?;
            OutputFile::written(self.folder, name, what)
        };
        let written: Vec<Result<OutputFile>> = self.files.par_iter().with_max_len(1).map(one).collect();
        written.into_iter().collect()
    }
}
