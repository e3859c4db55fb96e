//! Elements whose cells are turned inside out or nearly so, to be let go by whatever pulls them.

use super::lattice::{Lattice, Node};
use crate::geometry::stencil::NEIGHBOURS_26;
use nalgebra::{Matrix3, Vector3};
use rayon::prelude::*;

/// Whether each node belongs to a cell whose relative volume at a corner leaves `[least, 1 / least]`, or is a neighbour
/// of such a node; only cells with a soft node and none outside count. `None` when no cell does.
///
/// The volumes at the 8 corners are those of the one-sided finite differences (Liu et al., Int. J. Comput. Vis. 2024).
pub fn tangled(lattice: &Lattice, u: &[[f32; 3]], least: f64) -> Option<Vec<bool>> {
    let [nx, ny, nz] = lattice.grid.size();
    let strides = lattice.grid.strides();
    let inverse = lattice.grid.step().try_inverse()?;
    let planes: Vec<Vec<usize>> = (0..nz - 1)
        .into_par_iter()
        .map(|k| {
            let mut out = Vec::new();
            for j in 0..ny - 1 {
                for i in 0..nx - 1 {
                    let first = lattice.grid.linear([i, j, k]);
                    let corner = |c: usize| first + (0..3).map(|a| (c >> a & 1) * strides[a]).sum::<usize>();
                    let nodes: [usize; 8] = std::array::from_fn(corner);
                    let soft = nodes.iter().filter(|&&n| lattice.node[n] == Node::Soft).count();
                    if soft > 0
                        && nodes.iter().all(|&n| lattice.node[n] != Node::Outside)
                        && strained(&nodes, u, &inverse, least)
                    {
                        out.push(first);
                    }
                }
            }
            out
        })
        .collect();
    let cells: Vec<usize> = planes.concat();
    if cells.is_empty() {
        return None;
    }
    let mut out = vec![false; lattice.node.len()];
    let offsets = NEIGHBOURS_26.map(|o| (0..3).map(|a| o[a] as isize * strides[a] as isize).sum::<isize>());
    for first in cells {
        for c in 0..8 {
            let n = first + (0..3).map(|a| (c >> a & 1) * strides[a]).sum::<usize>();
            out[n] = true;
            for o in offsets {
                // Active nodes lie inside the border of outside ones, so every neighbour exists.
                out[(n as isize + o) as usize] = true;
            }
        }
    }
    Some(out)
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
            constraint: vec![crate::chainmail::material::RIGID; grid.len()],
            active: (0..grid.len() as u32).filter(|&n| inside(n as usize)).collect(),
            node,
            grid: grid.clone(),
        };
        let mut u: Vec<[f32; 3]> = (0..grid.len()).map(|n| [0.1 * grid.voxel(n)[1] as f32, 0.0, 0.0]).collect();
        assert_eq!(tangled(&lattice, &u, 0.3), None);
        u[grid.linear([4, 4, 4])][0] += 2.5;
        let found = tangled(&lattice, &u, 0.3).unwrap();
        assert!(found[grid.linear([4, 4, 4])] && found[grid.linear([6, 4, 4])] && !found[grid.linear([7, 4, 4])]);
    }
}
