//! Links across a sliding surface: what they hold of each other's ends as the tissue moves.

use super::super::lattice::Lattice;
use super::super::lattice::slip::Slip;
use super::pull::Pull;
use super::stencil::{ROWS, Stencil};
use super::turn::{Lanes, Turn};

impl Slip {
    /// Weakens the links of node `n` that cross the surface; returns what they hold normal to it.
    pub(super) fn part(&self, lattice: &Lattice, n: usize, stiffness: &mut Stencil<f32>) -> Vec<Crossing> {
        let [sy, sz] = [lattice.grid.strides()[1] as isize, lattice.grid.strides()[2] as isize];
        let mut out = Vec::new();
        for ((r, row), (j, k)) in stiffness.iter_mut().enumerate().zip(ROWS) {
            for (c, stiffness) in row.iter_mut().enumerate() {
                let w = *stiffness;
                let other = (n as isize + j * sy + k * sz + c as isize - 1) as usize;
                if w <= 0.0 || self.inside[n] == self.inside[other] {
                    continue;
                }
                let sum: [f32; 3] = std::array::from_fn(|a| self.normal[n][a] + self.normal[other][a]);
                let length = sum.iter().map(|v| v * v).sum::<f32>().sqrt();
                if length < 1e-3 {
                    continue;
                }
                *stiffness = self.along * w;
                let normal = sum.map(|v| v / length);
                out.push(Crossing { row: r as u8, column: c as u8, held: (1.0 - self.along) * w, normal });
            }
        }
        out
    }
}

/// A link across a sliding surface.
#[derive(Debug, Clone, Copy)]
pub(super) struct Crossing {
    pub(super) row: u8,
    pub(super) column: u8,
    /// Stiffness that acts along the normal alone.
    held: f32,
    normal: [f32; 3],
}

/// An element with links across a sliding surface.
#[derive(Debug, Clone)]
pub(super) struct Sliding {
    pub(super) links: Vec<Crossing>,
    /// What they add to its stiffness, in the order of [`Pull::ENTRIES`].
    pub(super) stiffness: [f32; 6],
}

impl Sliding {
    pub(super) fn new(links: Vec<Crossing>) -> Self {
        let mut stiffness = [0f32; 6];
        for link in &links {
            for (entry, (a, b)) in stiffness.iter_mut().zip(Pull::ENTRIES) {
                *entry += link.held * link.normal[a] * link.normal[b];
            }
        }
        Self { links, stiffness }
    }

    /// What the links draw towards, but for their turned rest vectors: `place` gives each neighbour's displacement.
    #[inline(always)]
    pub(super) fn towards(&self, place: impl Fn(usize, usize) -> Lanes, turned: &[f32]) -> [f32; 3] {
        let mut out = [0f32; 3];
        for (link, turned) in self.links.iter().zip(turned) {
            let q = place(usize::from(link.row), usize::from(link.column));
            let along = link.held * (link.normal[0] * q[0] + link.normal[1] * q[1] + link.normal[2] * q[2] + turned);
            (0..3).for_each(|a| out[a] += along * link.normal[a]);
        }
        out
    }

    /// How far each link's rest vector has turned along its normal, mm.
    pub(super) fn turned(&self, turns: [&[Turn; 3]; 9], own: &Turn, out: &mut [f32]) {
        for (link, out) in self.links.iter().zip(out) {
            let (r, c) = (usize::from(link.row), usize::from(link.column));
            let (j, k) = ROWS[r];
            let offset = [c as f32 - 1.0, j as f32, k as f32];
            let mut moved = [0f32; 3];
            for (axis, by) in offset.into_iter().enumerate() {
                (0..3).for_each(|a| moved[a] += 0.5 * by * (turns[r][c][axis][a] + own[axis][a]));
            }
            *out = -(link.normal[0] * moved[0] + link.normal[1] * moved[1] + link.normal[2] * moved[2]);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::super::lattice::Node;
    use super::super::super::lattice::material::Constraint;
    use super::super::super::variants::Elasticity;
    use super::super::relax::Relaxation;
    use super::super::rest::RestingLinks;
    use super::*;
    use crate::geometry::Grid;
    use nalgebra::Matrix3;

    const SIDE: usize = 18;

    /// Two slabs of soft tissue on each other, the lower on a bone and the upper below another; the upper slides or not.
    fn slabs(along: Option<f64>) -> Lattice {
        let grid = Grid::axis_aligned([SIDE; 3], [2.0; 3], [0.0; 3]).unwrap();
        let node = |n: usize| match grid.voxel(n) {
            at if at.iter().any(|&c| c == 0 || c == SIDE - 1) => Node::Outside,
            [_, _, 1] => Node::Bone(0),
            [_, _, k] if k == SIDE - 2 => Node::Bone(1),
            _ => Node::Soft,
        };
        let soft = Constraint { min: 0.8, max: 1.5, shear: 0.25 };
        let node: Vec<Node> = (0..grid.len()).map(node).collect();
        let share = (0..grid.len()).map(|n| if grid.voxel(n)[2] >= SIDE / 2 { 1.0 } else { 0.0 }).collect();
        let slip = along.and_then(|along| Slip::new(&grid, &node, share, along, true));
        Lattice { slip, ..Lattice::from_nodes(grid.clone(), node, vec![soft; grid.len()]) }
    }

    /// Displacements along x and z of the middle column, from below to above, when the upper bone moves by `by`.
    fn column(along: Option<f64>, by: [f32; 3]) -> Vec<[f32; 2]> {
        let lattice = slabs(along);
        let rest = RestingLinks::new(&lattice, Elasticity::Corotated);
        let start = |n: &Node| if *n == Node::Bone(1) { by } else { [0.0; 3] };
        let start: Vec<[f32; 3]> = lattice.node.iter().map(start).collect();
        let mut relaxation = Relaxation::new(&lattice, &rest, &start, &[Matrix3::identity(); 2], 0.0);
        let everywhere = relaxation.everywhere();
        relaxation.run(150, &everywhere, None);
        let u = relaxation.displacements();
        (1..SIDE - 1).map(|k| u[lattice.grid.linear([SIDE / 2, SIDE / 2, k])]).map(|u| [u[0], u[2]]).collect()
    }

    #[test]
    fn along_the_surface_tissue_slips_and_across_it_it_follows() {
        // The step over the surface, between two elements, as a share of the bone's motion.
        let step = |along, by: [f32; 3], axis: usize| {
            let column = column(along, by);
            let (below, above) = (column[SIDE / 2 - 2][axis], column[SIDE / 2 - 1][axis]);
            (above - below) / by[2 * axis]
        };
        let even = 1.0 / (SIDE - 3) as f32;
        let sidewards = [1.0, 0.0, 0.0];
        let held = step(None, sidewards, 0);
        assert!((held - even).abs() < 0.3 * even, "without a surface the step is even: {held}");
        let slips = step(Some(0.02), sidewards, 0);
        assert!(slips > 0.45, "much of the way is slipped: {slips}");
        // Ever less slips the more a link keeps.
        let less = step(Some(0.2), sidewards, 0);
        assert!(held < less && less < slips, "{held} {less} {slips}");
        // Drawn off or pressed, the surface holds as if it were none.
        for by in [[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]] {
            let (held, slips) = (step(None, by, 1), step(Some(0.02), by, 1));
            assert!((held - slips).abs() < 0.25 * held.abs(), "{held} {slips}");
        }
    }
}
