//! Elastic relaxation of the chain mail: bones are held, every other element settles where its links pull it (Gibson
//! 1997; heterogeneous after Rodriguez). In the corotated kind links turn with the tissue (Sorkine and Alexa 2007).
//! Stiffness of a link is the inverse of its play.

use super::lattice::{Lattice, Node};
use super::pull::Pull;
use super::turn::{Lanes, Turn, add_scaled, nearest_rotation, strained};
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

/// Least play of a link, relative to its length: rigid material without a label is stiff, not infinitely so.
const LEAST_PLAY: f32 = 0.03;

/// One of the 26 (or 6) links: where it leads and what it is at rest.
#[derive(Clone, Copy)]
struct Link {
    /// Plane offset: -1, 0, 1.
    dk: isize,
    /// Offset in the plane.
    at: isize,
    /// Rest vector, mm.
    rest: Lanes,
    /// Geometric weight: 1 / length^2, relative to the shortest link.
    weight: f32,
}

/// The soft elements of one plane with what their links hold.
struct Plane {
    /// Position in the plane of each.
    soft: Vec<u32>,
    /// Stiffness of each of their links, 0 to what is outside.
    stiffness: Vec<f32>,
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
    /// How the links of every node are turned and sheared at rest, minus identity; empty where links do not turn.
    turn: Vec<Turn>,
    planes: Vec<Plane>,
    links: Vec<Link>,
    /// Share of a change of shape that links give way to.
    yielding: f32,
}

const OUTSIDE: f32 = -1.0;

/// Sweeps over the elements after each fit of their rotations.
const SWEEPS: usize = 2;

impl Relaxation {
    /// Starts from displacements on the whole lattice; `turns` are the bones' rotations. Where links turn, `poisson` is
    /// Poisson's ratio.
    ///
    /// Equal links in all directions have the ratio 1/4: with shear modulus G their bulk modulus is 5/3 G. Links that give
    /// way to the share s of a change of shape have (1 - s) G, hence s = 1 - 5 (1 - 2 nu) / (2 (1 + nu)).
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
        let links = links(lattice, turning);
        let softness = softness(lattice, elasticity);
        let planes = (0..size[2])
            .into_par_iter()
            .map(|k| {
                let base = k * plane;
                let soft: Vec<u32> =
                    (0..plane as u32).filter(|&n| lattice.node[base + n as usize] == Node::Soft).collect();
                let mut stiffness = Vec::with_capacity(soft.len() * links.len());
                let mut turned = Vec::with_capacity(soft.len());
                let mut spread = Vec::with_capacity(soft.len());
                for &n in &soft {
                    let n = base + n as usize;
                    let first = stiffness.len();
                    stiffness.extend(links.iter().map(|l| {
                        let other = softness[(n as isize + l.dk * plane as isize + l.at) as usize];
                        link_stiffness(l, softness[n], other)
                    }));
                    turned.push([0.0, 0.0, 0.0, stiffness[first..].iter().sum()]);
                    spread.push(inverse_spread(&links, &stiffness[first..]));
                }
                let rotation = vec![Turn::default(); soft.len()];
                Plane { soft, stiffness, turned, rotation, spread, before: 0 }
            })
            .collect::<Vec<_>>();
        let mut parity = [Vec::new(), Vec::new()];
        for k in 0..size[2] {
            parity[k % 2].extend(u[k * plane..(k + 1) * plane].iter().map(|u| [u[0], u[1], u[2], 0.0]));
        }
        let turn = if turning { bone_turns(lattice, turns) } else { Vec::new() };
        let yielding = (1.0 - 2.5 * (1.0 - 2.0 * poisson) / (1.0 + poisson)) as f32;
        let mut out = Self { u: Halves { parity, plane }, turn, planes, links, yielding };
        let mut before = 0;
        for p in &mut out.planes {
            p.before = before;
            before += p.soft.len();
        }
        out
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
                let stiffness = &p.stiffness[s * links.len()..][..links.len()];
                let [x, y, z, total] = p.turned[s];
                let mut sum = [x, y, z, 0.0];
                for (l, &w) in links.iter().zip(stiffness) {
                    let m = (n as isize + l.at) as usize;
                    let q = match l.dk {
                        -1 => below[m],
                        0 => u[m],
                        _ => above[m],
                    };
                    add_scaled(&mut sum, w, &q);
                }
                if total <= 0.0 {
                    continue;
                }
                let sum = [sum[0], sum[1], sum[2]];
                let settled = match pull {
                    Some(pull) => pull.settle(p.before + s, total, sum),
                    None => sum.map(|s| s / total),
                };
                for (u, new) in u[n].iter_mut().zip(settled) {
                    *u = new;
                }
            }
        });
    }

    /// Fits the local rotation and strain of the region's elements to their links.
    fn rotate(&mut self, region: &Region) {
        let (u, links, yielding) = (&self.u, &self.links, self.yielding);
        self.turn.par_chunks_mut(u.plane).zip(&mut self.planes).enumerate().for_each(|(k, (turn, p))| {
            for &s in &region.0[k] {
                let s = s as usize;
                let n = p.soft[s] as usize;
                let own = u.plane(k)[n];
                let mut moment = Turn::default();
                for (l, &w) in links.iter().zip(&p.stiffness[s * links.len()..]) {
                    let q = u.plane((k as isize + l.dk) as usize)[(n as isize + l.at) as usize];
                    add_moment(&mut moment, w, &l.rest, &q, &own);
                }
                p.rotation[s] = nearest_rotation(&moment, &p.rotation[s]);
                turn[n] = strained(&moment, &p.spread[s], &p.rotation[s], yielding);
            }
        });
    }

    /// What the links of the region's elements add to their neighbours' displacements, turned by the mean of both ends'
    /// rotations.
    fn turn_links(&mut self, region: &Region) {
        let (turn, links, plane) = (&self.turn, &self.links, self.u.plane as isize);
        self.planes.par_iter_mut().enumerate().for_each(|(k, p)| {
            for &s in &region.0[k] {
                let s = s as usize;
                let n = k as isize * plane + p.soft[s] as isize;
                let own = &turn[n as usize];
                let mut sum = [0.0; 4];
                for (l, &w) in links.iter().zip(&p.stiffness[s * links.len()..]) {
                    let other = &turn[(n + l.dk * plane + l.at) as usize];
                    // The rest vector leads to the neighbour; from there to here it is the opposite.
                    for (c, rest) in l.rest[..3].iter().enumerate() {
                        let half = -0.5 * w * rest;
                        for (s, (a, b)) in sum.iter_mut().zip(own[c].iter().zip(&other[c])) {
                            *s += half * (a + b);
                        }
                    }
                }
                p.turned[s] = [sum[0], sum[1], sum[2], p.turned[s][3]];
            }
        });
    }
}

