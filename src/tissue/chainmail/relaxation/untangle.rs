//! Elements whose cells are turned inside out or nearly so, to be freed of whatever pulls them.

use super::super::lattice::Lattice;
use super::super::lattice::Node;
use nalgebra::{Matrix3, Vector3};
use rayon::prelude::*;

/// First nodes of the cells whose relative volume at a corner leaves `[least, 1 / least]`, among the cells that begin at
/// `nodes`; only cells with a soft node and none outside count.
///
/// The volumes at the 8 corners are those of the one-sided finite differences (Liu et al., Int. J. Comput. Vis. 2024).
pub fn tangled(lattice: &Lattice, u: &[[f32; 3]], nodes: &[u32], least: f64) -> Vec<u32> {
    let Some(inverse) = lattice.grid.step().try_inverse() else { return Vec::new() };
    let corners = lattice.grid.cell_corners();
    nodes
        .par_iter()
        .copied()
        .filter(|&first| {
            // An active node is never on the border, so its cell lies in the grid.
            let nodes = corners.map(|c| first as usize + c);
            let inside = nodes.iter().all(|&n| lattice.node[n] != Node::Outside);
            let soft = nodes.iter().any(|&n| lattice.node[n] == Node::Soft);
            inside && soft && strained(&nodes, u, &inverse, least)
        })
        .collect()
}

/// First nodes of the cells of which a corner is set.
pub fn cells_of(lattice: &Lattice, nodes: &[bool]) -> Vec<u32> {
    let corners = lattice.grid.cell_corners();
    // As in [`tangled`], these cells lie in the grid.
    lattice.active.iter().copied().filter(|&first| corners.iter().any(|c| nodes[first as usize + c])).collect()
}

/// Sets every node that is at most `links` links away from the cells that begin at `cells`.
pub fn around(lattice: &Lattice, cells: &[u32], links: usize) -> Vec<bool> {
    boxes(lattice, cells, links, links + 1)
}

/// Sets `nodes` and every node that a link joins to them.
pub fn beside(lattice: &Lattice, nodes: &[u32]) -> Vec<bool> {
    boxes(lattice, nodes, 1, 1)
}

/// Sets every node from `before` steps before to `after` steps after one of `nodes` along all axes.
fn boxes(lattice: &Lattice, nodes: &[u32], before: usize, after: usize) -> Vec<bool> {
    let size = lattice.grid.size();
    let mut out = vec![false; lattice.node.len()];
    for &node in nodes {
        let at = lattice.grid.voxel(node as usize);
        let low = at.map(|c| c.saturating_sub(before));
        let high: [usize; 3] = std::array::from_fn(|a| (at[a] + after).min(size[a] - 1));
        for k in low[2]..=high[2] {
            for j in low[1]..=high[1] {
                let row = lattice.grid.linear([low[0], j, k]);
                out[row..=row + high[0] - low[0]].fill(true);
            }
        }
    }
    out
}

/// Whether any of the 8 corner volumes leaves the range.
fn strained(nodes: &[usize; 8], u: &[[f32; 3]], inverse: &Matrix3<f64>, least: f64) -> bool {
    let edge = |a: usize, b: usize| Vector3::from_fn(|c, _| f64::from(u[nodes[b]][c]) - f64::from(u[nodes[a]][c]));
    (0..8).any(|c| {
        let column = |a: usize| {
            let (low, high) = (c & !(1 << a), c | 1 << a);
            edge(low, high)
        };
        // Differences per index step, turned into derivatives by position.
        let slope = Matrix3::from_columns(&[column(0), column(1), column(2)]) * inverse;
        let volume = (Matrix3::identity() + slope).determinant();
        !(least..=1.0 / least).contains(&volume)
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Grid;

    #[test]
    fn only_the_fold_is_found() {
        let grid = Grid::axis_aligned([9, 9, 9], [2.0; 3], [0.0; 3]).unwrap();
        let inside = |n: usize| grid.voxel(n).iter().all(|&c| c > 0 && c < 8);
        let node: Vec<Node> = (0..grid.len()).map(|n| if inside(n) { Node::Soft } else { Node::Outside }).collect();
        let lattice = Lattice {
            slip: None,
            constraint: vec![crate::chainmail::lattice::material::RIGID; grid.len()],
            active: (0..grid.len() as u32).filter(|&n| inside(n as usize)).collect(),
            node,
            grid: grid.clone(),
        };
        let mut u: Vec<[f32; 3]> = (0..grid.len()).map(|n| [0.1 * grid.voxel(n)[1] as f32, 0.0, 0.0]).collect();
        assert_eq!(tangled(&lattice, &u, &lattice.active, 0.3), Vec::<u32>::new());
        u[grid.linear([4, 4, 4])][0] += 2.5;
        let found = tangled(&lattice, &u, &lattice.active, 0.3);
        assert!(found.contains(&(grid.linear([4, 4, 4]) as u32)));
        let near = around(&lattice, &found, 1);
        assert!(near[grid.linear([4, 4, 4])] && near[grid.linear([6, 4, 4])] && !near[grid.linear([7, 4, 4])]);
    }
}
