//! Elastic relaxation of the chain mail: bones are held, every other element settles where its links pull it (Gibson
//! 1997; heterogeneous after Rodriguez). In the corotated kind links turn with the tissue (Sorkine and Alexa 2007).
//! Stiffness of a link is the inverse of its play.

use super::lattice::{Lattice, Node};
use super::pull::Pull;
use nalgebra::{Matrix3, Vector3};
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

/// State of one plane of nodes.
#[derive(Clone, Default)]
struct Plane {
    /// Displacement, mm.
    u: Vec<[f32; 3]>,
    /// Local rotation minus identity, row by row.
    turn: Vec<[f32; 9]>,
}

/// The active soft nodes of one plane with what they need.
struct Work {
    /// Position in the plane of each soft node.
    soft: Vec<u32>,
}

/// A relaxation in progress: displacements and local rotations in planes, even and odd apart, so that planes of one
/// parity can be updated in parallel while they read the other's.
pub struct Relaxation<'a> {
    lattice: &'a Lattice,
    even: Vec<Plane>,
    odd: Vec<Plane>,
    work: Vec<Work>,
    links: Vec<Link>,
    softness: Vec<f32>,
    /// Whether links turn with the tissue.
    turning: bool,
    /// Relative rest length of each node's links; empty where all are 1.
    scale: Vec<f32>,
}

/// One of the 26 links: where it leads and what it is at rest.
#[derive(Clone, Copy)]
struct Link {
    /// Plane offset: -1, 0, 1.
    dk: isize,
    /// Offset in the plane.
    at: isize,
    /// Rest vector, mm.
    rest: [f32; 3],
    /// Geometric weight: 1 / length^2, relative to the shortest link.
    weight: f32,
}

const OUTSIDE: f32 = -1.0;

impl<'a> Relaxation<'a> {
    /// Starts from displacements on the whole lattice; `turns` are the bones' rotations.
    pub fn new(lattice: &'a Lattice, u: &[[f32; 3]], turns: &[Matrix3<f64>], elasticity: Elasticity) -> Self {
        let size = lattice.grid.size();
        let plane = size[0] * size[1];
        let turning = elasticity == Elasticity::Corotated;
        let shortest = lattice.links().iter().map(|l| l.norm()).fold(f64::MAX, f64::min);
        let links = crate::geometry::stencil::NEIGHBOURS_26
            .iter()
            .zip(lattice.links())
            .filter(|(o, _)| turning || o.iter().filter(|&&c| c != 0).count() == 1)
            .map(|(o, rest)| Link {
                dk: o[2] as isize,
                at: o[0] as isize + o[1] as isize * size[0] as isize,
                rest: [rest.x as f32, rest.y as f32, rest.z as f32],
                weight: if turning { ((shortest / rest.norm()).powi(2)) as f32 } else { 1.0 },
            })
            .collect();
        let softness = lattice
            .node
            .iter()
            .zip(&lattice.constraint)
            .map(|(n, c)| match n {
                Node::Outside => OUTSIDE,
                _ if elasticity == Elasticity::Gibson => 1.0,
                Node::Bone(_) => 0.0,
                Node::Soft => c.shear,
            })
            .collect();
        let bone_turn: Vec<[f32; 9]> = turns.iter().map(|r| flat(&(r - Matrix3::identity()))).collect();
        let (mut even, mut odd, mut work) = (Vec::new(), Vec::new(), Vec::new());
        for k in 0..size[2] {
            let range = k * plane..(k + 1) * plane;
            let turn = lattice.node[range.clone()]
                .iter()
                .map(|n| match n {
                    Node::Bone(b) if turning => bone_turn[usize::from(*b)],
                    _ => [0.0; 9],
                })
                .collect();
            let p = Plane { u: u[range.clone()].to_vec(), turn };
            if k % 2 == 0 {
                even.push(p)
            } else {
                odd.push(p)
            }
            let soft = (0..plane as u32).filter(|&n| lattice.node[range.start + n as usize] == Node::Soft).collect();
            work.push(Work { soft });
        }
        Self { lattice, even, odd, work, links, softness, turning, scale: Vec::new() }
    }

    /// Sets the relative rest length of each node's links, where links turn; a link takes the mean of its ends.
    pub fn scale_links(&mut self, scale: Option<Vec<f32>>) {
        self.scale = scale.unwrap_or_default();
    }

    /// `rounds` rounds of local rotations (where links turn) and one sweep over all elements each; returns the last
    /// round's greatest step in mm.
    pub fn run(&mut self, rounds: usize, pull: Option<&Pull>) -> f32 {
        let mut greatest = 0.0;
        for _ in 0..rounds {
            if self.turning {
                self.rotate();
            }
            greatest = self.sweep(0, pull).max(self.sweep(1, pull));
        }
        greatest
    }

    /// Displacements in storage order.
    pub fn displacements(&self) -> Vec<[f32; 3]> {
        (0..self.work.len()).flat_map(|k| self.plane(k).u.iter().copied()).collect()
    }

    /// Local rotation of every node after `rounds` updates; identity outside.
    pub fn rotations(&mut self, rounds: usize) -> Vec<Matrix3<f64>> {
        (0..rounds).for_each(|_| self.rotate());
        let matrix = |t: &[f32; 9]| Matrix3::from_row_slice(t).cast::<f64>() + Matrix3::identity();
        (0..self.work.len()).flat_map(|k| self.plane(k).turn.iter().map(matrix)).collect()
    }

    fn plane(&self, k: usize) -> &Plane {
        if k.is_multiple_of(2) { &self.even[k / 2] } else { &self.odd[k / 2] }
    }

