//! The registration: one call per stage.

use super::{Case, Outcome};
use crate::body;
use crate::chainmail::{self, Initiators, Organs, Propagation, Tissue, check_links, propagate};
use crate::config::Config;
use crate::error::{Error, Result};
use crate::evaluate;
use crate::field::{self, PushField};
use crate::fit::{FitResult, fit_pose};
use crate::runtime::Runtime;
use crate::skeleton::{self, Skeleton};
use crate::volume::{LabelMap, Mask};
use crate::warning::Warning;
use nalgebra::Point3;

/// HU of what lies outside the planning scan when it is shown on the fraction grid.
const OUTSIDE_HU: f32 = -1000.0;

/// Registers a case.
///
/// # Errors
/// [`Error::Input`] when the inputs do not fit each other, [`Error::Registration`] when the images share no anatomy.
pub fn register(case: &Case, config: &Config, runtime: &Runtime) -> Result<Outcome> {
    check(case)?;
    let mut warnings = case.warnings.clone();
    let (skeleton, built) = runtime.stage("build skeleton", || skeleton_of(case, config))?;
    // Wrong names are found before the long work begins.
    Organs::new(&config.chainmail.organs, &case.bones, |l| skeleton.bones.iter().any(|b| b.label == l))?;
    warnings.extend(built);
    let body = runtime.stage("find the patient", || body::find(&case.planning, Some(&case.bones), &config.body))?;
    let fit = runtime.stage("fit skeleton", || {
        fit_pose(&skeleton, &case.planning, &case.bones, &case.fraction, &config.fit, runtime.progress())
    })?;
    warnings.extend(fit.warnings.iter().cloned());
    warnings.extend(fit_warnings(&fit));
    let (propagation, regions) =
        runtime.stage("propagate to soft tissue", || carry(case, &skeleton, &body, &fit, config, runtime))?;
    let turns: Vec<_> = fit.transforms.iter().map(|t| t.rotation.to_rotation_matrix().into_inner()).collect();
    let links = runtime.stage("check links", || check_links(&propagation.lattice, &propagation.displacement, &turns));
    let push = propagation.push;
    let (pull, mut inverse) = runtime.stage("invert", || field::invert(&push, case.fraction.grid(), &config.invert))?;
    let (planning_on_fraction, bones_on_fraction) = runtime.stage("resample", || {
        Ok::<_, Error>((field::warp_image(&pull, &case.planning, OUTSIDE_HU)?, field::warp_labels(&pull, &case.bones)?))
    })?;
    let middle = case.planning.grid().middle();
    let rigid: Vec<(u16, String)> = skeleton.bones.iter().map(|b| (b.label, b.name.clone())).collect();
    let (jacobian, jacobian_report, rigidity, landmarks, multiple) = runtime.stage("evaluate", || {
        let map = field::jacobian(&push);
        let tissue = evaluate::jacobian::tissue(&body, &case.planning);
        let report = evaluate::jacobian::evaluate(&push, &map, &tissue, &case.bones, &rigid);
        let rigidity = evaluate::rigidity::evaluate(&push, &case.bones, &rigid);
        let landmarks = (!case.landmarks.is_empty()).then(|| evaluate::landmark::evaluate(&push, &case.landmarks));
        let multiple = field::multiple_preimages(&push, &map, case.fraction.grid());
        (map, report, rigidity, landmarks, multiple)
    });
    inverse.multiple = multiple.count();
    warnings.extend(field_warnings(&push, &jacobian_report, &inverse));
    Ok(Outcome {
        skeleton,
        pose: fit.pose,
        couch_shift: fit.common * middle - middle,
        bone_fits: fit.bones,
        body,
        push,
        pull,
        planning_on_fraction,
        bones_on_fraction,
        jacobian,
        jacobian_report,
        rigidity,
        links,
        inverse,
        landmarks,
        regions,
        warnings,
        stages: runtime.times(),
    })
}

