//! First arrivals of fronts where bones hand on their motion undiminished: only times count, so that a wave is a shortest
//! path search over cells packed for it in bricks.
//!
//! Times are integers; each is the unique least sum over paths, whatever the order of processing. What cannot be entered
//! (outside, bones) has time 0 from the start, so that no offer is ever early enough and nothing else needs asking.

use super::super::super::lattice::Lattice;
use super::super::super::lattice::Node;
use super::super::front::{FrontRules, Hop};
use super::brick::{Brick, Bricks, CELLS, TILE, in_tile};
use rayon::prelude::*;

/// Time that no wave has come, in cells; all others are at most [`FrontRules::limit`].
pub(in crate::chainmail) const LATE: i32 = i32::MAX;

/// Links of a cell to the cells of one brick.
#[derive(Debug, Clone, Copy)]
pub(in crate::chainmail) struct Links {
    /// Bricks ahead along each axis.
    step: [i32; 3],
    /// The same in memory, for each place of a brick in its tile.
    pub(in crate::chainmail) ahead: [i32; TILE * TILE],
    /// Factor of each link; see [`FrontRules::factor`].
    pub(in crate::chainmail) factor: [f32; CELLS],
    /// Bit `l` for cell `l` where the front runs to it, otherwise 0.
    pub(in crate::chainmail) open: [i32; CELLS],
}

impl Links {
    /// The brick that they lead to from one of its own.
    #[inline(always)]
    pub(in crate::chainmail) fn from(&self, brick: usize) -> usize {
        brick.wrapping_add_signed(self.ahead[in_tile(brick)] as isize)
    }
}

/// What fronts run through: the box of the lattice that holds all active nodes, with a border that none may enter.
pub(in crate::chainmail) struct Medium {
    low: [usize; 3],
    pub(in crate::chainmail) bricks: Bricks,
    /// Relative shear of each cell.
    pub(in crate::chainmail) shear: Vec<Brick<f32>>,
    /// Times before a wave: [`LATE`] in soft tissue, 0 where no front may enter.
    pub(in crate::chainmail) rest: Vec<Brick<i32>>,
    /// For each cell of a brick its links, brick by brick.
    pub(in crate::chainmail) links: [Vec<Links>; CELLS],
    pub(in crate::chainmail) rules: FrontRules,
    /// Latest time that counts.
    pub(in crate::chainmail) limit: i32,
    /// The least and the most ticks that a link can take.
    pub(in crate::chainmail) ticks: [i32; 2],
    /// Bone and cell of every bone node beside soft tissue, bone by bone.
    pub(in crate::chainmail) surface: Vec<(u16, u32)>,
}

/// How a wave went, on the cells of the medium.
#[derive(Default)]
pub(in crate::chainmail) struct Arrival {
    pub(in crate::chainmail) times: Vec<Brick<i32>>,
    pub(in crate::chainmail) limit: i32,
    /// Whether it was pruned somewhere.
    pub(in crate::chainmail) pruned: bool,
}

impl Medium {
    /// Packs a lattice.
    pub(in crate::chainmail) fn new(lattice: &Lattice, rules: FrontRules) -> Self {
        let [low, size] = active_box(lattice);
        let bricks = Bricks::holding(size);
        let (mut shear, mut rest) = (vec![Brick::default(); bricks.len()], vec![Brick::default(); bricks.len()]);
        let planes = shear.par_chunks_mut(bricks.plane()).zip(rest.par_chunks_mut(bricks.plane()));
        planes.enumerate().for_each(|(plane, (shear, rest))| {
            for k in (2 * plane..2 * plane + 2).take_while(|k| *k < size[2]) {
                for j in 0..size[1] {
                    let start = lattice.grid.linear([low[0], low[1] + j, low[2] + k]);
                    for of_tile in (0..size[0]).step_by(2 * TILE) {
                        let first = bricks.cell([of_tile, j, k]) - plane * bricks.plane() * CELLS;
                        for i in 0..(size[0] - of_tile).min(2 * TILE) {
                            let (n, brick, at) = (start + of_tile + i, first / CELLS + i / 2, first % CELLS + i % 2);
                            shear[brick].0[at] = lattice.constraint[n].shear;
                            rest[brick].0[at] = if lattice.node[n] == Node::Soft { LATE } else { 0 };
                        }
                    }
                }
            }
        });
        let hops = rules.links(lattice);
        let greatest = shear.iter().flat_map(|b| b.0).fold(0f32, f32::max);
        let mut medium = Self {
            low,
            bricks,
            links: std::array::from_fn(|at| links_of(at, &hops, &rules, bricks)),
            limit: rules.limit() as i32,
            ticks: rules.ticks_of(&hops, greatest).map(|t| t as i32),
            rules,
            shear,
            rest,
            surface: Vec::new(),
        };
        medium.surface = medium.surface_of(lattice);
        medium
    }

