//! From bone motions to an outcome: soft tissue, inverse, resampling, evaluation. Shared by all ways to move bones.

use super::contact;
use super::couch::{Couch, common_shift};
use super::elements::bone_of_label;
use super::field_warnings::field_warnings;
use super::fraction::Fraction;
use super::guides::{self, Compared, GuidePair, GuidedField};
use super::kind::MisledTissue;
use super::matching::couch_match;
use super::moved::{Moved, bones_alone, elements, soft_tissue};
use super::outcome::CARRYING;
use super::planning::{Judging, Resting};
use super::{Case, FractionKind, Outcome, PlanningScan, VolumeReached};
use crate::body;
use crate::body::mr::DARKEST;
use crate::chainmail::{LinkReport, Propagation, Pruning, VolumeChange};
use crate::config::Config;
use crate::error::Result;
use crate::evaluate;
use crate::evaluate::agreement::Agreement;
use crate::evaluate::contact::ContactReport;
use crate::evaluate::couch::CouchMatch;
use crate::evaluate::jacobian::JacobianReport;
use crate::evaluate::landmark::{Landmark, LandmarkReport};
use crate::evaluate::rigidity::BoneRigidity;
use crate::evaluate::uncertainty::UncertaintyReport;
use crate::field::{self, ConsistencyReport, InverseReport, PullField, PushField, Resampling};
use crate::findings;
use crate::fit::FitResult;
use crate::geometry::Grid;
use crate::refine::{Guides, Images, Kind, Misled, Scan, Shading, translated};
use crate::runtime::Runtime;
use crate::sampling::PosePosterior;
use crate::skeleton::Skeleton;
use crate::view::View;
use crate::volume::{LabelMap, LabelSpans, Mask, Spans, Volume};
use crate::warning::Warning;
use nalgebra::Vector3;

/// HU of what lies outside the planning scan when it is shown on the fraction grid.
pub(super) const OUTSIDE_HU: f32 = -1000.0;

/// What images told of soft tissue, where they pulled.
#[derive(Default)]
pub(super) struct Shown {
    /// Displacements that the bones alone would give, on coarse elements, mm.
    pub(super) alone: Option<Volume<[f32; 3]>>,
    /// Where images misled and do not pull, on the elements' grid in planning.
    pub(super) misled: Option<Mask>,
    /// Planning as the fraction's modality shows it, where that is another one.
    pub(super) translated: Option<Volume<f32>>,
    /// Displacements of elements by bones and images without guides, mm, where there are guides.
    pub(super) first: Option<Volume<[f32; 3]>>,
    /// Correlations beside each guide, without and with it.
    pub(super) beside: Vec<Option<[f64; 2]>>,
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
    // A blank end of planning shows no air that tissue could follow.
    let shown = translated.as_ref().unwrap_or(&scan.ct);
    let measured = View::of_ends(&scan.ct).known(shown);
    let planning = Scan { ct: &measured, body };
    let there = Scan { ct: corrected.as_ref().unwrap_or(&fraction.ct), body: found.as_ref().unwrap_or(&fraction.body) };
    // Of a planning MR's texture a CT tells no more than of a cone beam's noise.
    let to_mr = translated.is_some() && fraction.mr.is_some();
    let other = corrected.is_some() || translated.is_some();
    let pair = Kind { lung: resting.lung.is_some(), corrected: other, translated: to_mr };
    let images = Images::new(planning, there, pair, &config.refine, Some(&resting.samples), alone.as_ref());
    let Drawn { propagation, regions, misled, first } = drawn(moved, images, &fraction, runtime)?;
    let beside = match &first {
        Some(first) => {
            let guided = Volume::new(propagation.lattice.grid.clone(), propagation.displacement.clone())?;
            let window = config.refine.window(resting.lung.is_some());
            let compared = Compared { planning: shown, body, fraction: there.ct, window, first, guided: &guided };
            fraction.guides.iter().map(|(planning, _)| compared.correlations(planning)).collect()
        }
        None => Vec::new(),
    };
    let (grey, corrected) = (shading.and_then(|s| s.grey), corrected.is_some());
    let told = misled.as_ref().map(|m| MisledTissue { percent: m.percent, centre_mm: m.centre.into() });
    let kind = FractionKind { view: fraction.view, grey, corrected, misled: told, mr: fraction.mr };
    let misled = misled.map(|m| m.at);
    Ok(Propagated { propagation, regions, shown: Shown { alone, misled, translated, first, beside }, kind: Some(kind) })
}

/// Tissue as images draw it, and structures that guide.
struct Drawn {
    propagation: Propagation,
    regions: Option<LabelMap>,
    misled: Option<Misled>,
    /// Displacements of elements without guides, mm, where there are guides.
    first: Option<Volume<[f32; 3]>>,
}

