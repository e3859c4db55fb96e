//! The planning side of a registration: what does not depend on the fraction, and is shared by all fractions of a patient.

use super::PlanningScan;
use super::checks::{check_image, check_labels};
use super::contact;
use super::elements::{alone_mm, bone_of_label, images_pull, tissue};
use super::guides::may_guide;
use super::matching;
use super::outcome::LINKING;
use super::uncertainty;
use crate::body;
use crate::chainmail::{ChainMail, Organs, organ_label};
use crate::config::{Config, Modality, SoftTissue};
use crate::error::{Error, Result};
use crate::evaluate::contact::RestingBones;
use crate::evaluate::uncertainty::PlanningSide;
use crate::evaluate::{self, CellKinds};
use crate::field;
use crate::findings;
use crate::fit::{BoneSamples, LandmarkUse};
use crate::plausibility::{labels_on_bone, levels_by_landmarks, sides_and_levels};
use crate::refine::PlanningSamples;
use crate::runtime::Runtime;
use crate::skeleton::{self, Skeleton};
use crate::volume::morphology::{dilate, erode};
use crate::volume::{Mask, Volume};
use crate::warning::{Warning, counted};
use std::sync::Arc;

/// What every way to move the bones begins with: the skeleton and the patient.
#[derive(Clone)]
pub(super) struct Patient {
    pub(super) skeleton: Skeleton,
    /// Inside of the skin in the planning CT.
    pub(super) body: Mask,
    /// What was found on the way.
    pub(super) warnings: Vec<Warning>,
}

impl Patient {
    /// Finds skeleton and patient in the planning side.
    pub(super) fn new(planning: &PlanningScan, config: &Config, runtime: &Runtime) -> Result<Self> {
        Ok(Self::new_beside(planning, config, runtime, |_| ())?.0)
    }

    /// As [`Patient::new`], with what `work` makes of the skeleton while the patient is looked for, for the most part by one
    /// thread.
    fn new_beside<T: Send>(
        planning: &PlanningScan,
        config: &Config,
        runtime: &Runtime,
        work: impl FnOnce(&Skeleton) -> T + Send,
    ) -> Result<(Self, T)> {
        check_labels(planning)?;
        let bones = || -> Result<_> {
            let (skeleton, mut warnings) = skeleton_of(planning, config)?;
            warnings.extend(check_planning(planning, &skeleton, config)?);
            let is_bone = |l: u16| skeleton.bones.iter().any(|b| b.label == l);
            Organs::new(&config.chainmail.organs, &planning.bones, is_bone)?;
            for change in &config.chainmail.volume_change {
                organ_label("chainmail.volume_change", &change.organ, &planning.bones, is_bone)?;
            }
            let made = work(&skeleton);
            Ok((skeleton, warnings, made))
        };
        let find = || body::find(&planning.ct, Some(&planning.bones), &config.body);
        // What is wrong with the inputs is told first.
        let (bones, body) = runtime.stage("build skeleton, find the patient", || rayon::join(bones, find));
        let (skeleton, warnings, made) = bones?;
        Ok((Self { skeleton, body: body?, warnings }, made))
    }
}

/// What bones and tissue are before anything moves. Clones share it all: a registration lets go of each part once it is done with
/// it, and the last one to do so frees its memory.
#[derive(Clone)]
pub(super) struct Resting {
    /// The bones' surfaces.
    pub(super) bones: Arc<RestingBones>,
    /// The longest edge of the voxels that the labels were drawn on, mm.
    pub(super) drawn_mm: f64,
    /// The chain mail; `None` where another model carries the motion.
    pub(super) chain_mail: Option<Arc<ChainMail>>,
    /// What its elements show in the planning CT.
    pub(super) samples: Arc<PlanningSamples>,
    /// Lung, where it takes part.
    pub(super) lung: Option<Mask>,
    /// What slides along its border, and the same where the field jumps there.
    pub(super) sliding: Option<Mask>,
    pub(super) jumps: Option<Mask>,
    /// The voxels near bones that touch and near where the field jumps.
    pub(super) beside_contact: Mask,
    /// What the cells between them hold.
    pub(super) cells: Arc<CellKinds>,
    /// The planning side of the uncertainty; `None` where no map of it is asked for.
    pub(super) side: Option<Arc<PlanningSide>>,
}

