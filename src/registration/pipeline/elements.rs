//! What the chain mail of a patient is made from.

use super::PlanningScan;
use crate::chainmail::{ChainmailOptions, SlidingRegion, Tissue};
use crate::config::{Config, SoftTissue};
use crate::skeleton::Skeleton;
use crate::volume::Mask;

/// Spacing of the field of the bones alone, mm: it is compared with, not used.
const ALONE_MM: f64 = 8.0;

/// Spacing of the field of the bones alone under these options, mm.
pub(super) fn alone_mm(options: &ChainmailOptions) -> f64 {
    options.spacing_mm.max(ALONE_MM)
}

/// Whether the images, and with them the patient in the fraction CT, take part in soft tissue.
pub(super) fn images_pull(config: &Config) -> bool {
    config.refine.pulls() && config.soft_tissue == SoftTissue::ChainMail
}

/// Position in the skeleton of each possible label.
pub(super) fn bone_of_label(skeleton: &Skeleton) -> Vec<Option<u16>> {
    let mut out = vec![None; usize::from(u16::MAX) + 1];
    for (b, bone) in skeleton.bones.iter().enumerate() {
        out[usize::from(bone.label)] = Some(b as u16);
    }
    out
}

/// What the chain mail of a patient is made from.
pub(super) fn tissue<'a>(
    planning: &'a PlanningScan,
    body: &'a Mask,
    lung: Option<&'a Mask>,
    sliding: Option<&'a Mask>,
    bone_of_label: &'a [Option<u16>],
    options: &ChainmailOptions,
) -> Tissue<'a> {
    let (along, jumps) = (options.slip.kept(&planning.bones), options.slip.jumps(&planning.bones));
    let sliding = sliding.map(|region| SlidingRegion { region, along, jumps });
    Tissue { ct: &planning.ct, body, labels: &planning.bones, bone_of_label, lung, sliding, least_hu: options.least_hu }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_field_of_the_bones_alone_is_coarse() {
        let at = |spacing_mm: f64| alone_mm(&ChainmailOptions { spacing_mm, ..ChainmailOptions::default() });
        assert!((at(3.0) - 8.0).abs() < 1e-12 && (at(12.0) - 12.0).abs() < 1e-12);
    }
}
