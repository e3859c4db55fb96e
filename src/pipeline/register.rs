//! The registration: one call per stage.

use super::carry::{carry_out, images};
use super::uncertainty;
use super::{Case, Outcome};
use crate::body;
use crate::chainmail::{Organs, organ_label};
use crate::config::Config;
use crate::error::{Error, Result};
use crate::fit::{FitResult, LandmarkUse, fit_pose, from_landmarks, given};
use crate::runtime::Runtime;
use crate::skeleton::{self, Skeleton};
use crate::volume::{Mask, Volume};
use crate::warning::Warning;

/// Registers a case.
///
/// # Errors
/// [`Error::Input`] when the inputs do not fit each other, [`Error::Registration`] when the images share no anatomy.
pub fn register(case: &Case, config: &Config, runtime: &Runtime) -> Result<Outcome> {
    check_labels(case)?;
    check_image("planning CT", &case.planning)?;
    check_image("fraction CT", &case.fraction)?;
    let (mut warnings, skeleton, body) = prepare(case, config, runtime)?;
    let placed = match case.bone_landmarks.as_slice() {
        [] => None,
        landmarks => Some(from_landmarks(&skeleton, landmarks)?),
    };
    let fit = runtime.stage("fit skeleton", || match &placed {
        Some(known) if config.fit.bone_landmarks == LandmarkUse::Replace => given(&skeleton, known),
        start => fit_pose(
            &skeleton,
            &case.planning,
            &case.bones,
            &case.fraction,
            start.as_deref(),
            &config.fit,
            runtime.progress(),
        ),
    })?;
    warnings.extend(fit.warnings.iter().cloned());
    warnings.extend(fit_warnings(&fit));
    let images = images(case, &body, config, runtime)?;
    let mut outcome =
        carry_out(case, case.fraction.grid(), (skeleton, body, fit), images.as_ref(), warnings, config, runtime)?;
    if config.output.uncertainty {
        let map = runtime.stage("uncertainty", || uncertainty::of(case, &outcome, images.is_some(), config))?;
        outcome.uncertainty = Some(map);
        outcome.stages = runtime.times();
    }
    Ok(outcome)
}

/// What every way to move the bones begins with: the skeleton and the patient.
pub(super) fn prepare(case: &Case, config: &Config, runtime: &Runtime) -> Result<(Vec<Warning>, Skeleton, Mask)> {
    let mut warnings = case.warnings.clone();
    let (skeleton, built) = runtime.stage("build skeleton", || skeleton_of(case, config))?;
    // Wrong names are found before the long work begins.
    let is_bone = |l: u16| skeleton.bones.iter().any(|b| b.label == l);
    Organs::new(&config.chainmail.organs, &case.bones, is_bone)?;
    for change in &config.chainmail.volume_change {
        organ_label("chainmail.volume_change", &change.organ, &case.bones, is_bone)?;
    }
    warnings.extend(built);
    let body = runtime.stage("find the patient", || body::find(&case.planning, Some(&case.bones), &config.body))?;
    Ok((warnings, skeleton, body))
}

/// The labels lie on the planning grid.
pub(super) fn check_labels(case: &Case) -> Result<()> {
    let (ct, bones) = (case.planning.grid(), case.bones.volume.grid());
    let tolerance = 0.1 * ct.spacing().into_iter().fold(f64::MAX, f64::min);
    if !ct.matches(bones, tolerance) {
        return Err(Error::input(
            "bone labels",
            format!(
                "their grid (size {:?}, spacing {:?} mm, origin {:.2?} mm) is not that of the planning CT (size {:?}, spacing {:?} mm, origin {:.2?} mm)",
                bones.size(),
                bones.spacing(),
                bones.origin().coords.as_slice(),
                ct.size(),
                ct.spacing(),
                ct.origin().coords.as_slice()
            ),
            "give the labels of this planning CT, or resample them onto its grid with nearest-neighbour interpolation",
        ));
    }
    Ok(())
}

/// An image that can show a patient.
pub(super) fn check_image(what: &str, image: &Volume<f32>) -> Result<()> {
    if image.grid().size().iter().any(|&n| n < 4) {
        return Err(Error::input(
            what,
            format!("its size is {:?} voxels", image.grid().size()),
            "a volume of at least 4 voxels along every axis is needed",
        ));
    }
    let first = image.data()[0];
    if image.data().iter().all(|v| v.to_bits() == first.to_bits()) {
        return Err(Error::input(what, format!("every voxel is {first}"), "give a CT that shows the patient, in HU"));
    }
    Ok(())
}

/// The user's skeleton, or the one that the labels give.
fn skeleton_of(case: &Case, config: &Config) -> Result<(Skeleton, Vec<Warning>)> {
    let built = skeleton::build(&case.bones)?;
    let mut warnings = built.warnings;
    let ignored: Vec<&str> =
        built.ignored.iter().map(String::as_str).filter(|n| !config.chainmail.names_organ(n)).collect();
    if !ignored.is_empty() {
        let list = ignored.join(", ");
        warnings.push(Warning::new(
            "labels-ignored",
            format!("{} labels are no bones of the skeleton and were ignored: {list}", ignored.len()),
        ));
    }
    Ok((case.skeleton.clone().unwrap_or(built.skeleton), warnings))
}

/// Bones that the user should look at.
pub(super) fn fit_warnings(fit: &FitResult) -> Vec<Warning> {
    let mut out = Vec::new();
    for bone in &fit.bones {
        if bone.determined_by == "joint" && bone.visible > 0.3 {
            out.push(Warning::new("bone-not-explained", format!("{}: {:.0} % of it should be visible in the fraction CT but its contrast is not found there; it follows its joint", bone.name, 100.0 * bone.visible)));
        }
        if bone.limit_excess > 3.0 {
            out.push(Warning::new("joint-limit", format!("{}: its joint is {:.1} (degrees or mm) beyond its soft range; check the label and the fusion images", bone.name, bone.limit_excess)));
        }
        if bone.stop.starts_with("iteration limit") {
            out.push(Warning::new("fit-iterations", format!("{}: the fit stopped at its {}", bone.name, bone.stop)));
        }
    }
    // One warning of a kind for all bones reads better than one per bone.
    let same: Vec<_> = out.iter().filter(|w| w.code == "fit-iterations").cloned().collect();
    if same.len() > 1 {
        out.retain(|w| w.code != "fit-iterations");
        out.push(Warning::new(
            "fit-iterations",
            format!("the fit of {} bones stopped at its iteration limit", same.len()),
        ));
    }
    out
}