    /// Bone nodes beside soft tissue.
    fn surface_of(&self, lattice: &Lattice) -> Vec<(u16, u32)> {
        let mut found: Vec<(u16, u32)> = lattice
            .active
            .par_iter()
            .filter_map(|&n| {
                let Node::Bone(bone) = lattice.node[n as usize] else { return None };
                let cell = self.cell(lattice.grid.voxel(n as usize));
                let soft = |links: &Links| {
                    let rest = self.rest[links.from(cell / CELLS)].0;
                    (0..CELLS).any(|l| links.open[l] != 0 && rest[l] == LATE)
                };
                self.links[cell % CELLS].iter().any(soft).then_some((bone, cell as u32))
            })
            .collect();
        found.sort_unstable();
        found
    }

    /// The lattice's voxel of the first cell.
    pub(in crate::chainmail) fn low(&self) -> [usize; 3] {
        self.low
    }

    /// The cell of a voxel of the lattice, which must lie inside the box.
    pub(in crate::chainmail) fn cell(&self, voxel: [usize; 3]) -> usize {
        self.bricks.cell(std::array::from_fn(|a| voxel[a] - self.low[a]))
    }

    /// The bricks that hold soft tissue, in order.
    pub(in crate::chainmail) fn soft_bricks(&self) -> Vec<usize> {
        let soft = |at: &usize| self.rest[*at].0.contains(&LATE);
        (0..self.bricks.len()).into_par_iter().filter(soft).collect()
    }
}

/// The lowest voxel and the size of the box that holds all active nodes, with a border of one.
pub(in crate::chainmail) fn active_box(lattice: &Lattice) -> [[usize; 3]; 2] {
    let (mut low, mut high) = ([usize::MAX; 3], [0; 3]);
    for &n in &lattice.active {
        let at = lattice.grid.voxel(n as usize);
        for a in 0..3 {
            (low[a], high[a]) = (low[a].min(at[a]), high[a].max(at[a]));
        }
    }
    if lattice.active.is_empty() {
        (low, high) = ([1; 3], [1; 3]);
    }
    // The lattice's border is outside, so there is always one more node around the active ones.
    let low = low.map(|l| l - 1);
    [low, std::array::from_fn(|a| high[a] + 2 - low[a])]
}

/// The links of cell `at` of a brick, by the bricks that they lead to.
fn links_of(at: usize, hops: &[Hop], rules: &FrontRules, bricks: Bricks) -> Vec<Links> {
    let mut links: Vec<Links> = Vec::new();
    for hop in hops {
        let (step, place) = Bricks::beside(at, hop.step);
        let to = links.iter().position(|l| l.step == step).unwrap_or_else(|| {
            links.push(Links { step, ahead: bricks.ahead(step), factor: [1.0; CELLS], open: [0; CELLS] });
            links.len() - 1
        });
        links[to].factor[place] = rules.factor(hop.mm);
        links[to].open[place] = 1 << place;
    }
    links
}

/// Ticks of a time that came to soft tissue within the limit.
#[inline(always)]
pub(in crate::chainmail) fn arrived(time: i32, limit: i32) -> Option<u32> {
    came(time, limit).then_some(time as u32)
}

/// Whether a time came to soft tissue within the limit.
#[inline(always)]
pub(in crate::chainmail) fn came(time: i32, limit: i32) -> bool {
    (time != 0) & (time <= limit)
}
