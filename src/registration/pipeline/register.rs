//! The registration: one call per stage.

use super::by_skin::Unplaced;
use super::carry::{Carried, Fitted, Through, Told, carry_out};
use super::checks::{check_fraction, check_labels};
use super::elements::images_pull;
use super::fraction::Fraction;
use super::guides;
use super::planning::{Patient, Planning, Resting, check_planning, skeleton_of};
use super::region::cut;
use super::{Case, FractionKind, Outcome, uncertainty};
use crate::body::mr;
use crate::config::{Config, Modality};
use crate::error::{Error, Result};
use crate::evaluate::agreement;
use crate::evaluate::uncertainty::{PlanningSide, UncertaintyReport};
use crate::findings;
use crate::fit::{
    BoneFit, BoneSamples, DeterminedBy, FitResult, FitStart, GivenMotion, Weighed, contradictions, fit_pose_weighed,
    from_labels, from_landmarks, given,
};
use crate::runtime::Runtime;
use crate::skeleton::Skeleton;
use crate::view::View;
use crate::volume::{Spans, Volume, Window};
use crate::warning::Warning;
use std::sync::Arc;

/// Registers a case. With a region of interest the outcome lies on the grids of that part; [`register_fraction`] returns the part.
///
/// # Errors
/// [`Error::Input`] when the inputs do not fit each other, [`Error::Registration`] when the images share no anatomy.
pub fn register(case: &Case, config: &Config, runtime: &Runtime) -> Result<Outcome> {
    check_fraction(&case.fraction.ct, config)?;
    Ok(register_fraction(case, Planning::new(&case.planning, config, runtime)?, config, runtime)?.0)
}

/// Registers a case whose planning side was prepared with the same settings, alone or for another fraction; where they name a
/// region, also returns the part of the case that was registered: everything lies on its grids. What no clone of the planning side
/// needs any more is freed on the way.
///
/// # Errors
/// As [`register`].
pub fn register_fraction(
    case: &Case,
    planning: Planning,
    config: &Config,
    runtime: &Runtime,
) -> Result<(Outcome, Option<Case>)> {
    let odd = check_fraction(&case.fraction.ct, config)?;
    let Planning { patient: Patient { skeleton, body, warnings }, resting, samples } = planning;
    let (guides, left_out) = guides::paired(case, &skeleton, config)?;
    let (placed, unlike) = match &case.fraction.bones {
        None => placed(case, &skeleton)?,
        Some(_) => runtime.stage("lay labels on each other", || placed(case, &skeleton))?,
    };
    let samples = match (samples, &placed) {
        // The settings would let landmarks alone place the bones, and there are none.
        (None, None) => {
            let options = config.fit_options();
            Some(BoneSamples::new(&skeleton, &case.planning.ct, &case.planning.bones, &options).into())
        }
        (samples, _) => samples,
    };
    // Grey values of an MR are brought to a scale on which air is told from the patient.
    let tissue = (config.fraction.modality == Modality::Mr).then(|| mr::tissue_scale(&case.fraction.ct)).transpose()?;
    let (known, report, grey) = {
        let (image, grey) = tissue.as_ref().map_or((&case.fraction.ct, None), |mr| (&mr.image, Some(mr.range)));
        let view = if grey.is_some() { View::of_ends(image) } else { View::of(image) };
        (view.known(image), view.report, grey)
    };
    let fit = || match (&samples, &placed) {
        (Some(samples), start) => {
            let start = match (start, case.fraction.start) {
                (Some(placed), _) => FitStart::Placed(placed),
                (None, Some(common)) => FitStart::Near(common),
                (None, None) => FitStart::Search,
            };
            fit_pose_weighed(&skeleton, samples, &known, start, &config.fit_options(), runtime.progress())
        }
        (None, Some(known)) => Ok((given(&skeleton, known)?, Weighed::default())),
        (None, None) => Err(Error::Internal("neither image nor landmarks place the bones".into())),
    };
    // An MR is shown and told of as one whether it pulls or not.
    let seen = || {
        (images_pull(config) || config.across() || !guides.is_empty())
            .then(|| Fraction::new(known.clone(), report.clone(), grey, config))
    };
    // Finding the patient is for the most part one thread's work.
    let (fit, fraction) = runtime.stage("fit skeleton", || rayon::join(fit, seen));
    let ((mut fit, weighed), mut fraction) = (fit?, fraction.transpose()?);
    drop((samples, known));
    if let (true, Some(resting), Some(fraction)) = (config.across(), &resting, &fraction) {
        let unplaced = Unplaced { scan: &case.planning, skeleton: &skeleton, body: &body, resting, config };
        runtime.stage("place by the skin", || unplaced.by_skin(&mut fit, fraction))?;
    }
    fraction.iter_mut().for_each(|fraction| fraction.guides.clone_from(&guides));
    let mislabelled = match (&placed, &case.fraction.bones) {
        (Some(placed), Some(_)) => contradictions(&skeleton, placed, &fit.transforms),
        _ => Vec::new(),
    };
    let warnings = [&warnings, &odd, &left_out, &unlike, &fit.warnings, &fit_warnings(&fit), &mislabelled]
        .map(|w| w.as_slice())
        .concat();
    if config.region.is_some() {
        let (part, body) = cut(case, &skeleton, &body, &fit, &config.region)?;
        let fraction = fraction.map(|whole| whole.part(part.fraction.ct.grid()));
        let resting = Resting::new(&part.planning, &skeleton, &body, true, config, runtime)?;
        let ready = Ready { case: &part, resting, fraction };
        let outcome = carried(ready, Fitted { skeleton, body, fit }, warnings, config, runtime)?;
        return Ok((Outcome { weighed, ..outcome }, Some(part)));
    }
    let resting = resting.ok_or_else(|| Error::Internal("the planning side was prepared for a region".into()))?;
    let ready = Ready { case, resting, fraction };
    let outcome = carried(ready, Fitted { skeleton, body, fit }, warnings, config, runtime)?;
    Ok((Outcome { weighed, ..outcome }, None))
}

