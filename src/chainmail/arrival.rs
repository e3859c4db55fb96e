//! First arrivals of fronts where bones hand on their motion undiminished: only times count, so that a wave is a shortest
//! path search over cells packed for it.
//!
//! Times are integers; each is the unique least sum over paths, whatever the order of processing. What cannot be entered
//! (outside, bones) has time 0 from the start, so that no offer is ever early enough and nothing else needs asking.

use super::dial::Search;
use super::engine::Source;
use super::front::{FrontRules, Hop, TICKS};
use super::lattice::{Lattice, Node};
use super::slabs::FirstArrivals;
use rayon::prelude::*;

/// Time that no wave has come, in cells; all others are below [`MOST`].
pub(super) const LATE: i32 = i32::MAX;
/// Times beyond this do not count, whatever the cut-off: sums stay far from overflow.
const MOST: f64 = (1 << 30) as f64;

/// Cells that are looked at together: a cell's neighbours on one row, and one more that makes it four.
pub(super) const SPAN: usize = 4;

/// Fewer planes are not worth a thread.
const LEAST_PLANES: usize = 8;

/// Links to the cells of a row.
#[derive(Debug, Clone, Copy)]
pub(super) struct Row {
    /// Distance in storage to the first of [`SPAN`] cells.
    pub(super) offset: isize,
    /// Factor of each link; see [`FrontRules::factor`].
    pub(super) factor: [f32; SPAN],
    /// Bit `l` is set where the front runs along link `l`.
    pub(super) open: u32,
}

/// What fronts run through: the box of the lattice that holds all active nodes, with a border that none may enter.
pub(super) struct Medium {
    low: [usize; 3],
    size: [usize; 3],
    /// Relative shear of each cell.
    pub(super) shear: Vec<f32>,
    /// Times before a wave: [`LATE`] in soft tissue, 0 where no front may enter.
    pub(super) rest: Vec<i32>,
    pub(super) rows: Vec<Row>,
    pub(super) rules: FrontRules,
    /// Latest time that counts.
    pub(super) limit: i32,
    /// The least and the most ticks that a link can take.
    pub(super) ticks: [i32; 2],
    /// Bone and cell of every bone node beside soft tissue, bone by bone.
    pub(super) surface: Vec<(u16, u32)>,
}

/// How a wave went, on the cells of the medium.
pub(super) struct Arrival {
    times: Vec<i32>,
    limit: i32,
}

impl Medium {
    /// Packs a lattice.
    pub(super) fn new(lattice: &Lattice, rules: FrontRules) -> Self {
        let [low, size] = active_box(lattice);
        let cells: usize = size.iter().product();
        // Room at the end for the last row's span.
        let (mut shear, mut rest) = (vec![0f32; cells + SPAN], vec![0i32; cells + SPAN]);
        let rows = shear[..cells].par_chunks_mut(size[0]).zip(rest[..cells].par_chunks_mut(size[0]));
        rows.enumerate().for_each(|(row, (shear, rest))| {
            let start = lattice.grid.linear([low[0], low[1] + row % size[1], low[2] + row / size[1]]);
            for ((shear, rest), n) in shear.iter_mut().zip(rest).zip(start..) {
                *shear = lattice.constraint[n].shear;
                *rest = if lattice.node[n] == Node::Soft { LATE } else { 0 };
            }
        });
        let hops = rules.links(lattice);
        let greatest = shear.iter().copied().fold(0f32, f32::max);
        let ticks =
            || hops.iter().flat_map(|h| [0.0, 2.0 * greatest].map(|shears| rules.ticks(rules.factor(h.mm), shears)));
        let mut medium = Self {
            low,
            size,
            rows: rows_of(&hops, &rules, size),
            limit: (rules.cutoff * TICKS).min(MOST) as i32,
            ticks: [ticks().min(), ticks().max()].map(|t| t.unwrap_or(1) as i32),
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
                let soft = |row: &Row| {
                    let first = cell.wrapping_add_signed(row.offset);
                    (0..SPAN).any(|l| row.open >> l & 1 == 1 && self.rest[first + l] == LATE)
                };
                self.rows.iter().any(soft).then_some((bone, cell as u32))
            })
            .collect();
        found.sort_unstable();
        found
    }

    /// Number of cells.
    pub(super) fn len(&self) -> usize {
        self.size.iter().product()
    }

    /// Cells along each axis.
    pub(super) fn size(&self) -> [usize; 3] {
        self.size
    }

    /// The lattice's voxel of the first cell.
    pub(super) fn low(&self) -> [usize; 3] {
        self.low
    }

    /// The cell of a voxel of the lattice, which must lie inside the box.
    pub(super) fn cell(&self, voxel: [usize; 3]) -> usize {
        let [i, j, k] = std::array::from_fn(|a| voxel[a] - self.low[a]);
        i + self.size[0] * (j + self.size[1] * k)
    }

    /// Runs one wave and notes nothing but times. `latest`: a time for each cell, after which the wave does not enter it.
    pub(super) fn times(&self, source: Source, latest: Option<&[i32]>) -> Arrival {
        let seeds = match source {
            Source::AnyBone => &self.surface[..],
            Source::Bone(b) => {
                let from = self.surface.partition_point(|s| s.0 < b);
                let to = self.surface.partition_point(|s| s.0 <= b);
                &self.surface[from..to]
            }
        };
        let seeds: Vec<(i32, u32)> = seeds.iter().map(|s| (0, s.1)).collect();
        let mut search = Search::new(self, 0..self.len(), latest);
        search.run(&seeds);
        Arrival { times: search.keys, limit: self.limit }
    }

    /// Runs one wave from all bones and notes which one comes first at each cell; of several at the same time the first in
    /// the skeleton.
    pub(super) fn first_arrivals(&self) -> FirstArrivals<'_> {
        FirstArrivals::of(self, rayon::current_num_threads().min(self.size[2] / LEAST_PLANES))
    }

    /// The latest time at each cell by [`super::ChainmailOptions::prune_ratio`].
    pub(super) fn latest(&self, first: &Arrival, ratio: f64) -> Vec<i32> {
        first.times.par_iter().map(|&t| (ratio * f64::from(t)).min(f64::from(LATE)) as i32).collect()
    }
}

/// The lowest voxel and the size of the box that holds all active nodes, with a border of one.
pub(super) fn active_box(lattice: &Lattice) -> [[usize; 3]; 2] {
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

/// The links by rows of cells.
fn rows_of(hops: &[Hop], rules: &FrontRules, size: [usize; 3]) -> Vec<Row> {
    let mut rows: Vec<Row> = Vec::new();
    for hop in hops {
        let [i, j, k] = hop.step.map(|s| s as isize);
        let offset = size[0] as isize * (j + size[1] as isize * k) - 1;
        let at = rows.iter().position(|r| r.offset == offset).unwrap_or_else(|| {
            rows.push(Row { offset, factor: [1.0; SPAN], open: 0 });
            rows.len() - 1
        });
        let lane = (i + 1) as usize;
        rows[at].factor[lane] = rules.factor(hop.mm);
        rows[at].open |= 1 << lane;
    }
    rows
}

impl Arrival {
    /// Ticks at a cell of soft tissue; `None` where the wave does not come, and in bones.
    #[inline(always)]
    pub(super) fn time(&self, cell: usize) -> Option<u32> {
        arrived(self.times[cell], self.limit)
    }
}

/// Ticks of a time that came to soft tissue within the limit.
#[inline(always)]
pub(super) fn arrived(time: i32, limit: i32) -> Option<u32> {
    (time != 0 && time <= limit).then_some(time as u32)
}