/// Nearer than this to where the field jumps a voxel's way there and back does not count, mm: readers interpolate across.
const SLIDING_MM: f64 = 5.0;

impl Resting {
    /// Of a planning side or a part of it, with its patient; `mapped` tells whether a map of uncertainty may be asked for.
    ///
    /// # Errors
    /// As [`ChainMail::new`].
    pub(super) fn new(
        planning: &PlanningScan,
        skeleton: &Skeleton,
        body: &Mask,
        mapped: bool,
        config: &Config,
        runtime: &Runtime,
    ) -> Result<Self> {
        runtime.stage(LINKING, || {
            let options = &config.chainmail;
            let mapped = mapped && config.output.uncertainty;
            let lung = options.lung.then(|| body::lung(&planning.ct, body)).flatten();
            let sliding = options.slip.region(lung.as_ref(), &planning.bones);
            let jumps = sliding.clone().filter(|_| options.slip.jumps(&planning.bones));
            let bone_of_label = bone_of_label(skeleton);
            let chain_mail = || {
                // Another modality's skin places bones, too, by what they alone would do.
                let wanted = images_pull(config) || may_guide(planning, config) || config.across();
                let alone = wanted.then(|| alone_mm(options));
                ChainMail::new(
                    &tissue(planning, body, lung.as_ref(), sliding.as_ref(), &bone_of_label, options),
                    options,
                    alone.as_slice(),
                )
            };
            let wanted = config.soft_tissue == SoftTissue::ChainMail;
            let window = config.refine.window(lung.is_some());
            let side =
                || mapped.then(|| uncertainty::side(&planning.ct, &planning.bones, skeleton, body, window)).transpose();
            let bones = || {
                let drawn = planning.bones.drawn_spacing().into_iter().fold(0.0, f64::max);
                (contact::resting(&planning.bones, skeleton), drawn)
            };
            let cells = || {
                let tissue = evaluate::jacobian::tissue(body, &planning.ct);
                let rigid = skeleton.labels_and_names();
                CellKinds::with_region(
                    &tissue,
                    &planning.bones,
                    &rigid,
                    &config.sliding.pairs(&rigid),
                    [sliding.as_ref(), jumps.as_ref()],
                )
            };
            let chain_mail = || wanted.then(chain_mail).transpose();
            let contact = || {
                let bone = |v: usize| bone_of_label[usize::from(planning.bones.volume.data()[v])];
                let contact = field::beside_contact(planning.bones.volume.grid(), &bone)?;
                Ok::<_, Error>(match &jumps {
                    None => contact,
                    Some(region) => {
                        let [out, deep] = [dilate(region, SLIDING_MM), erode(region, SLIDING_MM)];
                        let near = |n: usize| contact.data()[n] || (out.data()[n] && !deep.data()[n]);
                        Volume::from_fn(contact.grid().clone(), near)
                    }
                })
            };
            let bones = || rayon::join(bones, contact);
            let ((((bones, drawn_mm), beside_contact), side), (cells, chain_mail)) =
                rayon::join(|| rayon::join(bones, side), || rayon::join(cells, chain_mail));
            Ok(Self {
                bones: bones.into(),
                drawn_mm,
                chain_mail: chain_mail?.map(Arc::new),
                samples: Arc::default(),
                lung,
                sliding,
                jumps,
                beside_contact: beside_contact?,
                cells: cells.into(),
                side: side?.map(Arc::new),
            })
        })
    }

    /// Lets go of what elements are made from.
    pub(super) fn elements_done(&mut self) {
        (self.chain_mail, self.samples) = (None, Arc::default());
    }

