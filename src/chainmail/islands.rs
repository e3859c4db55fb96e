//! Small pieces of tissue that hang on nothing: vessels and noise in the lung.

use super::lattice::{Lattice, Node};
use crate::geometry::stencil::NEIGHBOURS_26;

/// Islands smaller than this follow what is around them, mm^3: images cannot tell so little tissue from noise, and nothing would hold
/// it back.
const LEAST_MM3: f64 = 1000.0;

/// Sets every soft node that no link joins to a bone, over however many nodes, unless its island is large.
pub(super) fn islands(lattice: &Lattice) -> Vec<bool> {
    let strides = lattice.grid.strides().map(|s| s as isize);
    let beside = NEIGHBOURS_26.map(|by| (0..3).map(|a| by[a] as isize * strides[a]).sum::<isize>());
    let mut met: Vec<bool> = lattice.node.iter().map(|n| *n == Node::Outside).collect();
    // An active node is never on the border, so its neighbours lie in the grid.
    let mut flood = |from: Vec<usize>| {
        let mut piece = from;
        piece.retain(|&n| !std::mem::replace(&mut met[n], true));
        let mut next = 0;
        while let Some(&n) = piece.get(next) {
            next += 1;
            for by in beside {
                let m = n.wrapping_add_signed(by);
                if !std::mem::replace(&mut met[m], true) {
                    piece.push(m);
                }
            }
        }
        piece
    };
    let active = || lattice.active.iter().map(|&n| n as usize);
    flood(active().filter(|&n| matches!(lattice.node[n], Node::Bone(_))).collect());
    let most = LEAST_MM3 / lattice.grid.voxel_volume();
    let mut out = vec![false; lattice.node.len()];
    for n in active() {
        let piece = flood(vec![n]);
        if (piece.len() as f64) < most {
            piece.into_iter().for_each(|n| out[n] = true);
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::chainmail::material::RIGID;
    use crate::geometry::Grid;

    #[test]
    fn small_pieces_without_bone_are_islands() {
        let grid = Grid::axis_aligned([30, 20, 20], [2.0; 3], [0.0; 3]).unwrap();
        let mut node = vec![Node::Outside; grid.len()];
        let mut fill = |low: [usize; 3], high: [usize; 3], kind: Node| {
            for (n, node) in node.iter_mut().enumerate() {
                let at = grid.voxel(n);
                if (0..3).all(|a| (low[a]..=high[a]).contains(&at[a])) {
                    *node = kind;
                }
            }
        };
        fill([1, 1, 1], [3, 3, 3], Node::Soft);
        fill([4, 4, 4], [4, 4, 4], Node::Bone(0));
        fill([10, 2, 2], [11, 3, 3], Node::Soft);
        fill([15, 1, 1], [24, 10, 10], Node::Soft);
        fill([27, 18, 18], [27, 18, 18], Node::Bone(1));
        let active = (0..grid.len() as u32).filter(|&n| node[n as usize] != Node::Outside).collect();
        let lattice = Lattice { constraint: vec![RIGID; grid.len()], active, node, grid: grid.clone() };
        for (n, found) in islands(&lattice).into_iter().enumerate() {
            let at = grid.voxel(n);
            // The first piece touches a bone at its corner; the third has 8 ml.
            let expected = (10..=11).contains(&at[0]) && lattice.node[n] == Node::Soft;
            assert_eq!(found, expected, "{at:?}");
        }
    }
}
