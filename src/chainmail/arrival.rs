//! First arrivals of fronts where bones hand on their motion undiminished: only times count, so that a wave is a shortest
//! path search over cells packed for it.
//!
//! Times are integers; each is the unique least sum over paths, whatever the order of processing. What cannot be entered
//! (outside, bones) has time 0 from the start, so that no offer is ever early enough and nothing else needs asking.

use super::engine::Source;
use super::front::{FrontRules, Hop, LinkTime, TICKS};
use super::lattice::{Lattice, Node};
use crate::geometry::vectorised;
use rayon::prelude::*;

/// Time that no wave has come, in cells; all others are below [`MOST`].
const LATE: i32 = i32::MAX;
/// Times beyond this do not count, whatever the cut-off: sums stay far from overflow.
const MOST: f64 = (1 << 30) as f64;

/// Cells that are looked at together: a cell's neighbours on one row, and one more that makes it four.
const SPAN: usize = 4;

/// Links to the cells of a row.
#[derive(Debug, Clone, Copy)]
struct Row {
    /// Distance in storage to the first of [`SPAN`] cells.
    offset: isize,
    /// Factor of each link; see [`FrontRules::factor`].
    factor: [f32; SPAN],
    /// Bit `l` is set where the front runs along link `l`.
    open: u32,
}

/// What fronts run through: the box of the lattice that holds all active nodes, with a border that none may enter.
pub(super) struct Medium {
    low: [usize; 3],
    size: [usize; 3],
    /// Relative shear of each cell.
    shear: Vec<f32>,
    /// Times before a wave: [`LATE`] in soft tissue, 0 where no front may enter.
    rest: Vec<i32>,
    rows: Vec<Row>,
    rules: FrontRules,
    /// Latest time that counts.
    limit: i32,
    /// The least and the most ticks that a link can take.
    ticks: [i32; 2],
    /// Bone and cell of every bone node beside soft tissue, bone by bone.
    surface: Vec<(u16, u32)>,
}

/// How a wave went, on the cells of the medium.
pub(super) struct Arrival<N> {
    times: Vec<i32>,
    limit: i32,
    /// What was noted.
    pub(super) notes: N,
}

/// What a wave notes besides times.
pub(super) trait Notes: Send {
    /// Whether offers that are equally early matter.
    const TIES: bool;
    /// `to` takes the offer of `from`, which is earlier than all before.
    fn earlier(&mut self, from: usize, to: usize);
    /// `to` is offered the time that it has already.
    fn equal(&mut self, from: usize, to: usize);
}

/// Nothing.
pub(super) struct Nothing;

impl Notes for Nothing {
    const TIES: bool = false;
    fn earlier(&mut self, _: usize, _: usize) {}
    fn equal(&mut self, _: usize, _: usize) {}
}

/// Which bone comes first; of several at the same time the first in the skeleton.
pub(super) struct Owners(pub(super) Vec<u16>);

impl Notes for Owners {
    const TIES: bool = true;
    fn earlier(&mut self, from: usize, to: usize) {
        self.0[to] = self.0[from];
    }
    fn equal(&mut self, from: usize, to: usize) {
        self.0[to] = self.0[to].min(self.0[from]);
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
    pub(super) fn times(&self, source: Source, latest: Option<&[i32]>) -> Arrival<Nothing> {
        self.wave(source, latest, Nothing)
    }

    /// Runs one wave and notes owners.
    pub(super) fn owners(&self, source: Source) -> Arrival<Owners> {
        self.wave(source, None, self.first_owners())
    }

    fn first_owners(&self) -> Owners {
        let mut owners = Owners(vec![0; self.len()]);
        self.surface.iter().for_each(|&(bone, cell)| owners.0[cell as usize] = bone);
        owners
    }

    /// The latest time at each cell by [`super::ChainmailOptions::prune_ratio`].
    pub(super) fn latest(&self, first: &Arrival<Nothing>, ratio: f64) -> Vec<i32> {
        first.times.par_iter().map(|&t| (ratio * f64::from(t)).min(f64::from(LATE)) as i32).collect()
    }

    fn wave<N: Notes>(&self, source: Source, latest: Option<&[i32]>, notes: N) -> Arrival<N> {
        let seeds = match source {
            Source::AnyBone => &self.surface[..],
            Source::Bone(b) => {
                let from = self.surface.partition_point(|s| s.0 < b);
                let to = self.surface.partition_point(|s| s.0 <= b);
                &self.surface[from..to]
            }
        };
        let search = Search { medium: self, times: self.rest.clone(), latest, notes };
        let (times, notes) = match self.rules.time {
            LinkTime::FastInStiff => vectorised(
                #[inline(always)]
                || search.run::<true>(seeds),
            ),
            LinkTime::SlowInStiff | LinkTime::Literal => vectorised(
                #[inline(always)]
                || search.run::<false>(seeds),
            ),
        };
        Arrival { times, limit: self.limit, notes }
    }
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

impl<N> Arrival<N> {
    /// Ticks at a cell of soft tissue; `None` where the wave does not come, and in bones.
    #[inline(always)]
    pub(super) fn time(&self, cell: usize) -> Option<u32> {
        let t = self.times[cell];
        (t != 0 && t <= self.limit).then_some(t as u32)
    }
}

/// A wave on its way.
struct Search<'a, N> {
    medium: &'a Medium,
    times: Vec<i32>,
    latest: Option<&'a [i32]>,
    notes: N,
}

/// Buckets are no wider, ticks: times up to 2^32 / [`WIDEST`] after a bucket are then divided exactly.
const WIDEST: i32 = 256;

/// Cells that wait, in a ring of buckets as wide as the quickest link: no offer goes into the bucket that is being emptied, so
/// that all times in it are final, and neighbours that arrive within it are looked at one after the other.
struct Ring {
    buckets: Vec<Vec<u32>>,
    /// The bucket that is being emptied, and the time at which it begins.
    slot: usize,
    base: i32,
    width: i32,
    /// 2^32 / width, rounded up: the quotient without a division.
    reciprocal: u64,
    waiting: usize,
}

impl Ring {
    fn new([quickest, slowest]: [i32; 2], seeds: &[(u16, u32)]) -> Self {
        let width = quickest.clamp(1, WIDEST);
        let mut buckets = vec![Vec::new(); (slowest / width) as usize + 2];
        buckets[0].extend(seeds.iter().map(|s| s.1));
        let reciprocal = (1u64 << 32).div_ceil(width as u64);
        Self { buckets, slot: 0, base: 0, width, reciprocal, waiting: seeds.len() }
    }

