//! Small pieces of tissue that hang on nothing: vessels and noise in the lung.

use super::elements::Lattice;
use super::node::Node;
use crate::volume::components::{Components, Connectivity};
use crate::volume::{Mask, Volume};

/// Islands smaller than this follow what is around them, mm^3: images cannot tell so little tissue from noise, and nothing would hold
/// it back.
const LEAST_MM3: f64 = 1000.0;

/// Sets every soft node that no link joins to a bone, over however many nodes, unless its island is large.
pub(in crate::chainmail) fn islands(lattice: &Lattice) -> Mask {
    let mut active = Volume::filled(lattice.grid.clone(), false);
    for &n in &lattice.active {
        active.data_mut()[n as usize] = true;
    }
    let pieces = Components::of(&active, false, Connectivity::Corner);
    let mut held = vec![false; pieces.len()];
    for run in &pieces.runs {
        held[run.component] |= lattice.node[run.start..run.end].iter().any(|n| matches!(n, Node::Bone(_)));
    }
    let most = LEAST_MM3 / lattice.grid.voxel_volume();
    pieces.select(&active, |piece| !held[piece] && (pieces.sizes[piece] as f64) < most)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::chainmail::lattice::material::RIGID;
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
        let lattice = Lattice { slip: None, constraint: vec![RIGID; grid.len()], active, node, grid: grid.clone() };
        for (n, found) in islands(&lattice).data().iter().enumerate() {
            let at = grid.voxel(n);
            // The first piece touches a bone at its corner; the third has 8 ml.
            let expected = (10..=11).contains(&at[0]) && lattice.node[n] == Node::Soft;
            assert_eq!(*found, expected, "{at:?}");
        }
    }
}