/// Motions of bones that landmarks or labels give, where there are any, and what is to be said of them.
#[expect(clippy::type_complexity, reason = "each bone's motion, where it is known, and words")]
fn placed(case: &Case, skeleton: &Skeleton) -> Result<(Option<Vec<Option<GivenMotion>>>, Vec<Warning>)> {
    match (case.fraction.bone_landmarks.as_slice(), &case.fraction.bones) {
        ([], None) => Ok((None, Vec::new())),
        ([], Some(labels)) => {
            let (motions, warnings) = from_labels(skeleton, &case.planning.bones, labels)?;
            Ok((Some(motions), warnings))
        }
        (landmarks, _) => Ok((Some(from_landmarks(skeleton, landmarks)?), Vec::new())),
    }
}

/// A case with what was made of both its sides before the bones' motion is carried out.
struct Ready<'a> {
    case: &'a Case,
    resting: Resting,
    /// The patient in the fraction CT, where it is known.
    fraction: Option<Fraction<'a>>,
}

/// Carries the bones' motion out, by the images too where the patient in the fraction CT is given, with a map of how far the result may be trusted.
fn carried(
    ready: Ready<'_>,
    mut moved: Fitted,
    warnings: Vec<Warning>,
    config: &Config,
    runtime: &Runtime,
) -> Result<Outcome> {
    let Ready { case, resting, fraction } = ready;
    // What is needed of the fraction when its part in soft tissue is over.
    let seen = fraction.as_ref().map(|f| f.ct.clone());
    let mr = fraction.as_ref().and_then(|f| Some((f.mr?, f.view.clone())));
    let through = Through::of(case, fraction.filter(|f| images_pull(config) || !f.guides.is_empty()));
    let open = moved.fit.open.take();
    let weighing =
        resting.side.clone().map(|side| Weighing { side, window: config.refine.window(resting.lung.is_some()) });
    let mut carried = carry_out(through, resting, moved, warnings, config, runtime)?;
    let mut told = Told::default();
    if let (None, Some((mr, view))) = (&carried.kind, mr) {
        carried.kind = Some(FractionKind { view, grey: None, corrected: false, misled: None, mr: Some(mr) });
    }
    let fraction = seen.as_deref().unwrap_or(&case.fraction.ct);
    if let Some(weighing) = weighing {
        told.uncertainty = Some(runtime.stage("uncertainty", || weighing.of(case, &carried, fraction))?);
        let fitted = &carried.fitted;
        told.posterior = Some(uncertainty::posterior(&fitted.skeleton.bones, &fitted.fit.bones, open.as_ref()));
    }
    // One modality's grey values are no function of another's in every window.
    if !config.across() {
        let labels: Vec<u16> = carried.fitted.skeleton.bones.iter().map(|b| b.label).collect();
        let compared = agreement::Images {
            pull: &carried.pull.displacement,
            planning: &case.planning.ct,
            fraction,
            body: &carried.fitted.body,
            bones: Some((&case.planning.bones.volume, &labels[..])),
            couch: carried.couch.shift(),
            alone: agreement::Alone::Couch,
        };
        told.agreement = Some(runtime.stage("compare images", || agreement::evaluate(&compared)));
    }
    drop(seen);
    carried.outcome(&case.planning, &case.fraction.landmarks, told, config, runtime)
}

