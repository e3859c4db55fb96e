//! From bone motions to an outcome: soft tissue, inverse, resampling, evaluation. Shared by all ways to move bones.

use super::contact;
use super::couch::{Couch, common_shift};
use super::elements::{alone_mm, bone_of_label, tissue};
use super::field_warnings::field_warnings;
use super::fraction::Fraction;
use super::kind::MisledTissue;
use super::matching::couch_match;
use super::outcome::CARRYING;
use super::planning::Resting;
use super::{Case, FractionKind, Outcome, PlanningScan, VolumeReached};
use crate::body;
use crate::body::mr::DARKEST;
use crate::chainmail::{
    self, ChainMail, ChainmailOptions, ImagePull, Initiators, Lattice, LinkReport, Propagation, Tissue, Variant,
    VolumeChange, check_links,
};
use crate::comparator::{nearest_bone, thin_plate};
use crate::config::{Config, SoftTissue};
use crate::error::{Error, Result};
use crate::evaluate;
use crate::evaluate::contact::ContactReport;
use crate::evaluate::jacobian::JacobianReport;
use crate::evaluate::landmark::{Landmark, LandmarkReport};
use crate::evaluate::rigidity::BoneRigidity;
use crate::field::{
    self, Beside, ConsistencyOptions, ConsistencyReport, InverseReport, MovedBones, PullField, PushField, Resampling,
};
use crate::findings;
use crate::fit::FitResult;
use crate::geometry::{Grid, Rigid, rotation_matrices};
use crate::progress::Silent;
use crate::refine::{Images, Kind, Scan, Shading, translated};
use crate::runtime::Runtime;
use crate::skeleton::Skeleton;
use crate::volume::{LabelMap, Mask, Spans, Volume, trilinear_vector};
use crate::warning::Warning;
use nalgebra::{Point3, Vector3};

/// HU of what lies outside the planning scan when it is shown on the fraction grid.
pub(super) const OUTSIDE_HU: f32 = -1000.0;

/// What carrying the motion gives.
pub(super) struct Carried {
    pub(super) outcome: Outcome,
    pub(super) shown: Shown,
}

/// What images told of soft tissue, where they pulled.
#[derive(Default)]
pub(super) struct Shown {
    /// Displacements that the bones alone would give, on coarse elements, mm.
    pub(super) alone: Option<Volume<[f32; 3]>>,
    /// Where images misled and do not pull, on the elements' grid in planning.
    pub(super) misled: Option<Mask>,
    /// Planning as the fraction's modality shows it, where that is another one.
    pub(super) translated: Option<Volume<f32>>,
}

/// A patient whose bones have moved, in the frame that the couch has brought along.
pub(super) struct Moved<'a> {
    scan: &'a PlanningScan,
    skeleton: &'a Skeleton,
    body: &'a Mask,
    transforms: &'a [Rigid],
    resting: &'a Resting,
    config: &'a Config,
}

