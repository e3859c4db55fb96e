//! Elastic relaxation of the chain mail: bones are held, every other element settles where its links pull it (Gibson
//! 1997; heterogeneous after Rodriguez). In the corotated kind links turn with the tissue (Sorkine and Alexa 2007).
//! Stiffness of a link is the inverse of its play.

use super::super::lattice::Lattice;
use super::super::lattice::Node;
use super::super::variants::Elasticity;
use super::pull::{Pull, settle};
use super::rest::{HELD, RestingLinks, RestingPlane, softness};
use super::stencil::{Links, ROWS, columns_of};
use super::turn::{Lanes, Turn, WideTurn, add_scaled, narrow, nearest_rotation, scaled, strained, wide};
use crate::geometry::{LANES, Wide, vectorised};
use nalgebra::Matrix3;
use rayon::prelude::*;

/// What the links of a plane's soft elements hold as they move.
struct Plane {
    /// What the turned links add to the neighbours' displacements, and in the last lane the sum of stiffness.
    turned: Vec<Lanes>,
    /// Local rotation minus identity.
    rotation: Vec<Turn>,
    /// What turning adds along the normals of sliding links, mm, element by element.
    slipping: Vec<Vec<f32>>,
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
pub struct Relaxation<'a> {
    rest: &'a RestingLinks,
    u: Halves,
    /// How much the turn and shear of every node's links move their ends per index step, mm; empty where links do not turn.
    turn: Vec<Turn>,
    planes: Vec<Plane>,
    /// Share of a change of shape that links give way to.
    yielding: f32,
    /// Relative rest length of each node's links; empty where all are 1.
    scale: Vec<f32>,
}

/// Steps of the local rotations in each round, which go on from those of the last.
const STEPS: usize = 2;

/// An element goes this many times as far as to where its links would let it rest (successive over-relaxation).
/// With it 3 rounds after a comparison do what 8 did (0.291 mm before and after on moderate).
const OVER: f32 = 1.7;
/// Sweeps over the elements after each fit of their rotations.
/// Three, with two rounds for three, gave 0.290 for 0.291 mm on moderate and were slower.
const SWEEPS: usize = 2;

impl<'a> Relaxation<'a> {
    /// Starts from displacements on the whole lattice, whose links are `rest`; `turns` are the bones' rotations. Where links
    /// turn, `poisson` is Poisson's ratio.
    ///
    /// Links that resist any departure from their turned rest vector have the energy `G tr(E^2)` of a strain `E`: ratio 0,
    /// bulk modulus 2/3 G. Links that give way to the share s of a change of shape have the shear modulus (1 - s) G and the
    /// same bulk modulus, hence s = 3 nu / (1 + nu).
    pub fn new(
        lattice: &Lattice,
        rest: &'a RestingLinks,
        u: &[[f32; 3]],
        turns: &[Matrix3<f64>],
        poisson: f64,
    ) -> Self {
        let plane = rest.links.plane;
        let mut parity = [Vec::new(), Vec::new()];
        for (k, u) in u.chunks(plane).enumerate() {
            parity[k % 2].extend(u.iter().map(|u| [u[0], u[1], u[2], 0.0]));
        }
        let turn = if rest.turning { bone_turns(lattice, turns) } else { Vec::new() };
        let turn = turn.par_iter().map(|t| rest.links.per_step(t)).collect();
        let of_plane = |p: &RestingPlane| Plane {
            turned: p.total.iter().map(|total| [0.0, 0.0, 0.0, *total]).collect(),
            rotation: vec![Turn::default(); p.soft.len()],
            slipping: p.sliding.iter().map(|s| vec![0.0; s.links.len()]).collect(),
        };
        let planes = rest.planes.par_iter().map(of_plane).collect();
        let yielding = (3.0 * poisson / (1.0 + poisson)) as f32;
        Self { rest, u: Halves { parity, plane }, turn, planes, yielding, scale: Vec::new() }
    }

    /// Sets the relative rest length of each node's links, where links turn; a link takes the mean of its ends.
    pub fn scale_links(&mut self, scale: Option<Vec<f32>>) {
        self.scale = scale.unwrap_or_default();
    }

    /// All soft elements.
    pub fn everywhere(&self) -> Region {
        Region(self.rest.planes.iter().map(|p| (0..p.soft.len() as u32).collect()).collect())
    }

    /// The soft elements among the nodes that are set.
    pub fn among(&self, nodes: &[bool]) -> Region {
        let plane = self.u.plane;
        let of = |(k, p): (usize, &RestingPlane)| {
            (0..p.soft.len() as u32).filter(|&s| nodes[k * plane + p.soft[s as usize] as usize]).collect()
        };
        Region(self.rest.planes.iter().enumerate().map(of).collect())
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
        let mut out = vec![[0.0; 3]; self.planes.len() * self.u.plane];
        out.par_chunks_mut(self.u.plane).enumerate().for_each(|(k, out)| {
            out.iter_mut().zip(self.u.plane(k)).for_each(|(out, u)| *out = [u[0], u[1], u[2]]);
        });
        out
    }

