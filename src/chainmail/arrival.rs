//! First arrivals of fronts where bones hand on their motion undiminished: only times count, so that a wave is a shortest
//! path search over cells packed for it.
//!
//! Times are integers; each is the unique least sum over paths, whatever the order of processing. What cannot be entered
//! (outside, bones) has time 0 from the start, so that no offer is ever early enough and nothing else needs asking.

use super::engine::Source;
use super::front::{FrontRules, LinkTime, NEVER, TICKS};
use super::lattice::{Lattice, Node};
use rayon::prelude::*;

/// A node as a wave sees it.
#[derive(Debug, Clone, Copy)]
struct Cell {
    /// Relative shear of the node.
    shear: f32,
    /// Least ticks found so far; 0 where no front may enter.
    time: u32,
}

/// What fronts run through: the box of the lattice that holds all active nodes, with a border that none may enter.
pub(super) struct Medium {
    low: [usize; 3],
    size: [usize; 3],
    rest: Vec<Cell>,
    /// Distance in storage and factor of each link; see [`FrontRules::factor`].
    links: Vec<(isize, f32)>,
    rules: FrontRules,
    /// Latest time that counts.
    limit: u32,
    /// The most ticks that a link can take.
    slowest: u32,
    /// The least ticks that a link can take here.
    fastest: u32,
    /// Bone and cell of every bone node beside soft tissue, bone by bone.
    surface: Vec<(u16, u32)>,
}

/// How a wave went, on the cells of the medium.
pub(super) struct Arrival<N> {
    cells: Vec<Cell>,
    limit: u32,
    /// What was noted.
    pub(super) notes: N,
}

/// What a wave notes besides times.
pub(super) trait Notes: Send {
    /// `to` takes the offer of `from`, which is earlier than all before.
    fn earlier(&mut self, from: usize, to: usize);
    /// `to` is offered the time that it has already.
    fn equal(&mut self, from: usize, to: usize);
    /// The time of `cell` is final.
    fn settled(&mut self, cell: usize);
}

/// Nothing.
pub(super) struct Nothing;

impl Notes for Nothing {
    fn earlier(&mut self, _: usize, _: usize) {}
    fn equal(&mut self, _: usize, _: usize) {}
    fn settled(&mut self, _: usize) {}
}

/// Which bone comes first; of several at the same time the first in the skeleton.
pub(super) struct Owners(pub(super) Vec<u16>);

impl Notes for Owners {
    fn earlier(&mut self, from: usize, to: usize) {
        self.0[to] = self.0[from];
    }
    fn equal(&mut self, from: usize, to: usize) {
        self.0[to] = self.0[to].min(self.0[from]);
    }
    fn settled(&mut self, _: usize) {}
}

/// Owners, and the order in which cells were processed.
pub(super) struct Ordered(pub(super) Owners, pub(super) Vec<u32>);

impl Notes for Ordered {
    fn earlier(&mut self, from: usize, to: usize) {
        self.0.earlier(from, to);
    }
    fn equal(&mut self, from: usize, to: usize) {
        self.0.equal(from, to);
    }
    fn settled(&mut self, cell: usize) {
        self.1.push(cell as u32);
    }
}

