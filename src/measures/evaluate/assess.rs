//! Everything that can be measured of a field with what is given.

use super::agreement::{self, Agreement, Alone};
use super::consistency::{self, Consistency};
use super::contour::{self, ContourMetrics};
use super::jacobian::tissue;
use super::landmark::{self, Landmark, LandmarkReport};
use super::pair::{Direction, FieldPair, nearest, on_grid, per_voxel};
use super::regularity::{self, Regularity};
use super::rigidity::{self, BoneRigidity};
use super::setup::{self, MeanShift, MovedBones};
use super::similarity::{self, SimilarityReport};
use super::verdict::{Domain, Limits, Verdict};
use crate::body;
use crate::error::Result;
use crate::field::{InverseReport, PullField, PushField, warp_labels};
use crate::geometry::Grid;
use crate::runtime::Runtime;
use crate::volume::{LabelMap, Mask, Spans, Volume};
use nalgebra::Vector3;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// A field and what is known about the case; everything but the field may be missing.
#[derive(Debug, Clone, Copy)]
pub struct Subject<'a> {
    /// Both directions of the field.
    pub pair: &'a FieldPair,
    /// Planning CT, HU.
    pub planning: Option<&'a Volume<f32>>,
    /// Fraction CT, HU.
    pub fraction: Option<&'a Volume<f32>>,
    /// Where to measure, any grid of the planning frame; without it the patient in the planning CT above -500 HU.
    pub mask: Option<&'a Mask>,
    /// Bones in the planning frame.
    pub bones: Option<&'a LabelMap>,
    /// Label and name of each bone that moves rigidly.
    pub rigid: &'a [(u16, String)],
    /// Labels of those of the spine, on which a couch shift is matched.
    pub spine: &'a [u16],
    /// Pairs of labels of bones that slide on each other, with the reach of each interface in mm.
    pub sliding: &'a [([u16; 2], f64)],
    /// Structures in the planning frame.
    pub structures: Option<&'a LabelMap>,
    /// Structures in the fraction frame; those of a name in both are compared.
    pub structures_fraction: Option<&'a LabelMap>,
    /// Points known in both images.
    pub landmarks: &'a [Landmark],
    /// Fields fraction to a third image, and planning to that image.
    pub triangle: Option<[&'a Volume<[f32; 3]>; 2]>,
}

/// What was measured of a field; parts that need inputs that were not given are missing.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Assessment {
    /// Regularity of each given field, on its own grid and in its own direction.
    pub regularity: Vec<(Direction, Regularity)>,
    /// The one shift of the whole scan that landmarks and images are compared with. Earlier reports lack it.
    #[serde(default)]
    pub shift: Option<MeanShift>,
    /// Landmark residuals.
    pub landmarks: Option<LandmarkReport>,
    /// Mapped planning structures against those of the fraction.
    pub contours: Vec<ContourMetrics>,
    /// Rigidity of each bone.
    pub rigidity: Vec<BoneRigidity>,
    /// There and back, from planning and from the fraction.
    pub inverse_consistency: [Consistency; 2],
    /// The inversion that made the missing direction; `None` when both were given and consistency compares two fields.
    pub inversion: Option<InverseReport>,
    /// Round the triangle of three images.
    pub transitivity: Option<Consistency>,
    /// Similarity of the CTs.
    pub similarity: Option<SimilarityReport>,
    /// How far the CTs agree in windows, by the rules of `register`. Earlier reports lack it.
    #[serde(default)]
    pub agreement: Option<Agreement>,
    /// What the rules say of the figures that have a limit.
    pub verdicts: Vec<Verdict>,
    /// Where regularity and consistency were measured, in words.
    pub measured_in: String,
    /// What that is to the rules. Earlier reports lack it.
    #[serde(default)]
    pub domain: Domain,
    /// Whether bones were given: without them no cell is known to lie between two. Earlier reports lack it.
    #[serde(default = "yes")]
    pub bones_known: bool,
}

fn yes() -> bool {
    true
}