/// Has tissue drawn by images, where they do not mislead, and by structures that guide.
fn drawn(moved: &Moved<'_>, images: Images<'_>, fraction: &Fraction<'_>, runtime: &Runtime) -> Result<Drawn> {
    if fraction.guides.is_empty() {
        let (mut propagation, mut regions) = soft_tissue(moved, Some(&images), runtime)?;
        let misled = images.misled(&propagation.lattice, &propagation.displacement);
        if let Some(misled) = &misled {
            (propagation, regions) = soft_tissue(moved, Some(&images.without(&misled.at)), runtime)?;
        }
        return Ok(Drawn { propagation, regions, misled, first: None });
    }
    // What guides draw is no evidence for or against images.
    let mut first = elements(moved, &images)?;
    let misled = images.misled(&first.lattice, first.displacement.data());
    let images = match &misled {
        Some(misled) => {
            let images = images.without(&misled.at);
            first = elements(moved, &images)?;
            images
        }
        None => images,
    };
    let guides = Guides::new(&fraction.guides, &moved.config.refine.guide);
    let (propagation, regions) = soft_tissue(moved, Some(&images.guided(guides.as_ref())), runtime)?;
    Ok(Drawn { propagation, regions, misled, first: Some(first.displacement) })
}

/// A skeleton whose pose is known, in the patient that it belongs to.
pub(super) struct Fitted {
    pub(super) skeleton: Skeleton,
    /// The patient in the planning CT.
    pub(super) body: Mask,
    pub(super) fit: FitResult,
}

/// What a motion is carried through, and to where.
pub(super) struct Through<'a> {
    /// The planning side.
    pub(super) scan: &'a PlanningScan,
    /// The grid that the planning CT is carried onto.
    pub(super) target: &'a Grid,
    /// The patient in the fraction CT, where both images refine soft tissue.
    pub(super) fraction: Option<Fraction<'a>>,
}

impl<'a> Through<'a> {
    /// Of a case, onto the grid of its fraction.
    pub(super) fn of(case: &'a Case, fraction: Option<Fraction<'a>>) -> Self {
        Self { scan: &case.planning, target: case.fraction.ct.grid(), fraction }
    }
}

/// A motion that was carried to every voxel, before it is judged.
pub(super) struct Carried {
    pub(super) fitted: Fitted,
    /// Planning to fraction, and back.
    pub(super) push: PushField,
    pub(super) pull: PullField,
    pub(super) couch: CouchMatch,
    pub(super) kind: Option<FractionKind>,
    pub(super) shown: Shown,
    /// What was said before the motion was carried.
    pub(super) warnings: Vec<Warning>,
    common_shift: Vector3<f64>,
    by: Judging,
    guides: Vec<GuidePair>,
    pruning: Option<Pruning>,
    links: LinkReport,
    inverse: InverseReport,
    consistency: ConsistencyReport,
    regions: Option<LabelMap>,
}

/// What is told of a motion by the images that it joins, where there are two.
#[derive(Default)]
pub(super) struct Told {
    pub(super) uncertainty: Option<(Spans<f32>, UncertaintyReport)>,
    pub(super) posterior: Option<PosePosterior>,
    pub(super) agreement: Option<Agreement>,
}

/// Carries the motion to every voxel of the planning grid and of the target: one line per stage.
///
/// All of it happens in a frame that the couch has brought along: what nothing else moves follows the couch.
pub(super) fn carry_out(
    through: Through<'_>,
    mut resting: Resting,
    fitted: Fitted,
    warnings: Vec<Warning>,
    config: &Config,
    runtime: &Runtime,
) -> Result<Carried> {
    let Through { scan, target, fraction } = through;
    let guides = fraction.as_ref().map(|f| f.guides.clone()).unwrap_or_default();
    let Fitted { skeleton, body, fit } = &fitted;
    let couch = Couch::of(fit, scan.ct.grid(), config.chainmail.variant.carry);
    let transforms = couch.transforms(&fit.transforms);
    let moved = Moved { scan, skeleton, body, transforms: &transforms, resting: &resting, config };
    let propagated = runtime.stage(CARRYING, || propagated(&moved, fraction.map(|f| f.shifted(&couch)), runtime))?;
    let Propagated { propagation, regions, mut shown, kind } = propagated;
    let links = runtime.stage("check links", || moved.links(&propagation));
    let Propagation { mut push, pruning, .. } = propagation;
    resting.elements_done();
    let moved = Moved { scan, skeleton, body, transforms: &transforms, resting: &resting, config };
    let (mut pull, inverse) = runtime.stage("invert", || moved.inverted(&push, &couch.grid(target)))?;
    let consistency = runtime.stage("make consistent", || moved.agree(&mut push, &mut pull));
    let (push, pull) = (couch.push(push), couch.pull(pull));
    shown.alone = shown.alone.map(|alone| couch.added(alone));
    shown.first = shown.first.map(|first| couch.added(first));
    let common_shift = common_shift(fit, scan.ct.grid());
    let grids = [scan.ct.grid(), target];
    let couch = couch_match(&config.couch, skeleton, &scan.bones, fit, grids, &common_shift);
    let by = resting.judging();
    Ok(Carried {
        fitted,
        push,
        pull,
        couch,
        kind,
        shown,
        warnings,
        common_shift,
        by,
        guides,
        pruning,
        links,
        inverse,
        consistency,
        regions,
    })
}

