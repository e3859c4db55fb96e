//! What a library is made from: files and flags, read and judged.

use super::super::args::PlanningArgs;
use super::super::contours::of_planning;
use super::super::inputs::{either, planning_side};
use super::super::phantom::cbct_options;
use super::args::{LibraryArgs, problem};
use crate::chainmail::VolumeChange;
use crate::config::{Config, InputRole, RecordedInput};
use crate::dose::judge as judge_dose;
use crate::error::{Error, Result};
use crate::io;
use crate::io::checksum::sha256;
use crate::io::dicom::{Role, check_frames};
use crate::io::postures::read_postures;
use crate::phantom::CbctOptions;
use crate::pipeline::PlanningScan;
use crate::postures::{PosturePlan, VolumeRange};
use crate::provenance::Provenance;
use crate::runtime::Runtime;
use crate::session::{BonesBy, judge};
use crate::skeleton;
use crate::volume::Volume;
use crate::volume::contour::Contours;
use crate::warning::Warning;
use std::path::{Path, PathBuf};

/// What goes along with the tissue.
pub(super) struct Carried {
    pub(super) contours: Option<Contours>,
    pub(super) dose: Option<Volume<f32>>,
    /// What reading them found.
    pub(super) warnings: Vec<Warning>,
}

/// Everything that was read.
pub(super) struct Sources {
    pub(super) planning: PlanningScan,
    pub(super) plan: PosturePlan,
    /// With organs that change named, so that wrong names are refused.
    pub(super) config: Config,
    pub(super) carried: Carried,
    pub(super) degrade: Option<CbctOptions>,
    /// All files with their checksums.
    pub(super) provenance: Provenance,
}

impl Sources {
    /// Reads the files that flags, or an earlier run, name.
    pub(super) fn load(
        args: &LibraryArgs,
        mut config: Config,
        earlier: &[RecordedInput],
        command: &str,
        runtime: &Runtime,
    ) -> Result<Self> {
        config.output.uncertainty = false;
        if config.region.is_some() {
            return Err(Error::usage(
                "the settings choose a region, but a library covers the whole scan",
                "remove [region] from the settings",
            ));
        }
        let mut recorded = earlier.to_vec();
        let side = PlanningArgs {
            planning: args.planning.clone(),
            bones: args.bones.clone(),
            labels: args.labels.clone(),
            skeleton: args.skeleton.clone(),
        };
        let mut side = planning_side(&side, &args.organs, &mut recorded)?;
        let needed: Vec<PathBuf> = [&args.plan, &args.structures, &args.dose].into_iter().flatten().cloned().collect();
        let by = BonesBy { beside: &args.out, command, quiet: args.run.shown.quiet };
        side.make_bones(&needed, config.planning.modality, by, runtime)?;
        judge(&side, &[], &config)?;
        let planning_file = side.ct.path().map(Path::to_owned).unwrap_or_default();
        let degrade = match (&args.cbct, args.noise) {
            (Some(file), _) => Some(cbct_options(file.as_deref())?),
            (None, Some(noise_hu)) => Some(CbctOptions { noise_hu, ..CbctOptions::off() }),
            (None, None) => None,
        };
        let (mut planning, mut provenance) = side.read(&recorded, &config, runtime)?;
        if planning.skeleton.is_none() {
            planning.skeleton = Some(skeleton::build(&planning.bones)?.skeleton);
        }
        let skeleton = planning.skeleton.as_ref().ok_or_else(|| Error::Internal("the skeleton was just set".into()))?;
        let own = |flag: &Option<PathBuf>, role: InputRole| either(flag, role, earlier);
        let (plan_file, structures, dose) = (
            own(&args.plan, InputRole::Plan),
            own(&args.structures, InputRole::Structures),
            own(&args.dose, InputRole::Dose),
        );
        let mut plan = match &plan_file {
            Some(path) => read_postures(path, skeleton)?,
            None => PosturePlan::usual(skeleton),
        };
        plan.volumes.retain(|v| args.volume_change.iter().all(|own| own.organ != v.organ));
        plan.volumes.extend(args.volume_change.iter().cloned());
        // What the settings fix holds for every posture.
        for VolumeChange { organ, factor } in &config.chainmail.volume_change {
            if plan.volumes.iter().all(|v| v.organ != *organ) {
                plan.volumes.push(VolumeRange { organ: organ.clone(), range: [*factor; 2] });
            }
        }
        if let Some(problem) = plan.volumes.iter().find_map(problem) {
            return Err(Error::usage(problem, "correct [volumes] of the plan, or --volume-change"));
        }
        // In the middle of each range: the postures' own come when they are drawn.
        let change =
            |v: &VolumeRange| VolumeChange { organ: v.organ.clone(), factor: f64::midpoint(v.range[0], v.range[1]) };
        config.chainmail.volume_change = plan.volumes.iter().map(change).collect();
        if let Some(problem) = config.problem() {
            return Err(Error::usage(problem, "correct the settings, or what the volumes ask of them"));
        }
        let carried = Carried::read(structures.as_deref(), dose.as_deref(), &planning_file)?;
        let cbct = args.cbct.as_ref().and_then(Option::as_deref);
        let more = [
            (InputRole::Plan, plan_file.as_deref()),
            (InputRole::Structures, structures.as_deref()),
            (InputRole::Dose, dose.as_deref()),
            (InputRole::Cbct, cbct),
        ];
        let mut of_plan = Provenance::default();
        for (role, path) in more.into_iter().filter_map(|(role, path)| Some((role, path?))) {
            of_plan.note(role, path)?;
        }
        of_plan.compare(earlier);
        provenance.extend(of_plan);
        Ok(Self { planning, plan, config, carried, degrade, provenance })
    }

    /// The files, none of which may be overwritten.
    pub(super) fn files(&self) -> Vec<&Path> {
        self.provenance.inputs.iter().map(|i| i.path.as_path()).collect()
    }

    /// Everything but a posture's own motion that its files depend on, as a checksum.
    pub(super) fn key(&self, args: &LibraryArgs) -> Result<String> {
        // The plan counts by the motions that come of it.
        let inputs: Vec<&str> =
            self.provenance.inputs.iter().filter(|i| i.role != InputRole::Plan).map(|i| i.sha256.as_str()).collect();
        let all = serde_json::json!([
            env!("CARGO_PKG_VERSION"),
            without_volumes(&self.config).value()?,
            inputs,
            args.margin,
            args.no_fields,
            self.degrade,
            self.plan.limits,
        ]);
        Ok(sha256(all.to_string().as_bytes()))
    }
}

/// The settings without changes of volume: those are the plan's.
pub(super) fn without_volumes(config: &Config) -> Config {
    let mut out = config.clone();
    out.chainmail.volume_change.clear();
    out
}

impl Carried {
    fn read(structures: Option<&Path>, dose: Option<&Path>, planning: &Path) -> Result<Self> {
        let mut out = Self { contours: None, dose: None, warnings: Vec::new() };
        if let Some(path) = structures {
            let (contours, found) = of_planning(path, Some(planning))?;
            out.warnings.extend(found);
            out.contours = Some(contours);
        }
        if let Some(path) = dose {
            check_frames(Role::Dose.at(path), Role::Image.at(planning))?;
            let mut read = io::read_dose(path)?;
            out.warnings.append(&mut read.warnings);
            out.warnings.extend(judge_dose(&path.display().to_string(), &mut read.value)?);
            out.dose = Some(read.value);
        }
        Ok(out)
    }
}