/// What a map of uncertainty is made from before there is a fraction.
struct Weighing {
    side: Arc<PlanningSide>,
    window: Window,
}

impl Weighing {
    /// The map of a motion that a fraction shows.
    fn of(self, case: &Case, carried: &Carried, seen: &Volume<f32>) -> Result<(Spans<f32>, UncertaintyReport)> {
        let Carried { fitted, shown, .. } = carried;
        let of = |ct| uncertainty::side(ct, &case.planning.bones, &fitted.skeleton, &fitted.body, self.window);
        let translated = shown.translated.as_ref().map(of).transpose()?;
        let (bones_alone, misled) = (shown.alone.as_ref(), shown.misled.as_ref());
        let found = uncertainty::Found {
            bones: &fitted.skeleton.bones,
            fits: &fitted.fit.bones,
            body: &fitted.body,
            push: &carried.push,
            warnings: &carried.warnings,
        };
        let images = uncertainty::Shown { fraction: seen, bones_alone, misled };
        uncertainty::of(&case.planning, &found, translated.as_ref().unwrap_or(&self.side), images)
    }
}

/// Judges the inputs of a case by themselves and against each other, as [`register`] does before its long work; nothing is
/// registered.
///
/// # Errors
/// [`Error::Input`] when they do not fit each other.
pub fn check_inputs(case: &Case, config: &Config) -> Result<Vec<Warning>> {
    let mut warnings = check_fraction(&case.fraction.ct, config)?;
    check_labels(&case.planning)?;
    let (skeleton, found) = skeleton_of(&case.planning, config)?;
    warnings.extend(found);
    warnings.extend(check_planning(&case.planning, &skeleton, config)?);
    warnings.extend(guides::paired(case, &skeleton, config)?.1);
    Ok(warnings)
}

/// Of a bone in view by less than this, too little contrast is no wonder and is not warned of.
const SHOULD_BE_FOUND: f64 = 0.3;
/// Farther than this beyond its soft range a joint is warned of.
const BEYOND_DEG: f64 = 3.0;
const BEYOND_MM: f64 = 3.0;

/// Bones that the user should look at.
pub(super) fn fit_warnings(fit: &FitResult) -> Vec<Warning> {
    let mut out = Vec::new();
    for bone in &fit.bones {
        if bone.determined_by == DeterminedBy::Joint && bone.visible > SHOULD_BE_FOUND {
            let message = format!(
                "{} follows its joint: {:.0} % of it should be seen in the fraction, but {} of its contrast is found \
                 where the joint holds it, too little to place it",
                bone.name,
                100.0 * bone.visible,
                bone.similarity_after.map_or("none".into(), |share| format!("{:.0} %", 100.0 * share)),
            );
            out.push(Warning::new(findings::BONE_NOT_EXPLAINED, message));
        }
        if bone.determined_by == DeterminedBy::Skin {
            let found = if bone.visible > SHOULD_BE_FOUND { " and too little of its contrast is found" } else { "" };
            let message = format!(
                "{} is placed by the skin around it: {:.0} % of it is in view{found}; look at the fusion images",
                bone.name,
                100.0 * bone.visible
            );
            out.push(Warning::new(findings::BONE_BY_SKIN, message));
        }
        let beyond = &bone.beyond_range;
        if beyond.rotation_deg > BEYOND_DEG || beyond.shift_mm > BEYOND_MM {
            let message = format!(
                "{}: its joint is {beyond} beyond its soft range; check the label and the fusion images",
                bone.name
            );
            out.push(Warning::new(findings::JOINT_LIMIT, message));
        }
    }
    out.extend(unlike(&fit.bones));
    out.extend(unsettled(&fit.bones));
    out
}