/// What pictures need of an assessment, beside its numbers.
#[derive(Debug, Clone)]
pub struct Maps {
    /// Jacobian map of planning to fraction, on the grid of that field.
    pub jacobian: Spans<f32>,
    /// Where it was measured, in the planning frame.
    pub measured: Mask,
    /// Planning structures on the fraction's grid, where both have structures.
    pub structures: Option<LabelMap>,
}

/// Measures everything that the inputs allow, and judges it by `limits`.
///
/// # Errors
/// When the planning CT holds no patient, or no structure of planning and fraction has the same name.
pub fn assess(subject: &Subject<'_>, limits: &Limits, runtime: &Runtime) -> Result<(Assessment, Maps)> {
    let pair = subject.pair;
    let Place { mask, patient, slides, told: measured_in, domain } =
        runtime.stage("find the tissue", || place(subject))?;
    let (push, pull) = (&pair.push.displacement, &pair.pull.displacement);
    let mask_push = same_grid(&mask, push.grid());
    let mask_pull = carried(&mask, pull);
    let (regularity, map) = runtime.stage("regularity", || {
        let given = |d: Direction| pair.given.contains(&d);
        let (forward, map) = regular(subject, &pair.push, &mask_push, slides.as_ref(), None);
        let mut all = Vec::new();
        if given(Direction::PlanningToFraction) {
            all.push((Direction::PlanningToFraction, forward));
        }
        if given(Direction::FractionToPlanning) {
            let field = PushField { displacement: pull.clone(), computed: Volume::filled(pull.grid().clone(), true) };
            all.push((
                Direction::FractionToPlanning,
                regular(subject, &field, &mask_pull, slides.as_ref(), Some(pull)).0,
            ));
        }
        for (_, r) in &mut all {
            r.histograms.iter_mut().take(1).for_each(|h| h.name = domain.name().to_owned());
        }
        (all, map)
    });
    let inverse_consistency = runtime.stage("consistency", || {
        [consistency::inverse(push, pull, &mask_push), consistency::inverse(pull, push, &mask_pull)]
    });
    let transitivity = runtime
        .stage("transitivity", || subject.triangle.map(|[bc, ac]| consistency::transitivity(push, bc, ac, &mask_push)));
    let rigidity = match subject.bones {
        Some(bones) => runtime.stage("rigidity", || {
            let grid = bones.volume.grid();
            let field = PushField { displacement: on_grid(push, grid)?, computed: Volume::filled(grid.clone(), true) };
            Ok::<_, crate::Error>(rigidity::evaluate(&field, bones, subject.rigid))
        })?,
        None => Vec::new(),
    };
    let moved =
        subject.bones.map(|labels| MovedBones { labels, rigid: subject.rigid, spine: subject.spine, moved: &rigidity });
    let shift = setup::shift(moved, push, &mask_push, subject.fraction.map_or(pull.grid(), Volume::grid));
    let landmarks = (!subject.landmarks.is_empty()).then(|| of_landmarks(subject, shift.as_ref()));
    let (contours, mapped) = match (subject.structures, subject.structures_fraction) {
        (Some(a), Some(b)) => runtime.stage("contours", || {
            let grid = b.volume.grid();
            let there = PullField { displacement: on_grid(pull, grid)?, inside: Volume::filled(grid.clone(), true) };
            let mapped = warp_labels(&there, a)?;
            Ok::<_, crate::Error>((contour::compare(&mapped, b)?, Some(mapped)))
        })?,
        _ => (Vec::new(), None),
    };
    let similarity = match (subject.planning, subject.fraction) {
        (Some(a), Some(b)) => Some(runtime.stage("similarity", || similarity::evaluate(pull, a, b, &mask))),
        _ => None,
    };
    let agreement = match (subject.planning, subject.fraction) {
        (Some(a), Some(b)) if shows_air(b) => {
            let body = patient.as_ref().unwrap_or(&mask);
            Some(runtime.stage("compare images", || agree(subject, [a, b], body, shift.as_ref())))
        }
        _ => None,
    };
    let mut assessment = Assessment {
        regularity,
        shift,
        landmarks,
        contours,
        rigidity,
        inverse_consistency,
        inversion: pair.inversion,
        transitivity,
        similarity,
        agreement,
        verdicts: Vec::new(),
        measured_in,
        domain,
        bones_known: subject.bones.is_some(),
    };
    assessment.verdicts = verdicts(&assessment, pair, limits);
    Ok((assessment, Maps { jacobian: map, measured: mask, structures: mapped }))
}

