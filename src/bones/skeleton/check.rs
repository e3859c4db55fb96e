//! Findings in a label map that are legal but unusual.

use super::anatomy::{Kind, SKULL, level_name};
use super::shape::{Shape, pieces};
use crate::findings;
use crate::volume::LabelMap;
use crate::warning::{Warning, counted};
use nalgebra::{Point3, Vector3};
use std::collections::BTreeMap;

/// A piece matters with this share of its bone ...
const PIECE_SHARE: f64 = 0.05;
/// ... when it lies farther than this from the main part, mm.
const PIECE_GAP: f64 = 10.0;
/// A bone with fewer voxels than this says little about its pose.
const FEW_VOXELS: usize = 50;

/// Warnings: bones in pieces, vertebrae out of order, very small bones.
pub(super) fn warnings(labels: &LabelMap, shapes: &[Shape]) -> Vec<Warning> {
    let mut out = in_pieces(labels, shapes);
    out.extend(out_of_order(shapes));
    let voxel = labels.volume.grid().voxel_volume();
    out.extend(shapes.iter().filter(|s| s.voxels < FEW_VOXELS).map(|s| {
        let volume = s.voxels as f64 * voxel;
        Warning::new(
            findings::SMALL_BONE,
            format!(
                "{} has only {} ({volume:.0} mm^3): its pose will mostly follow its joint.",
                s.name,
                counted(s.voxels, "voxel", "voxels")
            ),
        )
    }));
    out
}

fn in_pieces(labels: &LabelMap, shapes: &[Shape]) -> Vec<Warning> {
    let far: Vec<_> = pieces(labels, shapes, PIECE_SHARE).into_iter().filter(|p| p.gap > PIECE_GAP).collect();
    let of = |s: &Shape| far.iter().filter(|p| p.label == s.label).copied().collect::<Vec<_>>();
    let warn = |s: &Shape| {
        let own = of(s);
        let worst = own.iter().max_by(|a, b| a.gap.total_cmp(&b.gap))?;
        let message = format!(
            "{} is in {} pieces: {:.0} % of it lies {:.0} mm from its main part. It moves as one rigid bone; check \
             label {}.",
            s.name,
            own.len() + 1,
            100.0 * worst.share,
            worst.gap,
            s.label
        );
        Some(Warning::new(findings::BONE_IN_PIECES, message))
    };
    shapes.iter().filter_map(warn).collect()
}

/// Neighbouring levels whose order along the spine does not match their numbers.
fn out_of_order(shapes: &[Shape]) -> Vec<Warning> {
    let mut levels: BTreeMap<u8, Point3<f64>> = BTreeMap::new();
    for s in shapes {
        if let Kind::Spine(level) = s.kind {
            levels.insert(level, s.centroid);
        }
    }
    let list: Vec<(u8, Point3<f64>)> = levels.into_iter().collect();
    let mut out = Vec::new();
    for n in 1..list.len() {
        let ((lower, low), (upper, high)) = (list[n - 1], list[n]);
        // The direction comes from farther levels too, which a swap of two does not turn round.
        let (first, last) = (n.saturating_sub(3), (n + 2).min(list.len() - 1));
        let along = list[last].1 - list[first].1;
        let along = if last - first > 1 { along } else { Vector3::z() };
        if (high - low).dot(&along) <= 0.0 {
            let name = |l: u8| if l == SKULL { "skull".to_owned() } else { level_name(l) };
            out.push(Warning::new(
                findings::SPINE_ORDER,
                format!(
                    "{} lies below {} along the spine, against their numbers: check whether their labels are swapped.",
                    name(upper),
                    name(lower)
                ),
            ));
        }
    }
    out
}
