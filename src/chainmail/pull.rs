//! What pulls elements besides their links: a quadratic energy per element, as images give it.

use super::lattice::Lattice;

/// Energy `1/2 u.A u - b.u` of each soft element's displacement `u`, in storage order.
#[derive(Debug, Clone)]
pub struct Pull {
    /// `A`: xx, xy, xz, yy, yz, zz; positive semidefinite, zero where nothing pulls.
    pub stiffness: Vec<[f32; 6]>,
    /// `b`.
    pub towards: Vec<[f32; 3]>,
}

impl Pull {
    /// Lets go of the nodes that are set.
    pub(super) fn release(&mut self, lattice: &Lattice, nodes: &[bool]) {
        for (s, n) in lattice.soft().enumerate() {
            if nodes[n as usize] {
                self.stiffness[s] = [0.0; 6];
                self.towards[s] = [0.0; 3];
            }
        }
    }

    /// Where soft element `s` comes to rest whose links have the total stiffness `weights` and would hold it at
    /// `sum / weights`.
    pub(super) fn settle(&self, s: usize, weights: f32, sum: [f32; 3]) -> [f32; 3] {
        let [xx, xy, xz, yy, yz, zz] = self.stiffness[s];
        if xx + yy + zz <= 0.0 {
            return sum.map(|s| s / weights);
        }
        let t = self.towards[s];
        let b = [sum[0] + t[0], sum[1] + t[1], sum[2] + t[2]];
        let (a, d, f) = (xx + weights, yy + weights, zz + weights);
        // The inverse of a symmetric 3x3 by its adjugate.
        let (c0, c1, c2) = (d * f - yz * yz, xz * yz - xy * f, xy * yz - xz * d);
        let determinant = a * c0 + xy * c1 + xz * c2;
        let (c3, c4, c5) = (a * f - xz * xz, xy * xz - a * yz, a * d - xy * xy);
        [
            (c0 * b[0] + c1 * b[1] + c2 * b[2]) / determinant,
            (c1 * b[0] + c3 * b[1] + c4 * b[2]) / determinant,
            (c2 * b[0] + c4 * b[1] + c5 * b[2]) / determinant,
        ]
    }
}

/// Gives the pull at displacements of a lattice's nodes (storage order, mm).
pub type Comparison<'a> = Box<dyn Fn(&[[f32; 3]]) -> Pull + 'a>;

/// Images that pull elements towards places that look alike.
pub trait ImagePull: Sync {
    /// Prepares for a lattice.
    fn at<'a>(&'a self, lattice: &'a Lattice) -> Comparison<'a>;

    /// How often the images are compared anew at each spacing, and rounds of relaxation after each.
    fn passes(&self) -> (usize, usize);
}
