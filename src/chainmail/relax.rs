//! Elastic relaxation of the chain mail: bones are held, every other element settles where its links pull it (Gibson
//! 1997; heterogeneous after Rodriguez). In the corotated kind links turn with the tissue (Sorkine and Alexa 2007).
//! Stiffness of a link is the inverse of its play.

use super::lattice::{Lattice, Node};
use super::pull::Pull;
use super::stencil::{Links, ROWS, Stencil, columns_of, lean};
use super::turn::{Lanes, Turn, WideTurn, add_scaled, narrow, nearest_rotation, scaled, strained, wide};
use crate::geometry::{LANES, Wide, vectorised};
use nalgebra::Matrix3;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// What pulls the elements in the relaxation.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Elasticity {
    /// 26 links that turn with the tissue, stiffer where their play is less.
    #[default]
    Corotated,
    /// 6 equal links that do not turn: an element moves to the mean of the places where its neighbours want it.
    Gibson,
    /// 6 links that do not turn, stiffer where their play is less.
    Heterogeneous,
}

/// The soft elements of one plane with what their links hold.
struct Plane {
    /// Position in the plane of each.
    soft: Vec<u32>,
    /// Stiffness of each of their links, 0 to what is outside.
    stiffness: Vec<Stencil<f32>>,
    /// Sum of the links' index offsets, by stiffness.
    lean: Vec<[f32; 3]>,
    /// What the turned links add to the neighbours' displacements, and in the last lane the sum of stiffness.
    turned: Vec<Lanes>,
    /// Local rotation minus identity.
    rotation: Vec<Turn>,
    /// Inverse of the links' second moment: xx, xy, xz, yy, yz, zz.
    spread: Vec<[f32; 6]>,
    /// Soft elements in the planes before.
    before: usize,
}

/// The soft elements to relax: for each plane positions in its list.
pub struct Region(Vec<Vec<u32>>);

/// Displacements in planes, even and odd apart, so that planes of one parity can be updated in parallel while they read
/// the other's.
struct Halves {
    parity: [Vec<Lanes>; 2],
    plane: usize,
}

impl Halves {
    fn plane(&self, k: usize) -> &[Lanes] {
        &self.parity[k % 2][k / 2 * self.plane..][..self.plane]
    }
}

/// A relaxation in progress.
pub struct Relaxation {
    u: Halves,
    /// How much the turn and shear of every node's links move their ends per index step, mm; empty where links do not turn.
    turn: Vec<Turn>,
    planes: Vec<Plane>,
    links: Links,
    /// Share of a change of shape that links give way to.
    yielding: f32,
    /// Relative rest length of each node's links; empty where all are 1.
    scale: Vec<f32>,
}

const OUTSIDE: f32 = -1.0;

/// Steps of the local rotations in each round.
const STEPS: usize = 2;
/// An element goes this many times as far as to where its links would let it rest (successive over-relaxation).
const OVER: f32 = 1.7;
/// Sweeps over the elements after each fit of their rotations.
const SWEEPS: usize = 2;

