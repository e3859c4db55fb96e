//! Do the links hold? Each link of the result against its valid region (thesis 2.4, Fig. 7), which turns with the tissue.

use super::lattice::Lattice;
use super::lattice::Node;
use super::relaxation::relax::rotations;
use crate::geometry::stencil::NEIGHBOURS_26;
use nalgebra::{Matrix3, Vector3};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// How many links of the result lie outside their valid region, and by how much.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct LinkReport {
    /// Links between active elements (6-neighbourhood).
    pub links: usize,
    /// Links outside [min, max] along the link or beyond shear across it.
    pub violated: usize,
    /// Violated links in percent.
    pub violated_percent: f64,
    /// Mean excess of the violated links, mm.
    pub mean_excess_mm: f64,
    /// 95th percentile of the excess of the violated links, mm.
    pub p95_excess_mm: f64,
    /// Largest excess, mm.
    pub max_excess_mm: f64,
}

/// Excess below this is rounding, mm.
const ROUNDING_MM: f64 = 1e-3;

/// Excess of a link (mm): `moved` is the link's vector turned back into the rest frame, `axis` its unit rest direction.
fn excess(moved: &Vector3<f64>, axis: usize, directions: &Matrix3<f64>, length: f64, c: super::Constraint) -> f64 {
    let local = directions.transpose() * moved;
    let along = local[axis];
    let mut worst = (f64::from(c.min) * length - along).max(along - f64::from(c.max) * length);
    for other in (0..3).filter(|&o| o != axis) {
        worst = worst.max(local[other].abs() - f64::from(c.shear) * length);
    }
    worst
}

/// Checks every link of the lattice between active elements; two bones have no link, nor what slides along each other.
pub fn check_links(lattice: &Lattice, displacement: &[[f32; 3]], bone_turns: &[Matrix3<f64>]) -> LinkReport {
    let turns = rotations(lattice, displacement, bone_turns);
    let turn = |n: usize| Matrix3::from_fn(|a, b| f64::from(turns[n][b][a])) + Matrix3::identity();
    let size = lattice.grid.size();
    let plane = size[0] * size[1];
    let directions = lattice.grid.direction();
    // The three forward face neighbours: +i, +j, +k.
    let forward: Vec<(usize, isize, Vector3<f64>)> = NEIGHBOURS_26
        .iter()
        .enumerate()
        .filter(|(_, o)| o.iter().sum::<i32>() == 1 && o.iter().filter(|&&c| c != 0).count() == 1)
        .map(|(n, o)| (o.iter().position(|&c| c == 1).unwrap_or(0), lattice.offsets()[n], lattice.links()[n]))
        .collect();
    let at = |n: usize| Vector3::from(displacement[n].map(f64::from));
    let parts: Vec<(usize, Vec<f64>)> = lattice
        .active
        .par_chunks(plane)
        .map(|nodes| {
            let (mut links, mut found) = (0, Vec::new());
            for &n in nodes {
                let n = n as usize;
                for (axis, offset, rest) in &forward {
                    let m = (n as isize + offset) as usize;
                    let apart = matches!((lattice.node[n], lattice.node[m]), (Node::Bone(a), Node::Bone(b)) if a != b);
                    let slides = lattice.slip.as_ref().is_some_and(|s| s.jumps && s.inside[n] != s.inside[m]);
                    if lattice.node[m] == Node::Outside || apart || slides {
                        continue;
                    }
                    links += 1;
                    let back = (turn(n) + turn(m)).transpose() * 0.5;
                    let moved = back * (rest + at(m) - at(n));
                    let e = excess(&moved, *axis, directions, rest.norm(), lattice.link(n, m));
                    if e > ROUNDING_MM {
                        found.push(e);
                    }
                }
            }
            (links, found)
        })
        .collect();
    let links: usize = parts.iter().map(|p| p.0).sum();
    let all: Vec<f64> = parts.into_iter().flat_map(|p| p.1).collect();
    let s = crate::stats::Summary::of(&all);
    LinkReport {
        links,
        violated: s.n,
        violated_percent: 100.0 * s.n as f64 / links.max(1) as f64,
        mean_excess_mm: s.mean,
        p95_excess_mm: s.p95,
        max_excess_mm: s.max,
    }
}

#[cfg(test)]
mod tests {
    use super::super::lattice::{Constraint, Slip};
    use super::*;
    use crate::geometry::Grid;

    const SIDE: usize = 12;

    #[test]
    fn what_slides_has_no_link_that_breaks() {
        let grid = Grid::axis_aligned([SIDE; 3], [2.0; 3], [0.0; 3]).unwrap();
        let above = |n: usize| grid.voxel(n)[2] >= SIDE / 2;
        let outside = |n: usize| grid.voxel(n).iter().any(|c| *c == 0 || *c == SIDE - 1);
        let node: Vec<Node> = (0..grid.len()).map(|n| if outside(n) { Node::Outside } else { Node::Soft }).collect();
        let soft = Constraint { min: 0.8, max: 1.5, shear: 0.25 };
        // The upper half has moved along the lower one.
        let u: Vec<[f32; 3]> = (0..grid.len()).map(|n| [if above(n) { 9.0 } else { 0.0 }, 0.0, 0.0]).collect();
        let [held, slips] = [false, true].map(|slides| {
            let share = (0..grid.len()).map(|n| if above(n) { 1.0 } else { 0.0 }).collect();
            let slip = slides.then(|| Slip::new(&grid, &node, share, 0.003, true)).flatten();
            let lattice = Lattice { slip, ..Lattice::from_nodes(grid.clone(), node.clone(), vec![soft; grid.len()]) };
            check_links(&lattice, &u, &[])
        });
        let layer = (SIDE - 2) * (SIDE - 2);
        assert!(held.violated >= layer && slips.violated == 0, "{held:?} {slips:?}");
        assert_eq!(held.links - slips.links, layer);
    }
}