impl<'a> Moved<'a> {
    fn tissue(&self, bone_of_label: &'a [Option<u16>], options: &ChainmailOptions) -> Tissue<'a> {
        tissue(self.scan, self.body, self.resting.lung.as_ref(), self.resting.sliding.as_ref(), bone_of_label, options)
    }

    /// The links of the chain mail as the bones have left them.
    fn links(&self, propagation: &Propagation) -> LinkReport {
        check_links(&propagation.lattice, &propagation.displacement, &rotation_matrices(self.transforms))
    }

    /// The inverse of its field on a grid of the fraction.
    fn inverted(&self, push: &PushField, there: &Grid) -> Result<(PullField, InverseReport)> {
        let motions = self.skeleton.bones.iter().map(|b| b.label).zip(self.transforms.iter().copied());
        let bones = MovedBones::new(&self.scan.bones, motions, there);
        field::invert(push, there, Some(&bones), &self.config.invert)
    }

    /// Makes both directions of its field agree.
    fn agree(&self, push: &mut PushField, pull: &mut PullField) -> ConsistencyReport {
        let bone_of_label = bone_of_label(self.skeleton);
        let bone = |v: usize| bone_of_label[usize::from(self.scan.bones.volume.data()[v])];
        let beside = Beside { bone: &bone, spared: &self.resting.beside_contact };
        field::agree(push, pull, &beside, &self.config.invert, &consistency_of(self.config))
    }

    fn centroids(&self) -> Vec<Point3<f64>> {
        self.skeleton.bones.iter().map(|b| b.centroid).collect()
    }
}

/// A motion carried to the elements and every voxel.
struct Propagated {
    propagation: Propagation,
    regions: Option<LabelMap>,
    shown: Shown,
    kind: Option<FractionKind>,
}

/// Carries the bones' motion on, with the images' pull where there is a fraction (in the frame of the couch).
fn propagated(moved: &Moved<'_>, fraction: Option<Fraction<'_>>, runtime: &Runtime) -> Result<Propagated> {
    let Moved { scan, body, resting, config, .. } = moved;
    let Some(fraction) = fraction else {
        let (propagation, regions) = soft_tissue(moved, None, runtime)?;
        return Ok(Propagated { propagation, regions, shown: Shown::default(), kind: None });
    };
    let alone = resting.chain_mail.as_ref().map(|chain_mail| bones_alone(chain_mail, moved)).transpose()?;
    let bone = bone_of_label(moved.skeleton);
    let soft = |voxel: usize| body.data()[voxel] && bone[usize::from(scan.bones.volume.data()[voxel])].is_none();
    let planning = Scan { ct: &scan.ct, body };
    let mr = alone.as_ref().filter(|_| config.across());
    let translated = mr.map(|alone| translated(planning, &fraction.ct, DARKEST, alone));
    let shading = alone.as_ref().filter(|_| mr.is_none()).map(|a| Shading::of(&scan.ct, soft, &fraction.ct, a));
    let corrected = shading.as_ref().and_then(|s| s.corrected(&fraction.ct, &config.refine.shading));
    // On other grey values the patient may have another outline.
    let found = corrected.as_ref().map(|ct| body::find(ct, None, &config.body)).transpose()?;
    let planning = Scan { ct: translated.as_ref().unwrap_or(&scan.ct), body };
    let there = Scan { ct: corrected.as_ref().unwrap_or(&fraction.ct), body: found.as_ref().unwrap_or(&fraction.body) };
    let pair = Kind { lung: resting.lung.is_some(), corrected: corrected.is_some() || translated.is_some() };
    let images = Images::new(planning, there, pair, &config.refine, Some(&resting.samples), alone.as_ref());
    let (mut propagation, mut regions) = soft_tissue(moved, Some(&images), runtime)?;
    let misled = images.misled(&propagation.lattice, &propagation.displacement);
    if let Some(misled) = &misled {
        (propagation, regions) = soft_tissue(moved, Some(&images.without(&misled.at)), runtime)?;
    }
    let (grey, corrected) = (shading.and_then(|s| s.grey), corrected.is_some());
    let told = misled.as_ref().map(|m| MisledTissue { percent: m.percent, centre_mm: m.centre.into() });
    let kind = FractionKind { view: fraction.view, grey, corrected, misled: told, mr: fraction.mr };
    let misled = misled.map(|m| m.at);
    Ok(Propagated { propagation, regions, shown: Shown { alone, misled, translated }, kind: Some(kind) })
}

/// What the bones alone would have made of soft tissue, coarsely.
fn bones_alone(chain_mail: &ChainMail, moved: &Moved<'_>) -> Result<Volume<[f32; 3]>> {
    let options = &moved.config.chainmail;
    let spacing = alone_mm(options);
    let coarse = ChainmailOptions {
        spacing_mm: spacing,
        relaxation: options.relaxation.iter().copied().filter(|r| r.spacing_mm >= spacing).collect(),
        variant: Variant { waves_mm: options.spacing_of_waves(), ..options.variant.clone() },
        ..options.clone()
    };
    let bone_of_label = bone_of_label(moved.skeleton);
    let tissue = moved.tissue(&bone_of_label, options);
    let centroids = moved.centroids();
    let bones = Initiators { transforms: moved.transforms, centroids: &centroids };
    Ok(chain_mail.elements(&tissue, &bones, &coarse, None, &Silent)?.displacement)
}

/// A skeleton whose pose is known, in the patient that it belongs to.
pub(super) struct Fitted {
    pub(super) skeleton: Skeleton,
    /// The patient in the planning CT.
    pub(super) body: Mask,
    pub(super) fit: FitResult,
}

/// What a motion is carried through, and to where.
#[derive(Clone, Copy)]
pub(super) struct Through<'a> {
    /// The planning side.
    pub(super) scan: &'a PlanningScan,
    /// What was made of it beforehand.
    pub(super) resting: &'a Resting,
    /// Landmarks that evaluate the result.
    pub(super) landmarks: &'a [Landmark],
    /// The grid that the planning CT is carried onto.
    pub(super) target: &'a Grid,
    /// The patient in the fraction CT, where both images refine soft tissue.
    pub(super) fraction: Option<&'a Fraction<'a>>,
}