/// What must hold between the inputs.
fn check(case: &Case) -> Result<()> {
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
    for (what, image) in [("planning CT", &case.planning), ("fraction CT", &case.fraction)] {
        let thin = image.grid().size().iter().any(|&n| n < 4);
        if thin {
            return Err(Error::input(
                what,
                format!("its size is {:?} voxels", image.grid().size()),
                "a volume of at least 4 voxels along every axis is needed",
            ));
        }
        let first = image.data()[0];
        if image.data().iter().all(|v| v.to_bits() == first.to_bits()) {
            return Err(Error::input(
                what,
                format!("every voxel is {first}"),
                "give a CT that shows the patient, in HU",
            ));
        }
    }
    Ok(())
}

/// The user's skeleton, or the one that the labels give.
fn skeleton_of(case: &Case, config: &Config) -> Result<(Skeleton, Vec<Warning>)> {
    let built = skeleton::build(&case.bones)?;
    let mut warnings = built.warnings;
    let ignored: Vec<&str> =
        built.ignored.iter().map(String::as_str).filter(|n| !config.chainmail.organs.contains_key(*n)).collect();
    if !ignored.is_empty() {
        let list = ignored.join(", ");
        warnings.push(Warning::new(
            "labels-ignored",
            format!("{} labels are no bones of the skeleton and were ignored: {list}", ignored.len()),
        ));
    }
    Ok((case.skeleton.clone().unwrap_or(built.skeleton), warnings))
}

/// Carries the fitted motion to every voxel; with it the regions of influence, if they are asked for.
fn carry(
    case: &Case,
    skeleton: &Skeleton,
    body: &Mask,
    fit: &FitResult,
    config: &Config,
    runtime: &Runtime,
) -> Result<(Propagation, Option<LabelMap>)> {
    let mut bone_of_label = vec![None; usize::from(u16::MAX) + 1];
    for (b, bone) in skeleton.bones.iter().enumerate() {
        bone_of_label[usize::from(bone.label)] = Some(b as u16);
    }
    let tissue = Tissue {
        ct: &case.planning,
        body,
        labels: &case.bones,
        bone_of_label: &bone_of_label,
        least_hu: config.chainmail.least_hu,
    };
    let centroids: Vec<Point3<f64>> = skeleton.bones.iter().map(|b| b.centroid).collect();
    let bones = Initiators { transforms: &fit.transforms, centroids: &centroids };
    let propagation = propagate(&tissue, &bones, &config.chainmail, runtime.progress())?;
    let regions = || {
        let owner = chainmail::regions(&tissue, &propagation.lattice, &bones, &config.chainmail)?;
        let label = |o: &u16| usize::from(*o).checked_sub(1).map_or(0, |b| skeleton.bones[b].label);
        let names = skeleton.bones.iter().map(|b| (b.label, b.name.clone())).collect();
        Ok::<_, Error>(LabelMap { volume: owner.map(label), names })
    };
    let regions = config.output.regions.then(regions).transpose()?;
    Ok((propagation, regions))
}

/// Bones that the user should look at.
fn fit_warnings(fit: &FitResult) -> Vec<Warning> {
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

/// Findings about the field.
fn field_warnings(
    push: &PushField,
    jacobian: &evaluate::jacobian::JacobianReport,
    inverse: &field::InverseReport,
) -> Vec<Warning> {
    let mut out = Vec::new();
    if jacobian.body.folded > 0 {
        out.push(Warning::new(
            "folded",
            format!(
                "{} of {} tissue cells outside bone contact are folded; see the Jacobian map",
                jacobian.body.folded, jacobian.body.cells
            ),
        ));
    }
    if jacobian.contact.folded > 0 {
        out.push(Warning::new(
            "bones-meet",
            format!(
                "{} of {} cells between touching bones are folded: rigid bones slide or collide there",
                jacobian.contact.folded, jacobian.contact.cells
            ),
        ));
    }
    if inverse.unconverged_tissue > 0 {
        out.push(Warning::new(
            "inverse",
            format!(
                "{} tissue voxels of the fraction CT have no exact pre-image (largest residual {:.2} mm)",
                inverse.unconverged_tissue, inverse.unconverged_max_mm
            ),
        ));
    }
    if push.computed.count() == 0 {
        out.push(Warning::new("no-tissue", "the planning CT shows no tissue above the least HU inside the patient"));
    }
    out
}