impl Relaxation {
    /// Starts from displacements on the whole lattice; `turns` are the bones' rotations. Where links turn, `poisson` is
    /// Poisson's ratio.
    ///
    /// Links that resist any departure from their turned rest vector have the energy `G tr(E^2)` of a strain `E`: ratio 0,
    /// bulk modulus 2/3 G. Links that give way to the share s of a change of shape have the shear modulus (1 - s) G and the
    /// same bulk modulus, hence s = 3 nu / (1 + nu).
    pub fn new(
        lattice: &Lattice,
        u: &[[f32; 3]],
        turns: &[Matrix3<f64>],
        elasticity: Elasticity,
        poisson: f64,
    ) -> Self {
        let size = lattice.grid.size();
        let plane = size[0] * size[1];
        let turning = elasticity == Elasticity::Corotated;
        let links = Links::new(lattice, turning);
        let softness = softness(lattice, elasticity);
        let planes = (0..size[2])
            .into_par_iter()
            .map(|k| {
                let base = k * plane;
                let soft: Vec<u32> =
                    (0..plane as u32).filter(|&n| lattice.node[base + n as usize] == Node::Soft).collect();
                let stiffness: Vec<_> = soft.iter().map(|&n| links.stiffness(&softness, base + n as usize)).collect();
                let turned = stiffness.iter().map(|w| [0.0, 0.0, 0.0, w.as_flattened().iter().sum()]).collect();
                let spread = stiffness.iter().map(|w| links.inverse_spread(w)).collect();
                let lean = stiffness.iter().map(lean).collect();
                let rotation = vec![Turn::default(); soft.len()];
                Plane { soft, stiffness, lean, turned, rotation, spread, before: 0 }
            })
            .collect::<Vec<_>>();
        let mut parity = [Vec::new(), Vec::new()];
        for k in 0..size[2] {
            parity[k % 2].extend(u[k * plane..(k + 1) * plane].iter().map(|u| [u[0], u[1], u[2], 0.0]));
        }
        let turn = if turning { bone_turns(lattice, turns) } else { Vec::new() };
        let turn = turn.iter().map(|t| links.per_step(t)).collect();
        let yielding = (3.0 * poisson / (1.0 + poisson)) as f32;
        let mut out = Self { u: Halves { parity, plane }, turn, planes, links, yielding, scale: Vec::new() };
        let mut before = 0;
        for p in &mut out.planes {
            p.before = before;
            before += p.soft.len();
        }
        out
    }

    /// Sets the relative rest length of each node's links, where links turn; a link takes the mean of its ends.
    pub fn scale_links(&mut self, scale: Option<Vec<f32>>) {
        self.scale = scale.unwrap_or_default();
    }

    /// All soft elements.
    pub fn everywhere(&self) -> Region {
        Region(self.planes.iter().map(|p| (0..p.soft.len() as u32).collect()).collect())
    }

    /// The soft elements among the nodes that are set.
    pub fn among(&self, nodes: &[bool]) -> Region {
        let plane = self.u.plane;
        let of = |(k, p): (usize, &Plane)| {
            (0..p.soft.len() as u32).filter(|&s| nodes[k * plane + p.soft[s as usize] as usize]).collect()
        };
        Region(self.planes.iter().enumerate().map(of).collect())
    }

    /// `rounds` rounds of local rotations (where links turn) and sweeps over the elements of a region.
    pub fn run(&mut self, rounds: usize, region: &Region, pull: Option<&Pull>) {
        for _ in 0..rounds {
            if !self.turn.is_empty() {
                self.rotate(region);
                self.turn_links(region);
            }
            for _ in 0..SWEEPS {
                self.sweep(0, region, pull);
                self.sweep(1, region, pull);
            }
        }
    }

    /// Displacements in storage order.
    pub fn displacements(&self) -> Vec<[f32; 3]> {
        (0..self.planes.len()).flat_map(|k| self.u.plane(k).iter().map(|u| [u[0], u[1], u[2]])).collect()
    }