impl<'a> Through<'a> {
    /// Of a case, onto the grid of its fraction.
    pub(super) fn of(case: &'a Case, resting: &'a Resting, fraction: Option<&'a Fraction<'a>>) -> Self {
        let (landmarks, target) = (case.fraction.landmarks.as_slice(), case.fraction.ct.grid());
        Self { scan: &case.planning, resting, landmarks, target, fraction }
    }
}

/// Carries the motion to every voxel of the planning grid, and the planning CT onto the target: one line per stage.
///
/// All of it happens in a frame that the couch has brought along: what nothing else moves follows the couch.
pub(super) fn carry_out(
    through: Through<'_>,
    fitted: Fitted,
    warnings: Vec<Warning>,
    config: &Config,
    runtime: &Runtime,
) -> Result<Carried> {
    let Through { scan, resting, target, fraction, .. } = through;
    let Fitted { skeleton, body, fit } = &fitted;
    let couch = Couch::of(fit, scan.ct.grid(), config.chainmail.variant.carry);
    let transforms = couch.transforms(&fit.transforms);
    let moved = Moved { scan, skeleton, body, transforms: &transforms, resting, config };
    let propagated = runtime.stage(CARRYING, || propagated(&moved, fraction.map(|f| f.shifted(&couch)), runtime))?;
    let links = runtime.stage("check links", || moved.links(&propagated.propagation));
    let mut push = propagated.propagation.push;
    let (mut pull, mut inverse) = runtime.stage("invert", || moved.inverted(&push, &couch.grid(target)))?;
    let consistency = runtime.stage("make consistent", || moved.agree(&mut push, &mut pull));
    let (push, pull) = (couch.push(push), couch.pull(pull));
    let carried = runtime.stage("resample", || resampled(scan, &push, &pull, config))?;
    let judged = runtime.stage("evaluate", || Judged::of(through, &fitted, &push));
    inverse.multiple = judged.multiple.count();
    let mut shown = propagated.shown;
    shown.alone = shown.alone.map(|alone| couch.added(alone));
    let common_shift = common_shift(fit, scan.ct.grid());
    let grids = [scan.ct.grid(), target];
    let matched = couch_match(&config.couch, skeleton, &scan.bones, fit, grids, &common_shift);
    let volume_changes = reached(&scan.bones, &judged.jacobian, config);
    let found = [
        propagated.kind.as_ref().map(FractionKind::warnings).unwrap_or_default(),
        field_warnings(&push, &judged.jacobian_report, &inverse),
        contact::warnings(&judged.contact, coarsest(scan.ct.grid())),
        volume_changes.iter().filter_map(missed).collect(),
        judged.of_landmarks(through.landmarks, &push, &matched.shift()),
    ];
    let outcome = Outcome {
        pose: fitted.fit.pose,
        common_shift,
        bone_fits: fitted.fit.bones,
        weighed: Default::default(),
        skeleton: fitted.skeleton,
        body: fitted.body,
        push,
        pull,
        planning_on_fraction: carried.0,
        bones_on_fraction: carried.1,
        jacobian: judged.jacobian,
        jacobian_report: judged.jacobian_report,
        rigidity: judged.rigidity,
        contact: judged.contact,
        skin_contact: judged.skin_contact,
        volume_changes,
        kind: propagated.kind,
        uncertainty: None,
        posterior: None,
        agreement: None,
        pruning: propagated.propagation.pruning,
        links,
        inverse,
        consistency,
        landmarks: judged.residuals.map(|report| report.with_shift(&matched.shift())),
        regions: propagated.regions,
        couch: matched,
        warnings: warnings.into_iter().chain(found.into_iter().flatten()).collect(),
    };
    Ok(Carried { outcome, shown })
}

