//! The planning side of a patient, from files or memory.

use super::modality::of_scan;
use super::source::{LabelSources, Names, OF_PLANNING, Source, bones, image, outlines};
use crate::chainmail::organ_label;
use crate::config::{Config, InputRole, Modality, RecordedInput};
use crate::error::{Error, Result};
use crate::geometry::Grid;
use crate::io;
use crate::io::auto::{AUTO, Ask, AutoBones};
use crate::io::dicom::{Role, check_frames, is_dicom_path, missing_images};
use crate::pipeline::PlanningScan;
use crate::provenance::Provenance;
use crate::runtime::Runtime;
use crate::skeleton;
use crate::volume::{LabelMap, Volume};
use crate::warning::Warning;
use std::path::{Path, PathBuf};

/// What the planning side is read from.
#[derive(Debug, Clone)]
pub struct PlanningSources {
    /// Planning CT, HU.
    pub ct: Source<Volume<f32>>,
    /// Bone labels on its grid, a structure set, or the path `auto`.
    pub bones: Source<Volume<u16>>,
    /// Names of the labels; of a structure set the file of names that are not recognised.
    pub names: Option<Source<Names>>,
    /// Labels of organs on its grid, or a structure set.
    pub organs: Option<PathBuf>,
    /// Changes to the skeleton that the labels give.
    pub skeleton: Option<PathBuf>,
    /// Structures that guide, a label map or a structure set, with their names where it has none.
    pub guides: Option<LabelSources>,
    /// What is to be known of labels that were made.
    made: Vec<Warning>,
}

/// Who asks for bones that TotalSegmentator is to find.
#[derive(Debug, Clone, Copy)]
pub struct BonesBy<'a> {
    /// The result beside which the labels are kept.
    pub beside: &'a Path,
    /// What is run, for whoever finds the folder in use.
    pub command: &'a str,
    /// Keeps what TotalSegmentator says from standard error.
    pub quiet: bool,
}

impl PlanningSources {
    /// Of a CT and its labels.
    pub fn new(ct: Source<Volume<f32>>, bones: Source<Volume<u16>>) -> Self {
        Self { ct, bones, names: None, organs: None, skeleton: None, guides: None, made: Vec::new() }
    }

    /// The files that a report has recorded, where it names both CT and labels.
    pub fn recorded(inputs: &[RecordedInput]) -> Option<Self> {
        let file = |role: InputRole| inputs.iter().find(|i| i.role == role).map(|i| i.path.clone());
        Some(Self {
            names: file(InputRole::Labels).map(Source::File),
            organs: file(InputRole::Organs),
            skeleton: file(InputRole::Skeleton),
            guides: file(InputRole::Guide)
                .map(|guide| (Source::File(guide), file(InputRole::GuideLabels).map(Source::File))),
            ..Self::new(Source::File(file(InputRole::Planning)?), Source::File(file(InputRole::Bones)?))
        })
    }

    /// All files, in the order in which they are asked for.
    pub fn files(&self) -> impl Iterator<Item = PathBuf> {
        let names = self.names.as_ref().and_then(Source::path);
        let guides = self.guides.as_ref();
        let guides = [guides.and_then(|g| g.0.path()), guides.and_then(|g| g.1.as_ref()?.path())];
        let more = [names, self.organs.as_deref(), self.skeleton.as_deref(), guides[0], guides[1]];
        [self.ct.path(), self.bones.path()].into_iter().chain(more).flatten().map(Path::to_owned)
    }

    /// What is to be known of labels that were made.
    pub fn made(&self) -> &[Warning] {
        &self.made
    }

    /// Whether the bones are to be found by TotalSegmentator.
    pub fn wants_bones(&self) -> bool {
        self.bones.path() == Some(Path::new(AUTO))
    }

    /// Has labels made by TotalSegmentator where bones are asked for as `auto`, or finds those that were made before; `needed`:
    /// other files that the run will read, known to be there before minutes are spent; `told`: what the settings say made the scan.
    ///
    /// # Errors
    /// [`Error::Usage`] when the labels have names beside their own, the planning scan is no file, or it is of another modality than
    /// is told; else as [`AutoBones::of`].
    pub fn make_bones(&mut self, needed: &[PathBuf], told: Modality, by: BonesBy<'_>, runtime: &Runtime) -> Result<()> {
        if !self.wants_bones() {
            return Ok(());
        }
        let own = self.organs.iter().chain(&self.skeleton);
        let needed: Vec<&Path> = needed.iter().chain(own).map(PathBuf::as_path).collect();
        let scan = (self.ct.path(), of_scan(&self.ct, told, "--planning-modality")?);
        let made = made_bones("bones", scan, self.names.is_some(), &needed, by, runtime)?;
        (self.bones, self.made) = (Source::File(made.file), made.warnings);
        Ok(())
    }