    /// What fields are judged by; lets go of the rest.
    pub(super) fn judging(self) -> Judging {
        Judging { bones: self.bones, drawn_mm: self.drawn_mm, cells: self.cells, jumps: self.jumps }
    }
}

/// What fields are judged by: of [`Resting`].
pub(super) struct Judging {
    pub(super) bones: Arc<RestingBones>,
    pub(super) drawn_mm: f64,
    pub(super) cells: Arc<CellKinds>,
    pub(super) jumps: Option<Mask>,
}

/// The planning side of a registration. Results are the same bits whether fractions share one or each has its own. Clones share it.
#[derive(Clone)]
pub struct Planning {
    pub(super) patient: Patient,
    /// Of the whole scan; a region of interest has its own.
    pub(super) resting: Option<Resting>,
    /// Each bone's look in the planning CT; `None` where the settings let landmarks alone place the bones.
    pub(super) samples: Option<Arc<BoneSamples>>,
}

impl Planning {
    /// What was found of the planning side.
    pub fn warnings(&self) -> &[Warning] {
        &self.patient.warnings
    }

    /// Prepares the planning side.
    ///
    /// # Errors
    /// [`crate::error::Error::Input`] when planning CT and labels do not fit each other.
    pub fn new(planning: &PlanningScan, config: &Config, runtime: &Runtime) -> Result<Self> {
        let by_landmarks = config.fit.bone_landmarks == LandmarkUse::Replace;
        let draw = |skeleton: &Skeleton| {
            (!by_landmarks).then(|| BoneSamples::new(skeleton, &planning.ct, &planning.bones, &config.fit_options()))
        };
        let (patient, samples) = Patient::new_beside(planning, config, runtime, draw)?;
        let resting = || Resting::new(planning, &patient.skeleton, &patient.body, true, config, runtime);
        let resting = (!config.region.is_some()).then(resting).transpose()?;
        Ok(Self { patient, resting, samples: samples.map(Arc::new) })
    }
}

/// What is said of a planning MR.
const MR_TOLD: &str = "the planning scan is an MR: bones are compared by ranges of its grey values and by their surroundings, soft \
                       tissue by those ranges; the scanner's geometric distortion is not corrected. Look at the fusion images";

/// Judges planning scan and labels by themselves and against each other.
pub(super) fn check_planning(planning: &PlanningScan, skeleton: &Skeleton, config: &Config) -> Result<Vec<Warning>> {
    matching::check(&config.couch, skeleton, &planning.bones)?;
    let is_ct = config.planning.modality != Modality::Mr;
    let mut warnings = if is_ct {
        check_image("planning CT", &planning.ct, config)?
    } else {
        vec![Warning::new(findings::MR_PLANNING, MR_TOLD)]
    };
    warnings.extend(config.checks.told(sides_and_levels(&planning.bones))?);
    warnings.extend(levels_by_landmarks(&planning.bones));
    if is_ct {
        warnings.extend(config.checks.told(labels_on_bone(skeleton, &planning.ct, &planning.bones))?);
    }
    Ok(warnings)
}

/// The user's skeleton, or the one that the labels give.
pub(super) fn skeleton_of(planning: &PlanningScan, config: &Config) -> Result<(Skeleton, Vec<Warning>)> {
    let built = skeleton::build(&planning.bones)?;
    let mut warnings = built.warnings;
    let ignored: Vec<&str> =
        built.ignored.iter().map(String::as_str).filter(|n| !config.chainmail.names_organ(n)).collect();
    if !ignored.is_empty() {
        let list = ignored.join(", ");
        warnings.push(Warning::new(
            findings::LABELS_IGNORED,
            format!(
                "{}: {list}",
                counted(
                    ignored.len(),
                    "label is no bone of the skeleton and was ignored",
                    "labels are no bones of the skeleton and were ignored"
                )
            ),
        ));
    }
    Ok((planning.skeleton.clone().unwrap_or(built.skeleton), warnings))
}