/// Residuals of the landmarks, with one shift of the whole scan, too.
fn of_landmarks(subject: &Subject<'_>, shift: Option<&MeanShift>) -> LandmarkReport {
    let found = landmark::evaluate(&subject.pair.push, subject.landmarks);
    match shift {
        Some(shift) => found.with_shift(&shift.mm),
        None => found,
    }
}

/// How far the images agree in the patient, compared with one shift of the whole scan.
fn agree(
    subject: &Subject<'_>,
    [planning, fraction]: [&Volume<f32>; 2],
    body: &Mask,
    shift: Option<&MeanShift>,
) -> Agreement {
    let (couch, alone) = shift.map_or((Vector3::zeros(), Alone::Mean), |s| (s.mm, s.alone));
    let body = same_grid(body, planning.grid());
    let labels: Vec<u16> = subject.rigid.iter().map(|(label, _)| *label).collect();
    let bones = subject.bones.map(|map| (&map.volume, &labels[..]));
    let pull = &subject.pair.pull.displacement;
    agreement::evaluate(&agreement::Images { pull, planning, fraction, body: &body, bones, couch, alone })
}

/// Whether an image has values of air, as CTs in HU do and MR images do not.
fn shows_air(image: &Volume<f32>) -> bool {
    image.extremes()[0] < AIR_HU
}

/// Every CT of a patient has lower values somewhere, HU.
const AIR_HU: f32 = -500.0;

/// Where to measure, on a grid of the planning frame.
struct Place {
    mask: Mask,
    /// Inside of the skin with all cavities, where no mask is given and a planning CT is.
    patient: Option<Mask>,
    /// What slides along its border: lung, and organs along the wall.
    slides: Option<Mask>,
    /// In words.
    told: String,
    domain: Domain,
}

fn place(subject: &Subject<'_>) -> Result<Place> {
    if let Some(mask) = subject.mask {
        let told = "the given mask".into();
        return Ok(Place { mask: mask.clone(), patient: None, slides: None, told, domain: Domain::Mask });
    }
    match subject.planning {
        Some(ct) => {
            let body = body::find(ct, subject.bones, &body::BodyOptions::default())?;
            let told = "the patient in the planning CT above -500 HU".into();
            // Without organs the field does not jump along the lung.
            let names = body::SLIDING_ORGANS.map(str::to_owned);
            let organs = subject.structures.or(subject.bones).filter(|map| map.volume.grid().matches(ct.grid(), 1e-3));
            let organs = organs.filter(|map| body::organs_labelled(map, &names));
            let slides = organs.and_then(|organs| body::slides(body::lung(ct, &body).as_ref(), organs, &names));
            Ok(Place { mask: tissue(&body, ct), patient: Some(body), slides, told, domain: Domain::Tissue })
        }
        None => {
            let grid = subject.pair.push.displacement.grid().clone();
            let told = "the whole grid: neither mask nor planning CT was given".into();
            let mask = Volume::filled(grid, true);
            Ok(Place { mask, patient: None, slides: None, told, domain: Domain::Grid })
        }
    }
}