    /// Reads all of it; warns of files that are not those of the `recorded` run.
    ///
    /// # Errors
    /// As reading each file; [`Error::Usage`] when the settings name a region or organs that the labels do not have.
    pub fn read(
        self,
        recorded: &[RecordedInput],
        config: &Config,
        runtime: &Runtime,
    ) -> Result<(PlanningScan, Provenance)> {
        runtime.stage("read", || {
            // Labels before the CT's values: names are judged by them.
            let mut of_labels = Provenance::default();
            let planning = self.ct.path().map(Path::to_owned);
            let grid = match &self.ct {
                Source::Memory(ct) => Some(ct.grid().clone()),
                Source::File(_) => None,
            };
            let mut labels = labelled(
                InputRole::Bones,
                self.bones,
                self.names.clone(),
                (planning.as_deref(), grid),
                &mut of_labels,
            )?;
            if let Some(organs) = &self.organs {
                if let (true, Some(planning)) = (is_dicom_path(organs), &planning) {
                    check_frames(Role::Structures.at(organs), Role::Image.at(planning))?;
                    of_labels.warnings.extend(lost_images(organs, planning)?);
                }
                let named = config.chainmail.organs_named();
                of_labels.warnings.extend(io::add_organs(&mut labels, organs, &named)?);
            }
            judge_names(&labels, config)?;
            let own = |path: &PathBuf| io::skeleton::load_override(path, skeleton::build(&labels)?.skeleton);
            let skeleton = self.skeleton.as_ref().map(own).transpose()?;
            let mut provenance = Provenance::default();
            let ct = image(InputRole::Planning, self.ct, &mut provenance)?;
            provenance.extend(of_labels);
            for (role, path) in [
                (InputRole::Labels, self.names.as_ref().and_then(Source::path)),
                (InputRole::Organs, self.organs.as_deref()),
                (InputRole::Skeleton, self.skeleton.as_deref()),
            ] {
                path.map_or(Ok(()), |path| provenance.note(role, path))?;
            }
            let own = |given| outlines(OF_PLANNING, given, planning.as_deref(), &mut provenance);
            let guides = self.guides.map(own).transpose()?.unwrap_or_default();
            provenance.compare(recorded);
            provenance.warnings.extend(self.made);
            Ok((PlanningScan { ct, bones: labels, skeleton, guides }.by_modality(config)?, provenance))
        })
    }
}

/// Bone labels on the planning grid; a structure set is drawn on it.
pub(super) fn labelled(
    role: InputRole,
    given: Source<Volume<u16>>,
    names: Option<Source<Names>>,
    (planning, grid): (Option<&Path>, Option<Grid>),
    provenance: &mut Provenance,
) -> Result<LabelMap> {
    let Some(set) = given.path().filter(|path| is_dicom_path(path)).map(Path::to_owned) else {
        return bones(role, "bones", given, names, provenance);
    };
    let names = match &names {
        Some(Source::Memory(_)) => {
            let problem = "bones are DICOM, and a table of numbers and names is given with them";
            return Err(Error::usage(problem, "give a TOML file of names that are not recognised, or none"));
        }
        names => names.as_ref().and_then(Source::path),
    };
    if let Some(planning) = planning {
        check_frames(Role::Structures.at(&set), Role::Image.at(planning))?;
        provenance.warnings.extend(lost_images(&set, planning)?);
    }
    let grid = match (grid, planning) {
        (Some(grid), _) => grid,
        (None, Some(planning)) => io::read_grid(planning)?.0,
        (None, None) => return Err(Error::Internal("a planning CT is a file or in memory".into())),
    };
    Ok(provenance.take_scan(role, io::read_bones(&set, names, &grid)?))
}

/// Labels of a scan that TotalSegmentator makes now or has made of it before; `what` they are called in messages.
///
/// # Errors
/// [`Error::Usage`] when they have names beside their own, or the scan is no file; else as [`AutoBones::of`].
pub(super) fn made_bones(
    what: &str,
    (scan, modality): (Option<&Path>, Modality),
    named: bool,
    needed: &[&Path],
    by: BonesBy<'_>,
    runtime: &Runtime,
) -> Result<AutoBones> {
    if named {
        let problem =
            format!("{what} are \"auto\" and labels are given: the labels of TotalSegmentator bring their own names");
        return Err(Error::usage(problem, "leave labels out, or name a label map"));
    }
    let Some(planning) = scan else {
        let problem = format!("{what} are \"auto\" and their scan is in memory: TotalSegmentator reads a file");
        return Err(Error::usage(problem, "give the path of the scan"));
    };
    let BonesBy { beside, command, quiet } = by;
    let ask = Ask { planning, is_mr: modality == Modality::Mr, needed, beside, command, quiet };
    runtime.stage("bones by TotalSegmentator", || AutoBones::of(ask, runtime.progress()))
}

/// A word about images of the planning CT that its structures were drawn on and that are not there.
fn lost_images(set: &Path, planning: &Path) -> Result<Option<Warning>> {
    if is_dicom_path(planning) { missing_images(set, planning) } else { Ok(None) }
}

/// Refuses settings that name a region or organs which the labels do not have.
fn judge_names(labels: &LabelMap, config: &Config) -> Result<()> {
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