impl Carried {
    /// The outcome: the motion is judged, and the planning side shown on the fraction's grid. What was `told` of the images comes
    /// before, since it needs more memory.
    ///
    /// # Errors
    /// As [`field::warp_image`].
    pub(super) fn outcome(
        mut self,
        scan: &PlanningScan,
        landmarks: &[Landmark],
        told: Told,
        config: &Config,
        runtime: &Runtime,
    ) -> Result<Outcome> {
        let target = self.pull.displacement.grid().clone();
        let (fitted, push, by) = (&self.fitted, &self.push, self.by);
        let drawn_mm = by.drawn_mm;
        let judged = runtime.stage("evaluate", || Judged::of(scan, (landmarks, &target), by, fitted, push));
        self.inverse.multiple = judged.multiple;
        let (first, images) = (self.shown.first.as_ref(), &self.shown.beside);
        let guides = GuidedField::all(first, &push.displacement, &judged.jacobian, &self.guides, images);
        let volume_changes = reached(&scan.bones, &judged.jacobian, config);
        let coarsest = coarsest(scan.ct.grid()).max(coarsest(&target));
        let shift = self.couch.shift();
        let found = [
            self.kind.as_ref().map(FractionKind::warnings).unwrap_or_default(),
            field_warnings(push, &judged.jacobian_report, &self.inverse),
            contact::warnings(&judged.contact, drawn_mm),
            volume_changes.iter().filter_map(missed).collect(),
            guides::warnings(&guides, coarsest),
            judged.of_landmarks(landmarks, push, &shift),
        ];
        let carried = runtime.stage("resample", || resampled(scan, push, &self.pull, config))?;
        let Self { fitted, .. } = self;
        Ok(Outcome {
            pose: fitted.fit.pose,
            common_shift: self.common_shift,
            couch: self.couch,
            bone_fits: fitted.fit.bones,
            weighed: Default::default(),
            skeleton: fitted.skeleton,
            body: fitted.body,
            push: self.push,
            pull: self.pull,
            planning_on_fraction: carried.0,
            bones_on_fraction: carried.1,
            jacobian: judged.jacobian,
            jacobian_report: judged.jacobian_report,
            rigidity: judged.rigidity,
            contact: judged.contact,
            skin_contact: judged.skin_contact,
            volume_changes,
            guides,
            kind: self.kind,
            uncertainty: told.uncertainty,
            posterior: told.posterior,
            agreement: told.agreement,
            pruning: self.pruning,
            links: self.links,
            inverse: self.inverse,
            consistency: self.consistency,
            landmarks: judged.residuals.map(|report| report.with_shift(&shift)),
            regions: self.regions,
            warnings: self.warnings.into_iter().chain(found.into_iter().flatten()).collect(),
        })
    }
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
) -> Result<(Volume<f32>, LabelSpans)> {
    // Labels first: while they are made they take the memory that the image takes then.
    let labels = field::warp_labels(pull, &scan.bones)?.into();
    let image = match config.resampling {
        Resampling::PullBack => field::warp_image(pull, &scan.ct, OUTSIDE_HU)?,
        Resampling::FiveTetrahedra => field::scatter_image(push, &scan.ct, pull.displacement.grid(), OUTSIDE_HU)?.0,
    };
    Ok((image, labels))
}

/// What is measured of a field.
struct Judged {
    jacobian: Spans<f32>,
    jacobian_report: JacobianReport,
    rigidity: Vec<BoneRigidity>,
    residuals: Option<LandmarkReport>,
    /// Number of fraction voxels with more than one place in planning.
    multiple: usize,
    contact: ContactReport,
    skin_contact: Option<Mask>,
}

impl Judged {
    fn of(
        scan: &PlanningScan,
        (landmarks, target): (&[Landmark], &Grid),
        by: Judging,
        fitted: &Fitted,
        push: &PushField,
    ) -> Self {
        let Fitted { skeleton, body, fit } = fitted;
        let Judging { bones, cells, jumps, .. } = by;
        let figures = || {
            let (jacobian, report) = evaluate::jacobian::evaluate(push, &cells);
            let rigidity = evaluate::rigidity::evaluate(push, &scan.bones, &skeleton.labels_and_names());
            let residuals = (!landmarks.is_empty()).then(|| evaluate::landmark::evaluate(push, landmarks));
            let multiple = field::multiple_preimages(push, &jacobian, target, jumps.as_ref()).count();
            (jacobian, report, rigidity, residuals, multiple)
        };
        let meeting = || contact::measure(&bones, &fit.transforms, push, body, target);
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

#[cfg(test)]
mod tests;
