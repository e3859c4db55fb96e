//! The links of the chain mail at rest: what every relaxation of the same elements begins with, however the bones move.

use super::super::lattice::Lattice;
use super::super::lattice::Node;
use super::super::variants::Elasticity;
use super::crossing::Sliding;
use super::stencil::{Links, Stencil, lean};
use rayon::prelude::*;

/// The links of a lattice's soft elements.
pub struct RestingLinks {
    pub(super) links: Links,
    pub(super) planes: Vec<RestingPlane>,
    /// Whether they turn with the tissue.
    pub(super) turning: bool,
}

/// The soft elements of one plane.
pub(super) struct RestingPlane {
    /// Position in the plane of each.
    pub(super) soft: Vec<u32>,
    /// Stiffness of each of their links, 0 to what is outside.
    pub(super) stiffness: Vec<Stencil<f32>>,
    /// Its sum.
    pub(super) total: Vec<f32>,
    /// Sum of the links' index offsets, by stiffness.
    pub(super) lean: Vec<[f32; 3]>,
    /// Inverse of the links' second moment: xx, xy, xz, yy, yz, zz.
    pub(super) spread: Vec<[f32; 6]>,
    /// Position among `sliding` of each, or `HELD`; empty where none slides.
    pub(super) slides: Vec<u32>,
    /// Those with links across a sliding surface.
    pub(super) sliding: Vec<Sliding>,
    /// Soft elements in the planes before.
    pub(super) before: usize,
}

/// No link of this element slides.
pub(super) const HELD: u32 = u32::MAX;

const OUTSIDE: f32 = -1.0;

impl RestingLinks {
    /// Of all soft elements of a lattice.
    pub fn new(lattice: &Lattice, elasticity: Elasticity) -> Self {
        let turning = elasticity == Elasticity::Corotated;
        let links = Links::new(lattice, turning);
        let softness = softness(lattice, elasticity);
        let of_plane = |(k, nodes): (usize, &[Node])| {
            let soft: Vec<u32> = (0..).zip(nodes).filter(|(_, node)| **node == Node::Soft).map(|(n, _)| n).collect();
            let base = k * links.plane;
            let mut stiffness: Vec<_> = soft.iter().map(|&n| links.stiffness(&softness, base + n as usize)).collect();
            let (mut slides, mut sliding) = (Vec::new(), Vec::new());
            if let (Some(slip), true) = (&lattice.slip, turning) {
                for (&n, stiffness) in soft.iter().zip(&mut stiffness) {
                    let crossing = slip.part(lattice, base + n as usize, stiffness);
                    slides.push(if crossing.is_empty() { HELD } else { sliding.len() as u32 });
                    if !crossing.is_empty() {
                        sliding.push(Sliding::new(crossing));
                    }
                }
            }
            RestingPlane {
                total: stiffness.iter().map(|w| w.as_flattened().iter().sum()).collect(),
                lean: stiffness.iter().map(lean).collect(),
                spread: stiffness.iter().map(|w| links.inverse_spread(w)).collect(),
                slides,
                sliding,
                before: 0,
                soft,
                stiffness,
            }
        };
        let mut planes: Vec<RestingPlane> = lattice.node.par_chunks(links.plane).enumerate().map(of_plane).collect();
        let mut before = 0;
        for p in &mut planes {
            p.before = before;
            before += p.soft.len();
        }
        Self { links, planes, turning }
    }
}

/// Play of each node's material.
pub(super) fn softness(lattice: &Lattice, elasticity: Elasticity) -> Vec<f32> {
    let of = |(n, c): (&Node, &super::super::Constraint)| match n {
        Node::Outside => OUTSIDE,
        _ if elasticity == Elasticity::Gibson => 1.0,
        Node::Bone(_) => 0.0,
        Node::Soft => c.shear,
    };
    lattice.node.iter().zip(&lattice.constraint).map(of).collect()
}
