//! The files of one posture.

use super::args::LibraryArgs;
use super::sources::Carried;
use crate::config::Config;
use crate::dose::interpolate;
use crate::error::{Error, Result};
use crate::field::{Chain, InvertOptions, Link, Motion, PullField, WORTH_OF_LABELS, outside_field, resample_contours};
use crate::geometry::Grid;
use crate::io::{self, Stored, WriteOptions, write_json};
use crate::phantom::{CbctOptions, degrade};
use crate::pipeline::Outcome;
use crate::report::{Files, OutputFile, PostureRecord, RECORD, write_bone_transforms};
use crate::skeleton::Pose;
use crate::volume::contour::Contours;
use crate::volume::{LabelMap, Volume};
use crate::warning::Warning;
use std::borrow::Cow;
use std::collections::BTreeMap;
use std::path::Path;

/// What is to be written of a posture: all of it on one grid, which a degraded image may have made shorter.
pub(super) struct PostureWritten<'a> {
    outcome: &'a Outcome,
    pub(super) ct: Cow<'a, Volume<f32>>,
    pub(super) labels: LabelMap,
    image: Option<Volume<f32>>,
    /// The pull field where the grid is shorter.
    pull: Cow<'a, PullField>,
}

/// Names of files by what they are for, the same with checksums, and what writing them found.
type PostureFound = (BTreeMap<String, String>, Vec<OutputFile>, Vec<Warning>);

/// The part of a volume on a part of its grid.
fn part<T: Copy + Default + Send + Sync>(volume: &Volume<T>, grid: &Grid) -> Volume<T> {
    let whole = volume.grid();
    let value = |n: usize| whole.voxel_at(&grid.centre(grid.voxel(n))).map_or(T::default(), |voxel| *volume.at(voxel));
    Volume::from_fn(grid.clone(), value)
}

impl<'a> PostureWritten<'a> {
    /// Degrades the image where that is asked for.
    pub(super) fn of(outcome: &'a Outcome, options: Option<&CbctOptions>, seed: u64) -> Result<Self> {
        let ct = &outcome.planning_on_fraction;
        let image = options.map(|options| degrade(ct, options, seed)).transpose()?;
        let grid = image.as_ref().map(Volume::grid).filter(|grid| *grid != ct.grid());
        let Some(grid) = grid.cloned() else {
            let (ct, labels, pull) =
                (Cow::Borrowed(ct), outcome.bones_on_fraction.to_map(), Cow::Borrowed(&outcome.pull));
            return Ok(Self { outcome, ct, labels, image, pull });
        };
        let labels = outcome.bones_on_fraction.to_map();
        let labels = LabelMap { volume: part(&labels.volume, &grid), names: labels.names };
        let pull = PullField {
            displacement: part(&outcome.pull.displacement, &grid),
            inside: part(&outcome.pull.inside, &grid),
        };
        let ct = part(ct, &grid);
        Ok(Self { outcome, ct: Cow::Owned(ct), labels, image, pull: Cow::Owned(pull) })
    }