/// Inverse of `sum w rest rest^T`; zero where the links leave a direction open.
fn inverse_spread(links: &[Link], stiffness: &[f32]) -> [f32; 6] {
    let mut m = Matrix3::zeros();
    for (l, &w) in links.iter().zip(stiffness) {
        let r = nalgebra::Vector3::new(l.rest[0], l.rest[1], l.rest[2]).cast::<f64>();
        m += r * r.transpose() * f64::from(w);
    }
    let scale = m.trace() / 3.0;
    match m.try_inverse() {
        Some(i) if i.norm() * scale < 30.0 => {
            [i[(0, 0)], i[(0, 1)], i[(0, 2)], i[(1, 1)], i[(1, 2)], i[(2, 2)]].map(|v| v as f32)
        }
        _ => [0.0; 6],
    }
}

/// Local rotation of every node that `displacement` means; identity outside. `turns` are the bones' rotations.
pub fn rotations(lattice: &Lattice, displacement: &[[f32; 3]], turns: &[Matrix3<f64>]) -> Vec<Matrix3<f64>> {
    const ROUNDS: usize = 6;
    let (links, softness) = (links(lattice, true), softness(lattice, Elasticity::Corotated));
    let size = lattice.grid.size();
    let plane = (size[0] * size[1]) as isize;
    let lanes = |n: usize| [displacement[n][0], displacement[n][1], displacement[n][2], 0.0];
    let mut out = bone_turns(lattice, turns);
    out.par_iter_mut().enumerate().filter(|(n, _)| lattice.node[*n] == Node::Soft).for_each(|(n, turn)| {
        let mut moment = Turn::default();
        for l in &links {
            let m = (n as isize + l.dk * plane + l.at) as usize;
            add_moment(&mut moment, link_stiffness(l, softness[n], softness[m]), &l.rest, &lanes(m), &lanes(n));
        }
        (0..ROUNDS).for_each(|_| *turn = nearest_rotation(&moment, turn));
    });
    out.iter().map(|t| Matrix3::from_fn(|a, b| f64::from(t[b][a])) + Matrix3::identity()).collect()
}

/// Adds the moment of one link, `w (rest + q - u) rest^T`.
fn add_moment(moment: &mut Turn, w: f32, rest: &Lanes, q: &Lanes, u: &Lanes) {
    let mut moved = [0.0; 4];
    for (m, ((q, u), r)) in moved.iter_mut().zip(q.iter().zip(u).zip(rest)) {
        *m = w * (r + q - u);
    }
    for (column, &r) in moment.iter_mut().zip(rest) {
        add_scaled(column, r, &moved);
    }
}

/// The links of a lattice: 26 where they turn, else 6.
fn links(lattice: &Lattice, turning: bool) -> Vec<Link> {
    let size = lattice.grid.size();
    let shortest = lattice.links().iter().map(|l| l.norm()).fold(f64::MAX, f64::min);
    crate::geometry::stencil::NEIGHBOURS_26
        .iter()
        .zip(lattice.links())
        .filter(|(o, _)| turning || o.iter().filter(|&&c| c != 0).count() == 1)
        .map(|(o, rest)| Link {
            dk: o[2] as isize,
            at: o[0] as isize + o[1] as isize * size[0] as isize,
            rest: [rest.x as f32, rest.y as f32, rest.z as f32, 0.0],
            weight: if turning { ((shortest / rest.norm()).powi(2)) as f32 } else { 1.0 },
        })
        .collect()
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

/// Stiffness of a link between two nodes of given play.
fn link_stiffness(link: &Link, a: f32, b: f32) -> f32 {
    if b < 0.0 { 0.0 } else { link.weight / (0.5 * (a + b)).max(LEAST_PLAY) }
}

/// The bones' rotations minus identity on their nodes, none elsewhere.
fn bone_turns(lattice: &Lattice, turns: &[Matrix3<f64>]) -> Vec<Turn> {
    let column = |r: &Matrix3<f64>, c: usize| [r[(0, c)] as f32, r[(1, c)] as f32, r[(2, c)] as f32, 0.0];
    let turns: Vec<Turn> =
        turns.iter().map(|r| r - Matrix3::identity()).map(|r| [column(&r, 0), column(&r, 1), column(&r, 2)]).collect();
    let of = |n: &Node| match n {
        Node::Bone(b) => turns[usize::from(*b)],
        _ => Turn::default(),
    };
    lattice.node.iter().map(of).collect()
}
