//! Time maps: when a deformation that starts at a bone reaches each element (thesis 5.2.2), by Dial's bucket queue.

use super::lattice::{Lattice, Node};
use crate::geometry::stencil::{NEIGHBOURS_6, NEIGHBOURS_26};
use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

/// How long a front takes along a link.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum LinkTime {
    /// Length / shear: stiff tissue is slow (thesis eq. in 5.2.2, in units of length so that spacing does not matter).
    #[default]
    SlowInStiff,
    /// Length * shear: stiff tissue is fast (the text of thesis 2.4 and Fig. 14).
    FastInStiff,
    /// 1 / (length * shear): eq. in 5.2.2 to the letter, whose constraints are multiplied by the link's length.
    Literal,
}

/// Which links a front runs along.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Front {
    /// 26 links, each by its length: round within a few percent.
    #[default]
    Round,
    /// 6 links: rhombus fronts (thesis Fig. 14, 15).
    Rhombus,
}

/// Time that a node was not reached.
pub const NEVER: u32 = u32::MAX;
/// Ticks per mm of link at relative shear 1; the resolution of times.
pub const TICKS: f64 = 32.0;
/// Least relative shear in time: rigid material without a label is slow, not impassable.
const LEAST_SHEAR: f32 = 0.02;

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
    /// Ticks along a link of `length` mm with relative `shear`.
    fn ticks(&self, length: f64, shear: f32) -> u32 {
        let s = f64::from(shear.max(LEAST_SHEAR));
        let t = match self.time {
            LinkTime::SlowInStiff => length / s,
            LinkTime::FastInStiff => length * s,
            LinkTime::Literal => 1.0 / (length * s),
        };
        (t * TICKS).round().max(1.0) as u32
    }

    /// Index steps of the links.
    pub fn steps(&self) -> &'static [[i32; 3]] {
        match self.front {
            Front::Round => &NEIGHBOURS_26,
            Front::Rhombus => &NEIGHBOURS_6,
        }
    }

    /// Storage offsets and lengths in mm of the links.
    pub fn links(&self, lattice: &Lattice) -> Vec<(isize, f64)> {
        let [sx, sy, sz] = lattice.grid.strides().map(|s| s as isize);
        self.steps()
            .iter()
            .map(|o| {
                let mm = (lattice.grid.step() * Vector3::from(o.map(f64::from))).norm();
                (o[0] as isize * sx + o[1] as isize * sy + o[2] as isize * sz, mm)
            })
            .collect()
    }

    /// Ticks from one node to a neighbour.
    pub fn between(&self, lattice: &Lattice, from: usize, to: usize, length: f64) -> u32 {
        self.ticks(length, lattice.link(from, to).shear)
    }
}

/// When the front of one bone reaches each node.
pub struct TimeMap {
    /// Ticks; 0 inside the bone, [`NEVER`] where the front does not come.
    pub time: Vec<u32>,
    /// Soft nodes in the order in which the front settles them: no node before its parent.
    pub order: Vec<u32>,
}

/// Where a front starts.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Source {
    /// One bone of the skeleton.
    Bone(u16),
    /// All bones at once: the map of first arrival.
    AnyBone,
}

impl Source {
    fn holds(self, node: Node) -> bool {
        match (self, node) {
            (Self::Bone(b), Node::Bone(n)) => b == n,
            (Self::AnyBone, Node::Bone(_)) => true,
            _ => false,
        }
    }
}

/// Time map of one source.
///
/// `bound`: first-arrival times and a ratio; the front does not enter nodes that it would reach later than the ratio
/// times the first arrival.
///
///
/// Other bones are not entered (thesis 5.4.2). Times are the unique least path sums, whatever the order of processing.
pub fn time_map(lattice: &Lattice, source: Source, rules: &FrontRules, bound: Option<(&[u32], f64)>) -> TimeMap {
    let links = rules.links(lattice);
    let longest = links.iter().map(|l| l.1).fold(0.0, f64::max);
    let shortest = links.iter().map(|l| l.1).fold(f64::MAX, f64::min);
    let slowest = [longest, shortest]
        .iter()
        .flat_map(|&l| [rules.ticks(l, LEAST_SHEAR), rules.ticks(l, 10.0)])
        .max()
        .unwrap_or(1);
    let limit = (rules.cutoff * TICKS).min(f64::from(u32::MAX / 2)) as u32;
    let mut time = vec![NEVER; lattice.node.len()];
    let mut buckets: Vec<Vec<u32>> = vec![Vec::new(); slowest as usize + 1];
    let mut settled = vec![false; lattice.node.len()];
    let mut waiting = 0usize;
    for &n in &lattice.active {
        if source.holds(lattice.node[n as usize]) {
            time[n as usize] = 0;
            // Only the surface sends out fronts.
            if links.iter().any(|&(o, _)| !source.holds(lattice.node[(n as isize + o) as usize])) {
                buckets[0].push(n);
                waiting += 1;
            }
        }
    }
    let mut now = 0u32;
    let mut batch = Vec::new();
    let mut order = Vec::new();
    while waiting > 0 && now <= limit {
        let slot = now as usize % buckets.len();
        std::mem::swap(&mut batch, &mut buckets[slot]);
        waiting -= batch.len();
        for &n in &batch {
            let n = n as usize;
            if time[n] != now || settled[n] {
                continue;
            }
            settled[n] = true;
            if now > 0 {
                order.push(n as u32);
            }
            for &(o, mm) in &links {
                let m = (n as isize + o) as usize;
                if lattice.node[m] != Node::Soft || time[m] <= now {
                    continue;
                }
                let t = now + rules.between(lattice, n, m, mm);
                let late = bound.is_some_and(|(first, ratio)| f64::from(t) > ratio * f64::from(first[m]));
                if t < time[m] && t <= limit && !late {
                    time[m] = t;
                    let slot = t as usize % buckets.len();
                    buckets[slot].push(m as u32);
                    waiting += 1;
                }
            }
        }
        batch.clear();
        now += 1;
    }
    TimeMap { time, order }
}