/// The largest edge of a voxel, mm.
fn coarsest(grid: &Grid) -> f64 {
    grid.spacing().into_iter().fold(0.0, f64::max)
}

/// The planning CT and its bones on the fraction's grid.
fn resampled(
    scan: &PlanningScan,
    push: &PushField,
    pull: &PullField,
    config: &Config,
) -> Result<(Volume<f32>, LabelMap)> {
    let image = match config.resampling {
        Resampling::PullBack => field::warp_image(pull, &scan.ct, OUTSIDE_HU)?,
        Resampling::FiveTetrahedra => field::scatter_image(push, &scan.ct, pull.displacement.grid(), OUTSIDE_HU)?.0,
    };
    Ok((image, field::warp_labels(pull, &scan.bones)?))
}

/// What is measured of a field.
struct Judged {
    jacobian: Spans<f32>,
    jacobian_report: JacobianReport,
    rigidity: Vec<BoneRigidity>,
    residuals: Option<LandmarkReport>,
    /// Fraction voxels with more than one place in planning.
    multiple: Mask,
    contact: ContactReport,
    skin_contact: Option<Mask>,
}

impl Judged {
    fn of(through: Through<'_>, fitted: &Fitted, push: &PushField) -> Self {
        let Through { scan, resting, landmarks, target, .. } = through;
        let Fitted { skeleton, body, fit } = fitted;
        let figures = || {
            let (jacobian, report) = evaluate::jacobian::evaluate(push, &resting.cells);
            let rigidity = evaluate::rigidity::evaluate(push, &scan.bones, &skeleton.labels_and_names());
            let residuals = (!landmarks.is_empty()).then(|| evaluate::landmark::evaluate(push, landmarks));
            let multiple = field::multiple_preimages(push, &jacobian, target);
            (jacobian, report, rigidity, residuals, multiple)
        };
        let meeting = || contact::measure(&resting.bones, &fit.transforms, push, body, target);
        // Both have parts that one thread does alone.
        let (figures, (contact, skin_contact)) = rayon::join(figures, meeting);
        let (jacobian, jacobian_report, rigidity, residuals, multiple) = figures;
        Self { jacobian, jacobian_report, rigidity, residuals, multiple, contact, skin_contact }
    }

    /// What is to be said of landmarks.
    fn of_landmarks(&self, landmarks: &[Landmark], push: &PushField, couch_shift: &Vector3<f64>) -> Vec<Warning> {
        let told = |report| super::landmarks::warnings(landmarks, push, report, couch_shift);
        self.residuals.as_ref().map(told).unwrap_or_default()
    }
}

/// How well the fields have to agree: what the chain mail is compared with stays as it is.
fn consistency_of(config: &Config) -> ConsistencyOptions {
    let rounds = match config.soft_tissue {
        SoftTissue::ChainMail => config.consistency.rounds,
        SoftTissue::ThinPlateSplines | SoftTissue::NearestBone => 0,
    };
    ConsistencyOptions { rounds, ..config.consistency.clone() }
}