    /// Updates the displacements of all planes of one parity; within a plane in storage order (Gauss-Seidel).
    fn sweep(&mut self, parity: usize, region: &Region, pull: Option<&Pull>) {
        let plane = self.u.plane;
        let [even, odd] = &mut self.u.parity;
        let (own, other) = if parity == 0 { (even, &*odd) } else { (odd, &*even) };
        let (links, planes) = (&self.links, &self.planes);
        own.par_chunks_mut(plane).enumerate().for_each(|(h, u)| {
            vectorised(
                #[inline(always)]
                || {
                    let k = 2 * h + parity;
                    let (p, region) = (&planes[k], &region.0[k]);
                    if region.is_empty() {
                        return;
                    }
                    // Soft elements never lie on the border, so both neighbouring planes exist.
                    let beside = |dk: isize| &other[(k as isize + dk) as usize / 2 * plane..][..plane];
                    let (below, above) = (beside(-1), beside(1));
                    for &s in region {
                        let s = s as usize;
                        let n = p.soft[s] as usize;
                        let Some(rows) = links.around([below, &*u, above], n) else { continue };
                        let [x, y, z, total] = p.turned[s];
                        if total <= 0.0 {
                            continue;
                        }
                        // The sums of the columns do not wait for each other; the element just updated comes last.
                        let mut sums = [Lanes::default(); 3];
                        for r in [0, 1, 2, 3, 5, 6, 7, 8, 4] {
                            for c in 0..3 {
                                add_scaled(&mut sums[2 - c], p.stiffness[s][r][2 - c], &rows[r][2 - c]);
                            }
                        }
                        let sum = [(0, x), (1, y), (2, z)].map(|(l, own)| own + sums[1][l] + sums[2][l] + sums[0][l]);
                        let settled = match pull {
                            Some(pull) => pull.settle(p.before + s, total, sum),
                            None => sum.map(|s| s * (1.0 / total)),
                        };
                        for (u, new) in u[n].iter_mut().zip(settled) {
                            *u += OVER * (new - *u);
                        }
                    }
                },
            )
        });
    }

    /// Fits the local rotation and strain of the region's elements to their links.
    fn rotate(&mut self, region: &Region) {
        let (u, links, yielding, scale) = (&self.u, &self.links, self.yielding, &self.scale);
        self.turn.par_chunks_mut(u.plane).zip(&mut self.planes).enumerate().for_each(|(k, (turn, p))| {
            vectorised(
                #[inline(always)]
                || {
                    if region.0[k].is_empty() {
                        return;
                    }
                    let planes = [u.plane(k - 1), u.plane(k), u.plane(k + 1)];
                    for batch in region.0[k].chunks(LANES) {
                        let mut moments = [Turn::default(); LANES];
                        let mut spread = [Wide::default(); 6];
                        for (l, &s) in batch.iter().enumerate() {
                            let n = p.soft[s as usize] as usize;
                            if let Some(rows) = links.around(planes, n) {
                                moments[l] = links.moment(&p.stiffness[s as usize], rows, &planes[1][n]);
                            }
                            spread.iter_mut().zip(p.spread[s as usize]).for_each(|(wide, own)| wide.0[l] = own);
                        }
                        let moments = wide(moments.iter());
                        let last = wide(batch.iter().map(|&s| &p.rotation[s as usize]));
                        let rotations = nearest_rotation(&moments, &last, STEPS);
                        let strained = strained(&moments, &spread, &rotations, yielding);
                        for (l, &s) in batch.iter().enumerate() {
                            let n = p.soft[s as usize] as usize;
                            p.rotation[s as usize] = narrow(&rotations, l);
                            let own = narrow(&strained, l);
                            turn[n] = links.per_step(&match scale.get(k * u.plane + n) {
                                Some(&scale) => scaled(&own, scale),
                                None => own,
                            });
                        }
                    }
                },
            )
        });
    }