    /// Writes everything but the record.
    pub(super) fn write(
        &self,
        args: &LibraryArgs,
        config: &Config,
        pose: &Pose,
        carried: &Carried,
        record: &PostureRecord,
    ) -> Result<PostureFound> {
        let (out, name) = (&args.out, &record.name);
        let own = out.join(name);
        std::fs::create_dir_all(&own)
            .map_err(|e| Error::write(&own, e.to_string(), "choose a folder that you may write to"))?;
        let level = config.output.gzip_level;
        let options = |description: &str| WriteOptions { gzip_level: level, description: description.into() };
        let (contours, warnings) = self.contours(carried.contours.as_ref())?;
        let dose = carried.dose.as_ref().map(|dose| interpolate(dose, &self.pull.displacement, self.ct.grid()));
        let dose = dose.transpose()?;
        let (mut files, mut names) = (Files::of(out), BTreeMap::new());
        let mut file = |role: &str, file: &str| {
            let path = format!("{name}/{file}");
            names.insert(role.to_owned(), path.clone());
            path
        };
        let path = file("ct", "ct.nii.gz");
        names_of_image(&mut file, self.image.is_some());
        files.add(&path, "artificial CT, int16 HU", |path| {
            io::write_image(path, &self.ct, Stored::Int16, &options("planning CT in another posture"))
        });
        if let Some(image) = &self.image {
            files.add(
                &format!("{name}/image.nii.gz"),
                "the artificial CT as a machine would show it, int16 HU",
                |path| io::write_image(path, image, Stored::Int16, &options("artificial CT, degraded")),
            );
        }
        let path = file("label", "labels.nii.gz");
        files.add(&path, "labels of bones and organs, names in the header extension", |path| {
            io::write_labels(path, &self.labels, &options("labels in another posture"))
        });
        if !args.no_fields {
            self.fields(&mut files, &mut file, config);
        }
        if let Some(contours) = &contours {
            let path = file("contours", "contours.json");
            files.add(&path, "contours on the slices of the artificial CT, LPS mm", |path| {
                io::write_contours(path, contours, "fraction")
            });
        }
        if let Some(dose) = &dose {
            let path = file("dose", "dose.nii.gz");
            files.add(&path, "dose carried with the tissue, not computed anew, Gy", |path| {
                io::write_image(path, dose, Stored::Float32, &options("dose carried to another posture, Gy"))
            });
        }
        let path = file("pose", "pose.toml");
        let skeleton = &self.outcome.skeleton;
        files
            .add(&path, "motion of each joint, for `aventail pose`", |path| io::pose::write_pose(path, skeleton, pose));
        let path = file("bone_transforms", "bone_transforms.json");
        files.add(&path, "4x4 of each bone, planning to fraction, LPS mm", |path| {
            write_bone_transforms(path, self.outcome.bone_fits.iter().map(|b| (b.name.as_str(), &b.transform)))
        });
        let outputs = files.write()?;
        Ok((names, outputs, warnings))
    }

    /// Both fields.
    fn fields<'b>(&'b self, files: &mut Files<'b>, file: &mut impl FnMut(&str, &str) -> String, config: &'b Config) {
        let (format, level) = (config.output.field_format, config.output.gzip_level);
        let path = file("planning_to_fraction", &format!("planning_to_fraction.{}", format.extension()));
        files.add(&path, "push field on the planning grid, LPS mm: planning x goes to x + u(x)", move |path| {
            io::write_push(path, &self.outcome.push, format, level)
        });
        let path = file("fraction_to_planning", &format!("fraction_to_planning.{}", format.extension()));
        files.add(&path, "pull field on the artificial CT's grid, LPS mm: y shows planning at y + v(y)", move |path| {
            io::write_pull(path, &self.pull, format, level)
        });
    }

    /// The contours on the slices of the artificial CT, and what is to be known of them.
    fn contours(&self, contours: Option<&Contours>) -> Result<(Option<Contours>, Vec<Warning>)> {
        let Some(contours) = contours else { return Ok((None, Vec::new())) };
        let link = |from: &str, to: &str, field: &Volume<[f32; 3]>| {
            let motion = Motion::Field(Box::new(field.clone()));
            [Link { name: "the field".into(), from: from.into(), to: to.into(), motion }]
        };
        let push = link("planning", "fraction", &self.outcome.push.displacement);
        // The whole field: a structure may reach beyond a shorter image.
        let pull = link("fraction", "planning", &self.outcome.pull.displacement);
        let options = InvertOptions::default();
        let forward = Chain::between(&push, "planning", "fraction", &options)?;
        let back = Chain::between(&pull, "fraction", "planning", &options)?;
        let (moved, mapped) = resample_contours(contours, &forward, &back, self.ct.grid());
        let share = 100.0 * mapped.outside as f64 / mapped.points.max(1) as f64;
        let outside = outside_field("the contours", "a field", share, WORTH_OF_LABELS);
        Ok((Some(moved), outside.into_iter().collect()))
    }

    /// Writes the record of a posture whose files are there: it is complete.
    pub(super) fn record(out: &Path, record: &mut PostureRecord) -> Result<()> {
        write_json(out.join(&record.name).join(RECORD), record)
    }
}

/// The image of a datalist: the degraded one where there is one.
fn names_of_image(file: &mut impl FnMut(&str, &str) -> String, degraded: bool) {
    file("image", if degraded { "image.nii.gz" } else { "ct.nii.gz" });
}
