//! The chain mail's elements: a padded grid over the planning CT with the material of each node.

use super::material::{Constraint, Material, Organs, RIGID};
use super::node::Node;
use super::slip::{SlidingRegion, Slip};
use crate::geometry::{Grid, stencil::NEIGHBOURS_26};
use crate::volume::{LabelMap, Mask, Volume};
use nalgebra::{Matrix3, Point3, Vector3};
use rayon::prelude::*;
use std::ops::Range;

/// Chain-mail elements on a grid that covers the planning CT with a border of one node that is always outside.
///
/// Flat arrays in storage order; `active` lists the nodes that take part, ascending.
#[derive(Debug, Clone)]
pub struct Lattice {
    /// The padded grid, LPS mm.
    pub grid: Grid,
    /// Kind of each node.
    pub node: Vec<Node>,
    /// Constraint of each node; meaningless outside.
    pub constraint: Vec<Constraint>,
    /// Nodes that are soft tissue or bone, ascending.
    pub active: Vec<u32>,
    /// Where tissue slides; `None` where nothing does.
    pub slip: Option<Slip>,
}

/// Share of a node's voxels that must carry a bone label for the node to be bone.
/// At 1/6 moderate errs by 0.249 mm for 0.245, at 2/3 spline by 0.342 for 0.336.
const BONE_SHARE: f64 = 1.0 / 3.0;

/// What the chain mail is built from, all on the planning grid.
pub struct Tissue<'a> {
    /// Planning CT, HU.
    pub ct: &'a Volume<f32>,
    /// Inside of the patient's skin.
    pub body: &'a Mask,
    /// Bone labels.
    pub labels: &'a LabelMap,
    /// Position in the skeleton of each bone label.
    pub bone_of_label: &'a [Option<u16>],
    /// Lung: takes part whatever its HU.
    pub lung: Option<&'a Mask>,
    /// What slides along its border.
    pub sliding: Option<SlidingRegion<'a>>,
    /// Voxels below this take no part otherwise, HU.
    pub least_hu: f32,
}

impl Tissue<'_> {
    /// The bone a voxel belongs to.
    pub fn bone(&self, voxel: usize) -> Option<u16> {
        self.bone_of_label[usize::from(self.labels.volume.data()[voxel])]
    }

    /// Whether a place lies inside the patient.
    pub fn holds(&self, place: &Point3<f64>) -> bool {
        self.body.grid().voxel_at(place).is_some_and(|voxel| *self.body.at(voxel))
    }

    /// Whether a voxel takes part: bone, or body above the least HU.
    pub fn active(&self, voxel: usize) -> bool {
        self.bone(voxel).is_some()
            || (self.body.data()[voxel] && self.ct.data()[voxel] >= self.least_hu)
            || self.lung.is_some_and(|lung| lung.data()[voxel])
    }

    /// The voxels that take part.
    pub fn computed(&self) -> Mask {
        Volume::from_fn(self.ct.grid().clone(), |v| self.active(v))
    }
}

impl Lattice {
    /// The lattice at about `spacing` mm (0: the planning grid itself).
    pub fn new(tissue: &Tissue<'_>, material: &Material, organs: &Organs, spacing: f64) -> Self {
        let fine = tissue.ct.grid();
        let inner = fine.coarsened(spacing);
        let size = inner.size().map(|n| n + 2);
        let origin: Point3<f64> = inner.world(&Vector3::new(-1.0, -1.0, -1.0));
        let grid = Grid::new(size, inner.spacing(), origin, *inner.direction())
            .expect("a padded grid of a legal grid is legal");
        let [xs, ys, zs] = [0, 1, 2].map(|axis| fine.voxels_by_nearest(&inner, axis));
        // Voxels of a node along one axis; none on the border.
        let inner = |ranges: &'_ [Range<usize>], n: usize| n.checked_sub(1).and_then(|n| ranges.get(n).cloned());
        let of_node = |n: usize| {
            let [i, j, k] = grid.voxel(n);
            match (inner(&xs, i), inner(&ys, j), inner(&zs, k)) {
                (Some(x), Some(y), Some(z)) => classify(tissue, material, organs, [&x, &y, &z]),
                _ => (Node::Outside, RIGID),
            }
        };
        let (mut node, mut constraint) = (Vec::new(), Vec::new());
        (0..grid.len()).into_par_iter().map(of_node).unzip_into_vecs(&mut node, &mut constraint);
        let slip = tissue.sliding.and_then(|SlidingRegion { region, along, jumps }| {
            let share = |n: usize| {
                let [i, j, k] = grid.voxel(n);
                let ranges = [inner(&xs, i)?, inner(&ys, j)?, inner(&zs, k)?];
                Some(share(region, ranges))
            };
            let shares = (0..grid.len()).into_par_iter().map(|n| share(n).unwrap_or(0.0)).collect();
            Slip::new(&grid, &node, shares, along, jumps)
        });
        Self { slip, ..Self::from_nodes(grid, node, constraint) }
    }

