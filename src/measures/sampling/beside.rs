//! Beside a bone: which is nearest and how far, and how far tissue there may leave it.

use crate::geometry::{Grid, Rigid};
use crate::volume::distance::{nearest_label, squared_distance_within};
use crate::volume::{Volume, trilinear};
use nalgebra::{Point3, Vector3};

/// A sample moves tissue and its nearest bone apart by at most this share of the distance between them: beside a bone, where one
/// motion goes over into the other, more folds. Without it 0.02 to 0.45 % of a patient in a cone-beam CT folds, with it 0.0073 %
/// at most (`unfold`), and as many errors lie within the samples.
const APART: f32 = 0.4;
/// Distances below this count as it, mm.
const LEAST_MM: f32 = 4.0;
/// Tissue farther from bone than this moves freely, mm.
pub(super) const REACH_MM: f64 = 25.0;

/// On the planning grid the nearest bone, by its place in `bones` (labels) and 1, 0 where there is none, and the square of the
/// distance to it, mm^2, exact up to `reach` mm.
pub(super) fn nearest_bone(labels: &Volume<u16>, bones: &[u16], reach: f64) -> (Volume<u16>, Volume<f32>) {
    let mut place = vec![0u16; usize::from(u16::MAX) + 1];
    bones.iter().enumerate().for_each(|(n, label)| place[usize::from(*label)] = n as u16 + 1);
    let own = labels.map(|l| place[usize::from(*l)]);
    let square = squared_distance_within(&own.map(|o| *o != 0), true, reach);
    (nearest_label(&own), square)
}

/// For each of the nodes the place of the nearest bone and how far from its motion a sample may take the node, mm.
pub(super) fn limits(labels: &Volume<u16>, bones: &[u16], grid: &Grid, nodes: &[usize]) -> Vec<Option<(u16, f32)>> {
    let (owner, square) = nearest_bone(labels, bones, REACH_MM);
    let far = square.map(|s| s.sqrt());
    let fine = owner.grid();
    let limit = |at: &usize| {
        let index = fine.index_within(&grid.centre(grid.voxel(*at)));
        let bone = owner.at(fine.voxel_near(&index)?).checked_sub(1)?;
        let mm = trilinear(&far, &index)? as f32;
        (f64::from(mm) <= REACH_MM).then_some((bone, APART * mm.max(LEAST_MM)))
    };
    nodes.iter().map(limit).collect()
}

/// What a sample adds where the registration takes a node to `moved`, held to the bone beside it.
pub(super) fn held(beside: Option<(u16, f32)>, moved: &Point3<f64>, bones: &[Rigid], added: [f32; 3]) -> [f32; 3] {
    let Some((motion, limit)) = beside.and_then(|(bone, mm)| Some((bones.get(usize::from(bone))?, mm))) else {
        return added;
    };
    let bone = (motion * moved - moved).map(|c| c as f32);
    let apart = Vector3::from(added) - bone;
    let mm = apart.norm();
    if mm <= limit { added } else { (bone + apart * (limit / mm)).into() }
}

/// Whether the bone's own motion is what counts at such a node.
pub(super) fn touches(beside: Option<(u16, f32)>) -> bool {
    beside.is_some_and(|(_, mm)| mm <= APART * LEAST_MM)
}

#[cfg(test)]
#[expect(clippy::float_cmp, reason = "what is not held stays as it is")]
mod tests {
    use super::*;

    /// Two bones at the ends of a row of nodes 5 mm apart, of which the second moves by 3 mm.
    #[test]
    fn tissue_leaves_the_nearest_bone_by_a_share_of_its_distance_at_most() {
        let grid = Grid::axis_aligned([41, 3, 3], [1.0; 3], [0.0; 3]).unwrap();
        let labels = Volume::from_fn(grid.clone(), |l| match grid.voxel(l)[0] {
            0 => 7,
            40 => 5,
            _ => 0,
        });
        let nodes = Grid::axis_aligned([9, 1, 1], [5.0; 3], [0.0, 1.0, 1.0]).unwrap();
        let all: Vec<usize> = (0..nodes.len()).collect();
        let beside = limits(&labels, &[5, 7], &nodes, &all);
        let motions = [Rigid::translation(3.0, 0.0, 0.0), Rigid::identity()];
        for (n, far) in [0.0f32, 5.0, 10.0, 15.0, 20.0, 15.0, 10.0, 5.0, 0.0].into_iter().enumerate() {
            // In the middle either is nearest.
            let bone = beside[n].unwrap().0;
            assert!(n == 4 || bone == u16::from(n < 4), "{n}: {bone}");
            let own = if bone == 0 { 3.0 } else { 0.0 };
            let limit = 0.4 * far.max(4.0);
            let moved = Point3::new(10.0, 20.0, 30.0);
            let [x, y, z] = held(beside[n], &moved, &motions, [own, 20.0, 0.0]);
            assert!((x - own).abs() < 1e-5 && (y - limit).abs() < 1e-5 && z == 0.0, "{n}: {x} {y} {z}");
            let little = [own, 0.9 * limit, 0.1];
            assert_eq!(held(beside[n], &moved, &motions, little), little);
        }
        let none = limits(&labels, &[9], &nodes, &all);
        assert!(none.iter().all(Option::is_none));
        assert_eq!(held(None, &Point3::origin(), &motions, [9.0; 3]), [9.0; 3]);
    }
}