    /// What the links of the region's elements add to their neighbours' displacements, turned by the mean of both ends'
    /// rotations.
    fn turn_links(&mut self, region: &Region) {
        let (turns, links, plane) = (&self.turn, &self.links, self.u.plane);
        self.planes.par_iter_mut().enumerate().for_each(|(k, p)| {
            vectorised(
                #[inline(always)]
                || {
                    if region.0[k].is_empty() {
                        return;
                    }
                    let planes = [k - 1, k, k + 1].map(|k| &turns[k * plane..][..plane]);
                    for &s in &region.0[k] {
                        let s = s as usize;
                        let n = p.soft[s] as usize;
                        let Some(rows) = links.around(planes, n) else { continue };
                        // Sums that do not wait for each other. A rest vector is the step times its index offset, whose components are
                        // -1, 0 and 1.
                        let mut sums = [Lanes::default(); 4];
                        for ((w, t), (j, k)) in p.stiffness[s].iter().zip(rows).zip(ROWS) {
                            add_scaled(&mut sums[0], -w[0], &t[0][0]);
                            add_scaled(&mut sums[2], w[2], &t[2][0]);
                            for (c, side) in [(1, j as f32), (2, k as f32)] {
                                if side != 0.0 {
                                    (0..3).for_each(|n| add_scaled(&mut sums[n], side * w[n], &t[n][c]));
                                }
                            }
                        }
                        for (own, lean) in planes[1][n].iter().zip(p.lean[s]) {
                            add_scaled(&mut sums[3], lean, own);
                        }
                        let sum: [f32; 3] = std::array::from_fn(|l| sums[0][l] + sums[1][l] + sums[2][l] + sums[3][l]);
                        // The rest vector leads to the neighbour; from there to here it is the opposite.
                        p.turned[s] = [-0.5 * sum[0], -0.5 * sum[1], -0.5 * sum[2], p.turned[s][3]];
                    }
                },
            )
        });
    }
}

/// Local rotation of every node that `displacement` means; identity outside. `turns` are the bones' rotations.
pub fn rotations(lattice: &Lattice, displacement: &[[f32; 3]], turns: &[Matrix3<f64>]) -> Vec<Matrix3<f64>> {
    const STEPS: usize = 12;
    let (links, softness) = (Links::new(lattice, true), softness(lattice, Elasticity::Corotated));
    let u: Vec<Lanes> = displacement.iter().map(|u| [u[0], u[1], u[2], 0.0]).collect();
    let moment = |&n: &u32| {
        let n = n as usize;
        let k = n / links.plane;
        let planes = [k - 1, k, k + 1].map(|k| &u[k * links.plane..][..links.plane]);
        let rows = links.around(planes, n % links.plane);
        rows.map_or_else(Turn::default, |rows| links.moment(&links.stiffness(&softness, n), rows, &u[n]))
    };
    let soft: Vec<u32> = lattice.soft().collect();
    let of_batch = |batch: &[u32]| {
        let moments: Vec<Turn> = batch.iter().map(moment).collect();
        let found = nearest_rotation(&wide(moments.iter()), &WideTurn::default(), STEPS);
        (0..batch.len()).map(|l| narrow(&found, l)).collect::<Vec<_>>()
    };
    let found: Vec<Vec<Turn>> = soft.par_chunks(LANES).map(of_batch).collect();
    let mut out = bone_turns(lattice, turns);
    soft.iter().zip(found.iter().flatten()).for_each(|(&n, turn)| out[n as usize] = *turn);
    out.iter().map(|t| Matrix3::from_fn(|a, b| f64::from(t[b][a])) + Matrix3::identity()).collect()
}

/// Play of each node's material.
fn softness(lattice: &Lattice, elasticity: Elasticity) -> Vec<f32> {
    let of = |(n, c): (&Node, &super::Constraint)| match n {
        Node::Outside => OUTSIDE,
        _ if elasticity == Elasticity::Gibson => 1.0,
        Node::Bone(_) => 0.0,
        Node::Soft => c.shear,
    };
    lattice.node.iter().zip(&lattice.constraint).map(of).collect()
}

/// The bones' rotations minus identity on their nodes, none elsewhere.
fn bone_turns(lattice: &Lattice, turns: &[Matrix3<f64>]) -> Vec<Turn> {
    let turns: Vec<Turn> = turns.iter().map(|r| columns_of(&(r - Matrix3::identity()))).collect();
    let of = |n: &Node| match n {
        Node::Bone(b) => turns[usize::from(*b)],
        _ => Turn::default(),
    };
    lattice.node.iter().map(of).collect()
}