/// What came of the volumes that were asked to change.
fn reached(labels: &LabelMap, jacobian: &Spans<f32>, config: &Config) -> Vec<VolumeReached> {
    let of = |c: &VolumeChange| {
        let label = labels.names.iter().find(|(_, n)| **n == c.organ).map(|(l, _)| *l);
        let reached = label.and_then(|l| evaluate::jacobian::relative_volume(jacobian, labels, l));
        VolumeReached { organ: c.organ.clone(), factor: c.factor, reached }
    };
    config.chainmail.volume_change.iter().map(of).collect()
}

/// Departure from the asked factor that is warned of.
/// The full grid reaches a factor to 3 %.
const VOLUME_TOLERANCE: f64 = 0.05;

fn missed(v: &VolumeReached) -> Option<Warning> {
    let reached = v.reached.unwrap_or(1.0);
    ((reached / v.factor - 1.0).abs() > VOLUME_TOLERANCE).then(|| {
        let message = format!(
            "{}: its volume changes by a factor of {reached:.2}, not {:.2} as asked: bones, skin or images hold it",
            v.organ, v.factor
        );
        Warning::new(findings::VOLUME_CHANGE, message)
    })
}

/// Carries the bones' motion to every voxel by the model that the settings name: the chain mail with the images that pull it,
/// where that is the model. With it the regions of influence, if they are asked for and the model has any.
fn soft_tissue(
    moved: &Moved<'_>,
    images: Option<&Images<'_>>,
    runtime: &Runtime,
) -> Result<(Propagation, Option<LabelMap>)> {
    let Moved { skeleton, config, .. } = moved;
    let bone_of_label = bone_of_label(skeleton);
    let tissue = moved.tissue(&bone_of_label, &config.chainmail);
    let centroids = moved.centroids();
    let bones = Initiators { transforms: moved.transforms, centroids: &centroids };
    let push = match config.soft_tissue {
        SoftTissue::ChainMail => {
            let chain_mail = moved.resting.chain_mail.as_ref();
            let chain_mail = chain_mail.ok_or_else(|| Error::Internal("the chain mail was not made".into()))?;
            let images = images.map(|i| i as &dyn ImagePull);
            let propagation = chain_mail.propagate(&tissue, &bones, &config.chainmail, images, runtime.progress())?;
            let regions = || regions_of(&tissue, &propagation, &bones, skeleton, config);
            let regions = config.output.regions.then(regions).transpose()?;
            return Ok((propagation, regions));
        }
        SoftTissue::ThinPlateSplines => thin_plate(&tissue, &bones)?,
        SoftTissue::NearestBone => nearest_bone(&tissue, &bones)?,
    };
    // The chain mail that such a field would stretch, so that its links can be judged alike.
    let organs = chainmail::organs(&tissue, &config.chainmail)?;
    let lattice = Lattice::new(&tissue, &config.chainmail.material, &organs, config.chainmail.spacing_mm);
    let at = |n: usize| {
        let u = trilinear_vector(&push.displacement, &push.displacement.grid().index(&lattice.rest(n)));
        u.map_or([0.0; 3], |u| [u.x as f32, u.y as f32, u.z as f32])
    };
    let displacement = (0..lattice.node.len()).map(at).collect();
    Ok((Propagation { push, lattice: lattice.into(), displacement, pruning: None }, None))
}

/// The label of the bone that reaches each voxel first.
fn regions_of(
    tissue: &Tissue<'_>,
    propagation: &Propagation,
    bones: &Initiators<'_>,
    skeleton: &Skeleton,
    config: &Config,
) -> Result<LabelMap> {
    let owner = chainmail::regions(tissue, &propagation.lattice, bones, &config.chainmail.variant)?;
    let label = |o: &u16| usize::from(*o).checked_sub(1).map_or(0, |b| skeleton.bones[b].label);
    let names = skeleton.labels_and_names().into_iter().collect();
    Ok(LabelMap { volume: owner.map(label), names })
}

#[cfg(test)]
mod tests;