    /// Puts a cell where its time `due` belongs, unless its time `held` before had put it there already.
    #[inline(always)]
    fn put(&mut self, cell: usize, held: i32, due: i32) {
        let ahead = (((due - self.base) as u64 * self.reciprocal) >> 32) as i32;
        if held - self.base < (ahead + 1) * self.width {
            return;
        }
        let to = self.slot + ahead as usize;
        let to = if to >= self.buckets.len() { to - self.buckets.len() } else { to };
        self.buckets[to].push(cell as u32);
        self.waiting += 1;
    }
}

impl<N: Notes> Search<'_, N> {
    /// Dial's algorithm with buckets as wide as they may be (Dinitz).
    #[inline(always)]
    fn run<const FAST: bool>(mut self, seeds: &[(u16, u32)]) -> (Vec<i32>, N) {
        let mut ring = Ring::new(self.medium.ticks, seeds);
        while ring.waiting > 0 && ring.base <= self.medium.limit {
            let mut bucket = std::mem::take(&mut ring.buckets[ring.slot]);
            ring.waiting -= bucket.len();
            for n in bucket.drain(..) {
                let n = n as usize;
                let now = self.times[n];
                // A time before this bucket was dealt with in its own.
                if now >= ring.base && now <= self.medium.limit {
                    self.expand::<FAST>(n, now, &mut ring);
                }
            }
            ring.buckets[ring.slot] = bucket;
            ring.base += ring.width;
            ring.slot = if ring.slot + 1 == ring.buckets.len() { 0 } else { ring.slot + 1 };
        }
        (self.times, self.notes)
    }

    /// Offers the time of a settled cell to its neighbours.
    ///
    /// Whether an offer is early enough is as good as random, so that a branch for each would cost more than to compute a
    /// row's four at a time and ask once.
    #[inline(always)]
    fn expand<const FAST: bool>(&mut self, n: usize, now: i32, ring: &mut Ring) {
        let shear = self.medium.shear[n];
        for row in &self.medium.rows {
            let first = n.wrapping_add_signed(row.offset);
            let shears = self.medium.shear.get(first..).and_then(|s| s.first_chunk::<SPAN>());
            let times = self.times.get(first..).and_then(|t| t.first_chunk::<SPAN>());
            let (Some(shears), Some(times)) = (shears, times) else { continue };
            let mut due = [0; SPAN];
            let mut early = 0;
            for l in 0..SPAN {
                due[l] = now + FrontRules::ticks_of::<FAST>(row.factor[l], shear + shears[l]) as i32;
                early |= u32::from(due[l] - i32::from(N::TIES) < times[l]) << l;
            }
            early &= row.open;
            while early != 0 {
                let l = early.trailing_zeros() as usize;
                early &= early - 1;
                self.offer([n, first + l], due[l % SPAN], ring);
            }
        }
    }

    /// Makes an offer to a neighbour that it will not refuse for being late.
    #[inline(always)]
    fn offer(&mut self, [n, m]: [usize; 2], due: i32, ring: &mut Ring) {
        if self.latest.is_some_and(|latest| due > latest[m]) {
            return;
        }
        let held = self.times[m];
        if due == held {
            return self.notes.equal(n, m);
        }
        self.times[m] = due;
        self.notes.earlier(n, m);
        ring.put(m, held, due);
    }
}