/// A whole bone that leaves this many times as much unexplained as the middle one of so many, and this share at least, is unlike its
/// image: of a real neck, two vertebrae whose labels hold pieces of their neighbours left 0.07 and 0.12 (4 and 7 times the middle
/// one) and erred by 0.3 mm; its others left 0.05 at most, posed bones 0.02.
const UNLIKE: f64 = 4.0;
const UNLIKE_SHARE: f64 = 0.06;
const LEAST_COMPARED: usize = 6;
/// A bone of which more is in view is whole.
const WHOLE: f64 = 0.9;

/// A word about whole bones that the image explains worse than the others, though it places them.
fn unlike(bones: &[BoneFit]) -> Option<Warning> {
    let whole = bones.iter().filter(|b| b.determined_by == DeterminedBy::Image && b.visible > WHOLE);
    let mut left: Vec<(f64, &str)> = whole.filter_map(|b| Some((1.0 - b.similarity_after?, b.name.as_str()))).collect();
    left.sort_by(|a, b| a.0.total_cmp(&b.0));
    let middle = left.get(left.len() / 2).filter(|_| left.len() >= LEAST_COMPARED)?.0;
    let odd: Vec<String> = left
        .iter()
        .rev()
        .filter(|(share, _)| *share > UNLIKE_SHARE && *share > UNLIKE * middle)
        .map(|(share, name)| format!("{name} ({:.0} %)", 100.0 * (1.0 - share)))
        .collect();
    (!odd.is_empty()).then(|| {
        let message = format!(
            "the image explains less of the contrast of {} than of the other bones ({:.0} %): their labels may \
             hold parts of other bones, or they have changed; they may err by more than their reported deviation",
            odd.join(", "),
            100.0 * (1.0 - middle)
        );
        Warning::new(findings::BONE_UNLIKE, message)
    })
}

/// A bone that the next step of the fit would have moved by less than this has settled, whatever stopped the fit, mm.
const SETTLED_MM: f64 = 0.1;

