//! How far a registration may be trusted, place by place.

use super::carry::{self, bone_of_label};
use super::{Case, Outcome};
use crate::chainmail::{ChainmailOptions, Initiators, Mail};
use crate::config::Config;
use crate::error::Result;
use crate::evaluate::uncertainty::{self, Evidence, PlanningSide, UncertaintyReport};
use crate::geometry::Rigid;
use crate::progress::Silent;
use crate::skeleton::Skeleton;
use crate::volume::{Mask, Volume};
use nalgebra::Point3;
use std::collections::BTreeMap;

/// Spacing of the field of the bones alone, mm: it is compared with, not used.
const ALONE_MM: f64 = 8.0;

/// Spacing of the field of the bones alone under these options, mm.
pub(super) fn alone_mm(options: &ChainmailOptions) -> f64 {
    options.spacing_mm.max(ALONE_MM)
}

/// What the maps of all registrations of a case need of its planning side.
///
/// # Errors
/// Only for internal inconsistency of grids.
pub(super) fn side(case: &Case, (skeleton, body): (&Skeleton, &Mask)) -> Result<PlanningSide> {
    let bone_of_label = bone_of_label(skeleton);
    PlanningSide::new(&case.planning, body, &case.bones, |l| bone_of_label[usize::from(l)].is_some())
}

/// The map of a registration. `mail` is the chain mail, where images pulled it.
pub(super) fn of(
    case: &Case,
    outcome: &Outcome,
    (side, tissue, mail): (&PlanningSide, &Mask, Option<&Mail>),
    config: &Config,
) -> Result<(Volume<f32>, UncertaintyReport)> {
    let alone = mail.map(|mail| bones_alone(mail, case, outcome, &config.chainmail)).transpose()?;
    let bones = outcome.skeleton.bones.iter().zip(&outcome.bone_fits);
    let bone_mm: BTreeMap<u16, f64> = bones
        .map(|(bone, fit)| {
            // A bone that no image determines is where its joint's soft range lets it be.
            let play = bone.joint.translation_range_mm.iter().map(|m| m * m).sum::<f64>().sqrt();
            let known = fit.position_sd_mm.is_finite() && fit.determined_by != "joint";
            (bone.label, if known { fit.position_sd_mm } else { play })
        })
        .collect();
    uncertainty::map(&Evidence {
        side,
        fraction: &case.fraction,
        body: &outcome.body,
        tissue,
        bones: &case.bones,
        bone_mm: &bone_mm,
        push: &outcome.push,
        bones_alone: alone.as_ref(),
    })
}

/// What the bones alone would have made of soft tissue, coarsely.
fn bones_alone(mail: &Mail, case: &Case, outcome: &Outcome, options: &ChainmailOptions) -> Result<Volume<[f32; 3]>> {
    let spacing = alone_mm(options);
    let coarse = ChainmailOptions {
        spacing_mm: spacing,
        waves_mm: options.spacing_of_waves(),
        relaxation: options.relaxation.iter().copied().filter(|r| r.0 >= spacing).collect(),
        ..options.clone()
    };
    let bone_of_label = bone_of_label(&outcome.skeleton);
    let tissue = carry::tissue(case, &outcome.body, &bone_of_label, options);
    let transforms: Vec<Rigid> = outcome.bone_fits.iter().map(|b| b.transform).collect();
    let centroids: Vec<Point3<f64>> = outcome.skeleton.bones.iter().map(|b| b.centroid).collect();
    let bones = Initiators { transforms: &transforms, centroids: &centroids };
    Ok(mail.elements(&tissue, &bones, &coarse, None, &Silent)?.displacement)
}