    /// The voxels from `low` to `high` of the planning grid, each an element, with a border of one node.
    pub(in crate::chainmail) fn patch(
        tissue: &Tissue<'_>,
        material: &Material,
        organs: &Organs,
        low: [usize; 3],
        high: [usize; 3],
    ) -> Self {
        let fine = tissue.ct.grid();
        let size: [usize; 3] = std::array::from_fn(|a| high[a] - low[a] + 3);
        let origin = fine.world(&Vector3::from(low.map(|c| c as f64 - 1.0)));
        let grid =
            Grid::new(size, fine.spacing(), origin, *fine.direction()).expect("a padded part of a legal grid is legal");
        let (node, constraint): (Vec<Node>, Vec<Constraint>) = (0..grid.len())
            .map(|n| {
                let at = grid.voxel(n);
                if (0..3).any(|a| at[a] == 0 || at[a] + 1 == size[a]) {
                    return (Node::Outside, RIGID);
                }
                let [x, y, z] = std::array::from_fn(|a| at[a] + low[a] - 1).map(|c: usize| c..c + 1);
                classify(tissue, material, organs, [&x, &y, &z])
            })
            .unzip();
        let slip = tissue.sliding.filter(|s| s.jumps).and_then(|SlidingRegion { region, along, jumps }| {
            let inner = |at: [usize; 3]| (0..3).all(|a| at[a] > 0 && at[a] + 1 < size[a]);
            let share = |n: usize| {
                let at = grid.voxel(n);
                let inside = inner(at) && *region.at(std::array::from_fn(|a| at[a] + low[a] - 1));
                if inside { 1.0 } else { 0.0 }
            };
            Slip::new(&grid, &node, (0..grid.len()).map(share).collect(), along, jumps)
        });
        Self { slip, ..Self::from_nodes(grid, node, constraint) }
    }

    /// A lattice of given elements in storage order; those on the border of the grid must be outside.
    pub fn from_nodes(grid: Grid, node: Vec<Node>, constraint: Vec<Constraint>) -> Self {
        let active = (0..node.len() as u32).into_par_iter().filter(|&n| node[n as usize] != Node::Outside).collect();
        Self { grid, node, constraint, active, slip: None }
    }

    /// Values of the active nodes, in their order, on all nodes; the others have `outside`.
    pub fn on_all_nodes<T: Copy>(&self, active: impl IntoIterator<Item = T>, outside: T) -> Vec<T> {
        let mut out = vec![outside; self.node.len()];
        self.active.iter().zip(active).for_each(|(&n, v)| out[n as usize] = v);
        out
    }

    /// The nodes of soft tissue, ascending.
    pub fn soft(&self) -> impl Iterator<Item = u32> + '_ {
        self.active.iter().copied().filter(|&n| self.node[n as usize] == Node::Soft)
    }

    /// Distances in storage to the 26 neighbours.
    pub fn offsets(&self) -> [isize; 26] {
        let [sx, sy, sz] = self.grid.strides().map(|s| s as isize);
        NEIGHBOURS_26.map(|o| o[0] as isize * sx + o[1] as isize * sy + o[2] as isize * sz)
    }

    /// World vectors to the 26 neighbours, mm.
    pub fn links(&self) -> [Vector3<f64>; 26] {
        let step: &Matrix3<f64> = self.grid.step();
        NEIGHBOURS_26.map(|o| step * Vector3::from(o.map(f64::from)))
    }

    /// Constraint of the link between two nodes.
    pub fn link(&self, a: usize, b: usize) -> Constraint {
        self.constraint[a].mean(self.constraint[b])
    }

    /// World position of a node at rest.
    pub fn rest(&self, node: usize) -> Point3<f64> {
        self.grid.centre(self.grid.voxel(node))
    }
}

/// Share of a node's voxels that are set.
fn share(region: &Mask, [xs, ys, zs]: [Range<usize>; 3]) -> f32 {
    let all = xs.len() * ys.len() * zs.len();
    let row = |j: usize, k: usize| {
        let first = region.grid().linear([xs.start, j, k]);
        region.data()[first..first + xs.len()].iter().filter(|inside| **inside).count()
    };
    let own: usize = zs.flat_map(|k| ys.clone().map(move |j| (j, k))).map(|(j, k)| row(j, k)).sum();
    own as f32 / all.max(1) as f32
}

/// How many voxels each bone or label has in a node.
type Votes = Vec<(u16, usize)>;

/// Kind and constraint of one node from its voxels.
fn classify(
    tissue: &Tissue<'_>,
    material: &Material,
    organs: &Organs,
    [xs, ys, zs]: [&Range<usize>; 3],
) -> (Node, Constraint) {
    let grid = tissue.ct.grid();
    let (mut all, mut active, mut hu) = (0usize, 0usize, 0f64);
    let (mut votes, mut organ_votes) = (Votes::new(), Votes::new());
    let vote = |votes: &mut Votes, b: u16| match votes.iter_mut().find(|(n, _)| *n == b) {
        Some((_, count)) => *count += 1,
        None => votes.push((b, 1)),
    };
    for k in zs.clone() {
        for j in ys.clone() {
            for i in xs.clone() {
                let v = grid.linear([i, j, k]);
                all += 1;
                if let Some(b) = tissue.bone(v) {
                    vote(&mut votes, b);
                } else if !organs.is_empty() {
                    vote(&mut organ_votes, tissue.labels.volume.data()[v]);
                }
                if tissue.active(v) {
                    active += 1;
                    hu += f64::from(tissue.ct.data()[v]);
                }
            }
        }
    }
    // Ties go to the bone that comes first in the skeleton, or to the lower label.
    let most = |votes: &Votes| votes.iter().copied().max_by(|a, b| a.1.cmp(&b.1).then(b.0.cmp(&a.0)));
    let organ = || most(&organ_votes).and_then(|v| organs.of(v.0));
    match most(&votes) {
        Some((b, n)) if n as f64 >= BONE_SHARE * all as f64 => (Node::Bone(b), RIGID),
        _ if 2 * active >= all && active > 0 => {
            (Node::Soft, organ().unwrap_or_else(|| material.at((hu / active as f64) as f32)))
        }
        _ => (Node::Outside, RIGID),
    }
}
