//! Surfaces along which tissue slides, as lung and liver do along the chest wall: a link across one holds what is normal to it,
//! and lets most of the rest slip (docs/decisions/contact.md).

use super::node::Node;
use crate::body::{SLIDING_ORGANS, organs_labelled, slides};
use crate::geometry::Grid;
use crate::volume::{Counted, LabelMap, Mask, Volume, gaussian_ratio};
use nalgebra::Vector3;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// What slides along the wall of chest and belly.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SlipOptions {
    /// Whether lung slides, where it takes part.
    pub lung: bool,
    /// Labels that slide as one with the lung (and alone where there is none); those that a case lacks count for nothing.
    pub organs: Vec<String>,
    /// Share of the stiffness along the surface that links across it keep: 1 for no sliding at all.
    pub along: f64,
    /// The same where no organ is labelled that slides with the lung, if it is more: the lung's lower border is not where the
    /// diaphragm slides, and the field does not jump there.
    pub lung_alone: f64,
}

impl Default for SlipOptions {
    fn default() -> Self {
        let organs = SLIDING_ORGANS.map(str::to_owned).to_vec();
        Self { lung: true, organs, along: 0.003, lung_alone: 0.1 }
    }
}

impl SlipOptions {
    /// Nothing slides.
    pub fn none() -> Self {
        Self { lung: false, organs: Vec::new(), along: 1.0, lung_alone: 1.0 }
    }

    /// Whether the field jumps where tissue slides: organs are labelled, so all of the surface is known.
    pub fn jumps(&self, labels: &LabelMap) -> bool {
        organs_labelled(labels, &self.organs)
    }

    /// Share of the stiffness along the surface that is kept.
    pub fn kept(&self, labels: &LabelMap) -> f64 {
        if self.jumps(labels) { self.along } else { self.along.max(self.lung_alone) }
    }

    /// What slides, on the labels' grid: lung (with the vessels in it) and organs; `None` where nothing does.
    pub fn region(&self, lung: Option<&Mask>, labels: &LabelMap) -> Option<Mask> {
        if self.kept(labels) >= 1.0 {
            return None;
        }
        slides(lung.filter(|_| self.lung), labels, &self.organs)
    }
}

/// A region that slides along its border.
#[derive(Debug, Clone, Copy)]
pub struct SlidingRegion<'a> {
    /// On the planning grid.
    pub region: &'a Mask,
    /// As [`SlipOptions::along`].
    pub along: f64,
    /// As [`SlipOptions::jumps`].
    pub jumps: bool,
}

/// Which side of a sliding surface each element lies on, and the surface's normal near it.
#[derive(Debug, Clone)]
pub struct Slip {
    pub(in crate::chainmail) inside: Vec<bool>,
    /// Unit vectors; zero where the surface is far.
    pub(in crate::chainmail) normal: Vec<[f32; 3]>,
    pub(in crate::chainmail) along: f32,
    /// Whether the field jumps across it.
    pub(in crate::chainmail) jumps: bool,
}

/// Width (sigma) of the average that gives the surface its normal, in elements.
/// At 0.6 nothing changes, at 2.4 a chest errs by 1.823 mm for 1.820.
const SMOOTH: f64 = 1.2;
/// A surface is near where the share changes by so much from an element to the next.
/// Half or twice as much moves no mean error by 0.003 mm.
const NEAR: f64 = 1e-2;

impl Slip {
    /// Of elements with this share of the region each; `None` where it holds none.
    pub(in crate::chainmail) fn new(
        grid: &Grid,
        node: &[Node],
        share: Vec<f32>,
        along: f64,
        jumps: bool,
    ) -> Option<Self> {
        let inside: Vec<bool> = node.iter().zip(&share).map(|(node, s)| *node == Node::Soft && *s > 0.5).collect();
        if !inside.contains(&true) {
            return None;
        }
        // What lies outside the patient says nothing of where the surface runs.
        let known = node.iter().map(|n| if *n == Node::Outside { 0.0 } else { 1.0 }).collect();
        let volume = |data| Volume::new(grid.clone(), data).expect("one value per node");
        let (share, known): (Volume<f32>, Volume<f32>) = (volume(share), volume(known));
        let edge = grid.mean_edge();
        let ratio = |sum: f32, known: f32| if known > 1e-3 { sum / known } else { 0.0 };
        let smooth = gaussian_ratio(&Counted::whole(&share), &Counted::whole(&known), SMOOTH * edge, |_| false, ratio);
        let (size, strides) = (grid.size(), grid.strides());
        let turn = grid.inverse_step().transpose();
        let normal = (0..grid.len()).into_par_iter().map(|n| {
            let at = grid.voxel(n);
            let slope = Vector3::from_fn(|a, _| {
                let beside = |is: bool, m: usize| if is && node[m] != Node::Outside { m } else { n };
                let low = beside(at[a] > 0, n.saturating_sub(strides[a]));
                let high = beside(at[a] + 1 < size[a], (n + strides[a]).min(grid.len() - 1));
                let steps = ((high - low) / strides[a]).max(1) as f64;
                f64::from(smooth.data()[high] - smooth.data()[low]) / steps
            });
            let world = turn * slope;
            let length = world.norm();
            if length * edge > NEAR { (world / length).map(|c| c as f32).into() } else { [0.0; 3] }
        });
        Some(Self { inside, normal: normal.collect(), along: along as f32, jumps })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn where_nothing_lies_inside_nothing_slides() {
        let small = Grid::axis_aligned([3; 3], [2.0; 3], [0.0; 3]).unwrap();
        let (node, outside) = (vec![Node::Soft; small.len()], vec![0.4; small.len()]);
        assert!(Slip::new(&small, &node, outside, 0.1, true).is_none());
        let grid = Grid::axis_aligned([30, 30, 30], [2.0; 3], [0.0; 3]).unwrap();
        let labels = LabelMap {
            volume: Volume::from_fn(grid.clone(), |l| u16::from(grid.voxel(l)[2] < 10)),
            names: [(1, "liver".to_owned())].into(),
        };
        // A lung with a vessel of 8 mm through it.
        let lung = Volume::from_fn(grid.clone(), |l| {
            let [i, j, k] = grid.voxel(l);
            k >= 10 && !(13..17).contains(&i) && j > 0
        });
        let options = SlipOptions::default();
        let region = options.region(Some(&lung), &labels).unwrap();
        assert!(*region.at([15, 15, 15]), "the vessel slides with the lung");
        assert!(*region.at([15, 15, 5]), "so does the liver");
        assert!(options.region(None, &labels).is_some_and(|r| !*r.at([5, 5, 15])));
        let other = LabelMap { names: [(1, "skull".to_owned())].into(), ..labels.clone() };
        // The lung alone slides less, and nothing where nothing is to slide.
        let held = SlipOptions { along: 1.0, ..options.clone() };
        let kept = |options: &SlipOptions| [&labels, &other].map(|l| options.kept(l).to_bits());
        assert_eq!(kept(&options), [options.along, options.lung_alone].map(f64::to_bits));
        assert_eq!(kept(&held), [1f64.to_bits(); 2]);
        assert!(held.region(Some(&lung), &other).is_none());
        assert!(options.region(None, &other).is_none());
        assert!(SlipOptions::none().region(Some(&lung), &labels).is_none());
    }
}