    /// Updates the displacements of all planes of one parity; within a plane in storage order (Gauss-Seidel).
    fn sweep(&mut self, parity: usize, region: &Region, pull: Option<&Pull>) {
        let plane = self.u.plane;
        let [even, odd] = &mut self.u.parity;
        let (own, other) = if parity == 0 { (even, &*odd) } else { (odd, &*even) };
        let (rest, planes) = (self.rest, &self.planes);
        own.par_chunks_mut(plane).enumerate().for_each(|(h, u)| {
            vectorised(
                #[inline(always)]
                || {
                    let k = 2 * h + parity;
                    let (p, own, region) = (&rest.planes[k], &planes[k], &region.0[k]);
                    if region.is_empty() {
                        return;
                    }
                    // Soft elements never lie on the border, so both neighbouring planes exist.
                    let beside = |dk: isize| &other[(k as isize + dk) as usize / 2 * plane..][..plane];
                    let (below, above) = (beside(-1), beside(1));
                    for &s in region {
                        let s = s as usize;
                        let n = p.soft[s] as usize;
                        let Some(rows) = rest.links.around([below, &*u, above], n) else { continue };
                        let [x, y, z, total] = own.turned[s];
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
                        let settled = match (p.slides.get(s), pull) {
                            (Some(&slides), pull) if slides != HELD => {
                                let sliding = &p.sliding[slides as usize];
                                let place = |r: usize, c: usize| rows[r][c];
                                let more = sliding.towards(place, &own.slipping[slides as usize]);
                                let sum = std::array::from_fn(|a| sum[a] + more[a]);
                                let free = settle(total, &sliding.stiffness, sum);
                                match pull {
                                    Some(pull) => pull.settle_from(p.before + s, total, &sliding.stiffness, sum, free),
                                    None => free,
                                }
                            }
                            (_, Some(pull)) => pull.settle(p.before + s, total, sum),
                            (_, None) => sum.map(|s| s * (1.0 / total)),
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
        let (u, rest, yielding, scale) = (&self.u, self.rest, self.yielding, &self.scale);
        let links = &rest.links;
        self.turn.par_chunks_mut(u.plane).zip(&mut self.planes).enumerate().for_each(|(k, (turn, own))| {
            let p = &rest.planes[k];
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
                            spread.iter_mut().zip(p.spread[s as usize]).for_each(|(wide, one)| wide.0[l] = one);
                        }
                        let moments = wide(moments.iter());
                        let last = wide(batch.iter().map(|&s| &own.rotation[s as usize]));
                        let rotations = nearest_rotation(&moments, &last, STEPS);
                        let strained = strained(&moments, &spread, &rotations, yielding);
                        for (l, &s) in batch.iter().enumerate() {
                            let n = p.soft[s as usize] as usize;
                            own.rotation[s as usize] = narrow(&rotations, l);
                            let shape = narrow(&strained, l);
                            turn[n] = links.per_step(&match scale.get(k * u.plane + n) {
                                Some(&scale) => scaled(&shape, scale),
                                None => shape,
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
        let (turns, rest, plane) = (&self.turn, self.rest, self.u.plane);
        self.planes.par_iter_mut().enumerate().for_each(|(k, own)| {
            let p = &rest.planes[k];
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
                        let Some(rows) = rest.links.around(planes, n) else { continue };
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
                        for (turn, lean) in planes[1][n].iter().zip(p.lean[s]) {
                            add_scaled(&mut sums[3], lean, turn);
                        }
                        let sum: [f32; 3] = std::array::from_fn(|l| sums[0][l] + sums[1][l] + sums[2][l] + sums[3][l]);
                        // The rest vector leads to the neighbour; from there to here it is the opposite.
                        own.turned[s] = [-0.5 * sum[0], -0.5 * sum[1], -0.5 * sum[2], p.total[s]];
                        if let Some(&slides) = p.slides.get(s).filter(|s| **s != HELD) {
                            let slides = slides as usize;
                            p.sliding[slides].turned(rows, &planes[1][n], &mut own.slipping[slides]);
                        }
                    }
                },
            )
        });
    }
}

/// Local rotation minus identity of every node that `displacement` means, column by column; 0 outside. `turns` are the bones'
/// rotations.
pub fn rotations(lattice: &Lattice, displacement: &[[f32; 3]], turns: &[Matrix3<f64>]) -> Vec<Turn> {
    /// More than in a round: they begin at no rotation.
    const STEPS: usize = 12;
    let (links, softness) = (Links::new(lattice, true), softness(lattice, Elasticity::Corotated));
    let u: Vec<Lanes> = displacement.iter().map(|u| [u[0], u[1], u[2], 0.0]).collect();
    let moment = |&n: &u32| {
        let n = n as usize;
        let k = n / links.plane;
        let planes = [k - 1, k, k + 1].map(|k| &u[k * links.plane..][..links.plane]);
        let rows = links.around(planes, n % links.plane);
        let mut stiffness = links.stiffness(&softness, n);
        // What slides along an element does not turn it.
        if let Some(slip) = lattice.slip.as_ref().filter(|slip| slip.jumps) {
            slip.part(lattice, n, &mut stiffness);
        }
        rows.map_or_else(Turn::default, |rows| links.moment(&stiffness, rows, &u[n]))
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
    out
}

/// The bones' rotations minus identity on their nodes, none elsewhere.
fn bone_turns(lattice: &Lattice, turns: &[Matrix3<f64>]) -> Vec<Turn> {
    let turns: Vec<Turn> = turns.iter().map(|r| columns_of(&(r - Matrix3::identity()))).collect();
    let of = |n: &Node| match n {
        Node::Bone(b) => turns[usize::from(*b)],
        _ => Turn::default(),
    };
    lattice.node.par_iter().map(of).collect()
}