/// Regularity of a field on its own grid; `through` leads from that grid to the planning frame when it is the fraction's.
fn regular(
    subject: &Subject<'_>,
    field: &PushField,
    mask: &Mask,
    slides: Option<&Mask>,
    through: Option<&Volume<[f32; 3]>>,
) -> (Regularity, Spans<f32>) {
    let grid = field.displacement.grid();
    let labels = |map: &LabelMap| LabelMap {
        volume: match through {
            Some(pull) => carried(&map.volume, pull),
            None => same_grid(&map.volume, grid),
        },
        names: map.names.clone(),
    };
    let none = || LabelMap { volume: Volume::filled(grid.clone(), 0), names: BTreeMap::new() };
    let bones = subject.bones.map_or_else(none, labels);
    let structures = subject.structures.map(labels);
    let structures = structures.as_ref().or(subject.bones.map(|_| &bones));
    let region = slides.map(|slides| match through {
        Some(pull) => carried(slides, pull),
        None => same_grid(slides, grid),
    });
    // Which side a voxel of the fraction shows is known to a voxel there.
    let clear = through.and(region.as_ref()).map(|region| regularity::off_border(mask, region));
    let mask = clear.as_ref().unwrap_or(mask);
    regularity::evaluate(field, mask, &bones, subject.rigid, (subject.sliding, region.as_ref()), structures)
}

/// Nearest values of a volume on a grid of the same frame.
fn same_grid<T: Copy + Default + Send + Sync>(volume: &Volume<T>, grid: &Grid) -> Volume<T> {
    if volume.grid().matches(grid, 1e-3) {
        return volume.clone();
    }
    let data = per_voxel(grid, |p| nearest(volume, &p));
    Volume::new(grid.clone(), data).expect("one value per voxel")
}

/// Nearest values of a planning volume at the pre-images of the pull field's voxels.
fn carried<T: Copy + Default + Send + Sync>(volume: &Volume<T>, pull: &Volume<[f32; 3]>) -> Volume<T> {
    let grid = pull.grid();
    let data = per_voxel(grid, |y| {
        let v = nearest(pull, &y).map(f64::from);
        nearest(volume, &(y + nalgebra::Vector3::from(v)))
    });
    Volume::new(grid.clone(), data).expect("one value per voxel")
}

/// What the rules say of every figure that has a limit.
fn verdicts(a: &Assessment, pair: &FieldPair, limits: &Limits) -> Vec<Verdict> {
    let grids = [pair.push.displacement.grid(), pair.pull.displacement.grid()];
    let voxel = grids.iter().flat_map(|grid| grid.spacing()).fold(0.0, f64::max);
    let mut all = Vec::new();
    if let Some(l) = a.landmarks.as_ref().filter(|l| l.after.n > 0) {
        all.extend(limits.landmarks(&l.after, voxel));
    }
    for c in &a.contours {
        if let Some(d) = &c.distances {
            all.push(limits.agreement(&c.name, d.mean_mm, voxel));
        }
        all.push(limits.dice(&c.name, c.dice));
    }
    if let Some(bone) = a.rigidity.iter().max_by(|a, b| a.rms_mm.total_cmp(&b.rms_mm)) {
        all.push(limits.rigidity(&bone.name, bone.rms_mm));
    }
    for (direction, r) in &a.regularity {
        let name = direction.name();
        let grid = match direction {
            Direction::PlanningToFraction => grids[0],
            Direction::FractionToPlanning => grids[1],
        };
        all.extend(limits.folds(name, &r.jacobian, grid.voxel_volume() / 1000.0, a.domain));
        all.push(a.domain.judged(limits.jumps(name, r.jacobian.jumps_above_10)));
        all.push(a.domain.judged(limits.curl(name, r.curl.magnitude.max)));
    }
    let two = if a.inversion.is_some() { "own inversion" } else { "both fields" };
    let [there, back] = a.inverse_consistency.map(|c| c.distance_mm.p95);
    all.push(a.domain.judged(limits.consistency(&format!("inverse consistency ({two})"), there.max(back), voxel)));
    if let Some(t) = &a.transitivity {
        all.push(a.domain.judged(limits.consistency("transitivity", t.distance_mm.p95, voxel)));
    }
    if let Some(images) = &a.agreement {
        all.extend(limits.images(images));
    }
    all
}
