//! How far a registration may be trusted, place by place.

use super::carry::bone_of_label;
use super::{Case, Outcome};
use crate::chainmail::{self, ChainmailOptions, Initiators, Tissue};
use crate::config::Config;
use crate::error::Result;
use crate::evaluate::jacobian::tissue;
use crate::evaluate::uncertainty::{self, Evidence, UncertaintyReport};
use crate::geometry::Rigid;
use crate::progress::Silent;
use crate::volume::Volume;
use nalgebra::Point3;
use std::collections::BTreeMap;

/// Spacing of the field of the bones alone, mm: it is compared with, not used.
const ALONE_MM: f64 = 8.0;

/// The map of a registration. `images` tells whether they took part in soft tissue.
pub(super) fn of(
    case: &Case,
    outcome: &Outcome,
    images: bool,
    config: &Config,
) -> Result<(Volume<f32>, UncertaintyReport)> {
    let tissue = tissue(&outcome.body, &case.planning);
    let alone = images.then(|| bones_alone(case, outcome, &config.chainmail)).transpose()?;
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
        planning: &case.planning,
        fraction: &case.fraction,
        body: &outcome.body,
        tissue: &tissue,
        bones: &case.bones,
        bone_mm: &bone_mm,
        push: &outcome.push,
        bones_alone: alone.as_ref(),
    })
}

/// What the bones alone would have made of soft tissue, coarsely.
fn bones_alone(case: &Case, outcome: &Outcome, options: &ChainmailOptions) -> Result<Volume<[f32; 3]>> {
    let spacing = options.spacing_mm.max(ALONE_MM);
    let coarse = ChainmailOptions {
        spacing_mm: spacing,
        relaxation: options.relaxation.iter().copied().filter(|r| r.0 >= spacing).collect(),
        ..options.clone()
    };
    let bone_of_label = bone_of_label(&outcome.skeleton);
    let tissue = Tissue {
        ct: &case.planning,
        body: &outcome.body,
        labels: &case.bones,
        bone_of_label: &bone_of_label,
        least_hu: options.least_hu,
    };
    let transforms: Vec<Rigid> = outcome.bone_fits.iter().map(|b| b.transform).collect();
    let centroids: Vec<Point3<f64>> = outcome.skeleton.bones.iter().map(|b| b.centroid).collect();
    let bones = Initiators { transforms: &transforms, centroids: &centroids };
    Ok(chainmail::elements(&tissue, &bones, &coarse, None, &Silent)?.1)
}
