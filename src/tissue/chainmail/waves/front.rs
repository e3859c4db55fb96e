//! The rules of a front: which links it runs along, how long it takes, and which element is processed next.

use super::super::lattice::{Lattice, Node};
use super::super::variants::{Front, LinkTime, Variant};
use crate::geometry::stencil::{NEIGHBOURS_6, NEIGHBOURS_26};
use nalgebra::Vector3;

/// Time that a node was not reached.
pub const NEVER: u32 = u32::MAX;
/// Ticks per mm of link at relative shear 1; the resolution of times.
pub const TICKS: f64 = 32.0;
/// Least relative shear in time: rigid material without a label is slow, not impassable.
const LEAST_SHEAR: f32 = 0.02;
/// 2^23: above it single precision holds integers only.
const TWO_POW_23: f32 = 8_388_608.0;
/// The bits of that, and so what [`FrontRules::ticks_above_zero`] counts from.
pub(in crate::chainmail) const TICKS_ZERO: i32 = TWO_POW_23.to_bits() as i32;
/// No link takes longer, ticks: reached at spacings beyond a metre.
pub(in crate::chainmail) const MOST_TICKS: f32 = 8e6;

/// Times beyond this do not count, whatever the cut-off: sums stay far from overflow.
const MOST: f64 = (1 << 30) as f64;

/// Where a wave starts.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Source {
    /// One bone of the skeleton.
    Bone(u16),
    /// All bones at once: each element follows the one that reaches it first.
    AnyBone,
}

impl Source {
    /// The bone of a node from which the wave starts; `None` in others.
    pub fn holds(self, node: Node) -> Option<u16> {
        match (self, node) {
            (Self::Bone(b), Node::Bone(n)) if b == n => Some(b),
            (Self::AnyBone, Node::Bone(n)) => Some(n),
            _ => None,
        }
    }
}

/// One of the links of every element.
#[derive(Debug, Clone, Copy)]
pub struct Hop {
    /// Distance in storage.
    pub offset: isize,
    /// Index step.
    pub step: [i32; 3],
    /// Length, mm.
    pub mm: f64,
}

/// A front's rules.
#[derive(Debug, Clone, Copy)]
pub struct FrontRules {
    /// Time along a link.
    pub time: LinkTime,
    /// Links.
    pub front: Front,
    /// Times beyond this are not computed, mm at relative shear 1.
    pub cutoff: f64,
}

impl FrontRules {
    /// The rules that the variant describes.
    pub fn of(variant: &Variant) -> Self {
        Self { time: variant.link_time, front: variant.front, cutoff: variant.cutoff }
    }

    /// What the time along a link of `length` mm has from its length, so that [`FrontRules::ticks`] is one operation.
    pub fn factor(&self, length: f64) -> f32 {
        let factor = match self.time {
            LinkTime::SlowInStiff => 2.0 * TICKS * length,
            LinkTime::FastInStiff => 0.5 * TICKS * length,
            LinkTime::Literal => 2.0 * TICKS / length,
        };
        factor as f32
    }

    /// Ticks along a link of this factor between two nodes whose relative shears add up to `shears`.
    pub fn ticks(&self, factor: f32, shears: f32) -> u32 {
        let above = match self.time {
            LinkTime::FastInStiff => Self::ticks_above_zero::<true>(factor, shears, MOST_TICKS),
            LinkTime::SlowInStiff | LinkTime::Literal => Self::ticks_above_zero::<false>(factor, shears, MOST_TICKS),
        };
        (above - TICKS_ZERO) as u32
    }

    /// As [`FrontRules::ticks`], `most` at most, and [`TICKS_ZERO`] more; `FAST`: shear multiplies,
    /// [`LinkTime::FastInStiff`], otherwise it divides.
    #[inline(always)]
    pub fn ticks_above_zero<const FAST: bool>(factor: f32, shears: f32, most: f32) -> i32 {
        let s = shears.max(2.0 * LEAST_SHEAR);
        let t = if FAST { factor * s } else { factor / s };
        // Added to 2^23, a number's nearest integer stands in the low bits: without the cost of a call to round it.
        (t.max(1.0).min(most) + TWO_POW_23).to_bits() as i32
    }

    /// Index steps of the links.
    pub fn steps(&self) -> &'static [[i32; 3]] {
        match self.front {
            Front::Round => &NEIGHBOURS_26,
            Front::Rhombus => &NEIGHBOURS_6,
        }
    }

    /// Storage offsets, index steps and lengths in mm of the links.
    pub fn links(&self, lattice: &Lattice) -> Vec<Hop> {
        let [sx, sy, sz] = lattice.grid.strides().map(|s| s as isize);
        self.steps()
            .iter()
            .map(|o| {
                let mm = (lattice.grid.step() * Vector3::from(o.map(f64::from))).norm();
                Hop { offset: o[0] as isize * sx + o[1] as isize * sy + o[2] as isize * sz, step: *o, mm }
            })
            .collect()
    }

    /// The least and the most ticks that links can take between nodes of relative shear up to this.
    pub fn ticks_of(&self, hops: &[Hop], greatest_shear: f32) -> [u32; 2] {
        let ends = |hop: &Hop| [0.0, 2.0 * greatest_shear].map(|shears| self.ticks(self.factor(hop.mm), shears));
        let ticks = || hops.iter().flat_map(ends);
        [ticks().min(), ticks().max()].map(|t| t.unwrap_or(1))
    }

    /// The latest time that counts, ticks.
    pub fn limit(&self) -> u32 {
        (self.cutoff * TICKS).min(MOST) as u32
    }

    /// Ticks from one node to a neighbour.
    pub fn between(&self, lattice: &Lattice, from: usize, to: usize, length: f64) -> u32 {
        self.ticks(self.factor(length), lattice.constraint[from].shear + lattice.constraint[to].shear)
    }
}