/// A word about bones that were still moving when the fit stopped at its iteration limit.
fn unsettled(bones: &[BoneFit]) -> Option<Warning> {
    let stopped = |b: &&BoneFit| b.determined_by == DeterminedBy::Image && b.hit_limit();
    let mut moving: Vec<&BoneFit> = bones.iter().filter(stopped).filter(|b| b.unsettled_mm >= SETTLED_MM).collect();
    moving.sort_by(|a, b| b.unsettled_mm.total_cmp(&a.unsettled_mm));
    let stop = &moving.first()?.stop;
    let named: Vec<String> = moving.iter().take(6).map(|b| format!("{} by {:.1} mm", b.name, b.unsettled_mm)).collect();
    let more = moving.len().checked_sub(7).map_or(String::new(), |n| format!(" and {} more", n + 1));
    let message = format!(
        "the fit stopped at its {stop} while it still moved {}{more} a step: raise fit.max_iterations, or place these bones \
         with --bone-landmarks",
        named.join(", ")
    );
    Some(Warning::new(findings::FIT_ITERATIONS, message))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fit::Stop;
    use crate::geometry::Rigid;

    fn bone(name: &str, stop: Stop, unsettled_mm: f64) -> BoneFit {
        BoneFit {
            name: name.into(),
            transform: Rigid::identity(),
            visible: 1.0,
            similarity_before: None,
            similarity_after: None,
            stop,
            unsettled_mm,
            position_sd_mm: 0.1,
            rotation_sd_deg: 0.1,
            beyond_range: Default::default(),
            motion_mm: 0.0,
            determined_by: DeterminedBy::Image,
        }
    }

    /// Code and message of what is said of a bone.
    fn told(bone: BoneFit) -> Vec<(String, String)> {
        of_all(vec![bone])
    }

    fn of_all(bones: Vec<BoneFit>) -> Vec<(String, String)> {
        let fit = FitResult {
            transforms: bones.iter().map(|b| b.transform).collect(),
            pose: Default::default(),
            bones,
            common: Rigid::identity(),
            common_share: 1.0,
            open: None,
            warnings: Vec::new(),
        };
        fit_warnings(&fit).into_iter().map(|w| (w.code, w.message)).collect()
    }

    #[test]
    fn a_bone_that_its_image_explains_worse_than_the_others_is_told() {
        let left = |shares: &[f64]| -> Vec<BoneFit> {
            let of = |(n, share): (usize, &f64)| BoneFit {
                similarity_after: Some(1.0 - share),
                ..bone(&format!("vertebrae_C{n}"), Stop::FollowsJoint, 0.0)
            };
            shares.iter().enumerate().map(of).collect()
        };
        // A real neck, whose C4 has pieces of C3 in its label.
        let [(code, message)] = &of_all(left(&[0.016, 0.017, 0.032, 0.013, 0.121, 0.009, 0.046]))[..] else {
            panic!("one")
        };
        assert!(
            code == "bone-unlike" && message.contains("vertebrae_C4 (88 %)") && message.contains("(98 %)"),
            "{message}"
        );
        assert!(!message.contains("  "), "{message}");
        // A clean image, a noisy one, too few bones, a cut one.
        assert!(of_all(left(&[0.003, 0.002, 0.018, 0.003, 0.002, 0.003])).is_empty());
        assert!(of_all(left(&[0.21, 0.25, 0.30, 0.45, 0.22, 0.20])).is_empty());
        assert!(of_all(left(&[0.02, 0.03, 0.2])).is_empty());
        let mut cut = left(&[0.016, 0.017, 0.032, 0.013, 0.121, 0.009, 0.046]);
        cut[4].visible = 0.8;
        assert!(of_all(cut).is_empty());
    }

    #[test]
    fn a_bone_that_should_be_seen_and_is_not_found_is_told() {
        let seen = |visible: f64, determined_by: DeterminedBy| BoneFit {
            visible,
            similarity_after: Some(0.31),
            determined_by,
            ..bone("hyoid", Stop::FollowsJoint, 0.0)
        };
        let [(code, message)] = &told(seen(0.92, DeterminedBy::Joint))[..] else { panic!("one warning") };
        assert!(code == "bone-not-explained" && message.contains("hyoid follows its joint: 92 %"), "{code}: {message}");
        assert!(message.contains("31 % of its contrast is found where the joint holds it"), "{message}");
        assert!(!message.contains("CT") && !message.contains("2.5 mm"), "an MR is no CT: {message}");
        // Out of view it follows its joint, as it must.
        assert_eq!(told(seen(0.2, DeterminedBy::Joint)), []);
        assert_eq!(told(seen(0.92, DeterminedBy::Image)), []);
    }

    #[test]
    fn a_joint_beyond_its_range_is_told_by_turn_and_by_shift() {
        let beyond = |rotation_deg: f64, shift_mm: f64| {
            let mut bone = bone("atlas", Stop::Converged, 0.0);
            (bone.beyond_range.rotation_deg, bone.beyond_range.shift_mm) = (rotation_deg, shift_mm);
            told(bone).into_iter().map(|(code, _)| code).collect::<Vec<_>>()
        };
        assert_eq!(
            [beyond(2.9, 2.9), beyond(3.1, 0.0), beyond(0.0, 3.1)],
            [vec![], vec!["joint-limit".to_owned()], vec!["joint-limit".to_owned()]]
        );
    }

    #[test]
    fn only_bones_that_still_moved_are_named() {
        let limit = || Stop::IterationLimit(50);
        assert_eq!(unsettled(&[bone("skull", limit(), 0.01), bone("hyoid", Stop::Converged, 2.0)]), None);
        let word =
            unsettled(&[bone("skull", limit(), 0.01), bone("hyoid", limit(), 0.3), bone("mandible", limit(), 1.26)]);
        let word = word.unwrap();
        assert!(
            word.is(findings::FIT_ITERATIONS) && word.message.contains("mandible by 1.3 mm, hyoid by 0.3 mm"),
            "{word:?}"
        );
        assert!(!word.message.contains("skull") && word.message.contains("fit.max_iterations"), "{word:?}");
    }
}