impl Medium {
    /// Packs a lattice.
    pub(super) fn new(lattice: &Lattice, rules: FrontRules) -> Self {
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
        let size: [usize; 3] = std::array::from_fn(|a| high[a] + 2 - low[a]);
        let mut rest = vec![Cell { shear: 0.0, time: 0 }; size.iter().product()];
        rest.par_chunks_mut(size[0]).enumerate().for_each(|(row, cells)| {
            let start = lattice.grid.linear([low[0], low[1] + row % size[1], low[2] + row / size[1]]);
            for (cell, n) in cells.iter_mut().zip(start..) {
                let time = if lattice.node[n] == Node::Soft { NEVER } else { 0 };
                *cell = Cell { shear: lattice.constraint[n].shear, time };
            }
        });
        let hops = rules.links(lattice);
        let greatest = rest.iter().map(|c| c.shear).fold(0f32, f32::max);
        let ticks = |shears: f32| hops.iter().map(move |h| rules.ticks(rules.factor(h.mm), shears));
        let mut medium = Self {
            low,
            size,
            links: hops
                .iter()
                .map(|h| {
                    let [i, j, k] = h.step.map(|s| s as isize);
                    (i + size[0] as isize * (j + size[1] as isize * k), rules.factor(h.mm))
                })
                .collect(),
            limit: (rules.cutoff * TICKS).min(f64::from(u32::MAX / 2)) as u32,
            slowest: ticks(0.0).chain(ticks(2.0 * greatest)).max().unwrap_or(1),
            fastest: ticks(0.0).chain(ticks(2.0 * greatest)).min().unwrap_or(1),
            rules,
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
                let soft = |&(offset, _): &(isize, f32)| self.rest[cell.wrapping_add_signed(offset)].time == NEVER;
                self.links.iter().any(soft).then_some((bone, cell as u32))
            })
            .collect();
        found.sort_unstable();
        found
    }

    /// Number of cells.
    pub(super) fn len(&self) -> usize {
        self.rest.len()
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

    /// The lattice's voxel of a cell.
    pub(super) fn voxel(&self, cell: usize) -> [usize; 3] {
        let [nx, ny, _] = self.size;
        let at = [cell % nx, cell / nx % ny, cell / (nx * ny)];
        std::array::from_fn(|a| self.low[a] + at[a])
    }

    /// Runs one wave and notes nothing but times. `latest`: a time for each cell, after which the wave does not enter it.
    pub(super) fn times(&self, source: Source, latest: Option<&[u32]>) -> Arrival<Nothing> {
        self.wave(source, latest, Nothing)
    }

    /// Runs one wave and notes owners.
    pub(super) fn owners(&self, source: Source) -> Arrival<Owners> {
        self.wave(source, None, self.first_owners())
    }

    /// Runs one wave and notes owners and order.
    pub(super) fn ordered(&self, source: Source) -> Arrival<Ordered> {
        self.wave(source, None, Ordered(self.first_owners(), Vec::new()))
    }

    fn first_owners(&self) -> Owners {
        let mut owners = Owners(vec![0; self.len()]);
        self.surface.iter().for_each(|&(bone, cell)| owners.0[cell as usize] = bone);
        owners
    }

    /// The latest time at each cell by [`super::ChainmailOptions::prune_ratio`].
    pub(super) fn latest(&self, first: &Arrival<Nothing>, ratio: f64) -> Vec<u32> {
        first.cells.par_iter().map(|c| (ratio * f64::from(c.time)).min(f64::from(NEVER)) as u32).collect()
    }

    fn wave<N: Notes>(&self, source: Source, latest: Option<&[u32]>, notes: N) -> Arrival<N> {
        let seeds = match source {
            Source::AnyBone => &self.surface[..],
            Source::Bone(b) => {
                let from = self.surface.partition_point(|s| s.0 < b);
                let to = self.surface.partition_point(|s| s.0 <= b);
                &self.surface[from..to]
            }
        };
        let search = Search { medium: self, cells: self.rest.clone(), latest, notes };
        let (cells, notes) = match self.rules.time {
            LinkTime::FastInStiff => search.run::<true>(seeds),
            LinkTime::SlowInStiff | LinkTime::Literal => search.run::<false>(seeds),
        };
        Arrival { cells, limit: self.limit, notes }
    }
}

impl<N> Arrival<N> {
    /// Ticks at a cell of soft tissue; `None` where the wave does not come, and in bones.
    pub(super) fn time(&self, cell: usize) -> Option<u32> {
        let t = self.cells[cell].time;
        (t != 0 && t <= self.limit).then_some(t)
    }
}

/// A wave on its way.
struct Search<'a, N> {
    medium: &'a Medium,
    cells: Vec<Cell>,
    latest: Option<&'a [u32]>,
    notes: N,
}

impl<N: Notes> Search<'_, N> {
    /// Dial's algorithm: one bucket per tick, as many as a link can take at most.
    fn run<const FAST: bool>(mut self, seeds: &[(u16, u32)]) -> (Vec<Cell>, N) {
        let mut buckets: Vec<Vec<u32>> = vec![Vec::new(); self.medium.slowest as usize + 1];
        buckets[0].extend(seeds.iter().map(|s| s.1));
        let (mut waiting, mut now, mut slot) = (seeds.len(), 0, 0);
        while waiting > 0 && now <= self.medium.limit {
            // Every link takes time, so nothing is put into this bucket while it is emptied.
            let mut bucket = std::mem::take(&mut buckets[slot]);
            waiting -= bucket.len();
            for n in bucket.drain(..) {
                let n = n as usize;
                if self.cells[n].time == now {
                    self.notes.settled(n);
                    waiting += self.expand::<FAST>(n, now, slot, &mut buckets);
                }
            }
            buckets[slot] = bucket;
            now += 1;
            slot = if slot + 1 == buckets.len() { 0 } else { slot + 1 };
        }
        (self.cells, self.notes)
    }

    /// Offers the time of a settled cell to its neighbours; returns how many took it.
    #[inline(always)]
    fn expand<const FAST: bool>(&mut self, n: usize, now: u32, slot: usize, buckets: &mut [Vec<u32>]) -> usize {
        let shear = self.cells[n].shear;
        let mut taken = 0;
        for &(offset, factor) in &self.medium.links {
            let m = n.wrapping_add_signed(offset);
            let cell = self.cells[m];
            if cell.time < now + self.medium.fastest {
                continue;
            }
            let ticks = FrontRules::ticks_of::<FAST>(factor, shear + cell.shear);
            let time = now + ticks;
            if time > cell.time || self.latest.is_some_and(|latest| time > latest[m]) {
                continue;
            }
            if time == cell.time {
                self.notes.equal(n, m);
                continue;
            }
            self.cells[m].time = time;
            self.notes.earlier(n, m);
            let to = slot + ticks as usize;
            buckets[if to >= buckets.len() { to - buckets.len() } else { to }].push(m as u32);
            taken += 1;
        }
        taken
    }
}