    /// Updates the displacements of all planes of one parity; within a plane in storage order (Gauss-Seidel).
    fn sweep(&mut self, parity: usize, pull: Option<&Pull>) -> f32 {
        let size = self.lattice.grid.size();
        let plane = size[0] * size[1];
        let (own, other) = if parity == 0 { (&mut self.even, &self.odd) } else { (&mut self.odd, &self.even) };
        let (links, work, softness) = (&self.links, &self.work, &self.softness);
        own.par_iter_mut()
            .enumerate()
            .map(|(h, p)| {
                let k = 2 * h + parity;
                let base = k * plane;
                let mut greatest = 0f32;
                for &n in &work[k].soft {
                    let n = n as usize;
                    let mut sum = [0f32; 3];
                    let mut weights = 0f32;
                    let s = softness[base + n];
                    let r = p.turn[n];
                    for l in links {
                        let m = (n as isize + l.at) as usize;
                        let sm = softness[((base + n) as isize + l.dk * plane as isize + l.at) as usize];
                        if sm < 0.0 {
                            continue;
                        }
                        // The plane above or below lies in the other half: k - 1 and k + 1 of 2h + parity.
                        let q = if l.dk == 0 { &*p } else { &other[(k as isize + l.dk) as usize / 2] };
                        let (u, turn) = (q.u[m], q.turn[m]);
                        let w = l.weight / (0.5 * (s + sm)).max(LEAST_PLAY);
                        weights += w;
                        // Rest vector from neighbour to here is -rest; turned by the mean of both rotations.
                        for (a, sum) in sum.iter_mut().enumerate() {
                            let t = (r[3 * a] + turn[3 * a]) * l.rest[0]
                                + (r[3 * a + 1] + turn[3 * a + 1]) * l.rest[1]
                                + (r[3 * a + 2] + turn[3 * a + 2]) * l.rest[2];
                            *sum += w * (u[a] - 0.5 * t);
                        }
                    }
                    if weights > 0.0 {
                        let settled = match pull {
                            Some(pull) => pull.settle(base + n, weights, sum),
                            None => sum.map(|s| s / weights),
                        };
                        for (u, new) in p.u[n].iter_mut().zip(settled) {
                            greatest = greatest.max((new - *u).abs());
                            *u = new;
                        }
                    }
                }
                greatest
            })
            .reduce(|| 0.0, f32::max)
    }

    /// Fits the local rotation of every soft element to its links.
    fn rotate(&mut self) {
        let size = self.lattice.grid.size();
        let plane = size[0] * size[1];
        let this = &*self;
        let turns: Vec<Vec<[f32; 9]>> = (0..size[2])
            .into_par_iter()
            .map(|k| {
                let base = k * plane;
                let own = this.plane(k);
                this.work[k]
                    .soft
                    .iter()
                    .map(|&n| {
                        let n = n as usize;
                        let s = this.softness[base + n];
                        let u = own.u[n];
                        let mut m = [0f32; 9];
                        for l in &this.links {
                            let at = (n as isize + l.at) as usize;
                            let sm = this.softness[((base + n) as isize + l.dk * plane as isize + l.at) as usize];
                            if sm < 0.0 {
                                continue;
                            }
                            let q = this.plane((k as isize + l.dk) as usize).u[at];
                            let w = l.weight / (0.5 * (s + sm)).max(LEAST_PLAY);
                            for a in 0..3 {
                                let moved = w * (l.rest[a] + q[a] - u[a]);
                                for b in 0..3 {
                                    m[3 * a + b] += moved * l.rest[b];
                                }
                            }
                        }
                        match this.scale.get(base + n) {
                            None => nearest_rotation(&m, &own.turn[n]),
                            Some(&s) => scaled(&nearest_rotation(&m, &unscaled(&own.turn[n])), s),
                        }
                    })
                    .collect()
            })
            .collect();
        for (k, list) in turns.into_iter().enumerate() {
            let p = if k.is_multiple_of(2) { &mut self.even[k / 2] } else { &mut self.odd[k / 2] };
            for (&n, t) in self.work[k].soft.iter().zip(list) {
                p.turn[n as usize] = t;
            }
        }
    }
}

/// `s R - I` from `R - I`.
fn scaled(turn: &[f32; 9], s: f32) -> [f32; 9] {
    std::array::from_fn(|i| s * turn[i] + if i % 4 == 0 { s - 1.0 } else { 0.0 })
}

/// `R - I` from `s R - I`.
fn unscaled(turn: &[f32; 9]) -> [f32; 9] {
    let m = Matrix3::from_row_slice(turn) + Matrix3::identity();
    scaled(turn, m.determinant().cbrt().recip())
}

fn flat(m: &Matrix3<f64>) -> [f32; 9] {
    std::array::from_fn(|i| m[(i / 3, i % 3)] as f32)
}

/// Rotation (minus identity) nearest to `m`, started from the last one (Mueller et al. 2016, "A robust method to extract
/// the rotational part of deformations").
fn nearest_rotation(m: &[f32; 9], last: &[f32; 9]) -> [f32; 9] {
    let a = Matrix3::from_row_slice(m).cast::<f64>();
    let mut r = Matrix3::from_row_slice(last).cast::<f64>() + Matrix3::identity();
    for _ in 0..3 {
        let (mut torque, mut grip) = (Vector3::zeros(), 1e-9);
        for c in 0..3 {
            let (rc, ac) = (r.column(c), a.column(c));
            torque += rc.cross(&ac);
            grip += rc.dot(&ac);
        }
        let omega = torque / f64::abs(grip);
        let angle = omega.norm();
        if angle < 1e-7 {
            break;
        }
        r = nalgebra::Rotation3::from_axis_angle(&nalgebra::Unit::new_unchecked(omega / angle), angle.min(1.0))
            .matrix()
            * r;
    }
    flat(&(r - Matrix3::identity()))
}
